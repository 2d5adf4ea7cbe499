//! `bcap gateway` between a PLC (`bcap rac`) and a robot (`bcap sim`), as processes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::running::Running;
use crate::common::{bcap, command};
use bcap_tests::process::Signal;
use bcap_tests::pymodbus::Pymodbus;
use bcap_tests::tools;
use serde_json::Value;

const NOT_CONNECTED: &str = "-2147481342\r";

/// Starts a virtual controller at an address.
fn sim(bcap: &str) -> Running {
    Running::of(&mut command(&["sim", "--bcap", bcap, "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"]))
}

fn gateway(robot: &str, more: &[&str]) -> Running {
    Running::gateway_to(&format!("tcp:{robot}"), more)
}

/// A PLC: a connection that sends lines and reads answers.
struct Plc {
    stream: BufReader<TcpStream>,
}

impl Plc {
    fn connect(gateway: &Running) -> Self {
        let stream = TcpStream::connect(gateway.address("rac")).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self { stream: BufReader::new(stream) }
    }

    fn ask(&mut self, line: &str) -> String {
        self.stream.get_mut().write_all(line.as_bytes()).unwrap();
        let mut answer = Vec::new();
        self.stream.read_until(b'\r', &mut answer).unwrap();
        String::from_utf8(answer).unwrap()
    }
}

/// Starts a gateway and waits until its robot is connected.
fn up(robot: &str, more: &[&str]) -> Running {
    let mut gateway = self::gateway(robot, more);
    gateway.log("robot_up");
    gateway
}

/// A variable of each kind, and a value.
const KINDS: [(&str, &str); 9] = [
    ("I1", "-5"),
    ("F2", "-0.1"),
    ("D3", "0.1"),
    ("S4", "hello, world"),
    ("V5", "-1.5,0,0.25"),
    ("P6", "400,0,300.5,180,0,180,5"),
    ("J7", "1,2,3,4,5,6,7,8"),
    ("T8", "1,2,3,4,5,6,7,8,9,5"),
    ("IO128", "true"),
];

#[test]
fn clients_of_other_networks_are_reset_and_rules_for_networks_apply() {
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("rules.toml");
    let put = |clients: &str, index| format!("[[put]]\nkind = \"I\"\nindex = {index}\nclients = \"{clients}\"\n");
    let file = ["clients = [\"10.0.0.0/24\"]\n", &put("127.0.0.1", 1), &put("127.0.0.2", 2)].concat();
    std::fs::write(&rules, file).unwrap();
    let rules = rules.to_str().unwrap();
    // no robot: a request that the rules allow is answered so
    let mut gateway = self::gateway("127.0.0.1:1", &["--rules", rules]);
    // a reset may arrive before the connection is used
    let refused = TcpStream::connect(gateway.address("rac")).and_then(|mut plc| plc.read(&mut [0]));
    assert_eq!(refused.unwrap_err().kind(), std::io::ErrorKind::ConnectionReset);
    let denied = gateway.log("denied");
    assert_eq!(denied["reason"], "the rules do not allow this address to connect");
    assert!(denied["client"].as_str().unwrap().starts_with("127.0.0.1:"), "{denied}");

    let gateway = self::gateway("127.0.0.1:1", &["--rules", rules, "--clients", "10.0.1.7,127.0.0.0/8"]);
    let mut plc = Plc::connect(&gateway);
    assert_eq!(plc.ask("PUT:RC8:1:I:3,5\r"), NOT_CONNECTED);
    assert_eq!(plc.ask("PUT:RC8:2:I:3,5\r"), "-2147024891\r", "the rule is for another client");
}

