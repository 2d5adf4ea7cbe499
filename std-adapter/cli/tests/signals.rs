//! Signals, questions and checks: no command leaves the arm taken, the motor on or the robot moving, and no command moves the
//! robot by mistake.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use crate::common::fake::{Fake, usual};
use crate::common::robot::Robot;
use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bare, bcap, bcap_with, command};
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::server::Limits;
use bcap_tests::process::{Signal, send};
use bcap_tests::proxy::{Cut, Relay};
use bcap_tests::served::Served;

/// A motion that takes more than ten seconds.
const SLOW: [&str; 4] = ["move", "J(90, 45, 90, 0, 45, 0)", "--speed", "1"];
const INTERRUPTED: &str = "interrupted: the robot was halted, and the arm was given back";
/// The delay of an answer before which a signal arrives.
const LATE: u32 = 1500;

/// Returns the state of a process: `T` is suspended.
fn state(child: &Child) -> char {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
    stat.rsplit(") ").next().unwrap().chars().next().unwrap()
}

/// A robot whose answer to the first TakeArm is delayed.
fn slow_to_take(delay_ms: u32) -> Robot {
    let robot = Robot::start();
    let late = format!("[[fault]]\nwhen = {{ call = 1, of = \"TakeArm\" }}\nthen = {{ delay_ms = {delay_ms} }}\n");
    robot.served.application().play(Scenario::parse(&late).unwrap());
    robot
}

