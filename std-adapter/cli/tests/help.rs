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

#[test]
fn the_first_page_names_every_command_once_in_40_lines() {
    let page = bcap(&["--help"]).out;
    assert!(page.lines().count() <= 40 && page.lines().all(|line| line.len() <= 80), "{page}");
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(bcap(&["generate", "man", folder.path().to_str().unwrap()]).code, 0);
    let is_row = |line: &&str| line.starts_with("  ") && !line.starts_with("  -");
    let rows = page.lines().filter(is_row).map(|line| line[2..].split("  ").next().unwrap());
    let mut named: Vec<String> = rows
        .flat_map(|row| row.split([',', ' ']).filter(|word| !word.is_empty()).map(str::to_owned).collect::<Vec<_>>())
        .collect();
    named.sort();
    let mut pages: Vec<String> = fs::read_dir(folder.path())
        .unwrap()
        .filter_map(|file| {
            let name = file.unwrap().file_name().into_string().unwrap();
            let name = name.strip_prefix("bcap-")?.strip_suffix(".1")?.to_owned();
            (!name.contains('-')).then_some(name)
        })
        .collect();
    pages.sort();
    assert_eq!(named, pages);
}

#[test]
fn the_options_of_the_connection_are_one_line_or_none() {
    let get = bcap(&["get", "-h"]).out;
    assert!(get.contains("--robot <ADDRESS>") && get.contains("`bcap help connection`"), "{get}");
    for help in [&get, &bcap(&["get", "--help"]).out] {
        assert!(help.contains("--robot <ADDRESS>") && !help.contains("--provider"), "{help}");
        assert!(!help.contains("--attempts") && !help.contains("IPv6"), "{help}");
    }
    for local in ["explain", "generate", "decode", "sim"] {
        for help in ["-h", "--help"] {
            let out = bcap(&[local, help]).out;
            assert!(!out.contains("--robot <") && !out.contains("--provider"), "{local}: {out}");
        }
    }
    assert!(bcap(&["sim", "--help"]).out.contains("--write"));
    let connection = bcap(&["help", "connection"]).out;
    assert!(connection.contains("IPv6"), "{connection}");
    for option in ["--robot", "--timeout", "--provider", "--machine", "--option", "--attempts", "--rac-port", "--trace"]
    {
        assert!(connection.contains(option), "{option}: {connection}");
    }
}
