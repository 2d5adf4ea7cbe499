//! Tests the gateway board in QEMU between `bcap rac` and `bcap sim`.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_qemu::{Board, Plc, Sim, TIMEOUT, bcap, error, run};

const PROVIDER: &str = "provider=CaoProv.DENSO.VRC";

/// A variable of each kind, and a value.
const KINDS: [(&str, &str); 9] = [
    ("I1", "-5"),
    ("F2", "-0.1"),
    ("D3", "0.1"),
    ("V5", "-1.5,0,0.25"),
    ("P6", "400,0,300.5,180,0,180,5"),
    ("J7", "1,2,3,4,5,6,7,8"),
    ("T8", "1,2,3,4,5,6,7,8,9,5"),
    ("S4", "hello, world"),
    ("IO128", "true"),
];

#[test]
fn all_kinds_are_read_and_none_is_written_unless_a_rule_allows_it() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let robot = format!("tcp:{}", sim.bcap);
    let read_only = Board::start(&sim.bcap, &[], &[PROVIDER]).up();
    let rules = "put=I put=F/2 put=D put=V put=P/6=-400..400 put=J put=T put=S put=IO/128-143";
    let rules: Vec<&str> = [PROVIDER].into_iter().chain(rules.split(' ')).collect();
    let writing = Board::start(&sim.bcap, &[], &rules).up();
    for (name, value) in KINDS {
        let shown = format!("{name} = {value}\n");
        let refused = run(&bcap, &["rac", "put", name, value, "--robot", &read_only.rac]);
        assert!(!refused.ok && refused.err.contains("E_ACCESSDENIED"), "{name}: {refused:?}");
        // the robot has it, and both boards read it
        let put = run(&bcap, &["put", name, value, "--robot", &robot]);
        assert_eq!((&put.out, put.ok), (&shown, true), "{}", put.err);
        for board in [&read_only, &writing] {
            let get = run(&bcap, &["rac", "get", name, "--robot", &board.rac]);
            assert_eq!((&get.out, get.ok), (&shown, true), "{}", get.err);
        }
        // one of them may write it, and then the robot has that
        let (zero, other) = other(name);
        let shown = format!("{name} = {other}\n");
        let put = run(&bcap, &["rac", "put", name, zero, "--robot", &writing.rac]);
        assert!(put.ok, "{}", put.err);
        let put = run(&bcap, &["rac", "put", name, other, "--robot", &writing.rac]);
        assert_eq!((&put.out, put.ok), (&shown, true), "{}", put.err);
        let get = run(&bcap, &["get", name, "--robot", &robot]);
        assert_eq!((&get.out, get.ok), (&shown, true), "{}", get.err);
    }
    // variables without a rule
    for name in ["IO144", "F3", "P7"] {
        let (_, value) = other(name);
        let refused = run(&bcap, &["rac", "put", name, value, "--robot", &writing.rac]);
        assert!(!refused.ok && refused.err.contains("E_ACCESSDENIED"), "{name}: {refused:?}");
    }
    let refused = run(&bcap, &["rac", "put", "P6", "401,0,0,0,0,0,0", "--robot", &writing.rac]);
    assert!(!refused.ok && refused.err.contains("E_INVALIDARG"), "{refused:?}");
    // the robot's refusal passes through
    let missing = run(&bcap, &["rac", "get", "I100", "--robot", &read_only.rac]);
    assert!(!missing.ok && missing.err.contains("DISP_E_BADINDEX"), "{missing:?}");
    if read_only.log_is_text {
        let line = read_only.log_line(&["refused", "PUT:RC8:1:I:3,-5"]);
        assert!(line.contains("10.0.2.2:") && line.contains("ReadOnly"), "{line}");
        assert!(writing.log_line(&["refused", "PUT:RC8:144:IO:"]).contains("Index"));
    }
}

