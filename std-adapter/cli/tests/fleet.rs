//! `bcap fleet` between a broker and virtual controllers, as processes, with the configuration of docs/fleet.md.
#![cfg(unix)]

mod common;
#[path = "common/virtual_robot.rs"]
mod virtual_robot;

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};

use common::{bare, bcap};
use virtual_robot::{Virtual, signal};

/// A broker; dropping this kills it.
struct Broker {
    child: Child,
    port: u16,
}

impl Drop for Broker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Starts a broker; `None`, with a line that says so, where Mosquitto is not installed.
fn broker() -> Option<Broker> {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let start = |name| Command::new(name).args(["-p", &port.to_string()]).stderr(Stdio::null()).spawn();
    let Ok(child) = start("mosquitto").or_else(|_| start("/usr/sbin/mosquitto")) else {
        println!("skipped: mosquitto is not installed");
        return None;
    };
    while TcpStream::connect(("127.0.0.1", port)).is_err() {
        std::thread::yield_now();
    }
    Some(Broker { child, port })
}

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
