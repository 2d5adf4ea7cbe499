//! The recordings in `docs/screens`: the terminal of `bcap shell`, `bcap monitor`, `bcap jog`, `bcap sim --screen` and
//! `bcap-fleet --screen`, as text. It needs tmux, and Mosquitto for the fleet.
//!
//! `BLESS=1 cargo test -p bcap-cli screens::` writes them. The test compares what does not change from run to run: numbers,
//! sparklines and blanks are left out.

use std::fs;
use std::path::Path;

use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;
use crate::common::{bare, bcap, fleet_program};
use bcap_tests::mosquitto::Mosquitto;

const SIZES: [(u16, u16); 2] = [(80, 24), (200, 50)];
/// With a size between them.
const THREE: [(u16, u16); 3] = [(100, 30), SIZES[0], SIZES[1]];

/// Compares a screen with its recording, or writes it.
#[track_caller]
fn recorded(name: &str, size: (u16, u16), screen: &str) {
    recorded_rows(usize::MAX, name, size, screen);
}

/// As `recorded`, but compares only the first rows.
#[track_caller]
fn recorded_rows(rows: usize, name: &str, (width, height): (u16, u16), screen: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../docs/screens/{name}-{width}x{height}.txt"));
    if std::env::var_os("BLESS").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, screen).unwrap();
    }
    let recording = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(screen.lines().count(), usize::from(height), "{screen}");
    let hint = "BLESS=1 records it again";
    let [shown, recording] =
        [screen, &recording].map(|text| stable(text).lines().take(rows).collect::<Vec<_>>().join("\n"));
    assert_eq!(shown, recording, "{hint}:\n{screen}");
}

/// Returns a screen without what changes from run to run.
fn stable(screen: &str) -> String {
    let is_bar = |c: char| ('▁'..='█').contains(&c);
    // the order of the events of a fleet is not the same in each run
    let is_event = |line: &str| line.contains(" is connected") || line.contains(" is disconnected");
    let line = |line: &str| {
        let line = if is_event(line) { "event" } else { line };
        let words: Vec<String> = line
            .replace(is_bar, " ")
            .split_whitespace()
            .map(|word| {
                word.split(|c: char| c.is_ascii_digit()).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("#")
            })
            .collect();
        words.join(" ")
    };
    screen.lines().map(line).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_monitor() {
    for size in THREE {
        let folder = tempfile::tempdir().unwrap();
        let scenario = folder.path().join("scenario.toml");
        let message = "[[fault]]\nwhen = { call = 30, of = \"Variable_GetValue\" }\nthen = { message = \"the feeder is empty\" }\n";
        fs::write(&scenario, format!("[controller]\nerrors = [\"0x84201482\"]\n\n{message}")).unwrap();
        let robot = Virtual::start(&["--scenario", scenario.to_str().unwrap()]);
        // a session that a busy machine loses would be opened again, with other packets
        let limits = ["--interval", "50", "--timeout", "20000"];
        let args = [&["monitor", "I1-I3", "F1", "S1", "IO128", "--robot", &robot.tcp][..], &limits].concat();
        let Some(terminal) = Terminal::start(size, &args, folder.path()) else { return };
        terminal.wait_for("Pro1             ready");
        terminal.wait_for("the feeder is empty");
        terminal.wait_for("IO128 = false");
        for value in ["3", "1", "4", "1.5", "9", "2.6"] {
            assert_eq!(robot.run(&["put", "F1", value]).code, 0);
            terminal.wait_for(&format!("F1    = {value} "));
        }
        // in sequence, so that the packets are in this order
        assert_eq!(robot.run(&["put", "I2", "1200"]).code, 0);
        terminal.wait_for("= 1200");
        assert_eq!(robot.run(&["put", "S1", "gripper 2"]).code, 0);
        terminal.wait_for("= gripper 2");
        terminal.wait_until("no marks", |screen| !screen.contains('*'));
        // the mark is shown for 2 s, which may be over when the command has ended
        let put = robot.spawn(&["put", "IO128", "true", "--timeout", "20s"]);
        let screen = terminal.wait_for("*IO128 = true");
        recorded("monitor", size, &screen);
        assert!(put.wait_with_output().unwrap().status.success());
        terminal.keys(&["q"]);
    }
}

#[test]
fn the_calls_by_object() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let args = ["monitor", "I1", "P1", "--packets", "--interval", "50", "--robot", &robot.tcp];
    let Some(terminal) = Terminal::start(SIZES[0], &args, folder.path()) else { return };
    terminal.wait_for("Variable_GetValue @BUSY_STATUS = BOOL(false)");
    terminal.keys(&["End"]);
    terminal.wait_for("Variable_GetValue P1 = ");
    terminal.keys(&["End"]);
    terminal
        .wait_until("the selection", |screen| screen.lines().any(|line| line.contains('>') && line.contains(" P1 = ")));
    assert_eq!(robot.run(&["put", "I1", "12"]).code, 0);
    let screen = terminal.wait_until("the value", |screen| screen.contains("I1 = I4(12)") && !screen.contains('*'));
    // the order of the last packets is not the same in each run
    recorded_rows(18, "packets", SIZES[0], &screen);
    terminal.keys(&["q"]);
}

