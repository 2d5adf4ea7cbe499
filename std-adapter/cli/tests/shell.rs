//! `bcap shell`, `bcap run`, and the commands that do a whole job, against a virtual controller.

use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::sync::atomic::{AtomicU32, Ordering};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_tests::process::{Signal, send};
use bcap_tests::proxy::{Cut, Relay};
use serde_json::Value;

use crate::common;
use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap, bcap_with, command};

/// A motion that takes more than ten seconds.
const SLOW: [&str; 4] = ["move", "J(90, 45, 90, 0, 45, 0)", "--speed", "1"];
const INTERRUPTED: &str = "interrupted: the robot was halted, and the arm was given back";

#[test]
fn the_sample_sessions_of_the_specification_are_scripts() {
    let robot = Virtual::start(&["--model", "rc9"]);
    let provider = ["--provider", "CaoProv.DENSO.VRC9"];
    for (name, out) in
        [("variables", "IO150 = false\nIO150 = true\nIO150 = false\n"), ("tasks", "Pro1 ready\n"), ("robot", "")]
    {
        let file = format!("{}/../../docs/scripts/{name}.bcap", env!("CARGO_MANIFEST_DIR"));
        let run = robot.run(&[&["run", file.as_str()], &provider[..]].concat());
        assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (out, "", 0), "{name}");
    }
    let state = robot.run(&[&["get", "@BUSY_STATUS", "robot/@SERVO_ON"], &provider[..]].concat());
    assert_eq!(state.out, "@BUSY_STATUS = false\nrobot/@SERVO_ON = false\n");
}