/// Two values of a variable that differ, within its rule.
fn other(name: &str) -> (&'static str, &'static str) {
    match name.trim_end_matches(|c: char| c.is_ascii_digit()) {
        "V" => ("0,0,0", "1,2,3.5"),
        "P" => ("0,0,0,0,0,0,0", "1,2,3,4,5,6,7"),
        "J" => ("0,0,0,0,0,0,0,0", "8,7,6,5,4,3,2,1"),
        "T" => ("0,0,0,0,0,0,0,0,0,0", "9,8,7,6,5,4,3,2,1,0"),
        "IO" => ("true", "false"),
        "F" | "D" => ("0", "-2.5"),
        _ => ("0", "1234567"),
    }
}

#[test]
fn wrong_lines_are_answered_and_the_session_lives() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let rules = [PROVIDER, "put=I/10-19=-10..10", "put=F", "get=I", "get=F", "convert=yes"];
    let board = Board::start(&sim.bcap, &[], &rules).up();
    let mut plc = Plc::connect(&board.rac);
    let long = format!("GET:RC8:1:I:{}\r", " ".repeat(287));
    assert_eq!(long.len(), 300);
    let longer = format!("{}\r", "X".repeat(5000));
    for (line, code) in [
        ("HELLO\r", HResult::E_INVALIDCOMMAND),
        ("\r", HResult::E_INVALIDCOMMAND),
        ("GET:RC9:1:I:\r", HResult::E_INVALIDCOMMAND),
        ("GET:RC8:x:I:\r", HResult::E_INVALIDARG),
        ("GET:RC8:1:D:\r", HResult::E_ACCESSDENIED),
        ("PUT:RC8:10:I:3,x\r", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:10:I:3,11\r", HResult::E_INVALIDARG),
        ("PUT:RC8:20:I:3,1\r", HResult::E_ACCESSDENIED),
        ("PUT:RC8:1:F:5,0.1\r", HResult::E_INVALIDARGTYPE),
        (long.as_str(), HResult::E_PACKETSIZEOVER),
        (longer.as_str(), HResult::E_PACKETSIZEOVER),
    ] {
        assert_eq!(plc.ask(line), error(code), "{line:?}");
        assert_eq!(plc.ask("GET:RC8:1:I:\r"), "0,3,0\r", "after {line:?}");
    }
    // a value of another type, without loss
    assert_eq!(plc.ask("PUT:RC8:1:F:3,5\r"), "0\r");
    assert_eq!(plc.ask("GET:RC8:1:F:\r"), "0,4,5\r");
    // several lines together, and one in pieces
    plc.send(b"PUT:RC8:10:I:3,7\rNONSENSE\rGET:RC8:10:I:\rGET:RC");
    for answer in ["0\r", &error(HResult::E_INVALIDCOMMAND), "0,3,7\r"] {
        assert_eq!(plc.answer().unwrap(), answer);
    }
    assert_eq!(plc.ask("8:10:I:\r"), "0,3,7\r");
    if board.log_is_text {
        for (line, reason) in [("HELLO", "column"), ("PUT:RC8:10:I:3,11", "Value"), ("GET:RC8:1:D:", "Kind")] {
            let logged = board.log_line(&["refused", line]);
            assert!(logged.contains("10.0.2.2:"), "{logged}");
            assert!(logged.contains(reason), "{logged}");
        }
        let status = board.log_line(&["up ", "served", "refused", "stack"]);
        let stack = status.rsplit("stack ").next().and_then(|rest| rest.split(' ').next()).unwrap();
        let stack: u32 = stack.parse().unwrap();
        assert!((1000..=8192).contains(&stack), "{status}");
        show(&format!("the board says: {status}"));
    }
}

/// Prints a line that is shown even if the test passes.
fn show(text: &str) {
    let _ = io::Write::write_all(&mut io::stderr(), format!("{text}\n").as_bytes());
}