/// Starts a command, and sends it a signal when the arm is taken.
fn signal_at_take_arm(robot: &Robot, args: &[&str], signal: Signal) -> Run {
    let child = command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while robot.served.application().arm_owner().is_none() {
        thread::sleep(Duration::from_millis(1));
    }
    send(signal, &child);
    child.wait_with_output().unwrap().into()
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_z_halts_the_robot_and_gives_the_arm_back_before_the_process_is_suspended() {
    let robot = Virtual::start(&[]);
    let script = "move 'J(90, 45, 90, 0, 45, 0)' --speed 1\n";
    for (args, lines) in [(&SLOW[..], ""), (&["run", "-"], script)] {
        let mut child = robot.spawn(args);
        child.stdin.as_mut().unwrap().write_all(lines.as_bytes()).unwrap();
        robot.wait_for_motion();
        send(Signal::TSTP, &child);
        while state(&child) != 'T' {
            thread::sleep(Duration::from_millis(1));
        }
        // while it is suspended
        robot.assert_at_rest_with_free_arm();
        send(Signal::CONT, &child);
        let run: Run = child.wait_with_output().unwrap().into();
        assert_eq!(run.code, 130, "{run:?}");
        assert!(run.err.contains(INTERRUPTED) && run.err.contains("Ctrl-Z had ended the command"), "{run:?}");
    }
}

/// Signals that would end a process without its clean-up.
#[test]
#[cfg(target_os = "linux")]
fn every_signal_that_can_be_handled_ends_a_motion_in_order() {
    let robot = Virtual::start(&[]);
    for name in
        ["-USR1", "-USR2", "-ALRM", "-VTALRM", "-PROF", "-XCPU", "-XFSZ", "-IO", "-STKFLT", "-PWR", "-40", "-64"]
    {
        let child = robot.spawn(&SLOW);
        robot.wait_for_motion();
        // the last two have no name that `send` takes
        let sent = Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
        assert!(sent.success(), "{name}");
        let run: Run = child.wait_with_output().unwrap().into();
        assert_eq!(run.code, 130, "{name}: {run:?}");
        assert!(run.err.contains(INTERRUPTED), "{name}: {run:?}");
        robot.assert_at_rest_with_free_arm();
    }
}

/// A single command may leave the motor on, and says so. A session of several commands never leaves the motor on, however it
/// ends.
#[test]
fn a_motor_that_was_switched_on_by_name_stays_on_only_after_a_single_command() {
    let robot = Robot::start();
    let is_on = || robot.served.application().motor_is_on();
    const STAYS: &str = "the motor stays on after this command";
    for args in [
        &["exec", "robot", "Motor", "1"][..],
        &["exec", "controller", "Motor", "1"],
        &["put", "robot/@SERVO_ON", "true"],
    ] {
        let run = robot.run(args);
        assert!(run.code == 0 && run.err.contains(STAYS) && is_on(), "{args:?}: {run:?}");
        let run = robot.run(&["exec", "robot", "Motor", "0"]);
        assert!(run.code == 0 && !run.err.contains("motor") && !is_on(), "{run:?}");
    }
    const OFF: &str = "the motor is switched off now";
    for (lines, code) in [
        ("exec robot Motor 1 0\n", 0),
        ("exec robot Motor 1 0\nexpect I1 = 5\n", 1),
        ("put robot/@SERVO_ON true\n", 0),
        ("exec robot TakeArm 0 1\nexec robot Motor 1 0\nexec robot GiveArm\n", 0),
        ("call RobotExecute robot Motor 3,1\nexec robot TakeArm 0 1\nexec robot GiveArm\n", 0),
    ] {
        for program in [&["run", "-"][..], &["shell"]] {
            let run = robot.run_with(program, lines);
            // the shell prints an error and continues
            assert_eq!(run.code, if program[0] == "shell" { 0 } else { code }, "{lines}: {run:?}");
            assert!(run.err.contains(OFF) && !is_on(), "{program:?} {lines}: {run:?}");
        }
    }
    // with the arm it belongs to the arm
    let run = robot.run_with(&["run", "-"], "exec robot Motor 1 0\nexec robot TakeArm 0 1\ncall RobotRelease robot\n");
    assert!(run.code == 0 && !is_on(), "{run:?}");
    // another client uses the motor
    let address = format!("tcp:{}", robot.served.tcp);
    let mut other = bcap_std::blocking::Controller::connect(&address, &bcap_std::Settings::rc8()).unwrap();
    let arm = other.robot().unwrap().take_arm().unwrap();
    let run = robot.run_with(&["run", "-"], "exec robot Motor 1 0\n");
    assert!(run.code == 0 && is_on(), "{run:?}");
    drop(arm);
}

#[test]
#[cfg(target_os = "linux")]
fn a_shell_that_was_suspended_goes_on() {
    let robot = Virtual::start(&[]);
    let mut child = robot.spawn(&["shell"]);
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(b"move 'J(90, 45, 90, 0, 45, 0)' --speed 1\n").unwrap();
    robot.wait_for_motion();
    send(Signal::TSTP, &child);
    while state(&child) != 'T' {
        thread::sleep(Duration::from_millis(1));
    }
    robot.assert_at_rest_with_free_arm();
    send(Signal::CONT, &child);
    stdin.write_all(b"get I1\n").unwrap();
    drop(stdin);
    let run: Run = child.wait_with_output().unwrap().into();
    assert!(run.err.contains(INTERRUPTED) && run.out.contains("I1 = 0") && run.code == 0, "{run:?}");
}

#[test]
fn a_replay_that_is_ended_during_a_motion_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (script, capture) = (folder.path().join("script.bcap"), folder.path().join("session.pcapng"));
    let lines = [
        "exec robot TakeArm 0 1",
        "exec robot Motor 1 0",
        "call Robot_Move robot 1 '8,@E J(90, 45, 90, 0, 45, 0)' '8,NEXT, SPEED=2'",
        "call Robot_Halt robot 8,",
        // the halted motion is an error
        "errors --clear",
        // waits for the end of the motion
        "call Robot_Move robot 1 '8,@E J(90, 45, 90, 0, 45, 0)' 8,SPEED=100",
    ];
    std::fs::write(&script, lines.join("\n")).unwrap();
    let (script, capture) = (script.to_str().unwrap(), capture.to_str().unwrap());
    let recorded = Virtual::start(&[]).run(&["run", script, "--write", capture]);
    assert_eq!(recorded.code, 0, "{recorded:?}");
    for signal in [Signal::INT, Signal::TERM] {
        let robot = Virtual::start(&[]);
        let slow = robot.run(&["exec", "robot", "ExtSpeed", "1"]);
        assert_eq!(slow.code, 0, "{slow:?}");
        let allow = ["Controller_Execute", "Robot_Execute", "Robot_Move", "Robot_Halt"];
        let allow = allow.map(|name| ["--allow", name]).concat();
        let child = robot.spawn(&[&["replay", capture, "--fast"], &allow[..]].concat());
        robot.wait_for_motion();
        send(signal, &child);
        let run: Run = child.wait_with_output().unwrap().into();
        assert!(run.code == 130 && run.err.contains("its effects on the robot were ended"), "{run:?}");
        robot.assert_at_rest_with_free_arm();
        assert_eq!(robot.run(&["get", "robot/@SERVO_ON"]).out, "robot/@SERVO_ON = false\n");
    }
}

