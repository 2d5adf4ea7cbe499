//! The items of the b-CAP Tester (chapter 6 of the specification for RC9) that are options of every command. The table in
//! `docs/tester.md` names the test of each item.

use crate::common::bcap;
use crate::common::fake::{Answer, Fake, usual, value};
use crate::common::virtual_robot::Virtual;
use bcap_core::bcap::{Frame, FunctionId};
use bcap_tests::process::{Signal, send};

fn answer(request: &Frame<'_>) -> Answer {
    match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value(5),
        _ => usual(request),
    }
}

#[test]
fn provider_machine_and_option_are_those_of_controller_connect() {
    let fake = Fake::tcp(answer);
    let options = ["--provider", "CaoProv.DENSO.VRC9", "--machine", "192.168.0.1", "--option", "Timeout=1"];
    assert_eq!(bcap(&[&["get", "I1", "--robot", &fake.address], &options[..]].concat()).code, 0);
    let connect = r#"ControllerConnect("", "CaoProv.DENSO.VRC9", "192.168.0.1", "Timeout=1")"#;
    assert_eq!(fake.seen()[1], connect);
}

#[test]
fn the_watchdog_is_shorter_than_an_attempt() {
    for (udp, timeout, attempts, watchdog) in [
        (true, "500", "5", "WDT=80"),
        (true, "5000", "5", "WDT=333"),
        (true, "5000", "1", "WDT=400"),
        // an attempt takes at least 100 ms, so there are three
        (true, "300", "7", "WDT=80"),
        (false, "500", "5", "WDT=166"),
        (false, "200", "5", "WDT=80"),
        (false, "80", "5", ""),
    ] {
        let fake = if udp { Fake::udp(answer) } else { Fake::tcp(answer) };
        // on a busy machine the time can be over before the first call
        for _ in 0..10 {
            bcap(&["get", "I1", "--robot", &fake.address, "--timeout", timeout, "--attempts", attempts]);
            if !fake.seen().is_empty() {
                break;
            }
        }
        assert_eq!(fake.seen()[0], format!("ServiceStart({watchdog:?})"), "{timeout} {attempts}");
    }
}

/// A server without replies gets each attempt: their number is at least 1 and at most 7, and they share the time limit.
#[test]
fn attempts_are_clamped_and_share_the_time() {
    for (attempts, sent) in [("-3", 1), ("0", 1), ("1", 1), ("3", 3), ("7", 7), ("100", 7)] {
        assert_attempts(&["--timeout", "1400", "--attempts", attempts], sent, "1400 ms");
    }
}

/// Checks the number of attempts for a server without replies. On a busy machine an attempt can be so late that the time limit
/// ends before the last attempt, so a run with fewer attempts is repeated; more are a failure.
#[track_caller]
fn assert_attempts(options: &[&str], expected: usize, limit: &str) {
    let mut received = 0;
    for _ in 0..10 {
        let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = format!("udp:{}", silent.local_addr().unwrap());
        let run = bcap(&[&["get", "I1", "--robot", &address], options].concat());
        assert!(run.code == 4 && run.err.contains(limit), "{run:?}");
        silent.set_nonblocking(true).unwrap();
        let mut datagram = [0; 1024];
        received = std::iter::from_fn(|| silent.recv(&mut datagram).ok()).count();
        if received >= expected {
            break;
        }
    }
    assert_eq!(received, expected, "{options:?}");
}

#[test]
fn the_time_of_an_attempt_gives_that_of_an_answer() {
    for (attempts, sent, limit) in [("3", 3, "450 ms"), ("-3", 1, "150 ms")] {
        assert_attempts(&["--attempt-timeout", "150", "--attempts", attempts], sent, limit);
    }
}

#[test]
fn the_last_packets_are_variables() {
    let robot = Virtual::start(&[]);
    for address in [&robot.tcp, &robot.udp] {
        let run = bcap(&["get", "I1", "$LAST_SEND_PACKET$", "$LAST_RECEIVE_PACKET$", "--robot", address]);
        let lines: Vec<&str> = run.out.lines().collect();
        assert_eq!((lines.len(), run.code), (3, 0), "{run:?}");
        let bytes = |line: &str, name: &str| line.strip_prefix(name).unwrap().to_owned();
        // the call that released I1, and its reply
        let sent = bcap(&["decode", &bytes(lines[1], "$LAST_SEND_PACKET$ = "), "--json"]);
        assert!(sent.out.contains("\"name\":\"VariableRelease\""), "{sent:?}");
        let received = bcap(&["decode", &bytes(lines[2], "$LAST_RECEIVE_PACKET$ = "), "--as", "response", "--json"]);
        assert!(received.out.contains("\"name\":\"S_OK\""), "{received:?}");
    }
    let script = robot.script("put I1 1\nget $LAST_SEND_PACKET$ --json\n");
    assert!(script.out.contains("{\"name\":\"$LAST_SEND_PACKET$\",\"vt\":8,\"v\":\"01 1e 00"), "{script:?}");
}