#[test]
fn four_plcs_are_served_at_once_and_a_fifth_replaces_an_idle_one() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let board = Board::start(&sim.bcap, &[], &[PROVIDER, "put=I", "rate=1/2", "evict=5"]).up();
    let mut served = [(); 4].map(|()| Plc::connect_when_free(&board.rac));
    // the four may wait for tokens, but none is idle
    for plc in &mut served {
        let _ = plc.ask("GET:RC8:1:I:\r");
    }
    let mut late = Plc::connect(&board.rac);
    assert_eq!(late.ask("GET:RC8:1:I:\r"), error(HResult::E_MAX_CONNECT));
    assert!(late.answer().is_err(), "the connection is closed");
    // each sends more requests than its rate allows, and only the excess is refused
    for plc in &mut served {
        plc.send(b"GET:RC8:1:I:\rGET:RC8:1:I:\rGET:RC8:1:I:\rGET:RC8:1:I:\r");
        let answers: Vec<String> = (0..4).map(|_| plc.answer().unwrap()).collect();
        let busy = error(HResult::E_BUSY_PROC);
        assert!(answers.iter().all(|answer| answer == "0,3,0\r" || *answer == busy), "{answers:?}");
        assert!(answers.contains(&busy), "{answers:?}");
    }
    // four clients that no longer send do not block other clients
    let mut next = Plc::connect_when_free(&board.rac);
    assert_ne!(next.ask("GET:RC8:1:I:\r"), error(HResult::E_MAX_CONNECT));
    assert!(served.iter_mut().any(|plc| plc.answer().is_err()), "one of them was disconnected");
    drop(served);
    let _ = board.up();
}

#[test]
fn clients_of_other_networks_have_no_access_or_other_rules() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    // all connections are from 10.0.2.2
    let rules = [PROVIDER, "allow=10.0.2.0/24", "put=I/1", "put@10.0.2.2=I/2", "put@10.0.2.3=I/3", "idle=10"];
    let board = Board::start(&sim.bcap, &[], &rules).up();
    let mut plc = Plc::connect_when_free(&board.rac);
    assert_eq!(plc.ask("PUT:RC8:1:I:3,5\r"), "0\r");
    assert_eq!(plc.ask("PUT:RC8:2:I:3,5\r"), "0\r");
    assert_eq!(plc.ask("PUT:RC8:3:I:3,5\r"), error(HResult::E_ACCESSDENIED));
    assert!(plc.answer().is_err(), "idle connections are closed");
    let board = Board::start(&sim.bcap, &[], &[PROVIDER, "allow=10.0.3.0/24", "allow=10.0.2.3"]);
    if board.log_is_text {
        let _ = board.log_line(&["robot up"]);
        assert!(Plc::connect(&board.rac).try_ask("GET:RC8:1:I:\r").is_err());
        let _ = board.log_line(&["not served", "Address"]);
    }
}

#[test]
fn a_robot_is_reached_over_udp_as_well() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let board = Board::start(&sim.udp, &["--udp"], &["put=I", PROVIDER]).up();
    let mut plc = Plc::connect(&board.rac);
    for value in 0..50 {
        assert_eq!(plc.ask(&format!("PUT:RC8:9:I:3,{value}\r")), "0\r");
        assert_eq!(plc.ask("GET:RC8:9:I:\r"), format!("0,3,{value}\r"));
    }
    let get = run(&bcap, &["get", "I9", "--robot", &format!("tcp:{}", sim.bcap)]);
    assert_eq!(get.out, "I9 = 49\n");
}

/// The observations of a PLC under load.
#[derive(Default)]
struct Seen {
    served: AtomicU32,
    away: AtomicU32,
    timed_out: AtomicU32,
    /// Maximum wait for E_NOT_CONNECTED, in microseconds.
    longest: AtomicU32,
    stop: AtomicBool,
}

impl Seen {
    fn not_connected(&self, after: Duration) {
        self.away.fetch_add(1, Ordering::Relaxed);
        self.longest.fetch_max(u32::try_from(after.as_micros()).unwrap_or(u32::MAX), Ordering::Relaxed);
    }
}