#[test]
fn a_command_that_is_ended_while_it_takes_the_arm_gives_it_back() {
    for signal in [Signal::TERM, Signal::HUP, Signal::QUIT, Signal::INT] {
        for protocol in ["udp", "tcp"] {
            let robot = slow_to_take(LATE);
            let address = if protocol == "udp" { &robot.udp } else { &robot.tcp };
            let run = signal_at_take_arm(&robot, &["exec", "robot", "TakeArm", "0", "1", "--robot", address], signal);
            assert!(run.code == 130 && run.err.contains("interrupted: the arm was given back"), "{signal:?}: {run:?}");
            assert_eq!(robot.served.application().arm_owner(), None, "{signal:?} {protocol}");
        }
    }
}

#[test]
fn doctor_that_is_ended_while_it_takes_the_arm_gives_it_back() {
    for signal in [Signal::TERM, Signal::INT] {
        let robot = slow_to_take(LATE);
        let ports = [robot.tcp.rsplit(':').next().unwrap(), robot.udp.rsplit(':').next().unwrap()];
        let args = ["doctor", "--tcp-port", ports[0], "--udp-port", ports[1], "--robot", &robot.tcp];
        let run = signal_at_take_arm(&robot, &args, signal);
        assert!(run.code == 130 && run.err.contains("interrupted"), "{signal:?}: {run:?}");
        assert_eq!(robot.served.application().arm_owner(), None, "{signal:?}");
    }
}

#[test]
fn an_arm_whose_take_arm_had_no_reply_is_given_back_over_udp() {
    let robot = slow_to_take(1500);
    let run = bcap(&["exec", "robot", "TakeArm", "0", "1", "--timeout", "400", "--robot", &robot.udp]);
    assert_eq!(run.code, 4, "{run:?}");
    assert_eq!(robot.served.application().arm_owner(), None);
}

#[test]
fn a_motion_without_a_speed_is_slow() {
    let robot = Virtual::start(&[]);
    let run = robot.run(&["move", "J(1, 45, 90, 0, 45, 0)", "--trace=values"]);
    assert!(run.code == 0 && run.err.contains("\"NEXT,SPEED=10\""), "{run:?}");
}

#[test]
fn what_cannot_be_a_destination_is_refused_before_the_first_call() {
    let fake = Fake::tcp(usual);
    for to in ["I1", "F2", "D3", "S1", "IO5", "J(0, 45", "J(0, 45, 90, 0, 45, 0", "J(0, nan, 90, 0, 45, 0)", "P(1, 2)"]
    {
        let run = bcap(&["move", to, "--yes", "--robot", &fake.address]);
        assert!(run.code == 2 && run.err.contains(to), "{run:?}");
    }
    let run = bcap(&["move", "P1", "--yes", "--speed", "nan", "--robot", &fake.address]);
    assert_eq!(run.code, 2, "{run:?}");
    assert!(fake.seen().is_empty(), "{:?}", fake.seen());
}

