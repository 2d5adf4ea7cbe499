//! The program `bcap-fleet`: its check, its lines, its exit codes, its manual page.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::common::{Robot, Subscriber, free_port};
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::process::{Signal, send};

const PROGRAM: &str = env!("CARGO_BIN_EXE_bcap-fleet");

/// The output and the exit code of a run.
#[derive(Debug)]
struct Run {
    out: String,
    err: String,
    code: Option<i32>,
}

fn run(args: &[&str]) -> Run {
    let output = Command::new(PROGRAM).args(args).stdin(Stdio::null()).output().unwrap();
    let [out, err] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    Run { out, err, code: output.status.code() }
}

/// Returns the configuration of the page.
fn documented() -> String {
    let page = include_str!("../../../docs/fleet.md");
    let (_, config) = page.split_once("```toml\n").unwrap();
    config.split_once("```").unwrap().0.to_owned()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_configuration_of_the_page_runs() {
    let Some(broker) = Mosquitto::open() else { return };
    let folder = tempfile::tempdir().unwrap();
    let robots = [Robot::start().await, Robot::start().await, Robot::start().await];
    let mut config =
        documented().replace("host = \"127.0.0.1\"", &format!("host = \"127.0.0.1\"\nport = {}", broker.port));
    config = config.replace("port = 9184", &format!("port = {}", free_port()));
    for (number, robot) in (1..).zip(&robots) {
        let address = format!("tcp:127.0.0.1:510{number}");
        assert!(config.contains(&address), "{config}");
        config = config.replace(&address, &format!("tcp:{}", robot.address));
    }
    let file = folder.path().join("fleet.toml");
    fs::write(&file, config).unwrap();
    let file = file.to_str().unwrap();

    let check = run(&[file, "--check"]);
    assert_eq!(check.code, Some(0), "{check:?}");
    assert!(check.out.lines().any(|line| line.starts_with("cell1 ") && line.contains(" I9 ")), "{}", check.out);
    let check = run(&[file, "--check", "--offline"]);
    let out: Vec<_> = check.out.lines().map(|line| line.split_whitespace().last().unwrap_or_default()).collect();
    assert_eq!((out, check.code), (vec!["connected", "variables", "variables", "variables"], Some(0)), "{check:?}");
    let check = run(&[file, "--check", "--json"]);
    let first: serde_json::Value = serde_json::from_str(check.out.lines().next().unwrap()).unwrap();
    assert_eq!((first["name"].as_str(), first["value"].as_str()), (Some("broker"), Some("connected")));

    let mut fleet = Command::new(PROGRAM).arg(file).current_dir(folder.path()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(fleet.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.next().unwrap().starts_with("ready controllers=3 metrics=127.0.0.1:"));
    let mut waiting: Vec<_> = ["broker_up", "cell1", "cell2", "cell3"].into();
    while !waiting.is_empty() {
        let line: serde_json::Value = serde_json::from_str(&lines.next().unwrap()).unwrap();
        assert!(line["time"].as_str().unwrap().ends_with('Z'), "{line}");
        waiting.retain(|word| line["event"] != *word && line["controller"] != *word);
    }
    reload(&fleet, &mut lines, Path::new(file));
    for (leaf, key, expected) in [("state", "state", "disconnected"), ("S1", "quality", "bad")] {
        let topic = format!("bcap/plant/cell3/{leaf}");
        let mut late = Subscriber::start(broker.port, &topic).await;
        let retained = late.json(&topic, |_| true).await;
        assert_eq!(retained[key], expected, "the controller was removed: {retained}");
    }
    send(Signal::TERM, &fleet);
    assert_eq!(fleet.wait().unwrap().code(), Some(0));
    assert!(folder.path().join("buffer").is_dir());
}

/// Reloads a file with a fault, and then one without the third controller.
fn reload(fleet: &Child, lines: &mut impl Iterator<Item = String>, file: &Path) {
    let good = fs::read_to_string(file).unwrap();
    let outcome = |lines: &mut dyn Iterator<Item = String>, config: &str| {
        fs::write(file, config).unwrap();
        send(Signal::HUP, fleet);
        let mut events = lines.map(|line| serde_json::from_str::<serde_json::Value>(&line).unwrap());
        events.find(|event| event["event"].as_str().unwrap().starts_with("reload")).unwrap()
    };
    let failed = outcome(lines, &good.replace("interval_ms = 200", "interval_ms = 0"));
    assert!(
        failed["event"] == "reload_failed" && failed["reason"].as_str().unwrap().contains("interval_ms"),
        "{failed}"
    );
    let two = good.split("[[controller]]\nname = \"cell3\"").next().unwrap();
    let reloaded = outcome(lines, two);
    assert!(reloaded["event"] == "reloaded" && reloaded["controllers"] == 2, "{reloaded}");
    let up = lines.map(|line| serde_json::from_str::<serde_json::Value>(&line).unwrap());
    let up: Vec<_> = up.filter(|event| event["event"] == "robot_up").take(2).collect();
    assert!(up.iter().all(|event| event["controller"] != "cell3"), "{up:?}");
}

#[test]
fn a_check_that_fails_says_what_and_has_an_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fleet.toml");
    // no program listens on port 1
    let config = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"127.0.0.1\"\nport = 1\n[[controller]]\nname = \"cell1\"\n\
        address = \"tcp:127.0.0.1:1\"\n";
    fs::write(&file, config).unwrap();
    let ended = run(&[file.to_str().unwrap(), "--check"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert_eq!(ended.out.lines().filter(|line| line.contains("  error ")).count(), 2, "{}", ended.out);
    assert!(ended.err.contains("2 of 2 checks failed"), "{}", ended.err);

    fs::write(&file, config.replace("port = 1\n", "prot = 1\n")).unwrap();
    let ended = run(&[file.to_str().unwrap()]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.err.contains("prot") && ended.err.contains("line 5"), "{}", ended.err);
}

#[test]
fn a_failure_is_also_json() {
    let ended = run(&["does-not-exist.toml", "--check", "--json"]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    let line: serde_json::Value = serde_json::from_str(&ended.out).unwrap();
    assert!(line["error"].as_str().unwrap().starts_with("cannot read does-not-exist.toml: "), "{line}");
    assert!(ended.err.starts_with("error: cannot read does-not-exist.toml: "), "{}", ended.err);
}

#[test]
fn an_argument_in_an_error_is_escaped() {
    let ended = run(&["a.toml", "--\u{1b}[2J"]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.err.contains("\\u{1b}[2J") && !ended.err.contains('\u{1b}'), "{ended:?}");
}

#[test]
fn the_manual_page_and_the_completions_have_the_options() {
    let man = run(&["--man"]);
    assert_eq!(man.code, Some(0), "{man:?}");
    assert!(man.out.contains(".TH bcap-fleet 1") && man.out.contains("\\-\\-screen"), "{}", man.out);
    for shell in ["bash", "zsh", "fish"] {
        let script = run(&["--completions", shell]);
        assert!(script.code == Some(0) && script.out.contains("screen"), "{script:?}");
    }
}
