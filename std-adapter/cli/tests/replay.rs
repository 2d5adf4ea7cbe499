//! `bcap replay`: the same calls again, differences, and calls that must be allowed.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::capture::{BCAP, Capture, Flow, From, bstr, i4, numbered, r8};
use crate::common::recorded;
use crate::common::robot::Robot;
use crate::common::running::Running;
use crate::common::{Run, bcap, command};
use bcap_sim::{Config, Profile, Scenario};
use bcap_tests::real_time::repeated;
use serde_json::Value;

/// The calls of a recorded session that may move or write. Its end halts the robot before it switches the motor off.
const ALLOWED: [&str; 5] = ["Variable_PutValue", "Robot_Execute", "Robot_Move", "Robot_Halt", "PUT"];

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Replays a file against a virtual controller.
fn replay(file: &Path, sim: &Running, options: &[&str]) -> Run {
    let robot = ["--robot", &sim.bcap, "--robot-udp", &sim.udp, "--robot-rac", &sim.rac];
    bcap(&[&["replay", file.to_str().unwrap()], &robot[..], options].concat())
}

/// Records a session that reads over all protocols, with a new controller; returns the file.
fn read_session(name: &str) -> PathBuf {
    let file = path(name);
    let sim = Running::sim(&["--write", file.to_str().unwrap()]);
    let (tcp, udp) = (format!("tcp:{}", sim.bcap), format!("udp:{}", sim.udp));
    for args in [
        &["get", "I1", "F1", "robot/@CURRENT_ANGLE", "--robot", &tcp][..],
        &["get", "S1", "--robot", &udp],
        &["rac", "get", "P1", "--robot", &sim.rac],
    ] {
        assert_eq!(bcap(args).code, 0, "{args:?}");
    }
    assert_eq!(sim.interrupt().code, 0);
    file
}

#[test]
fn a_capture_is_not_replaced_by_its_own_replay() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("session.pcap");
    let before = std::fs::read(crate::common::recorded::committed()).unwrap();
    std::fs::write(&file, &before).unwrap();
    let path = file.to_str().unwrap();
    let again = folder.path().join(".").join("session.pcap");
    let write = ["--write", again.to_str().unwrap()];
    for args in [&["replay", path, "--robot", "127.0.0.1:1"][..], &["sim", "--replay", path]] {
        let run = bcap(&[args, &write].concat());
        assert_eq!((run.code, run.err.contains("would replace the capture")), (2, true), "{args:?}: {run:?}");
        assert_eq!(std::fs::read(&file).unwrap(), before);
    }
}

#[test]
fn a_replay_finds_exactly_the_value_that_changed() {
    let (file, sim) = (read_session("reads.pcapng"), Running::sim(&[]));
    for options in [&[][..], &["--fast"]] {
        let run = replay(&file, &sim, options);
        let totals = "23 calls of 3 connections, 23 replies compared, 0 differences\n";
        assert_eq!((run.code, run.out.as_str(), run.err.as_str()), (0, totals, ""), "{run:?}");
    }
    assert_eq!(bcap(&["put", "F1", "2.5", "--robot", &sim.bcap]).code, 0);
    let run = replay(&file, &sim, &["--fast"]);
    assert_eq!((run.code, run.err.as_str()), (1, "error: 1 of 23 replies differ from the recorded ones\n"), "{run:?}");
    let lines: Vec<_> = run.out.lines().collect();
    assert!(lines[0].ends_with(" Variable_GetValue(variable: F1)"), "{lines:?}");
    assert_eq!(lines[1..3], ["  recorded: S_OK R4(0.0)", "  replayed: S_OK R4(2.5)"]);
    assert_eq!(lines.len(), 4, "{lines:?}");

    let run = replay(&file, &sim, &["--fast", "--json"]);
    let difference: Value = serde_json::from_str(run.out.lines().next().unwrap()).unwrap();
    let values = ["recorded", "replayed"].map(|side| &difference[side]["value"]["v"]);
    assert_eq!(values, [&Value::from(0.0), &Value::from(2.5)], "{difference}");

    for name in ["F1", "Variable_GetValue"] {
        let run = replay(&file, &sim, &["--fast", "--volatile", name]);
        assert_eq!(run.code, 0, "{name}: {run:?}");
    }
}

