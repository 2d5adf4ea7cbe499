//! `bcap scan`.

use std::fs;

use bcap_core::bcap::FunctionId;
use serde_json::{Value, json};

use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use crate::common::tmux::Terminal;
use crate::common::{Run, bcap, command};

/// A network of two hosts on this machine that no other process uses.
#[cfg(target_os = "linux")]
fn network() -> String {
    let id = std::process::id();
    format!("127.{}.{}", 16 + id / 256 % 200, id % 256)
}

#[cfg(target_os = "linux")]
#[test]
fn a_network_has_one_line_for_each_controller() {
    let network = network();
    let at = |port: u16| format!("{network}.1:{port}");
    let args = ["sim", "--bcap", &at(5007), "--udp", &at(5007), "--rac", &at(5006), "--model", "rc9"];
    let _robot = crate::common::running::Running::start(&args);
    let run = bcap(&["scan", &format!("{network}.0/30"), "--json"]);
    assert_eq!(run.code, 0, "{run:?}");
    let found: Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!((&found["host"], &found["model"]), (&json!(format!("{network}.1")), &json!("RC9")), "{run:?}");
    assert_eq!([&found["tcp"], &found["udp"], &found["rac"]], [&json!(5007), &json!(5007), &json!(5006)], "{run:?}");
    let lines = bcap(&["scan", &format!("{network}.2"), &format!("{network}.1")]);
    assert_eq!((lines.out.lines().count(), lines.code), (1, 0), "{lines:?}");
    let (version, robot) = (found["version"].as_str().unwrap(), found["robot"].as_str().unwrap());
    let line = format!("{network}.1  RC9  {version}  {robot}  TCP 5007, UDP 5007, RAC 5006\n");
    assert_eq!(lines.out, line);
}

#[test]
fn only_calls_that_a_stream_allows_are_made() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value("RC8 Controller".to_owned()),
        FunctionId::ROBOT_GET_VARIABLE => value(7),
        _ => usual(request),
    });
    let run = bcap(&["scan", &fake.address, "--rac-port", "1"]);
    assert!(run.code == 0 && run.out.contains("RC8  RC8 Controller  RC8 Controller  TCP "), "{run:?}");
    let seen = fake.seen();
    let allowed = [
        "ServiceStart",
        "ServiceStop",
        "ControllerConnect",
        "ControllerDisconnect",
        "ControllerGetVariable",
        "ControllerGetRobot",
        "RobotGetVariable",
        "RobotRelease",
        "VariableGetValue",
        "VariableRelease",
    ];
    let other = seen.iter().find(|call| !allowed.contains(&call.split('(').next().unwrap()));
    assert_eq!(other, None, "{seen:?}");
    assert_eq!(seen.last().map(String::as_str), Some("ServiceStop()"));
}

#[test]
fn without_targets_the_profiles_are_asked() {
    let robot = Robot::start();
    let folder = tempfile::tempdir().unwrap();
    let scan = || -> Run { command(&["scan"]).env("XDG_CONFIG_HOME", folder.path()).output().unwrap().into() };
    let none = scan();
    assert!(none.code == 2 && none.err.contains("write one, such as 192.168.0.0/24"), "{none:?}");
    fs::create_dir(folder.path().join("bcap")).unwrap();
    let text = format!("[profile.a]\naddress = \"{}\"\n[profile.b]\naddress = \"serial:/dev/ttyS0\"\n", robot.tcp);
    fs::write(folder.path().join("bcap/config.toml"), text).unwrap();
    let found = scan();
    assert_eq!((found.out.lines().count(), found.err.as_str(), found.code), (1, "", 0), "{found:?}");
    assert!(found.out.starts_with("127.0.0.1  RC8  "), "{found:?}");
}

#[test]
fn the_networks_of_this_machine_are_asked_after_a_question() {
    let robot = Robot::start();
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("bcap")).unwrap();
    fs::write(folder.path().join("bcap/config.toml"), format!("[profile.a]\naddress = \"{}\"\n", robot.tcp)).unwrap();
    let Some(terminal) = Terminal::run((120, 24), &["sh"], folder.path()) else { return };
    let settings = folder.path().display();
    let program = env!("CARGO_BIN_EXE_bcap");
    terminal.enter(&format!("XDG_CONFIG_HOME={settings} {program} scan --timeout 20s; echo code $?"));
    // a machine without a network has no question
    let screen =
        terminal.wait_until("a question or an answer", |screen| screen.contains("[y/N]") || screen.contains("code 0"));
    if screen.contains("[y/N]") {
        assert!(screen.contains("/24") || screen.contains("/2"), "{screen}");
        terminal.enter("n");
    }
    let screen = terminal.wait_for("code 0");
    assert!(screen.contains("127.0.0.1  RC8  "), "{screen}");
}

#[test]
fn a_scan_is_bounded_and_finding_nothing_is_an_error() {
    for (target, message) in [
        (&["10.0.0.0/21"][..], "10.0.0.0/21: write a network from /22 (1,024) to /32"),
        (&["10.0.0.0/x"], "10.0.0.0/x: write a network"),
        (&["10.0.0.0/22", "10.1.0.0/29"], "1028 addresses are too many: a scan has at most 1024"),
        (&["serial:/dev/ttyS0"], "serial lines are not supported"),
    ] {
        let run = bcap(&[&["scan"], target].concat());
        assert!(run.code == 2 && run.err.contains(message) && run.out.is_empty(), "{run:?}");
    }
    let run = bcap(&["scan", "127.0.0.1:1", "--rac-port", "1"]);
    assert!(run.code == 3 && run.err.contains("no controller answers at the 1 addresses"), "{run:?}");
}
