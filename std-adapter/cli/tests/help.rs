//! The examples in the help of the commands for variables, files, backups and profiles run as they are printed.

use std::env;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::bcap;
use crate::common::robot::Robot;
use bcap_sim::{Config, Profile};

/// Returns the examples of a command.
fn examples(command: &str) -> Vec<String> {
    let help = bcap(&[command, "--help"]).out;
    let (_, examples) = help.split_once("Examples:\n").unwrap_or_else(|| panic!("{command}: {help}"));
    examples.lines().map(str::trim).filter(|line| line.contains("bcap ")).map(str::to_owned).collect()
}

#[test]
fn the_examples_run() {
    let folder = tempfile::tempdir().unwrap();
    let files = folder.path().join("robot");
    fs::create_dir(&files).unwrap();
    fs::write(files.join("Pro2.pcs"), "two").unwrap();
    fs::write(folder.path().join("Pro1.pcs"), "one").unwrap();
    let robot = Robot::with(Config { files: Some(files), ..Config::new(Profile::Rc8) });
    let settings = folder.path().join("settings").join("bcap");
    fs::create_dir_all(&settings).unwrap();
    fs::write(settings.join("config.toml"), format!("[profile.cell1]\naddress = \"{}\"\n", robot.tcp)).unwrap();
    for command in ["get", "put", "names", "ls", "cp", "dump", "diff", "restore", "profile"] {
        let examples = examples(command);
        assert!(examples.len() >= 2, "{command}: {examples:?}");
        for example in examples {
            // the addresses of the examples stand for this robot
            let line = example.replace("tcp:192.168.0.1", &robot.tcp).replace("udp:192.168.0.1", &robot.udp);
            let output = shell(&line, folder.path(), &robot.tcp);
            let is_fine = output.status.code() == Some(0) || command == "diff" && output.status.code() == Some(1);
            assert!(is_fine, "{example}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

fn shell(line: &str, folder: &Path, address: &str) -> std::process::Output {
    let own = Path::new(env!("CARGO_BIN_EXE_bcap")).parent().unwrap();
    let path =
        env::join_paths([own.to_owned()].into_iter().chain(env::split_paths(&env::var("PATH").unwrap()))).unwrap();
    let mut shell = Command::new("sh");
    shell.args(["-c", line]).current_dir(folder).env("PATH", path).env("BCAP_ROBOT", address);
    shell.env("XDG_CONFIG_HOME", folder.join("settings")).env_remove("BCAP_PROFILE").output().unwrap()
}