#[test]
fn calls_that_move_or_write_are_made_only_if_they_are_allowed_by_name() {
    let (recorded, _) = recorded::proxied(&["--quiet"]);
    let seen = path("seen.pcapng");
    let sim = Running::sim(&["--write", seen.to_str().unwrap()]);
    let run = replay(&recorded.file, &sim, &["--allow", "Variable_PutValue"]);
    assert_eq!(run.code, 2, "{run:?}");
    for refused in ["PUT (1)", "Robot_Execute/TakeArm (1)", "Robot_Execute/Nonsense (1)", "Robot_Move (1)"] {
        assert!(run.err.contains(refused), "{refused}: {run:?}");
    }
    // CurJnt reads, by the core's table of commands
    assert!(!run.err.contains("CurJnt") && !run.err.contains("PutValue"), "{run:?}");
    assert_eq!(sim.interrupt().code, 0);
    let run = bcap(&["decode", seen.to_str().unwrap()]);
    assert_eq!((run.code, run.out.as_str()), (0, ""), "nothing was sent");
}

#[test]
fn a_whole_session_has_the_same_replies_on_a_new_controller() {
    repeated(|| {
        let (recorded, _) = recorded::proxied(&["--quiet"]);
        let served = recorded::serve();
        let [tcp, udp, rac] = [&served.tcp, &served.udp, &served.rac].map(ToString::to_string);
        let allowed = ALLOWED.map(|name| ["--allow", name]).concat();
        // the position and the date of an error depend on the moment
        let more =
            ["--volatile", "Robot_Execute/slvMove", "--volatile", "Controller_Execute/GetCurErrorInfo", "--fast"];
        let file = recorded.file.to_str().unwrap();
        let robot = ["--robot", &tcp, "--robot-udp", &udp, "--robot-rac", &rac];
        let run = bcap(&[&["replay", file], &robot[..], &allowed, &more].concat());
        assert_eq!(run.code, 0, "{run:?}");
        let count = recorded.seen.len();
        let connections = run.out.split(' ').nth(3).unwrap();
        let totals = format!("{count} calls of {connections} connections, {count} replies compared, 0 differences\n");
        assert_eq!(run.out, totals);
        println!("{}", run.out.trim_end());
    });
}

#[test]
fn a_lost_connection_and_other_handles_are_differences_only_where_they_matter() {
    // handle 99 instead of the controller's own, and a call without a reply
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    let connect = [bstr(""), bstr("CaoProv.DENSO.VRC"), bstr("localhost"), bstr("")];
    for (from, frame) in [
        (From::Client, numbered(1, 0, 1, &[bstr("")])),
        (From::Server, numbered(1, 0, 0, &[])),
        (From::Client, numbered(2, 0, 3, &connect)),
        (From::Server, numbered(2, 0, 0, &[i4(99)])),
        (From::Client, numbered(3, 0, 9, &[i4(99), bstr("I1"), bstr("")])),
        (From::Server, numbered(3, 0, 0, &[i4(98)])),
        (From::Client, numbered(4, 0, 101, &[i4(98)])),
        (From::Server, numbered(4, 0, 0, &[i4(0)])),
        (From::Client, numbered(5, 0, 2, &[])),
    ] {
        capture.tcp(&mut flow, from, &frame);
    }
    let file = path("handles.pcap");
    capture.save(&file);
    let sim = Running::sim(&[]);
    let run = replay(&file, &sim, &["--fast"]);
    let totals = "5 calls of 1 connection, 4 replies compared, 0 differences\n";
    assert_eq!((run.code, run.out.as_str()), (0, totals), "{run:?}");

    assert_eq!(sim.interrupt().code, 0);
    // nothing listens there, and no other test will
    let run = bcap(&["replay", file.to_str().unwrap(), "--robot", "127.0.0.1:1"]);
    assert_eq!(run.code, 1, "{run:?}");
    assert!(run.out.contains("replayed: no reply: cannot connect to "), "{run:?}");
    assert!(run.out.ends_with("4 replies compared, 4 differences\n"), "{run:?}");
    let run = bcap(&["replay", "no/such/file.pcapng"]);
    assert!(run.code == 2 && run.err.contains("cannot read no/such/file.pcapng: "), "{run:?}");
}