#[test]
fn the_arm_stays_taken_from_line_to_line() {
    let robot = Virtual::start(&[]);
    let run = robot.script(
        "# the arm and the motor\n\
         exec robot TakeArm 0 1\n\
         exec robot Motor 1 0\n\
         get robot/@SERVO_ON\n\
         names --json\n\
         call Robot_Move robot 1 '8,@E J(10, 45, 90, 0, 45, 0)' 8,SPEED=100\n\
         move 'J(0, 45, 90, 0, 45, 0)'\n\
         get robot/@SERVO_ON\n",
    );
    assert_eq!((run.err.as_str(), run.code), ("", 0));
    assert!(run.out.ends_with("at J(0, 45, 90, 0, 45, 0)\nrobot/@SERVO_ON = true\n"), "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn variables_of_a_script_are_replaced() {
    let robot = Virtual::start(&[]);
    let run = robot.script("set x = 3\nset name = I$x\nput $name ${x}5\nput S1 '$x'\nget I3 S1\n");
    assert_eq!((run.out.as_str(), run.code), ("I3 = 35\nS1 = $x\nI3 = 35\nS1 = $x\n", 0), "{run:?}");
}

#[test]
fn a_script_stops_at_the_first_error_and_names_its_line() {
    let robot = Virtual::start(&[]);
    let file = tempfile::NamedTempFile::new().unwrap();
    let name = file.path().display();
    for (lines, message, code) in [
        ("put I1 7\n\nexpect I1 = 5\nput I2 1\n", format!("{name}:3: expected I1 = 5, found 7"), 1),
        ("expect I1 >= 8\n", format!("{name}:1: expected I1 >= 8, found 7"), 1),
        ("get I1 X1\n", format!("{name}:1: 1 of 2 were refused"), 1),
        ("get I1\ngte I1\n", format!("{name}:2: unrecognized subcommand 'gte'"), 2),
        ("get $y\n", format!("{name}:1: the variable y is not set"), 2),
        ("wait I1 = 5 20ms\n", format!("{name}:1: waited 20ms for I1 = 5, found 7"), 4),
        ("exec robot NoCommand\n", format!("{name}:1: robot: NoCommand"), 1),
        ("bcap get I1\n", format!("{name}:1: write the command without the word bcap"), 2),
        ("get I1 --robot tcp:x\n", format!("{name}:1: unexpected argument '--robot' found"), 2),
    ] {
        std::fs::write(file.path(), lines).unwrap();
        let run = robot.run(&["run", &name.to_string()]);
        assert!(run.err.contains(&message) && run.code == code, "{lines}: {run:?}");
    }
    assert_eq!(robot.run(&["get", "I2"]).out, "I2 = 0\n");
    let run = bcap(&["run", "/no/such/file"]);
    assert!(run.code == 2 && run.err.contains("/no/such/file: No such file"), "{run:?}");
}

#[test]
fn conditions_compare_as_put_writes() {
    let robot = Virtual::start(&[]);
    let lines = "put F1 2.5\nput P1 400,0,300.1,180,0,180,5\nput IO128 on\n\
                 expect F1 = 2.5\nexpect F1 > -3\nexpect F1 <= 2.5\nexpect F1 != 2.4\n\
                 expect P1 = 400,0,300.1,180,0,180,5\nexpect IO128 = true\nwait I1 = 0\nsleep 1ms\n";
    assert_eq!(robot.script(lines).code, 0);
}

#[test]
fn one_move_takes_the_arm_and_gives_it_back() {
    let robot = Virtual::start(&[]);
    let run = robot.run(&["move", "J(10, 45, 90, 0, 45, 0)", "--speed", "50"]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("at J(10, 45, 90, 0, 45, 0)\n", "", 0));
    robot.assert_at_rest_with_free_arm();
    let run = robot.run(&["move", "J(999, 45, 90, 0, 45, 0)"]);
    assert_eq!(run.code, 1, "{run:?}");
    assert_eq!(robot.run(&["errors", "--clear"]).code, 0);
    let run = robot.run(&["move", "P1", "--speed", "0"]);
    assert!(run.code == 2 && run.err.contains("write a speed above 0 and up to 100"), "{run:?}");
    let run = robot.run(&["move", "P1", "--no-wait"]);
    assert!(run.code == 2 && run.err.contains("--no-wait needs the arm of this session"), "{run:?}");
    let run = robot.run(&["move", "J(-90, 45, 90, 0, 45, 0)", "--speed", "1", "--within", "1ms"]);
    assert!(run.code == 1 && run.err.contains("so the robot was halted"), "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn what_ends_with_the_session_is_said() {
    let robot = Virtual::start(&[]);
    let run = robot.run(&["exec", "robot", "TakeArm", "0", "1"]);
    assert!(run.code == 0 && run.err.contains("the arm was taken, and is given back now"), "{run:?}");
    let run = robot.run(&["call", "Robot_Move", "robot", "3,2", "8,@E P1", "8,SPEED=10"]);
    assert!(run.code == 1 && run.err.contains("`bcap move P1` takes it, moves and gives it back"), "{run:?}");
}

#[test]
fn ctrl_c_halts_a_motion_and_gives_the_arm_back() {
    let robot = Virtual::start(&[]);
    // one command; a motion of a script; a call that lasts as long as the motion; a motion of an earlier line
    let slow = "move 'J(90, 45, 90, 0, 45, 0)' --speed 1\n";
    let arm = "exec robot TakeArm 0 1\nexec robot Motor 1 0\n";
    let long_call = format!("{arm}call Robot_Move robot 1 '8,@E J(-90, 45, 90, 0, 45, 0)' 8,SPEED=1\n");
    let earlier = format!("{arm}{}sleep 1min\n", slow.replace("--speed", "--no-wait --speed"));
    // the same after a line whose session also handles signals
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    assert_eq!(robot.run(&["get", "I1", "--write", &path("get.pcapng")]).code, 0);
    let after = |line: String| long_call.replacen(arm, &format!("{arm}{line}\n"), 1);
    let recorded = after(format!("slave record {} --seconds 0.01", path("poses.csv")));
    let replayed = after(format!("replay {}", path("get.pcapng")));
    for (args, lines) in [
        (&SLOW[..], ""),
        (&["run", "-"], slow),
        (&["run", "-"], &long_call),
        (&["run", "-"], &earlier),
        (&["run", "-"], &recorded),
        (&["run", "-"], &replayed),
        (&["shell"], slow),
    ] {
        let mut child = robot.spawn(args);
        child.stdin.as_mut().unwrap().write_all(lines.as_bytes()).unwrap();
        robot.wait_for_motion();
        send(Signal::INT, &child);
        if args == ["shell"] {
            // the shell continues after an interruption
            child.stdin.as_mut().unwrap().write_all(b"get I1\n").unwrap();
        }
        let run: Run = child.wait_with_output().unwrap().into();
        assert!(run.err.contains(INTERRUPTED), "{lines}: {run:?}");
        assert_eq!(run.code, if args == ["shell"] { 0 } else { 130 }, "{lines}: {run:?}");
        assert_eq!(run.out.contains("I1 = 0"), args == ["shell"], "{run:?}");
        robot.assert_at_rest_with_free_arm();
    }
}

#[test]
fn a_signal_ends_a_script_that_waits_for_its_next_line() {
    let robot = Virtual::start(&[]);
    for signal in [Signal::INT, Signal::TERM] {
        let mut child = robot.spawn(&["run", "-"]);
        // stays open, because the end of the input would end the script too
        let mut stdin = child.stdin.take().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap()).lines();
        let lines = "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove J(90,45,90,0,45,0) --speed 1 --no-wait\n";
        stdin.write_all(lines.as_bytes()).unwrap();
        // the third line ends after the motion has begun
        assert!(out.any(|line| line.unwrap().starts_with("on the way to ")));
        robot.wait_for_motion();
        send(signal, &child);
        let run: Run = child.wait_with_output().unwrap().into();
        assert!(run.code == 130 && run.err.contains("-:4: interrupted before this line"), "{signal:?}: {run:?}");
        drop(stdin);
        robot.assert_at_rest_with_free_arm();
    }
}

#[test]
fn ctrl_c_halts_motions_after_a_command_with_signals_of_its_own() {
    let robot = Virtual::start(&[]);
    let backup = tempfile::tempdir().unwrap();
    let mut child = robot.spawn(&["shell"]);
    let mut stdin = child.stdin.take().unwrap();
    let (there, back) = ("move 'J(90, 45, 90, 0, 45, 0)' --speed 1\n", "move 'J(-90, 45, 90, 0, 45, 0)' --speed 1\n");
    stdin.write_all(format!("dump {}\n{there}", backup.path().join("cell").display()).as_bytes()).unwrap();
    robot.wait_for_motion();
    send(Signal::INT, &child);
    robot.wait_for_rest();
    stdin.write_all(format!("errors --clear\n{back}").as_bytes()).unwrap();
    robot.wait_for_motion();
    send(Signal::INT, &child);
    robot.wait_for_rest();
    stdin.write_all(b"get I1\n").unwrap();
    drop(stdin);
    let run: Run = child.wait_with_output().unwrap().into();
    assert_eq!((run.err.matches(INTERRUPTED).count(), run.code), (2, 0), "{run:?}");
    assert!(run.out.ends_with("I1 = 0\n"), "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn the_end_of_a_script_has_time_of_its_own_to_halt_the_robot() {
    let robot = Virtual::start(&[]);
    let lines =
        "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove J(90,45,90,0,45,0) --speed 1 --no-wait\nsleep 4500ms\n";
    let run = bcap_with(&["run", "-", "--timeout", "4s", "--robot", &robot.tcp], lines.as_bytes());
    assert_eq!(run.code, 0, "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn scripts_that_run_themselves_and_incomplete_commands_are_errors() {
    let robot = Virtual::start(&[]);
    let file = tempfile::NamedTempFile::new().unwrap();
    let name = file.path().display();
    std::fs::write(file.path(), format!("run {name}\n")).unwrap();
    let run = robot.run(&["run", &name.to_string()]);
    assert!(run.code == 2 && run.err.contains("more than 16 scripts run each other"), "{run:?}");
    let run = robot.script("task start\nput I1 1\n");
    assert!(run.code == 2 && run.err.contains("-:1: "), "{run:?}");
    assert_eq!(robot.run(&["get", "I1"]).out, "I1 = 0\n");
}

#[test]
fn a_recording_that_would_be_empty_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("empty.pcapng");
    for args in [["raw", "01"], ["explain", "E_HANDLE"]] {
        let run = bcap(&[&args[..], &["--write", file.to_str().unwrap()]].concat());
        assert!(run.code == 2 && run.err.contains("nothing to record") && !file.exists(), "{run:?}");
    }
}

#[test]
fn ctrl_c_halts_a_motion_over_udp() {
    let robot = Virtual::start(&[]);
    let mut command = common::bare(&[&SLOW[..], &["--robot", &robot.udp]].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    robot.wait_for_motion();
    send(Signal::INT, &child);
    let run: Run = child.wait_with_output().unwrap().into();
    assert!(run.err.contains(INTERRUPTED) && run.code == 130, "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn both_sessions_of_a_motion_end() {
    let robot = Virtual::start(&[]);
    // a controller has 16 slots for clients over UDP
    for _ in 0..20 {
        let run = bcap(&["move", "J(0, 45, 90, 0, 45, 0)", "--robot", &robot.udp]);
        assert_eq!(run.code, 0, "{run:?}");
    }
}

#[test]
fn a_connection_that_is_lost_during_a_motion_is_replaced_to_halt() {
    let scenario = tempfile::NamedTempFile::new().unwrap();
    // `move` reads the state of the controller while it waits
    let fault =
        |call: u8, of: &str| format!("[[fault]]\nwhen = {{ call = {call}, of = {of:?} }}\nthen = \"disconnect\"\n");
    let arm = "exec robot TakeArm 0 1\nexec robot Motor 1 0\n";
    let slow = "'8,@E J(90, 45, 90, 0, 45, 0)' 8,NEXT,SPEED=1";
    let reads = "get I1\n".repeat(5);
    // the halt reads the state too, so each case has one fault
    for (lines, fault) in [
        (format!("{arm}call Robot_Move robot 1 {slow}\n{reads}"), fault(5, "Variable_GetValue")),
        ("move 'J(90, 45, 90, 0, 45, 0)' --speed 1\n".to_owned(), fault(3, "SysState")),
    ] {
        std::fs::write(scenario.path(), fault).unwrap();
        let robot = Virtual::start(&["--scenario", scenario.path().to_str().unwrap()]);
        let run = robot.script(&lines);
        assert_eq!(run.code, 3, "{lines}: {run:?}");
        assert!(run.err.contains("the robot was halted over another connection"), "{lines}: {run:?}");
        let state = robot.run(&["get", "@BUSY_STATUS"]);
        assert_eq!(state.out, "@BUSY_STATUS = false\n");
        // the halted motion is an error
        assert_eq!(robot.run(&["errors", "--clear"]).code, 0);
        assert_eq!(robot.run(&["exec", "robot", "TakeArm", "0", "1"]).code, 0);
    }
}

#[test]
fn a_shell_that_is_ended_gives_the_arm_back() {
    let robot = Virtual::start(&[]);
    for signal in [Signal::TERM, Signal::HUP] {
        let mut child = robot.spawn(&["shell"]);
        let lines = "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove J(90,45,90,0,45,0) --speed 1 --no-wait\n";
        // stays open, because the end of the input would end the shell too
        let mut stdin = child.stdin.take().unwrap();
        stdin.write_all(lines.as_bytes()).unwrap();
        robot.wait_for_motion();
        send(signal, &child);
        let run: Run = child.wait_with_output().unwrap().into();
        assert_eq!(run.code, 130, "{signal:?}: {run:?}");
        drop(stdin);
        robot.assert_at_rest_with_free_arm();
    }
}

#[test]
fn the_shell_says_that_the_connection_is_lost_and_connects_again() {
    let robot = Virtual::start(&[]);
    let scenario = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(
        scenario.path(),
        "[[fault]]\nwhen = { call = 1, of = \"Variable_PutValue\" }\nthen = \"disconnect\"\n",
    )
    .unwrap();
    drop(robot);
    let robot = Virtual::start(&["--scenario", scenario.path().to_str().unwrap()]);
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup");
    let backup = backup.display();
    // a command that fails because of the lost connection does not open another connection
    let lines = format!(
        "dump {backup}\nexec robot TakeArm 0 1\nput I1 1\nrestore {backup} --yes\nget I1\nconnect\nput I1 2\n\
         exec robot TakeArm 0 1\n"
    );
    let run = bcap_with(&["shell", "--robot", &robot.tcp], lines.as_bytes());
    assert_eq!(run.err.matches("the connection is lost").count(), 2, "{run:?}");
    assert_eq!((run.out.matches("I1 = ").count(), run.code), (1, 0), "{run:?}");
    assert!(run.out.contains("I1 = 2"), "{run:?}");
    assert!(run.err.contains("closed the connection during Variable_PutValue"), "{run:?}");
    assert!(run.err.contains("the connection is lost") && run.err.contains("`connect` connects again"), "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn a_shell_without_a_controller_explains_itself() {
    let run = bcap_with(
        &["shell", "--robot", "tcp:127.0.0.1:1"],
        b"decode 01100000000100000002000000000004\nhelp\nhelp move\n",
    );
    assert!(run.err.contains("cannot connect") && run.err.contains("`connect` tries again"), "{run:?}");
    assert!(run.out.contains("function 2 Service_Stop") && run.out.contains("--speed <PERCENT>"), "{run:?}");
    for command in ["get", "exec", "move", "task", "sim", "expect", "connect"] {
        assert!(run.out.lines().any(|line| line.starts_with(&format!("{command} "))), "{command}: {run:?}");
    }
}

#[test]
fn errors_and_messages_are_shown_and_cleared() {
    let scenario = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(
        scenario.path(),
        "[[fault]]\nwhen = { call = 1, of = \"Motor\" }\nthen = { error = \"0x84201486\" }\n",
    )
    .unwrap();
    let robot = Virtual::start(&["--scenario", scenario.path().to_str().unwrap()]);
    let run = robot.run(&["errors"]);
    assert_eq!((run.out.as_str(), run.code), ("no errors\n", 0));
    let shell = bcap_with(
        &["shell", "--robot", &robot.tcp],
        b"exec robot TakeArm 0 1\nexec robot Motor 1 0\nerrors\nerrors --clear\nerrors\nexit\nget I1\n",
    );
    assert_eq!(shell.out.matches("0x84201486 (E_").count(), 1, "{shell:?}");
    // the message of the controller precedes the next prompt
    assert_eq!(shell.err.matches(" RC8 0x84201486: ").count(), 1, "{shell:?}");
    assert!(shell.err.contains("note: DATE("), "{shell:?}");
    assert!(shell.out.ends_with("no errors\n"), "{shell:?}");
}

#[test]
fn tasks_are_started_and_stopped() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["task", "start", "Pro1", "--forever"]).code, 0);
    assert_eq!(robot.run(&["task", "status", "Pro1"]).out, "Pro1 running\n");
    assert_eq!(robot.run(&["task", "stop", "Pro1", "--now"]).code, 0);
    assert_ne!(robot.run(&["task", "status", "Pro1", "--json"]).out, "{\"name\":\"Pro1\",\"status\":\"running\"}\n");
    assert_eq!(robot.run(&["task", "start", "Pro1"]).code, 2);
    assert_eq!(robot.run(&["task", "start", "Pro1", "Pro2", "--forever"]).code, 0);
    let list = robot.run(&["task"]);
    assert!(list.out.starts_with("Pro1             running           line "), "{list:?}");
    let lines: Vec<Value> = robot.run(&["task", "--json"]).out.lines().map(|line| line.parse().unwrap()).collect();
    let of = |name: &str| lines.iter().find(|line| line["name"] == name).unwrap();
    assert_eq!((&of("Pro1")["status"], &of("Pro2")["status"]), (&"running".into(), &"running".into()));
    assert!(of("Pro1")["line"].as_f64().is_some() && of("Pro1")["cycle_ms"].as_f64().is_some(), "{list:?}");
    let run = robot.run(&["task", "start", "Pro3", "NoSuch", "--forever"]);
    assert!(run.code == 1 && run.err.contains("started before: Pro3"), "{run:?}");
}

#[test]
fn the_logs_are_a_table() {
    let robot = Virtual::start(&[]);
    let lines = "exec robot TakeArm 0 1\nexec robot Motor 1 0\nexec robot Motor 0 0\nmove 'J(999,45,90,0,45,0)'\n";
    assert_eq!(robot.script(lines).code, 1);
    let errors = robot.run(&["log", "--errors"]).out;
    let operations = robot.run(&["log", "--operations"]).out;
    assert!(errors.lines().all(|line| line[23..].starts_with(" errors ") && line.contains("0x8")), "{errors}");
    assert!(operations.contains(" operations ") && !operations.contains(" errors "), "{operations}");
    let both = robot.run(&["log"]).out;
    assert_eq!(both.lines().count(), errors.lines().count() + operations.lines().count());
    let times: Vec<&str> = both.lines().map(|line| &line[..23]).collect();
    assert!(times.is_sorted() && times[0].starts_with("20"), "{both}");
    assert_eq!(robot.run(&["log", "--last", "1"]).out.lines().count(), 1);
    let line: Value = robot.run(&["log", "--errors", "--last", "1", "--json"]).out.parse().unwrap();
    assert!(line["log"] == "errors" && line["code"].as_i64().unwrap() < 0, "{line}");
}

#[test]
fn a_log_is_followed() {
    let robot = Robot::start();
    let error = |code| robot.served.application().inject_error(HResult::from_u32(code), bcap_std::now());
    error(0x8420_1482);
    let mut follow =
        command(&["log", "--errors", "--follow", "--robot", &robot.tcp]).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(follow.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.next().unwrap().contains("0x84201482"));
    error(0x8150_1003);
    assert!(lines.next().unwrap().contains("0x81501003"));
    error(0x8150_1004);
    error(0x8150_1025);
    let two = [lines.next().unwrap(), lines.next().unwrap()].join("\n");
    assert!(two.contains("0x81501004") && two.contains("0x81501025"), "{two}");
    send(Signal::INT, &follow);
    assert_eq!((follow.wait().unwrap().code(), lines.next()), (Some(0), None));
    let ended = robot.run(&["log", "--last", "1", "--follow", "--for", "10ms"]);
    assert_eq!((ended.code, ended.out.lines().count()), (0, 1), "{ended:?}");
}

#[test]
fn a_command_of_a_script_is_repeated() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let (part, whole) = (folder.path().join("part.bcap"), folder.path().join("whole.bcap"));
    std::fs::write(&part, "get I1\n").unwrap();
    let part = part.to_str().unwrap();
    let lines =
        format!("repeat 2 run {part}\nrepeat 0 get I2\nset x = I3\nrepeat 3 get $x\nput IO128 on\nwait IO128\n");
    std::fs::write(&whole, &lines).unwrap();
    let whole = whole.to_str().unwrap();
    assert_eq!(robot.run(&["run", whole, "--check"]).out, format!("{whole}: 6 lines are valid\n"));
    let run = robot.run(&["run", whole]);
    assert_eq!((run.out.as_str(), run.err.as_str()), ("I1 = 0\nI1 = 0\nI3 = 0\nI3 = 0\nI3 = 0\nIO128 = true\n", ""));
    for (line, code, text) in [
        ("repeat 2 repeat 2 get I1", 2, "a line has one of repeat, while and if"),
        ("repeat 2 nonsense", 2, "nonsense"),
        ("repeat 2", 2, "required"),
        ("wait I1 =", 2, "required"),
        ("wait I1 == 3 --within 20ms", 4, "waited 20ms for I1 == 3, found 0"),
        ("wait IO129 --within 1ms", 4, "for IO129 = true, found false"),
        ("repeat 3 expect I1 = 1", 1, "expected I1 = 1, found 0"),
    ] {
        let run = robot.script(line);
        assert!(run.code == code && run.err.contains(text), "{line}: {run:?}");
    }
}

/// A shell without a terminal does not see signals while it reads a line, so Ctrl-C must reach the session in another way.
#[test]
fn ctrl_c_at_the_prompt_without_a_terminal_gives_the_arm_back() {
    let robot = Virtual::start(&[]);
    let mut shell = robot.spawn(&["shell"]);
    let mut lines = shell.stdin.take().unwrap();
    lines.write_all(b"exec robot TakeArm 0 1\nget I1\n").unwrap();
    let mut out = BufReader::new(shell.stdout.take().unwrap()).lines();
    while !out.next().unwrap().unwrap().contains("I1 = 0") {}
    send(Signal::INT, &shell);
    let mut err = BufReader::new(shell.stderr.take().unwrap()).lines();
    while !err.next().unwrap().unwrap().contains("the robot was halted, and the arm was given back") {}
    robot.assert_at_rest_with_free_arm();
    drop(lines);
    assert_eq!(shell.wait().unwrap().code(), Some(0));
}

/// Moves the robot without waiting for it.
const STARTED: &str = "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove J(90,45,90,0,45,0) --speed 1 --no-wait\n";
const BY_ANOTHER: &str = "the robot was halted over another connection";

#[test]
fn a_link_that_is_found_lost_at_the_prompt_halts_the_robot() {
    let robot = Virtual::start(&[]);
    let relay = Relay::tcp(robot.tcp.trim_start_matches("tcp:").parse().unwrap());
    let address = format!("tcp:{}", relay.tcp);
    let mut shell = common::bare(&["shell", "--timeout", "3s", "--robot", &address]);
    let mut shell = shell.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = shell.stdin.take().unwrap();
    lines.write_all(STARTED.as_bytes()).unwrap();
    robot.wait_for_motion();
    relay.cut(Cut::Silent);
    relay.heal();
    // an empty line sends nothing; the next prompt detects that the link is silent
    lines.write_all(b"\n").unwrap();
    drop(lines);
    let run: Run = shell.wait_with_output().unwrap().into();
    assert!(run.err.contains(BY_ANOTHER) && run.code == 0, "{run:?}");
    robot.wait_for_rest();
}

#[test]
fn ctrl_c_at_the_prompt_over_a_lost_link_halts_the_robot() {
    let robot = Virtual::start(&[]);
    let relay = Relay::tcp(robot.tcp.trim_start_matches("tcp:").parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let address = format!("tcp:{}", relay.tcp);
    let args = ["shell", "--timeout", "3s", "--robot", &address];
    let Some(terminal) = Terminal::start((120, 24), &args, folder.path()) else { return };
    for line in STARTED.lines() {
        terminal.wait_until("a prompt", |screen| screen.trim_end().ends_with('>'));
        terminal.enter(line);
    }
    terminal.wait_until("a prompt", |screen| screen.contains("on the way") && screen.trim_end().ends_with("motor>"));
    relay.cut(Cut::Silent);
    relay.heal();
    terminal.keys(&["C-c"]);
    terminal.wait_for(BY_ANOTHER);
    terminal.wait_for("not connected>");
    robot.wait_for_rest();
}

#[test]
fn messages_without_end_delay_neither_the_prompt_nor_the_end() {
    let fake = || {
        let asked = AtomicU32::new(0);
        Fake::tcp(move |request| match request.function() {
            // so that the test ends if the command does not
            FunctionId::CONTROLLER_GET_MESSAGE if asked.fetch_add(1, Ordering::Relaxed) < 250 => value(5),
            FunctionId::MESSAGE_GET_DESCRIPTION => value("a message"),
            FunctionId::ROBOT_GET_VARIABLE => value(6),
            FunctionId::VARIABLE_GET_VALUE => value(true),
            _ => usual(request),
        })
    };
    let run = bcap(&["errors", "--follow", "--for", "1ms", "--robot", &fake().address]);
    assert_eq!((run.out.matches("a message").count(), run.code), (100, 0), "{run:?}");
    let run = bcap_with(&["shell", "--robot", &fake().address], b"exit\n");
    assert_eq!((run.err.matches("a message").count(), run.code), (100, 0), "{run:?}");
}

/// The arm belongs to the session of the shell, so a command with a separate session would have closed it or not seen
/// it.
#[test]
fn commands_on_files_and_backups_use_the_session_of_the_shell() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup").display().to_string();
    let local = folder.path().join("local.txt").display().to_string();
    std::fs::write(&local, "text").unwrap();
    let lines = format!(
        "ls\ncp {local} robot:/a.txt\nls robot:/\ndump {backup}\ndiff robot: {backup}\nrestore {backup} --yes --io\n"
    );
    let run = bcap_with(&["run", "-", "--trace=headers", "--robot", &robot.tcp], lines.as_bytes());
    assert!(run.out.contains("/a.txt") && run.code < 2, "{run:?}");
    assert_eq!(run.err.matches(" Service_Start, ").count(), 1, "{}", run.err.lines().take(20).collect::<String>());
}

#[test]
fn conditions_guard_and_repeat_a_command() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let part = folder.path().join("part.bcap");
    std::fs::write(&part, "put I2 $next\nset seen = $next\nput I1 3\n").unwrap();
    let lines = format!(
        "set next = 7\nif I1 = 0 include {}\nget I2\nput I3 $seen\nwhile I1 != 0 put I1 0\nif I1 > 0 put I4 1\nget I1 I3 I4\n",
        part.display()
    );
    let whole = folder.path().join("whole.bcap");
    std::fs::write(&whole, lines).unwrap();
    let run = robot.run(&["run", whole.to_str().unwrap()]);
    assert_eq!((run.err.as_str(), run.code), ("", 0));
    let out = "I2 = 7\nI1 = 3\nI2 = 7\nI3 = 7\nI1 = 0\nI1 = 0\nI3 = 7\nI4 = 0\n";
    assert_eq!(run.out, out);
    for (line, text) in [
        ("if I1 put I1 1", "write a condition of three words"),
        ("while I1 = 1", "required"),
        ("if I1 = 0 if I2 = 0 put I1 1", "a line has one of repeat, while and if"),
        ("repeat 2 while I1 = 0 put I1 1", "a line has one of repeat, while and if"),
        ("if I1 = 0 pt I1 1", "unrecognized subcommand"),
    ] {
        let run = robot.script(line);
        assert!(run.code == 2 && run.err.contains(text), "{line}: {run:?}");
        std::fs::write(&whole, format!("put I1 5\n{line}\n")).unwrap();
        let run = robot.run(&["run", whole.to_str().unwrap()]);
        assert!(run.code == 2 && run.out.is_empty() && run.err.contains("whole.bcap:2: "), "{line}: {run:?}");
    }
    // a signal ends a loop
    let mut child = robot.spawn(&["run", "-"]);
    std::io::Write::write_all(child.stdin.as_mut().unwrap(), b"while I1 = 0 get I5\n").unwrap();
    let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut out, &mut String::new()).unwrap();
    send(Signal::INT, &child);
    std::io::copy(&mut out, &mut std::io::sink()).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
}
