//! The completions of a shell, which calls `bcap` for each Tab.

use std::fs;

use crate::common::command;
use crate::common::robot::Robot;

/// Returns the completions of the last word of a line, with a file of profiles.
fn complete(words: &[&str]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("bcap")).unwrap();
    fs::write(
        folder.path().join("bcap/config.toml"),
        "[profile.cell1]\naddress = \"tcp:127.0.0.1:1\"\n[profile.lab]\n",
    )
    .unwrap();
    let mut command = command(&[&["--", "bcap"], words].concat());
    command.env("COMPLETE", "bash").env("_CLAP_IFS", "\n").env("_CLAP_COMPLETE_INDEX", words.len().to_string());
    let output = command.env("XDG_CONFIG_HOME", folder.path()).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    assert_eq!(text(output.stderr), "");
    text(output.stdout).lines().map(|line| line.trim_end().to_owned()).collect()
}

#[test]
fn commands_and_options_are_completed() {
    assert_eq!(complete(&["ge"]), ["get", "generate"]);
    assert_eq!(complete(&["get", "--rob"]), ["--robot"]);
    assert_eq!(complete(&["task", "st"]), ["start", "stop", "status"]);
}

#[test]
fn profiles_are_completed() {
    assert_eq!(complete(&["get", "--profile", ""]), ["cell1", "lab"]);
    assert_eq!(complete(&["profile", "show", "c"]), ["cell1"]);
}

#[test]
fn names_come_from_the_controller_of_the_line() {
    let robot = Robot::start();
    // 500 ms without a time limit
    let at = ["--robot", &robot.tcp, "--timeout", "20s"];
    assert_eq!(complete(&[&at[..], &["get", "@MO"]].concat()), ["@MODE"]);
    let current = complete(&[&at[..], &["watch", "I1", "robot/@CURRENT_T"]].concat());
    assert_eq!(current, ["robot/@CURRENT_TRANS", "robot/@CURRENT_TOOL"]);
    assert_eq!(complete(&[&at[..], &["task", "start", "P"]].concat()), ["Pro1", "Pro2", "Pro3"]);
    assert_eq!(complete(&[&at[..], &["put", "robot/@EXTS"]].concat()), ["robot/@EXTSPEED"]);
    // no controller listens there
    assert_eq!(complete(&["--profile", "cell1", "get", "@MO"]), [""; 0]);
}