#[test]
fn a_server_that_plays_a_session_back_gives_the_recorded_replies() {
    let (recorded, _) = recorded::proxied(&["--quiet"]);
    let file = recorded.file.to_str().unwrap();
    let again = path("again.pcapng");
    let server = Running::sim(&["--replay", file, "--write", again.to_str().unwrap()]);
    let allowed = ALLOWED.map(|name| ["--allow", name]).concat();
    // positions of Slave Mode are compared too: they are the recorded ones
    let run = replay(&recorded.file, &server, &[&["--fast"][..], &allowed].concat());
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    assert!(run.out.ends_with(" replies compared, 0 differences\n"), "{run:?}");

    // bytes that the capture does not have
    let run = bcap(&["get", "D77", "--robot", &server.bcap]);
    assert_eq!(run.code, 1, "{run:?}");
    assert!(run.err.contains("E_FAIL"), "{run:?}");
    let printed = server.interrupt();
    assert_eq!(printed.code, 0, "{printed:?}");
    let lines: Vec<_> = printed.err.lines().collect();
    assert_eq!(lines.len(), 1, "{printed:?}");
    assert!(lines[0].starts_with("not in the capture: Controller_GetVariable(I4("), "{lines:?}");

    let run = bcap(&["sim", "--replay", "no/such/file.pcapng"]);
    assert!(run.code == 2 && run.err.contains("cannot read no/such/file.pcapng: "), "{run:?}");
}

// codes of functions
const SERVICE_START: u32 = 1;
const SERVICE_STOP: u32 = 2;
const CONNECT: u32 = 3;
const GET_ROBOT: u32 = 7;
const GET_VARIABLE: u32 = 9;
const ROBOT_EXECUTE: u32 = 64;
const ROBOT_MOVE: u32 = 72;
const GET_VALUE: u32 = 101;
const PUT_VALUE: u32 = 102;
const RELEASE: u32 = 111;

/// The recorded handle of the controller.
const CONTROLLER: u8 = 200;

/// A connection of a capture that a test makes.
struct Session {
    flow: Flow,
    serial: u8,
}

impl Session {
    /// Starts a session that opens the controller.
    fn start(capture: &mut Capture, number: u32) -> Self {
        let mut session = Self { flow: Flow::new(number, BCAP), serial: 0 };
        session.call(capture, SERVICE_START, &[bstr("")], &[]);
        let connect = [bstr(""), bstr("CaoProv.DENSO.VRC"), bstr("localhost"), bstr("")];
        session.call(capture, CONNECT, &connect, &[i4(CONTROLLER)]);
        session
    }

    /// Adds a call and its reply with S_OK.
    fn call(&mut self, capture: &mut Capture, function: u32, arguments: &[Vec<u8>], value: &[Vec<u8>]) {
        self.serial += 1;
        capture.tcp(&mut self.flow, From::Client, &numbered(self.serial, 0, function, arguments));
        capture.tcp(&mut self.flow, From::Server, &numbered(self.serial, 0, 0, value));
    }

    /// Adds the call that opens a variable.
    fn open(&mut self, capture: &mut Capture, name: &str, handle: u8) {
        self.call(capture, GET_VARIABLE, &[i4(CONTROLLER), bstr(name), bstr("")], &[i4(handle)]);
    }
}

const NOT_OPEN: &str = "replayed: no reply: not sent: the object is not open in this replay";

#[test]
fn a_handle_that_was_not_opened_in_the_replay_is_not_sent() {
    let (mut capture, sim) = (Capture::new(), Running::sim(&[]));
    let mut session = Session::start(&mut capture, 1);
    session.open(&mut capture, "I1", 201);
    // numbers that the controller gives to the objects above
    const GIVEN: std::ops::RangeInclusive<u8> = 1..=20;
    for handle in GIVEN {
        // the capture lacks the call that opened it
        session.call(&mut capture, PUT_VALUE, &[i4(handle), i4(7)], &[]);
        // the replayed call is refused
        session.open(&mut capture, "no variable", handle);
        session.call(&mut capture, PUT_VALUE, &[i4(handle), i4(8)], &[]);
    }
    // a number that an object had before
    session.open(&mut capture, "no variable", 201);
    session.call(&mut capture, PUT_VALUE, &[i4(201), i4(9)], &[]);
    let file = path("foreign.pcap");
    capture.save(&file);
    let run = replay(&file, &sim, &["--fast", "--allow", "Variable_PutValue"]);
    assert_eq!(run.code, 1, "{run:?}");
    let refused = 2 * GIVEN.count() + 1;
    assert_eq!(run.out.matches(NOT_OPEN).count(), refused, "{}", run.out);
    assert_eq!(bcap(&["get", "I1", "--robot", &sim.bcap]).out, "I1 = 0\n");
}

