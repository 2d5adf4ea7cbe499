//! The examples of `--help` of the commands that work with one controller: each runs against a virtual one.

use std::env;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap};

/// The commands, in the order in which they run: `put` writes the position of `move`.
const COMMANDS: [&str; 10] = ["put", "get", "names", "call", "exec", "move", "task", "errors", "run", "raw"];

/// Returns the lines of the examples.
fn examples(command: &str) -> Vec<String> {
    let help = bcap(&[command, "--help"]).out;
    let (_, examples) = help.split_once("Examples:\n").unwrap_or_else(|| panic!("{command} has no examples"));
    examples.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect()
}

#[test]
fn every_example_runs() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("cycle.bcap"), "set x = 3\nput I1 $x\nexpect I1 = 3\n").unwrap();
    let bin = Path::new(env!("CARGO_BIN_EXE_bcap")).parent().unwrap();
    let path = env::join_paths([bin.to_owned()].into_iter().chain(env::split_paths(&env::var_os("PATH").unwrap())));
    let path = path.unwrap();
    for command in COMMANDS {
        // an example that listens waits for a client
        for example in examples(command).iter().filter(|example| !example.contains("--listen")) {
            let line = example.replace("tcp:192.168.0.1", &robot.tcp).replace("udp:192.168.0.1", &robot.udp);
            let run: Run = Command::new("sh")
                .args(["-c", &line])
                .current_dir(folder.path())
                .env("PATH", &path)
                .env("BCAP_ROBOT", &robot.tcp)
                .output()
                .unwrap()
                .into();
            assert_eq!(run.code, 0, "{example}: {run:?}");
        }
    }
}
