//! Outputs that are full, closed or a terminal: a command whose work is cut says so, and only one that prints may be ended by its reader.

use std::io::{Write, pipe};
use std::process::Stdio;
use std::thread;
use std::time::{Duration, Instant};

use crate::common::fake::{Fake, usual, value};
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, command};
use bcap_core::bcap::FunctionId;
use bcap_tests::process::{Signal, send};

/// Runs a command whose standard output is closed.
fn unread(robot: &Virtual, args: &[&str]) -> Run {
    let (reader, writer) = pipe().unwrap();
    drop(reader);
    let mut command = command(&[args, &["--robot", &robot.tcp]].concat());
    command.stdin(Stdio::null()).stdout(writer).stderr(Stdio::piped()).output().unwrap().into()
}

#[test]
fn a_closed_output_ends_a_command_that_only_prints() {
    let robot = Virtual::start(&[]);
    for args in [&["get", "I1"][..], &["watch", "I1"], &["errors"], &["status"]] {
        let run = unread(&robot, args);
        assert_eq!((run.err.as_str(), run.code), ("", 0), "{args:?}");
    }
}

#[test]
fn a_closed_output_does_not_hide_a_finding() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup").display().to_string();
    assert_eq!(robot.run(&["dump", &backup]).code, 0);
    assert_eq!(unread(&robot, &["diff", &backup]).code, 0);
    assert_eq!(robot.run(&["put", "I1-I2", "7"]).code, 0);
    assert_eq!(unread(&robot, &["diff", &backup]).code, 1);
    let run = unread(&robot, &["get", "X1", "I1"]);
    assert!(run.code == 1 && run.err.contains("1 of 2 were refused"), "{run:?}");
    // the first line fails, because nothing listens on that port
    let run = unread(&robot, &["doctor", "--tcp-port", "1"]);
    assert!(run.code == 3 && run.err.contains("cannot connect to"), "{run:?}");
}

#[test]
fn a_closed_output_is_an_error_of_a_command_that_writes() {
    let robot = Virtual::start(&[]);
    let run = unread(&robot, &["put", "I1-I50", "7"]);
    assert!(run.code == 2 && run.err.contains("Broken pipe") && run.err.contains("(1 of 50 are written)"), "{run:?}");
    assert_eq!(robot.run(&["get", "I1-I2"]).out, "I1 = 7\nI2 = 0\n");
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_cannot_be_written_is_named() {
    let robot = Virtual::start(&[]);
    for option in ["--csv", "--mcap"] {
        let run = robot.run(&["watch", "I1", "--count", "1", option, "/dev/full"]);
        assert_eq!((run.err.starts_with("error: /dev/full: No space left on device"), run.code), (true, 2), "{run:?}");
    }
    // the lost recording is not hidden by the closed output
    let run = unread(&robot, &["get", "I1", "--write", "/dev/full"]);
    assert!(run.code == 2 && run.err.contains("No space left on device"), "{run:?}");
}

#[test]
fn a_signal_at_the_prompt_completes_the_recording_and_the_history() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::ROBOT_GET_VARIABLE => value(6),
        FunctionId::VARIABLE_GET_VALUE => value(true),
        _ => usual(request),
    });
    let folder = tempfile::tempdir().unwrap();
    let (history, recording) = (folder.path().join("state").join("history"), folder.path().join("shell.pcapng"));
    let recording = recording.to_str().unwrap();
    let mut shell = command(&["shell", "--write", recording, "--robot", &fake.address]);
    shell.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).env("BCAP_HISTORY", &history);
    let mut shell = shell.spawn().unwrap();
    // stays open, because the end of the input would end the shell too
    let mut lines = shell.stdin.take().unwrap();
    lines.write_all(b"get I1\n").unwrap();
    // each prompt requests messages: one prompt before the line, one after it
    let prompts = || fake.seen().iter().filter(|call| call.starts_with("ControllerGetMessage(")).count();
    let end = Instant::now() + Duration::from_secs(30);
    while prompts() < 2 {
        assert!(Instant::now() < end, "{:?}", fake.seen());
        thread::sleep(Duration::from_millis(1));
    }
    send(Signal::TERM, &shell);
    let run: Run = shell.wait_with_output().unwrap().into();
    assert_eq!(run.code, 130, "{run:?}");
    let packets: Run = command(&["decode", recording]).output().unwrap().into();
    assert!(packets.out.trim_end().lines().last().unwrap().contains("Service_Stop"), "{packets:?}");
    assert!(std::fs::read_to_string(history).unwrap().contains("get I1"));
}

#[test]
fn a_table_on_the_standard_output_has_no_control_characters() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["put", "S1", "a\u{1b}[31m"]).code, 0);
    let run = robot.run(&["watch", "S1", "--count", "1", "--csv", "-"]);
    assert!(run.code == 0 && run.out.ends_with(",a\\u{1b}[31m\n"), "{run:?}");
}