#[test]
fn all_kinds_can_be_read_and_only_allowed_kinds_written() {
    let sim = self::sim("127.0.0.1:0");
    let robot = sim.address("bcap");
    let mut read_only = up(&robot, &[]);
    let writing = up(&robot, &["--allow-put", "I,F,D,S,V", "--allow-put", "P,J,T,IO/128-143"]);
    for (name, value) in KINDS {
        let refused = read_only.rac(&["put", name, value]);
        assert!(refused.code == 1 && refused.err.contains("E_ACCESSDENIED"), "{refused:?}");
        let put = writing.rac(&["put", name, value]);
        assert_eq!((put.out, put.code), (format!("{name} = {value}\n"), 0), "{}", put.err);
        for gateway in [&read_only, &writing] {
            let get = gateway.rac(&["get", name]);
            assert_eq!((get.out, get.code), (format!("{name} = {value}\n"), 0), "{}", get.err);
        }
        // the robot has the value
        let get = bcap(&["get", name, "--robot", &format!("tcp:{robot}")]);
        assert_eq!(get.out, format!("{name} = {value}\n"));
    }
    assert!(writing.rac(&["put", "IO144", "-1"]).err.contains("E_ACCESSDENIED"));
    let missing = read_only.rac(&["get", "I100"]);
    assert!(missing.code == 1 && missing.err.contains("DISP_E_BADINDEX"), "{missing:?}");
    let refused = read_only.log("refused");
    assert_eq!(refused["line"], "PUT:RC8:1:I:3,-5");
    assert_eq!(refused["name"], "E_ACCESSDENIED");
    assert!(refused["client"].as_str().unwrap().starts_with("127.0.0.1:"));
}

#[test]
fn a_file_of_rules_limits_writes() {
    let path = std::env::temp_dir().join(format!("bcap-gateway-{}.toml", std::process::id()));
    let rules = "\
        convert = true\n\
        [[put]]\nkind = \"I\"\nindex = [10, 19]\nvalues = [-10, 10]\n\
        [[put]]\nkind = \"F\"\n\
        [[get]]\nkind = \"I\"\n";
    std::fs::write(&path, rules).unwrap();
    let sim = self::sim("127.0.0.1:0");
    let gateway = up(&sim.address("bcap"), &["--rules", path.to_str().unwrap()]);
    let mut plc = Plc::connect(&gateway);
    for (line, answer) in [
        ("PUT:RC8:10:I:3,-10\r", "0\r"),
        ("PUT:RC8:10:I:3,11\r", "-2147024809\r"),
        ("PUT:RC8:20:I:3,1\r", "-2147024891\r"),
        ("PUT:RC8:1:D:5,1\r", "-2147024891\r"),
        ("PUT:RC8:1:F:3,5\r", "0\r"),
        ("PUT:RC8:1:F:5,0.1\r", "-2147418109\r"),
        ("GET:RC8:10:I:\r", "0,3,-10\r"),
        ("GET:RC8:1:F:\r", "-2147024891\r"),
    ] {
        assert_eq!(plc.ask(line), answer, "{line}");
    }
    std::fs::write(&path, "puts = 3\n").unwrap();
    let run = bcap(&["gateway", "--rules", path.to_str().unwrap()]);
    assert!(run.code == 2 && run.err.contains("puts"), "{run:?}");
    std::fs::remove_file(&path).unwrap();
    let run = bcap(&["gateway", "--allow-put", "X"]);
    assert!(run.code == 2 && run.err.contains("I F D S V P J T IO"), "{run:?}");
    let run = bcap(&["gateway", "--allow-put", "F,I/3-1"]);
    let error = "\"I/3-1\": invalid index range 3-1: the first index is above the last, at column 3";
    assert!(run.code == 2 && run.err.contains(error), "{run:?}");
}

