//! Outputs that are full, closed or a terminal: a command whose work is cut says so, and only one that prints may be ended by its reader.

use std::io::pipe;
use std::process::Stdio;

use crate::common::virtual_robot::Virtual;
use crate::common::{Run, command};

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
fn a_table_on_the_standard_output_has_no_control_characters() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["put", "S1", "a\u{1b}[31m"]).code, 0);
    let run = robot.run(&["watch", "S1", "--count", "1", "--csv", "-"]);
    assert!(run.code == 0 && run.out.ends_with(",a\\u{1b}[31m\n"), "{run:?}");
}