#[test]
fn the_keys_of_jog() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = Terminal::start(SIZES[0], &["jog", "--robot", &robot.tcp], folder.path()) else { return };
    terminal.wait_for("> J1 =     0.000");
    terminal.keys(&["Right"]);
    let screen = terminal.wait_for("> J1 =     1.000");
    recorded("jog", SIZES[0], &screen);
    terminal.keys(&["q"]);
}

#[test]
fn the_shell() {
    for size in SIZES {
        let robot = Virtual::start(&[]);
        let folder = tempfile::tempdir().unwrap();
        let Some(terminal) = Terminal::start(size, &["shell", "--robot", &robot.tcp], folder.path()) else { return };
        terminal.wait_for("RC8 auto ok>");
        for (line, reply) in [
            ("put I1=5 F1=2.5", "F1 = 2.5\nRC8 auto ok>"),
            ("get I1 F1 robot/@CURRENT_ANGLE", "ANGLE = 0,45,90,0,45,0,0,0\nRC8 auto ok>"),
            ("exec robot TakeArm 0 1", "RC8 auto ok arm>"),
            ("move 'J(10, 45, 90, 0, 45, 0)' --speed 50", "at J(10, 45, 90, 0, 45, 0)\nRC8 auto ok arm motor>"),
            ("put D1 3,14", "RC8 auto ok arm motor>"),
            ("exec robot GiveArm", "RC8 auto ok motor>"),
        ] {
            let before = terminal.screen().matches("RC8 auto").count();
            terminal.enter(line);
            terminal.wait_until(reply, |screen| {
                screen.trim_end().ends_with(reply.lines().last().unwrap_or_default())
                    && screen.contains(reply)
                    && screen.matches("RC8 auto").count() > before
            });
        }
        recorded("shell", size, &terminal.screen());
        terminal.enter("exit");
    }
}

#[test]
fn the_fleet() {
    for size in SIZES {
        let folder = tempfile::tempdir().unwrap();
        let Some(broker) = Mosquitto::open() else { return };
        let robots = [(); 2].map(|()| Virtual::start(&[]));
        let mut config = format!(
            "group = \"plant\"\nnode = \"edge1\"\n[broker]\nhost = \"127.0.0.1\"\nport = {}\n[buffer]\ndirectory = {:?}\n",
            broker.port,
            folder.path().join("buffer")
        );
        // no program listens on port 1
        let addresses = [&robots[0].tcp, &robots[1].tcp, "tcp:127.0.0.1:1"];
        for (number, address) in (1..).zip(addresses) {
            config += &format!("[[controller]]\nname = \"cell{number}\"\naddress = \"{address}\"\n");
            config += "[[controller.publish]]\nnames = [\"I1-9\"]\ninterval_ms = 100\n";
        }
        let file = folder.path().join("fleet.toml");
        fs::write(&file, config).unwrap();
        let program = fleet_program();
        let line = [program.to_str().unwrap(), file.to_str().unwrap(), "--screen"];
        let Some(terminal) = Terminal::run(size, &line, folder.path()) else { return };
        terminal.wait_for("2 of 3 controllers connected, broker connected");
        terminal.wait_for("cell3: ");
        // 80 by 24 has lines for three of the four
        let screen = terminal.wait_until("all events", |screen| {
            let count =
                ["the broker is connected", "cell1 is connected", "cell2 is connected", "cell3 is disconnected"];
            count.iter().filter(|event| screen.contains(*event)).count() >= if size.1 < 50 { 3 } else { 4 }
        });
        recorded("fleet", size, &screen);
        terminal.keys(&["Down"]);
        terminal.wait_for("> cell2");
        drop(broker);
        terminal.wait_for("BROKER DISCONNECTED");
        terminal.keys(&["q"]);
    }
}

#[test]
fn the_virtual_controller() {
    for size in THREE {
        let folder = tempfile::tempdir().unwrap();
        let free = ["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
        let Some(terminal) = Terminal::run(size, &["sh"], folder.path()) else { return };
        terminal.enter(&format!(
            "PS1='ready> '; clear; {} sim --screen {}",
            env!("CARGO_BIN_EXE_bcap"),
            free.join(" ")
        ));
        let screen = terminal.wait_for(" udp=127.0.0.1:");
        let (_, address) = screen.split_once("bcap=").unwrap();
        let address = format!("tcp:{}", address.split_whitespace().next().unwrap());
        let mut client = bare(&["watch", "I1", "--interval", "60s", "--robot", &address]);
        let mut client = client.stdout(std::process::Stdio::null()).spawn().unwrap();
        terminal.wait_for(": Variable_GetValue, 4 calls");
        let refused = bcap(&["call", "Variable_PutValue", "variable:I1", "8,x", "--robot", &address]);
        assert_eq!(refused.code, 1, "{}", refused.err);
        terminal.wait_for("(E_INVALIDARGTYPE)");
        terminal.wait_for("= Service_Stop()");
        let screen = terminal
            .wait_until("one client", |screen| !screen.contains("client 2: Var") && !screen.contains("client 2: Serv"));
        recorded("sim", size, &screen);
        // `a` shows every call, `q` ends the controller and restores the terminal
        terminal.keys(&["a"]);
        terminal.wait_for("calls, all");
        terminal.keys(&["q"]);
        terminal.wait_for("ready>");
        assert_eq!(["alternate_on", "cursor_flag"].map(|name| terminal.variable(name)), ["0", "1"]);
        client.kill().unwrap();
        client.wait().unwrap();
        assert_eq!(bcap(&["get", "I1", "--robot", &address]).code, 3);
    }
}