#[test]
fn the_robot_is_reached_over_udp_too() {
    let sim = self::sim("127.0.0.1:0");
    let robot = format!("udp:{}", sim.address("udp"));
    let mut gateway = Running::gateway_to(&robot, &["--allow-put", "V/7=0..1,-5..5,I"]);
    assert_eq!(gateway.log("robot_up")["robot"], robot);
    let mut plc = Plc::connect(&gateway);
    assert_eq!(plc.ask("PUT:RC8:7:V:8196,1,-5,5\r"), "0\r");
    assert_eq!(plc.ask("PUT:RC8:7:V:8196,2,-5,5\r"), "-2147024809\r");
    assert_eq!(plc.ask("PUT:RC8:1:I:3,5\r"), "0\r");
    assert_eq!(bcap(&["get", "I1", "V7", "--robot", &robot]).out, "I1 = 5\nV7 = 1,-5,5\n");
    drop(sim);
    assert_eq!(gateway.log("robot_down")["robot"], robot);
    assert_eq!(plc.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
}

/// A client chooses the text of its lines; a terminal that shows the log must not act on them.
#[test]
fn lines_in_the_log_are_escaped() {
    let mut gateway = self::gateway("127.0.0.1:9", &[]);
    let line = "GET:\u{9b}31m\u{202e}";
    Plc::connect(&gateway).ask(&format!("{line}\r"));
    let mut raw = String::new();
    while !raw.contains("\"refused\"") {
        raw.clear();
        gateway.out.read_line(&mut raw).unwrap();
    }
    assert!(raw.contains("\"line\":\"GET:\\u009b31m\\u202e\""), "{raw}");
    assert_eq!(serde_json::from_str::<Value>(&raw).unwrap()["line"], line);
}

#[test]
fn invalid_lines_are_answered_and_the_session_continues() {
    let sim = self::sim("127.0.0.1:0");
    let mut gateway = up(&sim.address("bcap"), &[]);
    let mut plc = Plc::connect(&gateway);
    let long = format!("GET:RC8:1:I:{}\r", " ".repeat(287));
    assert_eq!(long.len(), 300);
    for (line, answer, reason) in [
        ("HELLO\r", "-2147418107\r", "column 1"),
        ("GET:RC9:1:I:\r", "-2147418107\r", "column 5"),
        ("GET:RC8:x:I:\r", "-2147024809\r", "column 9"),
        ("PUT:RC8:1:I:3,x\r", "-2147418109\r", "column 15"),
        (long.as_str(), "-2147418095\r", "256"),
    ] {
        assert_eq!(plc.ask(line), answer, "{line}");
        assert_eq!(plc.ask("GET:RC8:1:I:\r"), "0,3,0\r", "after {line}");
        let refused = gateway.log("refused");
        let logged = refused["line"].as_str().unwrap();
        assert!(line.starts_with(logged) && logged.len() >= (line.len() - 1).min(256), "{refused}");
        let because = refused["reason"].as_str().unwrap();
        assert!(because.contains(reason), "{because}");
    }
}

#[test]
fn a_disconnected_robot_gives_an_error_at_once_and_service_resumes_after_reconnecting() {
    // a free port, on which the robot will listen later
    let robot = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let mut gateway = self::gateway(&robot, &["--allow-put", "I"]);
    let down = gateway.log("robot_down");
    assert_eq!(down["retry_ms"], 500);
    assert!(down["reason"].as_str().unwrap().contains("refused"), "{down}");
    let mut plc = Plc::connect(&gateway);
    assert_eq!(plc.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
    let sim = self::sim(&robot);
    gateway.log("robot_up");
    assert_eq!(plc.ask("PUT:RC8:1:I:3,7\r"), "0\r");
    drop(sim);
    let down = gateway.log("robot_down");
    assert_eq!(down["retry_ms"], 500, "pauses begin anew after a session");
    assert!(down["reason"].as_str().unwrap().to_lowercase().contains("connection"), "{down}");
    assert_eq!(plc.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
}

#[cfg(unix)]
#[test]
fn signals_end_the_gateway_with_0_and_the_log_with_totals() {
    let sim = self::sim("127.0.0.1:0");
    for signal in [Signal::INT, Signal::TERM] {
        let mut gateway = up(&sim.address("bcap"), &[]);
        let mut plc = Plc::connect(&gateway);
        assert_eq!(plc.ask("GET:RC8:1:I:\r"), "0,3,0\r");
        assert_eq!(plc.ask("PUT:RC8:1:I:3,1\r"), "-2147024891\r");
        let rest = gateway.end(signal);
        let last: Value = serde_json::from_str(rest.lines().last().unwrap()).unwrap();
        assert_eq!(last["event"], "end");
        assert_eq!((&last["served"]["count"], &last["refused"], &last["sessions"]), (&1.into(), &1.into(), &1.into()));
        assert!(last["served"]["p99_us"].as_u64().unwrap() <= last["served"]["max_us"].as_u64().unwrap());
    }
}

/// A line of two bytes takes about 200 bytes in the log, so the number of lines is limited and omitted lines are counted.
#[test]
#[cfg(unix)]
fn a_flood_of_wrong_lines_is_counted_in_the_log() {
    const LINES: u64 = 20_000;
    let mut gateway = self::gateway("127.0.0.1:9", &[]);
    let begun = Instant::now();
    let mut flood = TcpStream::connect(gateway.address("rac")).unwrap();
    let mut answers = flood.try_clone().unwrap();
    let writer = std::thread::spawn(move || flood.write_all("X\r".repeat(LINES as usize).as_bytes()).unwrap());
    let (mut answered, mut buffer) = (0, [0; 1 << 16]);
    while answered < LINES {
        let count = answers.read(&mut buffer).unwrap();
        assert!(count > 0, "the connection is kept");
        answered += buffer[..count].iter().filter(|byte| **byte == b'\r').count() as u64;
    }
    writer.join().unwrap();
    let seconds = begun.elapsed().as_secs() + 1;
    let log = gateway.end(Signal::TERM);
    let records: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let refused = records.iter().filter(|record| record["event"] == "refused").count() as u64;
    let suppressed = records.iter().filter(|record| record["event"] == "suppressed");
    let suppressed: u64 = suppressed
        .inspect(|record| assert_eq!(record["client"], "127.0.0.1"))
        .map(|r| r["lines"].as_u64().unwrap())
        .sum();
    assert!(refused >= 50 && refused <= 100 + 10 * seconds, "{refused} lines in {seconds} s");
    // besides the refusals, connecting and disconnecting give a line each
    assert!((LINES..=LINES + 2).contains(&(refused + suppressed)), "{refused} and {suppressed}");
    assert_eq!(records.last().unwrap()["refused"], LINES, "the totals count all of them");
}

/// Writes change the robot, so each successful write is in the log, even during a flood of other requests.
#[test]
#[cfg(unix)]
fn every_successful_write_is_logged() {
    let sim = self::sim("127.0.0.1:0");
    let mut gateway = up(&sim.address("bcap"), &["--allow-put", "I", "--audit-rate", "1"]);
    let mut plc = Plc::connect(&gateway);
    for n in 0..50 {
        assert_eq!(plc.ask("GET:RC8:1:I:\r"), if n == 0 { "0,3,0\r".into() } else { format!("0,3,{}\r", n - 1) });
        assert_eq!(plc.ask(&format!("PUT:RC8:1:I:3,{n}\r")), "0\r");
    }
    let log = gateway.end(Signal::TERM);
    for n in 0..50 {
        assert!(log.contains(&format!("\"line\":\"PUT:RC8:1:I:3,{n}\"")), "{n} in {log}");
    }
    assert!(log.contains("\"event\":\"suppressed\""), "{log}");
}

#[test]
fn one_address_cannot_exceed_its_share_of_the_slots() {
    let gateway = self::gateway("127.0.0.1:9", &[]);
    let mut connected: Vec<Plc> = (0..16).map(|_| Plc::connect(&gateway)).collect();
    for plc in &mut connected {
        assert_eq!(plc.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
    }
    assert_eq!(Plc::connect(&gateway).ask("GET:RC8:1:I:\r"), "-2147481333\r", "E_MAX_CONNECT");
    // another address has its own share
    #[cfg(target_os = "linux")]
    {
        let address = socket2::SockAddr::from("127.0.0.2:0".parse::<std::net::SocketAddr>().unwrap());
        let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).unwrap();
        socket.bind(&address).unwrap();
        socket.connect(&gateway.address("rac").parse::<std::net::SocketAddr>().unwrap().into()).unwrap();
        let mut other = Plc { stream: BufReader::new(socket.into()) };
        assert_eq!(other.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
    }
}

#[test]
fn the_longest_idle_connection_is_evicted_for_a_new_one() {
    let gateway = self::gateway("127.0.0.1:9", &["--clients-per-address", "2", "--evict-after", "0"]);
    let mut plcs = [(); 2].map(|()| Plc::connect(&gateway));
    // the second connection is idle longest
    for n in [0, 1, 0] {
        assert_eq!(plcs[n].ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
    }
    let mut late = Plc::connect(&gateway);
    assert_eq!(late.ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
    assert_eq!(plcs[1].stream.read(&mut [0; 1]).unwrap(), 0, "it is closed");
    assert_eq!(plcs[0].ask("GET:RC8:1:I:\r"), NOT_CONNECTED);
}

#[test]
fn an_address_in_use_is_reported() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let run = bcap(&["gateway", "--rac", &address]);
    assert_eq!((run.out.as_str(), run.code), ("", 3));
    assert!(run.err.contains(&address) && run.err.contains("--rac"), "{}", run.err);
}

/// A gateway with Modbus: its map is in a file and on the command line.
fn with_modbus(name: &str, robot: &str) -> Running {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let rules = "register = [\"100=I/10-20:i16\", \"200=F/1:low\"]\n\
                 [[put]]\nkind = \"I\"\nindex = [10, 19]\nvalues = [-100, 100]\n[[put]]\nkind = \"F\"\nindex = 1\n";
    std::fs::write(&file, rules).unwrap();
    let modbus = ["--modbus", "127.0.0.1:0", "--rules", file.to_str().unwrap()];
    up(robot, &[&modbus[..], &["--coil", "0=IO/128-143", "--allow-put", "IO/128-135"]].concat())
}

#[test]
fn clients_of_modbus_read_and_write_what_the_rules_allow() {
    let sim = self::sim("127.0.0.1:0");
    let mut gateway = with_modbus("gateway-modbus.toml", &sim.address("bcap"));
    let mut stream = TcpStream::connect(gateway.address("modbus")).unwrap();
    let mut ask = |request: &[u8], response: &[u8]| {
        let length = u8::try_from(request.len() + 1).unwrap();
        stream.write_all(&[&[0, 7, 0, 0, 0, length, 1], request].concat()).unwrap();
        let mut found = vec![0; 7 + response.len()];
        stream.read_exact(&mut found).unwrap();
        assert_eq!(found[7..], *response, "{request:?}");
    };
    ask(&[16, 0, 100, 0, 2, 4, 0, 7, 0xff, 0xff], &[16, 0, 100, 0, 2]);
    ask(&[3, 0, 100, 0, 3], &[3, 6, 0, 7, 0xff, 0xff, 0, 0]);
    ask(&[6, 0, 100, 0, 101], &[0x86, 3]);
    ask(&[5, 0, 1, 0xff, 0], &[5, 0, 1, 0xff, 0]);
    ask(&[1, 0, 0, 0, 3], &[1, 1, 2]);
    ask(&[5, 0, 8, 0xff, 0], &[0x85, 2]);
    ask(&[3, 0, 0, 0, 1], &[0x83, 2]);
    assert_eq!(gateway.rac(&["get", "I11"]).out, "I11 = -1\n");
    assert_eq!(gateway.rac(&["get", "IO129"]).out, "IO129 = true\n");
    for (line, name) in [("PUT:RC8:10:I:3,101", "E_INVALIDARG"), ("PUT:RC8:136:IO:11,-1", "E_ACCESSDENIED")] {
        let refused = gateway.log("refused");
        assert_eq!((refused["line"].as_str(), refused["name"].as_str()), (Some(line), Some(name)));
    }
    assert_eq!(gateway.log("refused")["line"], "MODBUS:3:0:1");
}

#[test]
fn a_client_of_modbus_of_another_make_reads_and_writes_variables() {
    let pymodbus = match Pymodbus::find(Path::new(env!("CARGO_TARGET_TMPDIR"))) {
        Ok(pymodbus) => pymodbus,
        Err(why) => return tools::missing(&why),
    };
    let sim = self::sim("127.0.0.1:0");
    let gateway = with_modbus("gateway-pymodbus.toml", &sim.address("bcap"));
    let exchanges = [
        ("client.write_registers(100, [7, 65535, 9])", "ok"),
        ("client.read_holding_registers(100, count=3)", "[7, 65535, 9]"),
        ("client.read_input_registers(102, count=1)", "[9]"),
        ("client.write_register(103, 101)", "exception 3"),
        ("client.write_register(110, 1)", "exception 2"),
        ("client.write_registers(200, [0, 0x3fc0])", "ok"),
        ("client.read_holding_registers(200, count=2)", "[0, 16320]"),
        ("client.write_coils(1, [True, False, True])", "ok"),
        ("client.read_coils(0, count=8)", "[False, True, False, True, False, False, False, False]"),
        ("client.write_coil(8, True)", "exception 2"),
        ("client.mask_write_register(address=100, and_mask=0x04, or_mask=0x10)", "ok"),
        ("client.readwrite_registers(read_address=100, read_count=3, write_address=102, values=[1])", "[20, 65535, 1]"),
        ("client.read_device_information(object_id=0)", "{0: b'bcap', 1: b'bcap-gateway', 2: b'0.1.0'}"),
    ];
    pymodbus.check(&gateway.address("modbus"), &exchanges);
    assert_eq!(gateway.rac(&["get", "F1"]).out, "F1 = 1.5\n");
}

/// The settings of the page about fieldbuses, as options of `bcap gateway`.
fn fieldbus_options() -> Vec<String> {
    let page = include_str!("../../../docs/fieldbus.md");
    let (_, settings) = page.split_once("\n```text\n").unwrap();
    let (settings, _) = settings.split_once("```").unwrap();
    let option = |line: &str| {
        let (key, value) = line.split_once('=').unwrap();
        match key {
            "modbus" => ["--modbus".to_owned(), "127.0.0.1:0".to_owned()],
            "put" => ["--allow-put".to_owned(), value.to_owned()],
            _ => [format!("--{key}"), value.to_owned()],
        }
    };
    assert!(bcap_board::Settings::check(settings.as_bytes()).is_ok(), "a board takes them, too");
    settings.lines().flat_map(option).collect()
}

#[test]
fn a_converter_of_a_fieldbus_exchanges_the_blocks_of_the_page() {
    let pymodbus = match Pymodbus::find(Path::new(env!("CARGO_TARGET_TMPDIR"))) {
        Ok(pymodbus) => pymodbus,
        Err(why) => return tools::missing(&why),
    };
    let sim = self::sim("127.0.0.1:0");
    for (variable, value) in [("I10", "-7"), ("I14", "4"), ("F10", "1.5"), ("IO129", "true")] {
        let run = bcap(&["put", "--robot", &format!("tcp:{}", sim.address("bcap")), variable, value]);
        assert_eq!(run.code, 0, "{run:?}");
    }
    let options = fieldbus_options();
    let gateway = up(&sim.address("bcap"), &options.iter().map(String::as_str).collect::<Vec<_>>());
    let cycle = [
        ("client.read_holding_registers(100, count=5)", "[65529, 0, 0, 0, 4]"),
        ("client.read_holding_registers(110, count=4)", "[16320, 0, 0, 0]"),
        ("client.read_coils(0, count=8)", "[False, True, False, False, False, False, False, False]"),
        ("client.write_registers(200, [1000, 2, 3, 1])", "ok"),
    ];
    let more = [
        // a value out of its range: no variable of the request is written
        ("client.write_registers(200, [5, 5, 1001, 2])", "exception 3"),
        ("client.read_holding_registers(200, count=4)", "[1000, 2, 3, 1]"),
        // the PLC stops
        ("client.write_registers(200, [0, 0, 0, 0])", "ok"),
        ("client.write_registers(100, [1, 1, 1, 1, 1])", "exception 2"),
        // a block with a gap
        ("client.read_holding_registers(100, count=14)", "exception 2"),
    ];
    let exchanges: Vec<_> = cycle.iter().cycle().take(40).chain(&more).copied().collect();
    pymodbus.check(&gateway.address("modbus"), &exchanges);
    assert_eq!(gateway.rac(&["get", "I20"]).out, "I20 = 0\n");
}

#[test]
fn modbus_without_a_valid_map_is_refused() {
    for (args, error) in [
        (&[][..], "--modbus needs a map of registers or coils"),
        (&["--register", "1=S/1"], "a variable of kind S cannot be in registers"),
        (
            &["--register", "0=I/0-9", "--register", "19=I/10"],
            "the map of Modbus has register 19 in two entries, 0=I/0-9 and 19=I/10",
        ),
    ] {
        let run = bcap(&[&["gateway", "--rac", "127.0.0.1:0", "--modbus", "127.0.0.1:0"], args].concat());
        assert_eq!((run.out.as_str(), run.code), ("", 2), "{}", run.err);
        assert!(run.err.contains(error), "{}", run.err);
    }
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let run = bcap(&["gateway", "--rac", "127.0.0.1:0", "--modbus", &address, "--coil", "0=IO/1"]);
    assert_eq!((run.out.as_str(), run.code), ("", 3));
    assert!(run.err.contains(&address) && run.err.contains("--modbus"), "{}", run.err);
}