#[test]
fn a_released_handle_is_not_sent_and_handle_0_is() {
    let (mut capture, sim) = (Capture::new(), Running::sim(&[]));
    let mut session = Session::start(&mut capture, 1);
    session.open(&mut capture, "I1", 201);
    session.call(&mut capture, RELEASE, &[i4(201)], &[]);
    // the controller may give the number of I1 to I2
    session.open(&mut capture, "I2", 202);
    session.call(&mut capture, PUT_VALUE, &[i4(201), i4(7)], &[]);
    session.call(&mut capture, PUT_VALUE, &[i4(202), i4(8)], &[]);
    session.call(&mut capture, GET_VALUE, &[i4(0)], &[]);
    session.call(&mut capture, SERVICE_STOP, &[], &[]);
    let file = path("released.pcap");
    capture.save(&file);
    let run = replay(&file, &sim, &["--fast", "--allow", "Variable_PutValue"]);
    assert_eq!(run.out.matches(NOT_OPEN).count(), 1, "{}", run.out);
    let zero = "tcp1 #8 Variable_GetValue(variable: I4(0))\n  recorded: S_OK\n  replayed: 0x80070006 (E_HANDLE)";
    assert!(run.out.contains(zero), "{}", run.out);
    assert!(run.out.ends_with("9 calls of 1 connection, 9 replies compared, 2 differences\n"), "{}", run.out);
    assert_eq!(bcap(&["get", "I1", "I2", "--robot", &sim.bcap]).out, "I1 = 0\nI2 = 8\n");
}

#[test]
fn a_replay_ends_whatever_the_times_of_the_capture_are() {
    let sim = Running::sim(&[]);
    for (name, step) in [("equal", 0), ("backward", -1000)] {
        let mut capture = Capture::new();
        (capture.micros, capture.step) = (1_000_000, step);
        let mut sessions = [1, 2].map(|number| Session::start(&mut capture, number));
        for handle in 201..204 {
            for session in &mut sessions {
                session.open(&mut capture, "I1", handle);
                session.call(&mut capture, GET_VALUE, &[i4(handle)], &[i4(0)]);
            }
        }
        let file = path(&format!("{name}.pcap"));
        capture.save(&file);
        for options in [&[][..], &["--fast"]] {
            let run = replay(&file, &sim, options);
            let totals = "16 calls of 2 connections, 16 replies compared, 0 differences\n";
            assert_eq!((run.code, run.out.as_str(), run.err.as_str()), (0, totals, ""), "{name}: {run:?}");
        }
    }
}

/// Saves a session that takes the arm and starts a motion, which lasts longer than the test.
fn motion(name: &str) -> PathBuf {
    let mut capture = Capture::new();
    let mut session = Session::start(&mut capture, 1);
    session.call(&mut capture, GET_ROBOT, &[i4(CONTROLLER), bstr(""), bstr("")], &[i4(201)]);
    for (command, numbers) in [("TakeArm", [0.0, 1.0]), ("Motor", [1.0, 0.0])] {
        session.call(&mut capture, ROBOT_EXECUTE, &[i4(201), bstr(command), r8(&numbers)], &[]);
    }
    let motion = [i4(201), i4(1), bstr("@E J(90, 45, 90, 0, 45, 0)"), bstr("SPEED=1, NEXT")];
    session.call(&mut capture, ROBOT_MOVE, &motion, &[]);
    let file = path(name);
    capture.save(&file);
    file
}

/// Replays the motion, with a time limit for each call.
fn replay_motion(file: &Path, robot: &str) -> Run {
    let allowed = ["--allow", "Robot_Execute", "--allow", "Robot_Move", "--timeout", "1000"];
    bcap(&[&["replay", file.to_str().unwrap(), "--fast", "--robot", robot], &allowed[..]].concat())
}

/// Relays connections to a robot. The first connection blocks after the request that contains these bytes.
fn relay_until(robot: SocketAddr, last: &'static [u8]) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    // it ends with the process
    thread::spawn(move || {
        for (number, client) in listener.incoming().map_while(Result::ok).enumerate() {
            let server = TcpStream::connect(robot).unwrap();
            let is_held = Arc::new(AtomicBool::new(false));
            for (mut from, mut to) in [(client.try_clone().unwrap(), server.try_clone().unwrap()), (server, client)] {
                let is_held = Arc::clone(&is_held);
                thread::spawn(move || {
                    let mut bytes = [0; 4096];
                    while let Ok(count @ 1..) = from.read(&mut bytes) {
                        let passes = !is_held.load(Ordering::SeqCst);
                        if number == 0 && bytes[..count].windows(last.len()).any(|part| part == last) {
                            is_held.store(true, Ordering::SeqCst);
                        }
                        if passes && to.write_all(&bytes[..count]).is_err() {
                            break;
                        }
                    }
                    let _ = to.shutdown(Shutdown::Both);
                });
            }
        }
    });
    address
}

