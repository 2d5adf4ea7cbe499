//! `bcap fleet` between a broker and virtual controllers, as processes, with the configuration of docs/fleet.md.
#![cfg(unix)]

mod common;
#[path = "common/mosquitto.rs"]
mod mosquitto;
#[path = "common/virtual_robot.rs"]
mod virtual_robot;

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use common::{bare, bcap};
use mosquitto::broker;
use rumqttc::{Client, MqttOptions, Packet, QoS};
use virtual_robot::{Virtual, signal};

/// Returns the configuration of the page.
fn documented() -> String {
    let page = include_str!("../../../docs/fleet.md");
    let (_, config) = page.split_once("```toml\n").unwrap();
    config.split_once("```").unwrap().0.to_owned()
}

#[test]
fn the_configuration_of_the_page_runs() {
    let Some(broker) = broker() else { return };
    let folder = tempfile::tempdir().unwrap();
    let robots = [(); 3].map(|()| Virtual::start(&[]));
    let mut config =
        documented().replace("host = \"127.0.0.1\"", &format!("host = \"127.0.0.1\"\nport = {}", broker.port));
    config = config.replace("port = 9184", "port = 0");
    for (number, robot) in (1..).zip(&robots) {
        let address = format!("tcp:127.0.0.1:510{number}");
        assert!(config.contains(&address), "{config}");
        config = config.replace(&address, &robot.tcp);
    }
    let file = folder.path().join("fleet.toml");
    fs::write(&file, config).unwrap();
    let file = file.to_str().unwrap();

    let check = bcap(&["fleet", file, "--check"]);
    assert_eq!(check.code, 0, "{check:?}");
    assert!(check.out.lines().any(|line| line.starts_with("cell1 ") && line.contains(" I9 ")), "{}", check.out);
    let check = bcap(&["fleet", file, "--check", "--json"]);
    let first: serde_json::Value = serde_json::from_str(check.out.lines().next().unwrap()).unwrap();
    assert_eq!((first["name"].as_str(), first["value"].as_str()), (Some("broker"), Some("connected")));

    let mut fleet = bare(&["fleet", file]).current_dir(folder.path()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(fleet.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.next().unwrap().starts_with("ready controllers=3 metrics=127.0.0.1:"));
    let mut waiting: Vec<_> = ["broker_up", "cell1", "cell2", "cell3"].into();
    while !waiting.is_empty() {
        let line: serde_json::Value = serde_json::from_str(&lines.next().unwrap()).unwrap();
        assert!(line["time"].as_str().unwrap().ends_with('Z'), "{line}");
        waiting.retain(|word| line["event"] != *word && line["controller"] != *word);
    }
    signal("-TERM", &fleet);
    assert_eq!(fleet.wait().unwrap().code(), Some(0));
    assert!(folder.path().join("buffer").is_dir());
}

#[test]
fn the_demo_plant_of_the_page_runs() {
    // the script starts a broker of its own
    let Some(broker) = broker() else { return };
    let port = broker.port;
    drop(broker);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/plant/run");
    let mut command = Command::new(script);
    command.arg(port.to_string()).env("BCAP", env!("CARGO_BIN_EXE_bcap")).stdout(Stdio::piped());
    let mut plant = command.spawn().unwrap();
    let mut lines = BufReader::new(plant.stdout.take().unwrap()).lines().map(Result::unwrap);
    let config = lines.find_map(|line| line.strip_prefix("config ").map(str::to_owned)).unwrap();
    lines.find(|line| line.starts_with("ready controllers=3 ")).unwrap();
    // a pipe that is full would stop the script
    let rest = std::thread::spawn(move || lines.count());

    let mut options = MqttOptions::new("test", "127.0.0.1", port);
    options.set_max_packet_size(1 << 20, 1 << 20);
    let (client, mut connection) = Client::new(options, 10);
    client.subscribe("bcap/demo/#", QoS::AtLeastOnce).unwrap();
    let mut waiting: Vec<_> = ["I1", "tasks"].into_iter().flat_map(|name| (1..=3).map(move |n| (n, name))).collect();
    let messages = connection.iter().filter_map(|event| match event.unwrap() {
        rumqttc::Event::Incoming(Packet::Publish(publish)) => Some(publish),
        _ => None,
    });
    for publish in messages {
        let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
        let is_counted = json["value"].as_i64() >= Some(2);
        let has_tasks = json["value"]["Pro1"] == "ready";
        waiting.retain(|(n, name)| publish.topic != format!("bcap/demo/cell{n}/{name}") || !(is_counted || has_tasks));
        if waiting.is_empty() {
            break;
        }
    }
    let check = bcap(&["fleet", &config, "--check"]);
    assert_eq!(check.code, 0, "{check:?}");
    let rows = |name: &str| check.out.lines().filter(|line| line.split_whitespace().nth(1) == Some(name)).count();
    assert_eq!((check.out.lines().count(), rows("I1"), rows("tasks")), (1 + 3 * 7, 3, 3), "{}", check.out);

    signal("-TERM", &plant);
    assert_eq!(plant.wait().unwrap().code(), Some(0));
    // all of its processes have ended, so that the pipe is closed
    rest.join().unwrap();
    assert!(!Path::new(&config).exists());
}

#[test]
fn a_check_that_fails_says_what_and_has_an_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fleet.toml");
    // no program listens on port 1
    let config = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"127.0.0.1\"\nport = 1\n[[controller]]\nname = \"cell1\"\n\
        address = \"tcp:127.0.0.1:1\"\n";
    fs::write(&file, config).unwrap();
    let run = bcap(&["fleet", file.to_str().unwrap(), "--check"]);
    assert_eq!(run.code, 3, "{run:?}");
    assert_eq!(run.out.lines().filter(|line| line.contains("  error ")).count(), 2, "{}", run.out);
    assert!(run.err.contains("2 of 2 checks failed"), "{}", run.err);

    fs::write(&file, config.replace("port = 1\n", "prot = 1\n")).unwrap();
    let run = bcap(&["fleet", file.to_str().unwrap()]);
    assert_eq!(run.code, 2, "{run:?}");
    assert!(run.err.contains("prot") && run.err.contains("line 5"), "{}", run.err);
}