#[test]
fn a_trace_has_three_levels() {
    let fake = Fake::tcp(answer);
    let traced = |level: &str| bcap(&["get", "I1", level, "--robot", &fake.address]);
    let run = traced("--trace=headers");
    let lines: Vec<&str> = run.err.lines().collect();
    assert_eq!(run.out, "I1 = 5\n");
    assert_eq!((lines[6], lines[7]), ("-> #4 Variable_GetValue, 30 bytes", "<- #4 0x00000000 (S_OK), 30 bytes"));
    assert_eq!(lines.len(), 14, "{run:?}");
    let run = traced("--trace=values");
    assert!(run.err.contains("-> #4 Variable_GetValue(variable: I4(2))\n<- #4 0x00000000 (S_OK): I4(5)\n"), "{run:?}");
    let request = "-> 01 1e 00 00 00 04 00 00 00 65 00 00 00 01 00     #4 Variable_GetValue, 30 bytes\n   \
                   0a 00 00 00 03 00 01 00 00 00 02 00 00 00 04     variable: I4(2)\n";
    let run = traced("--trace");
    assert!(run.err.contains(request), "{run:?}");
    assert!(bcap(&["gateway", "--trace"]).err.contains("this command has no --trace"));
}

#[test]
fn the_trace_covers_retries_and_rac() {
    let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = format!("udp:{}", silent.local_addr().unwrap());
    let run =
        bcap(&["get", "I1", "--trace=headers", "--robot", &address, "--attempt-timeout", "150", "--attempts", "3"]);
    assert_eq!(run.err.matches("Service_Start, ").count(), 3, "{run:?}");
    let robot = Virtual::start(&[]);
    let run = bcap(&["rac", "get", "I1", "--trace=values", "--robot", &robot.rac]);
    let lines: Vec<&str> = run.err.lines().collect();
    assert_eq!((lines.len(), run.out.as_str()), (2, "I1 = 0\n"), "{run:?}");
    assert!(lines[0].starts_with("-> ") && lines[0].contains("GET") && lines[1].starts_with("<- "), "{run:?}");
}

#[test]
fn several_arguments_are_an_array() {
    let fake = Fake::tcp(usual);
    let exec = |arguments: &[&str]| {
        let run = bcap(&[&["exec", "robot:Arm0", "X", "--robot", &fake.address], arguments].concat());
        assert_eq!(run.code, 0, "{run:?}");
        fake.seen().into_iter().rfind(|call| call.starts_with("RobotExecute")).unwrap()
    };
    assert_eq!(exec(&[]), r#"RobotExecute(I4(3), "X", EMPTY)"#);
    assert_eq!(exec(&["-1"]), r#"RobotExecute(I4(3), "X", I4(-1))"#);
    assert_eq!(exec(&["0", "1"]), r#"RobotExecute(I4(3), "X", I4[0, 1])"#);
    assert_eq!(exec(&["0", "1.5"]), r#"RobotExecute(I4(3), "X", R8[0.0, 1.5])"#);
    assert_eq!(exec(&["1", "P1", "8197,1,2"]), r#"RobotExecute(I4(3), "X", VARIANT[I4(1), "P1", R8[1.0, 2.0]])"#);
}

#[test]
fn messages_are_fetched_while_the_command_waits() {
    let robot = Virtual::start(&[]);
    let mut waiting = robot.spawn(&["errors", "--follow", "--for", "1min", "--json"]);
    let mut out = std::io::BufReader::new(waiting.stdout.take().unwrap());
    // another client causes errors until the first message arrives
    let mut line = String::new();
    let causes = std::thread::scope(|scope| {
        let (stop, stopped) = std::sync::mpsc::channel();
        let robot = &robot;
        let causes = scope.spawn(move || {
            while stopped.try_recv().is_err() {
                robot.run(&["move", "J(999, 45, 90, 0, 45, 0)"]);
                robot.run(&["errors", "--clear"]);
            }
        });
        std::io::BufRead::read_line(&mut out, &mut line).unwrap();
        stop.send(()).unwrap();
        causes.join()
    });
    causes.unwrap();
    assert!(line.contains("\"source\":\"RC8\"") && line.contains("\"number\":\"-"), "{line}");
    send(Signal::INT, &waiting);
    std::io::copy(&mut out, &mut std::io::sink()).unwrap();
    assert_eq!(waiting.wait().unwrap().code(), Some(0));
}

#[test]
fn a_pose_is_an_array_of_variants() {
    let fake = Fake::tcp(usual);
    let pose = "8204,(8197,0,0,0,0,0,0,5),(3,0),(3,-2)";
    let run = bcap(&["call", "Robot_Move", "robot:Arm0", "1", pose, "8,NEXT", "--robot", &fake.address]);
    assert_eq!(run.code, 0, "{run:?}");
    let moved = "RobotMove(I4(3), I4(1), VARIANT[R8[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0], I4(0), I4(-2)], \"NEXT\")";
    assert!(fake.seen().contains(&moved.to_owned()), "{:?}", fake.seen());
}