#[test]
fn a_motion_whose_connection_is_silent_is_halted_over_another_one() {
    let robot = Robot::with(Config { motor_on_delay: Duration::ZERO, ..Config::new(Profile::Rc8) });
    // the end of the option, in UTF-16
    let relay = relay_until(robot.served.tcp, b"N\0E\0X\0T\0");
    let run = replay_motion(&motion("silent.pcap"), &relay.to_string());
    assert_eq!(run.code, 1, "{run:?}");
    // the controller may not have detected the loss when the new connection checks it
    let seen = "over a new one the robot was halted, the motor was switched off, and the arm was not seen to be free";
    assert!(run.err.contains("IT IS UNKNOWN whether") && run.err.contains(seen), "{run:?}");
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let mut sim = robot.served.application();
        sim.advance(bcap_std::now());
        assert!(!sim.is_moving() && !sim.motor_is_on());
        if sim.arm_owner().is_none() {
            break;
        }
        drop(sim);
        assert!(Instant::now() < end, "the arm is free after the end of the connection");
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_replay_that_leaves_the_motor_on_says_so() {
    let robot = Robot::with(Config { motor_on_delay: Duration::ZERO, ..Config::new(Profile::Rc8) });
    let refused = "[[fault]]\nwhen = { call = 2, to = 99, of = \"Motor\" }\nthen = { refuse = \"E_FAIL\" }\n";
    robot.served.application().play(Scenario::parse(refused).unwrap());
    let run = replay_motion(&motion("refused.pcap"), &robot.tcp);
    assert!(run.code == 1 && run.err.contains("IT IS UNKNOWN whether the robot rests, its motor is off"), "{run:?}");
    assert!(run.err.contains("the motor was NOT switched off") && run.err.contains("emergency stop"), "{run:?}");
    assert!(robot.served.application().motor_is_on());
}

#[test]
fn a_replay_whose_output_is_closed_makes_no_more_calls() {
    let seen = path("closed-seen.pcapng");
    let (mut capture, sim) = (Capture::new(), Running::sim(&["--write", seen.to_str().unwrap()]));
    let mut sessions = [1, 2].map(|number| Session::start(&mut capture, number));
    sessions[0].open(&mut capture, "I1", 201);
    sessions[1].open(&mut capture, "I2", 202);
    // the difference
    sessions[0].call(&mut capture, GET_VALUE, &[i4(201)], &[i4(99)]);
    // much later, in both connections
    capture.micros = 2_000_000_000;
    sessions[0].call(&mut capture, PUT_VALUE, &[i4(201), i4(7)], &[]);
    sessions[1].call(&mut capture, PUT_VALUE, &[i4(202), i4(7)], &[]);
    let file = path("closed.pcap");
    capture.save(&file);
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let args = ["replay", file.to_str().unwrap(), "--robot", &sim.bcap, "--allow", "Variable_PutValue"];
    let mut command = command(&args);
    command.stdin(Stdio::null()).stdout(writer).status().unwrap();
    assert_eq!(sim.interrupt().code, 0);
    let run = bcap(&["decode", seen.to_str().unwrap()]);
    assert!(run.out.contains("Variable_GetValue(variable: I1)"), "{run:?}");
    assert!(!run.out.contains("Variable_PutValue"), "{run:?}");
}

#[test]
fn a_capture_with_too_many_connections_is_refused() {
    let mut capture = Capture::new();
    for number in 1..=1025 {
        Session { flow: Flow::new(number, BCAP), serial: 0 }.call(&mut capture, SERVICE_START, &[bstr("")], &[]);
    }
    let file = path("links.pcap");
    capture.save(&file);
    // nothing listens there, and no other test will
    let run = bcap(&["replay", file.to_str().unwrap(), "--robot", "127.0.0.1:1"]);
    let refused = "error: the capture has calls in 1025 connections; at most 1024 can be replayed at once\n";
    assert_eq!((run.code, run.out.as_str()), (2, ""), "{run:?}");
    assert!(run.err.starts_with(refused), "{run:?}");
}

#[test]
fn options_of_a_virtual_controller_conflict_with_a_capture_to_play_back() {
    for option in [
        &["--model", "rc8"][..],
        &["--mode", "auto"],
        &["--token", "any"],
        &["--robot-type", "VS060A3"],
        &["--no-slave-licence"],
        &["--record", "motion.csv"],
        &["--print-model"],
    ] {
        let run = bcap(&[&["sim", "--replay", "no/such/file.pcapng"], option].concat());
        let conflict = format!("the argument '--replay <FILE.pcapng>' cannot be used with '{}", option[0]);
        assert!(run.code == 2 && run.err.contains(&conflict), "{run:?}");
    }
}
