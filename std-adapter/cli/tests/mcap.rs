//! The MCAP files of `bcap watch --mcap` and `bcap sim --record`, read back.

use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::common::virtual_robot::Virtual;
use bcap_tests::process::{Signal, send};
use mcap::Summary;
use serde_json::{Value, json};

/// A message.
struct Message {
    topic: String,
    at: u64,
    sequence: u32,
    value: Value,
}

/// Reads the messages of a file, and asserts that it has an index and a schema of JSON for each channel.
fn read(path: &Path) -> Vec<Message> {
    let bytes = fs::read(path).unwrap();
    let summary = Summary::read(&bytes).unwrap().expect("an index");
    assert!(!summary.chunk_indexes.is_empty());
    for channel in summary.channels.values() {
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!((channel.message_encoding.as_str(), schema.encoding.as_str()), ("json", "jsonschema"));
        serde_json::from_slice::<Value>(&schema.data).unwrap();
    }
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let messages: Vec<Message> = messages
        .map(|message| Message {
            topic: message.channel.topic.clone(),
            at: message.log_time,
            sequence: message.sequence,
            value: serde_json::from_slice(&message.data).unwrap(),
        })
        .collect();
    assert_eq!(summary.stats.unwrap().message_count, messages.len() as u64);
    messages
}

fn now() -> u64 {
    u64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos()).unwrap()
}

#[test]
fn watched_values_have_their_times() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["put", "I1=5", "F2=0.1", "S3=a,b", "IO128=true", "V4=1,2,3.5"]).code, 0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("values.mcap");
    let file = path.to_str().unwrap();
    let before = now();
    let watch = ["watch", "I1", "F2", "S3", "IO128", "V4", "--interval", "10", "--count", "3", "--mcap", file];
    let run = robot.run(&watch);
    let after = now();
    assert_eq!((run.code, run.out.as_str()), (0, ""), "{}", run.err);
    let messages = read(&path);
    let values = [
        ("/I1", json!({"value": 5})),
        ("/F2", json!({"value": 0.1})),
        ("/S3", json!({"value": "a,b"})),
        ("/IO128", json!({"value": true})),
        ("/V4", json!({"value": [1.0, 2.0, 3.5]})),
    ];
    let found: Vec<_> = messages.iter().map(|message| (message.topic.as_str(), message.value.clone())).collect();
    assert_eq!(found, [&values[..]; 3].concat());
    assert!(messages.iter().all(|message| (before..=after).contains(&message.at)));
    assert!(messages.is_sorted_by_key(|message| message.at));
    assert_eq!(messages[10].sequence, 2);
}

#[test]
fn only_changes_are_written_and_a_signal_completes_the_file() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let (path, table) = (folder.path().join("values.mcap"), folder.path().join("values.csv"));
    let files = ["--mcap", path.to_str().unwrap(), "--csv", table.to_str().unwrap()];
    let mut watch = robot.spawn(&[&["watch", "I1", "--interval", "5", "--changed"], &files[..]].concat());
    // the table shows the read values
    let has_read = |value: &str| fs::read_to_string(&table).is_ok_and(|rows| rows.ends_with(value));
    let wait_for = |value: &str| {
        while !has_read(value) {
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    wait_for(",0\n");
    assert_eq!(robot.run(&["put", "I1", "7"]).code, 0);
    wait_for(",7\n");
    // it is in the file a second later, although the value does not change again
    let is_written = || fs::read(&path).unwrap().windows(11).any(|bytes| bytes == br#"{"value":7}"#);
    for _ in 0..300 {
        if is_written() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(is_written());
    send(Signal::TERM, &watch);
    assert_eq!(watch.wait().unwrap().code(), Some(0));
    let values: Vec<Value> = read(&path).into_iter().map(|message| message.value["value"].clone()).collect();
    assert_eq!(values, [0, 7]);
}

#[test]
fn a_trajectory_is_recorded_from_start_to_destination() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("motion.mcap");
    let before = now();
    let mut robot = Virtual::start(&["--record", path.to_str().unwrap()]);
    let moved = robot.run(&["move", "J(10, 45, 90, 0, 45, 0)", "--speed", "50"]);
    assert_eq!(moved.code, 0, "{}", moved.err);
    robot.end(Signal::TERM);
    let after = now();
    let points = read(&path);
    assert!(points.iter().all(|point| point.topic == "/arm"));
    assert!(points.len() > 10, "{}", points.len());
    let joint = |point: &Message| point.value["joints"]["J1"].as_f64().unwrap();
    assert_eq!((joint(&points[0]), joint(points.last().unwrap())), (0.0, 10.0));
    assert!(points.is_sorted_by(|a, b| joint(a) <= joint(b) && b.at - a.at >= 8_000_000));
    assert_eq!(points[0].value["position"]["X"].as_f64().map(f64::round), Some(364.0));
    // the controller's clock begins with the wall clock's millisecond
    let range = before - 2_000_000..=after + 2_000_000;
    assert!(points.iter().all(|point| range.contains(&point.at)));
}