#[test]
fn a_script_with_an_error_in_its_last_line_makes_no_call() {
    let fake = Fake::tcp(usual);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("bad"), "get I1\nmove I1\n").unwrap();
    for (last, problem) in [
        ("gte I1", "unrecognized subcommand 'gte'"),
        ("get $y", "the variable y is not set"),
        ("put I1", "the value is missing"),
        ("move P1 --speed 0", "write a speed above 0"),
        ("move 'J(1, nan, 3, 4, 5, 6)'", "is not a finite number"),
        ("call NoSuchFunction", "there is no function NoSuchFunction"),
        ("exec variable:I1 X", "has no commands"),
        ("wait I1 = 5 soon", "soon"),
        ("shell", "a shell does not run inside"),
        (&format!("run {}", path("bad")), "bad:2: I1 is not the destination"),
        ("run no-such-file", "no-such-file"),
    ] {
        std::fs::write(path("script"), format!("set x = 3\nput I1 $x\nexec robot TakeArm 0 1\n{last}\n")).unwrap();
        for more in [&[][..], &["--check"]] {
            let run = bcap(&[&["run", &path("script"), "--robot", &fake.address], more].concat());
            assert!(run.code == 2 && run.err.contains("script:4: ") && run.err.contains(problem), "{last}: {run:?}");
        }
    }
    // valid lines are only checked, and lines after `exit` are not
    std::fs::write(path("script"), "set x = 3\nput I1 $x\nmove P$x --help\nexit\nnonsense\n").unwrap();
    let run = bcap(&["run", &path("script"), "--check", "--robot", &fake.address]);
    assert_eq!(
        (run.out.as_str(), run.code),
        (format!("{}: 5 lines are valid\n", path("script")).as_str(), 0),
        "{run:?}"
    );
    // an `exit` that may not run ends no check
    for exit in ["if I1 = 1 exit", "while I1 = 1 exit", "repeat 0 exit"] {
        std::fs::write(path("script"), format!("{exit}\nnonsense\n")).unwrap();
        let run = bcap(&["run", &path("script"), "--check", "--robot", &fake.address]);
        assert!(run.code == 2 && run.err.contains("script:2: "), "{exit}: {run:?}");
    }
    let run = bcap_with(&["run", "-", "--check", "--json", "--robot", &fake.address], b"get I1\nget I2\n");
    assert_eq!((run.out.as_str(), run.code), ("{\"lines\":2}\n", 0), "{run:?}");
    assert!(fake.seen().is_empty(), "{:?}", fake.seen());
}

#[test]
fn a_real_robot_moves_only_after_a_question() {
    let robot = Robot::with(Config { serial_number: "1234567".into(), ..Config::new(Profile::Rc8) });
    let to = "J(1, 45, 90, 0, 45, 0)";
    let script = format!("move '{to}'\n");
    let runs = [robot.run(&["move", to]), robot.run_with(&["run", "-"], &script)];
    for run in runs {
        assert!(run.code == 2 && run.err.contains("cannot ask for confirmation"), "{run:?}");
        assert!(run.err.contains("give --yes"), "{run:?}");
    }
    assert_eq!(robot.served.application().joints()[0], 0.0);
    assert!(!robot.served.application().motor_is_on());
    assert_eq!(robot.run(&["move", to, "--yes"]).code, 0);
    assert!((robot.served.application().joints()[0] - 1.0).abs() < 1e-6);
    // a virtual controller needs no confirmation
    assert_eq!(Robot::start().run(&["move", to]).code, 0);
}

#[test]
fn the_question_before_a_motion_takes_an_answer_or_a_signal() {
    let robot = Robot::with(Config { serial_number: "1234567".into(), ..Config::new(Profile::Rc8) });
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script");
    let line = format!("{} move 'J(1, 45, 90, 0, 45, 0)' --robot {}\n", env!("CARGO_BIN_EXE_bcap"), robot.tcp);
    // the shell continues after a SIGINT of its command
    std::fs::write(&script, format!("trap : INT\n{line}echo code $?\nsleep 60\n")).unwrap();
    for (key, code) in [("n", 2), ("C-c", 130), ("y", 0)] {
        let Some(terminal) = Terminal::run((120, 24), &["sh", script.to_str().unwrap()], folder.path()) else { return };
        terminal.wait_for("Continue? [y/N]");
        assert_eq!(robot.served.application().arm_owner(), None);
        terminal.keys(&[key]);
        if key != "C-c" {
            terminal.keys(&["Enter"]);
        }
        terminal.wait_for(&format!("code {code}"));
        let moved = robot.served.application().joints()[0] != 0.0;
        assert_eq!(moved, key == "y");
    }
}