/// Puts unique numbers, reads them back and counts the outcomes, until it is stopped.
fn load(address: &str, plc: u32, seen: &Arc<Seen>) -> JoinHandle<()> {
    let (mut connection, seen) = (Plc::connect_when_free(address), Arc::clone(seen));
    std::thread::spawn(move || {
        let (not_connected, timeout) = (error(HResult::E_NOT_CONNECTED), error(HResult::E_TIMEOUT));
        let mut ask = |line: &str| {
            let since = Instant::now();
            let answer = connection.ask(line);
            if answer == not_connected {
                seen.not_connected(since.elapsed());
                return None;
            }
            if answer == timeout {
                seen.timed_out.fetch_add(1, Ordering::Relaxed);
                return None;
            }
            Some(answer)
        };
        let mut request = 0;
        while !seen.stop.load(Ordering::Relaxed) {
            request += 1;
            let (index, number) = (plc * 20 + request % 20, plc * 100_000_000 + request);
            let Some(put) = ask(&format!("PUT:RC8:{index}:I:3,{number}\r")) else { continue };
            assert_eq!(put, "0\r");
            // no other client writes there, and a robot that was started again in between would have been missed
            let Some(get) = ask(&format!("GET:RC8:{index}:I:\r")) else { continue };
            assert_eq!(get, format!("0,3,{number}\r"), "the answer to another request");
            seen.served.fetch_add(1, Ordering::Relaxed);
        }
    })
}

/// Waits until a counter of each PLC has grown by this number.
fn wait_for_more(seen: &[Arc<Seen>], count: impl Fn(&Seen) -> &AtomicU32, more: u32, board: &mut Board, what: &str) {
    let before: Vec<u32> = seen.iter().map(|seen| count(seen).load(Ordering::Relaxed)).collect();
    let since = Instant::now();
    while !seen.iter().zip(&before).all(|(seen, before)| count(seen).load(Ordering::Relaxed) >= before + more) {
        assert!(board.is_running(), "the board was reset: {}", board.log());
        assert!(since.elapsed() < 2 * TIMEOUT, "the PLCs wait for {what}: {}", board.log());
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_robot_that_stops_under_load_costs_errors_and_nothing_else() {
    let bcap = bcap();
    let mut sim = Sim::start(&bcap, "127.0.0.1:0");
    let robot = sim.bcap.clone();
    let mut board = Board::start(&robot, &[], &[PROVIDER, "put=I/0-99"]).up();
    let seen = [(); 4].map(|()| Arc::new(Seen::default()));
    let plcs: Vec<_> = (0..).zip(&seen).map(|(plc, seen)| load(&board.rac, plc, seen)).collect();
    for ends in ["-TERM", "-KILL"] {
        wait_for_more(&seen, |seen| &seen.served, 50, &mut board, "a robot that is there");
        sim.end(ends);
        // answered while no robot exists, so no request waits for the robot
        wait_for_more(&seen, |seen| &seen.away, 50, &mut board, "E_NOT_CONNECTED");
        sim = Sim::start(&bcap, &robot);
    }
    let longest = || {
        let micros = seen.iter().map(|seen| seen.longest.load(Ordering::Relaxed)).max().unwrap_or_default();
        Duration::from_micros(micros.into())
    };
    let closed = longest();
    // a robot that stops responding is disconnected after 3 s; its pending calls time out
    wait_for_more(&seen, |seen| &seen.served, 50, &mut board, "a robot that is there");
    sim.signal("-STOP");
    wait_for_more(&seen, |seen| &seen.away, 50, &mut board, "E_NOT_CONNECTED after silence");
    sim.signal("-CONT");
    wait_for_more(&seen, |seen| &seen.served, 50, &mut board, "a robot that is there again");
    for seen in &seen {
        seen.stop.store(true, Ordering::Relaxed);
    }
    for plc in plcs {
        plc.join().unwrap();
    }
    let sum = |count: fn(&Seen) -> &AtomicU32| seen.iter().map(|s| count(s).load(Ordering::Relaxed)).sum::<u32>();
    let (served, away, timed_out) = (sum(|seen| &seen.served), sum(|seen| &seen.away), sum(|seen| &seen.timed_out));
    show(&format!(
        "{served} numbers came back, {timed_out} answers of E_TIMEOUT, {away} of E_NOT_CONNECTED, the latest after \
         {closed:?} when the connection was closed, {:?} when the robot fell silent",
        longest()
    ));
    // four connections that were never closed, and an emulator that ends with a reset: the board was not started again
    assert!(board.is_running());
    if board.log_is_text {
        let gateway_lines = board.log().lines().filter(|line| line.contains("gateway to")).count();
        assert_eq!(gateway_lines, 1, "{}", board.log());
        assert!(board.log().matches("robot up").count() >= 4, "{}", board.log());
    }
}