#[test]
fn what_is_rarely_meant_is_written_only_with_its_type() {
    let robot = Virtual::start(&[]);
    for (name, value, typed) in [
        ("F1", "nan", "4,nan"),
        ("D1", "inf", "5,inf"),
        ("P2", "nan,0,0,0,0,0,5", "8196,nan,0,0,0,0,0,5"),
        ("P2", "1,2,3,4,5,6,7.5", "8196,1,2,3,4,5,6,7.5"),
        ("T2", "1,2,3,0,1,0,0,0,1,0.5", "8196,1,2,3,0,1,0,0,0,1,0.5"),
        ("IO128", "5", "11,5"),
    ] {
        let refused = [
            robot.run(&["put", name, value]),
            bcap(&["rac", "put", name, value, "--robot", &robot.rac]),
            robot.script(&format!("put {name} {value}\n")),
        ];
        for run in refused {
            assert!(run.code == 2 && run.err.contains(&format!("--typed {typed}")), "{name}: {run:?}");
        }
    }
    assert_eq!(robot.run(&["get", "F1", "IO128"]).out, "F1 = 0\nIO128 = false\n");
    assert_eq!(robot.run(&["put", "--typed", "F1", "4,nan"]).code, 0);
    assert_eq!(robot.run(&["put", "--typed", "IO128", "11,5"]).code, 0);
    assert_eq!(robot.run(&["get", "F1", "IO128"]).out, "F1 = NaN\nIO128 = true\n");
}

#[test]
fn a_link_that_is_silent_during_a_motion_is_reported_before_the_call_fails() {
    let robot = Virtual::start(&[]);
    let relay = Relay::tcp(robot.tcp.trim_start_matches("tcp:").parse().unwrap());
    let address = format!("tcp:{}", relay.tcp);
    let args = [&SLOW[..], &["--timeout", "60s", "--robot", &address]].concat();
    let mut child = bare(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    robot.wait_for_motion();
    relay.hold(true);
    let mut err = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    err.read_line(&mut line).unwrap();
    assert!(line.contains("has not answered for 1 s: the robot may be moving"), "{line}");
    relay.hold(false);
    line.clear();
    err.read_line(&mut line).unwrap();
    assert!(line.contains("answers again"), "{line}");
    send(Signal::INT, &child);
    let mut rest = String::new();
    err.read_to_string(&mut rest).unwrap();
    assert!(rest.contains(INTERRUPTED), "{rest}");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn a_motion_whose_link_is_lost_may_go_on_and_the_command_says_so() {
    let robot = Virtual::start(&[]);
    let relay = Relay::tcp(robot.tcp.trim_start_matches("tcp:").parse().unwrap());
    let address = format!("tcp:{}", relay.tcp);
    let args = [&SLOW[..], &["--timeout", "6s", "--robot", &address]].concat();
    let child = bare(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    robot.wait_for_motion();
    relay.hold(true);
    let run: Run = child.wait_with_output().unwrap().into();
    assert_eq!(run.code, 4, "{run:?}");
    assert!(run.err.contains("the robot may still move; use the emergency stop"), "{run:?}");
}

/// Over UDP a controller ends the session of an idle peer if it needs its slot: for example the session that waits to halt.
#[test]
fn ctrl_c_halts_a_motion_after_the_halting_session_was_evicted() {
    let limits = Limits::default().udp_peers_per_address(3).udp_idle(Duration::ZERO);
    let served = Served::of(Controller::new(Config::new(Profile::Rc8)), limits);
    let address = format!("udp:{}", served.udp);
    let mut command = bare(&[&SLOW[..], &["--robot", &address]].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    served.until(Controller::is_moving);
    // the session of the motion makes calls, so the idle one makes room for the second
    let others = [(); 2].map(|()| bcap_std::blocking::Controller::connect(&address, &bcap_std::Settings::rc8()));
    assert!(others.iter().all(Result::is_ok), "{others:?}");
    drop(others);
    send(Signal::INT, &child);
    let run: Run = child.wait_with_output().unwrap().into();
    assert_eq!((run.err.trim_end(), run.code), (format!("error: {INTERRUPTED}").as_str(), 130));
    assert!(served.application().joints()[0] < 89.0 && served.is(|robot| !robot.is_moving()));
}

#[test]
fn a_motion_whose_halt_was_refused_is_not_said_to_be_halted() {
    let robot = Robot::start();
    let refused = |of: &str| {
        format!("[[fault]]\nwhen = {{ every = 1, of = {of:?} }}\nthen = {{ refuse = \"E_ACCESSDENIED\" }}\n")
    };
    let faults = ["Robot_Halt", "KillAll"].map(refused).concat();
    robot.served.application().play(Scenario::parse(&faults).unwrap());
    let mut command = bare(&["move", "J(12, 45, 90, 0, 45, 0)", "--speed", "1", "--robot", &robot.tcp]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    robot.served.until(Controller::is_moving);
    send(Signal::INT, &child);
    let run: Run = child.wait_with_output().unwrap().into();
    assert_eq!(run.code, 130, "{run:?}");
    assert!(run.err.contains("E_ACCESSDENIED"), "{run:?}");
    assert!(run.err.ends_with("the motion was not halted: it has ended, and the arm was given back\n"), "{run:?}");
    assert!((robot.served.application().joints()[0] - 12.0).abs() < 1e-6);
}

/// The end of a lost session needs a new connection to switch the motor off.
#[test]
fn a_motor_that_a_lost_session_may_leave_on_is_reported() {
    for is_back in [false, true] {
        let robot = Robot::start();
        let relay = Relay::tcp(robot.served.tcp);
        let mut command = command(&["run", "-", "--robot", &format!("tcp:{}", relay.tcp)]);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = child.stdin.take().unwrap();
        lines.write_all(b"exec robot Motor 1 0\n").unwrap();
        robot.served.until(Controller::motor_is_on);
        if is_back {
            relay.disconnect();
        } else {
            relay.cut(Cut::Reset);
        }
        // the first line may have ended the script
        let _ = lines.write_all(b"get I1\n");
        let run: Run = child.wait_with_output().unwrap().into();
        assert_eq!(run.code, 3, "{run:?}");
        let told = run.err.contains("it is unknown whether the robot rests and its motor is off");
        assert_eq!((told, robot.served.application().motor_is_on()), (!is_back, !is_back), "{run:?}");
    }
}

/// Undoing the effects of a session can fail, and only the user can check the robot.
#[test]
fn an_end_of_a_session_that_fails_is_a_failure() {
    let fault = |call: u8, of: &str, code: &str| {
        format!("[[fault]]\nwhen = {{ call = {call}, of = {of:?} }}\nthen = {{ refuse = {code:?} }}\n")
    };
    const ARM: &str = "exec robot TakeArm 0 1\n";
    const MOTOR: &str = "exec robot Motor 1 0\n";
    const MOVE: &str = "move 'J(90, 45, 90, 0, 45, 0)' --speed 1 --no-wait\n";
    const TIMEOUT: &str = "0x80000900";
    // the first Motor switches it on; without the arm it is switched off twice at the end
    let off = [2, 3, 4, 5].map(|call| fault(call, "Motor", TIMEOUT)).concat();
    let cases = [
        (
            [ARM, MOTOR, MOVE].concat(),
            fault(1, "Robot_Halt", "0x83500079"),
            "Robot_Halt: the controller refused with 0x83500079",
        ),
        ([ARM, MOTOR].concat(), off.clone(), "the controller refused with 0x80000900"),
        (MOTOR.to_owned(), off, "the controller refused with 0x80000900"),
    ];
    for (lines, faults, message) in cases {
        for (program, last) in [(&["run", "-"][..], ""), (&["shell"], ""), (&["run", "-"], "disconnect\n")] {
            let robot = Robot::start();
            robot.served.application().play(Scenario::parse(&faults).unwrap());
            let run = robot.run_with(program, &format!("{lines}{last}"));
            assert!(run.code == 1 && run.err.contains(message), "{program:?} {lines}{last}: {run:?}");
            assert!(run.err.contains("the robot may still move, or its motor be on"), "{run:?}");
            assert!(!run.err.contains("the motor is switched off now"), "{run:?}");
        }
    }
}
