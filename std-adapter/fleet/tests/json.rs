//! Plain JSON through a real Mosquitto: values, states, commands, the buffer.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::time::Duration;

use crate::common::{Publish, Robot, Running, Subscriber, counter, folder, http, muting_proxy, now_ms};
use crate::sparkplug::{confirm_subscription, forward, packet};
use bcap_fleet::{CommandResult, Event};
use bcap_std::asynch::Controller;
use bcap_std::{Settings, TaskStart};
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::proxy::Relay;
use serde_json::json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

/// Returns a configuration with the controllers `cell1`, `cell2`, ...
fn config(port: u16, more: &str, robots: &[&Robot], publish: &str) -> String {
    let mut text = format!(
        "group = \"plant\"\nnode = \"edge1\"\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n[metrics]\nport = 0\n{more}\n"
    );
    for (number, robot) in (1..).zip(robots) {
        text += &format!("[[controller]]\nname = \"cell{number}\"\naddress = \"tcp:{}\"\n{publish}\n", robot.address);
    }
    text
}

const FAST: &str = "[[controller.publish]]\nnames = [\"I1\", \"pose\", \"error\"]\ninterval_ms = 10";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn values_and_states_of_several_robots_arrive() {
    let Some(broker) = Mosquitto::open() else { return };
    let (mut one, two) = (Robot::start().await, Robot::start().await);
    one.set(1, 11);
    two.set(1, 22);
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let fleet = Running::start(&config(broker.port, "", &[&one, &two], FAST)).await;
    host.json("bcap/plant/edge1/state", |json| json["state"] == "online").await;
    let first = host.json("bcap/plant/cell1/I1", |json| json["value"] == 11).await;
    assert_eq!((&first["quality"], first.get("historical")), (&json!("good"), None));
    assert!(first["time"].as_u64().unwrap().abs_diff(now_ms()) < 60_000 && first["id"].is_u64());

    two.set(1, 23);
    host.json("bcap/plant/cell2/I1", |json| json["value"] == 23).await;

    one.kill().await;
    // the failed read may be reported before or after the lost connection
    let mut missing = vec!["bcap/plant/cell1/I1", "bcap/plant/cell1/state"];
    while !missing.is_empty() {
        let publish = host.next().await;
        let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
        let is_bad = json["quality"] == "bad" && json["value"].is_null();
        let is_lost = json["state"] == "disconnected" && json["reason"].is_string();
        missing.retain(|topic| *topic != publish.topic || !(is_bad || is_lost));
    }
    one.restart().await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good" && json["value"] == 11).await;

    // a later subscriber gets the retained values
    let mut late = Subscriber::start(broker.port, "bcap/plant/cell2/pose").await;
    let pose = late.json("bcap/plant/cell2/pose", |json| json["quality"] == "good").await;
    assert_eq!(pose["value"].as_array().unwrap().len(), 7);

    assert!(fleet.metric("bcap_controller_up{controller=\"cell2\"}").await == 1);
    assert!(fleet.metric("bcap_published_total").await > 0);
    fleet.stop().await;
    host.json("bcap/plant/edge1/state", |json| json["state"] == "offline").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn metrics_answer_queries_and_head_and_idle_connections_lock_nobody_out() {
    let robot = Robot::start().await;
    // no broker listens on port 1
    let fleet = Running::start(&config(1, "", &[&robot], FAST)).await;
    let address = fleet.metrics.unwrap();
    // a connection without a header ends after a second
    let mut slow = TcpStream::connect(address).await.unwrap();
    slow.write_all(b"GET /metrics HTTP/1.1\r\n").await.unwrap();
    let mut answer = Vec::new();
    slow.read_to_end(&mut answer).await.unwrap();
    assert_eq!(answer, b"", "half a header has no answer");
    // more idle connections than it serves: a new one ends the oldest
    let mut idle = Vec::new();
    for _ in 0..145 {
        idle.push(TcpStream::connect(address).await.unwrap());
    }
    assert!(http(address, "GET /healthz").await.starts_with("HTTP/1.1 503 "));
    assert_eq!(idle[0].read(&mut [0]).await.unwrap_or_default(), 0, "the oldest one");
    drop(idle);
    let head = http(address, "HEAD /metrics?x=1").await;
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && head.ends_with("\r\n\r\n"), "{head}");
    let text = http(address, "GET /metrics?x=1").await;
    assert!(text.contains("\nbcap_build_info{version=") && text.ends_with("# EOF\n"), "{text}");
    assert!(http(address, "GET /metric").await.starts_with("HTTP/1.1 404 "));
    assert!(http(address, "POST /metrics").await.contains("\r\nAllow: GET, HEAD\r\n"));
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_that_may_end_a_stream_of_slave_mode_is_refused() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let (to, from) = ("bcap/plant/cell1/command", "bcap/plant/cell1/answer");
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let rules = "[commands]\nallow = [\"I/10\"]\nlongest_seconds = 10";
    let publish = "[[controller.publish]]\nnames = [\"I1\"]\ninterval_ms = 10";
    let fleet = Running::start(&config(broker.port, rules, &[&robot], publish)).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;
    let other = Controller::connect(&format!("tcp:{}", robot.address), &Settings::rc8()).await.unwrap();
    let mut arm = other.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    // no pose is sent, so that a busy machine does not end it
    arm.robot().execute::<()>("slvChangeMode", 0x202).await.unwrap();
    host.publish(to, command("a", "I10", 7, now_ms() + 10_000)).await;
    let answer = host.json(from, |_| true).await;
    assert_eq!(answer["result"], "refused", "{answer}");
    let reason = "skipped: a stream of Slave Mode runs, and Variable_PutValue may end it";
    assert!(answer["reason"].as_str().unwrap().contains(reason), "{answer}");
    assert_eq!((robot.get(10), robot.controller.lock().unwrap().slave_mode()), (0, 0x202));
    arm.robot().execute::<()>("slvChangeMode", 0).await.unwrap();
    host.publish(to, command("b", "I10", 7, now_ms() + 10_000)).await;
    assert_eq!(host.json(from, |_| true).await, json!({"id": "b", "result": "done"}));
    assert_eq!(robot.get(10), 7);
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_refused_commands_is_answered_and_few_of_its_events_are_reported() {
    const FLOOD: u64 = 500;
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/answer").await;
    let fleet = Running::start(&config(broker.port, "[commands]\nallow = [\"I/1\"]", &[&robot], FAST)).await;
    // the node subscribes before it announces that it is online
    let mut node = Subscriber::start(broker.port, "bcap/plant/edge1/state").await;
    node.json("bcap/plant/edge1/state", |json| json["state"] == "online").await;
    let began = std::time::Instant::now();
    for number in 0..FLOOD {
        // not a command, but it has an id
        let command = json!({"id": number.to_string(), "name": 1}).to_string();
        host.publish("bcap/plant/cell1/command", command).await;
    }
    let last = (FLOOD - 1).to_string();
    let answer = host.json("bcap/plant/cell1/answer", |json| json["id"] == last).await;
    assert_eq!(answer["result"], "refused");
    let (mut reported, mut suppressed) = (0, 0);
    for event in fleet.stop().await {
        match event {
            Event::Command { result, .. } => {
                assert_eq!(result, CommandResult::Refused);
                reported += 1;
            }
            Event::Suppressed { controller, events } => {
                assert_eq!(controller, "cell1");
                suppressed += events;
            }
            _ => {}
        }
    }
    assert_eq!(reported + suppressed, FLOOD);
    assert!(reported <= 100 + 10 * (1 + began.elapsed().as_secs()), "{reported}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_retained_message_of_5_mb_on_a_command_topic_stops_nothing() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let (to, from) = ("bcap/plant/cell1/command", "bcap/plant/cell1/answer");
    let mut host = Subscriber::start(broker.port, from).await;
    host.retain(to, vec![b'x'; 5_000_000]).await;
    let rules = "[commands]\nallow = [\"I/1\"]\nlongest_seconds = 10";
    let fleet = Running::start(&config(broker.port, rules, &[&robot], FAST)).await;
    fleet.event(|event| matches!(event, Event::RobotUp { .. })).await;
    let answer = host.json(from, |_| true).await;
    assert_eq!(answer, json!({"id": "", "result": "refused", "reason": "it is empty, or has more than 1048576 bytes"}));
    // other commands, with the same connection to the broker
    host.publish(to, command("a", "I1", 7, now_ms() + 10_000)).await;
    assert_eq!(host.json(from, |json| json["id"] == "a").await["result"], "done");
    let mut values = Subscriber::start(broker.port, "bcap/plant/cell1/I1").await;
    values.json("bcap/plant/cell1/I1", |json| json["value"] == 7).await;
    assert_eq!(fleet.metric("bcap_broker_connections_total").await, 1);
    fleet.stop().await;
}

/// Returns the readings of the next list that has a variable with a value.
async fn next_list(host: &mut Subscriber, name: &str, value: &serde_json::Value) -> Vec<serde_json::Value> {
    let has = |list: &serde_json::Value| {
        list.as_array().is_some_and(|list| list.iter().any(|entry| entry["name"] == name && entry["value"] == *value))
    };
    let list = host.json("bcap/plant/cell1/values", has).await;
    list.as_array().cloned().unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn joined_readings_of_a_scan_share_a_message() {
    let Some(broker) = Mosquitto::open() else { return };
    let mut robot = Robot::start().await;
    (1..=20).for_each(|index| robot.set(index, 100 + index.cast_signed()));
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let publish = "[[controller.publish]]\nnames = [\"I1-20\"]\ninterval_ms = 50\njoined = true\n\
        [[controller.publish]]\nnames = [\"I21\"]\ninterval_ms = 50";
    let fleet = Running::start(&config(broker.port, "", &[&robot], publish)).await;
    let list = next_list(&mut host, "I20", &json!(120)).await;
    for index in 1..=20 {
        let entry = list.iter().find(|entry| entry["name"] == format!("I{index}"));
        let entry = entry.unwrap_or_else(|| panic!("I{index} is not in {list:?}"));
        assert!(entry["value"] == 100 + index && entry["quality"] == "good", "{entry}");
        assert!(entry["time"].is_u64() && entry["id"].is_u64(), "{entry}");
    }

    // only readings that changed are in a list
    robot.set(7, -7);
    let list = next_list(&mut host, "I7", &json!(-7)).await;
    assert_eq!(list.len(), 1, "{list:?}");

    // a lost connection makes all of them bad
    robot.kill().await;
    next_list(&mut host, "I7", &json!(null)).await;
    robot.restart().await;
    next_list(&mut host, "I7", &json!(-7)).await;

    // other points have a retained topic, but a list does not
    let mut late = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    late.find(|publish| {
        assert!(publish.topic != "bcap/plant/cell1/values" || !publish.retain, "a list is not retained");
        (publish.topic == "bcap/plant/cell1/I21" && publish.retain).then_some(())
    })
    .await;
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_that_stops_responding_costs_one_timeout() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let proxy = Relay::tcp(robot.address);
    let publish = "[[controller.publish]]\nnames = [\"I1-16\"]\ninterval_ms = 10";
    let text = config(broker.port, "", &[&robot], publish);
    let text = text.replace(&robot.address.to_string(), &format!("127.0.0.1:{}", proxy.tcp.port()));
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let fleet = Running::start(&text).await;
    host.json("bcap/plant/cell1/I16", |json| json["quality"] == "good").await;
    proxy.hold(true);
    // a call times out after 3 s, so a timeout for each of the 16 would take 48 s
    let bad = async {
        while fleet.metric("bcap_read_errors_total{controller=\"cell1\"}").await < 16 {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        host.json("bcap/plant/cell1/I16", |json| json["quality"] == "bad").await;
    };
    tokio::time::timeout(Duration::from_secs(20), bad).await.expect("all points are bad after few timeouts");
    proxy.hold(false);
    host.json("bcap/plant/cell1/I16", |json| json["quality"] == "good").await;
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn variables_without_a_reply_do_not_keep_the_others_from_being_read() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let muted = Arc::new(AtomicBool::new(true));
    // the second and the third of a batch: the first scans read no variable after them
    let port = muting_proxy(robot.address, &["I12", "I13"], &muted).await;
    let publish = "[[controller.publish]]\nnames = [\"I11-16\", \"pose\"]\ninterval_ms = 10";
    let text = config(broker.port, "", &[&robot], publish);
    let text = text.replace(&robot.address.to_string(), &format!("127.0.0.1:{port}"));
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let fleet = Running::start(&text).await;
    for value in [1, 2, 3] {
        for index in 11..=16 {
            robot.set(index, value);
        }
        let mut missing = BTreeSet::from([11, 14, 15, 16]);
        while !missing.is_empty() {
            let publish = host.next().await;
            let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
            assert!(
                json["value"] != value || !["bcap/plant/cell1/I12", "bcap/plant/cell1/I13"].contains(&&*publish.topic)
            );
            missing.retain(|index| publish.topic != format!("bcap/plant/cell1/I{index}") || json["value"] != value);
        }
    }
    // a new subscriber gets the retained values
    let mut late = Subscriber::start(broker.port, "bcap/plant/cell1/pose").await;
    late.json("bcap/plant/cell1/pose", |json| json["quality"] == "good").await;
    muted.store(false, Ordering::SeqCst);
    for topic in ["bcap/plant/cell1/I12", "bcap/plant/cell1/I13"] {
        let mut late = Subscriber::start(broker.port, topic).await;
        late.json(topic, |json| json["value"] == 3).await;
    }
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_a_timeout_the_rest_of_a_batch_does_not_wait_for_its_next_interval() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let muted = Arc::new(AtomicBool::new(true));
    let port = muting_proxy(robot.address, &["I12"], &muted).await;
    let publish = "[[controller.publish]]\nnames = [\"I11-16\"]\ninterval_ms = 3600000";
    let text = config(broker.port, "", &[&robot], publish);
    let text = text.replace(&robot.address.to_string(), &format!("127.0.0.1:{port}"));
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let fleet = Running::start(&text).await;
    host.json("bcap/plant/cell1/I12", |json| json["quality"] == "bad").await;
    host.json("bcap/plant/cell1/I16", |json| json["quality"] == "good").await;
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_states_of_tasks_are_points() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let publish = "[[controller.publish]]\nnames = [\"task/Pro1\", \"tasks\", \"task/Pro9\"]\ninterval_ms = 10";
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let fleet = Running::start(&config(broker.port, "", &[&robot], publish)).await;
    host.json("bcap/plant/cell1/task/Pro1", |json| json["value"] == "ready").await;
    let all = json!({"Pro1": "ready", "Pro2": "ready", "Pro3": "ready"});
    host.json("bcap/plant/cell1/tasks", |json| json["value"] == all).await;
    host.json("bcap/plant/cell1/task/Pro9", |json| json["quality"] == "bad" && json["value"].is_null()).await;

    let (address, settings) = (format!("tcp:{}", robot.address), Settings::rc8());
    let other = Controller::connect(&address, &settings).await.unwrap();
    other.task("Pro1").await.unwrap().start(TaskStart::Continuous).await.unwrap();
    // the task may start between the reads of the two
    let mut waiting = vec!["bcap/plant/cell1/task/Pro1", "bcap/plant/cell1/tasks"];
    while !waiting.is_empty() {
        let publish = host.next().await;
        let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
        let is_running = json["value"] == "running" || json["value"]["Pro1"] == "running";
        waiting.retain(|topic| *topic != publish.topic || !is_running);
    }
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fleet_that_is_killed_is_offline_by_will() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/plant/edge1/state").await;
    let fleet = bcap_fleet::Config::parse(&config(broker.port, "", &[&robot], FAST)).unwrap();
    let fleet = bcap_fleet::Fleet::start(fleet, |_| {}).await.unwrap();
    let task = tokio::spawn(fleet.run(std::future::pending()));
    host.json("bcap/plant/edge1/state", |json| json["state"] == "online").await;
    task.abort();
    host.json("bcap/plant/edge1/state", |json| json["state"] == "offline").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_values_of_an_earlier_process_are_bad_if_the_robot_is_disconnected() {
    let Some(broker) = Mosquitto::open() else { return };
    let mut robot = Robot::start().await;
    let text = config(broker.port, "", &[&robot], FAST);
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let fleet = Running::start(&text).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;
    fleet.abort().await;
    robot.kill().await;
    let fleet = Running::start(&text).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "bad" && json["value"].is_null()).await;
    let mut late = Subscriber::start(broker.port, "bcap/plant/cell1/I1").await;
    assert_eq!(late.json("bcap/plant/cell1/I1", |_| true).await["quality"], "bad", "it is retained");
    robot.restart().await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;
    fleet.stop().await;
}

fn command(id: &str, name: &str, value: i32, expires: u64) -> String {
    json!({"id": id, "name": name, "value": value, "expires": expires, "origin": "mes"}).to_string()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn commands_are_allowed_by_rules_only_and_executed_once() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let rules = "[commands]\nallow = [\"I/10-19=-10..10\"]\nper_second = 1000\nlongest_seconds = 10";
    let fleet = Running::start(&config(broker.port, rules, &[&robot], FAST)).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;

    let (to, from) = ("bcap/plant/cell1/command", "bcap/plant/cell1/answer");
    host.publish(to, command("a", "I10", 7, now_ms() + 10_000)).await;
    assert_eq!(host.json(from, |_| true).await, json!({"id": "a", "result": "done"}));
    assert_eq!(robot.get(10), 7);

    robot.set(10, 0);
    let now = now_ms();
    for (command, reason) in [
        (command("a", "I10", 7, now + 10_000), "executed at most once"),
        (command("b", "I10", 11, now + 10_000), "out of the range"),
        (command("c", "I20", 1, now + 10_000), "no rule allows this variable"),
        (command("d", "F1", 1, now + 10_000), "no rule allows this kind"),
        (command("e", "@SPEED", 1, now + 10_000), "no user variable"),
        (command("f", "I10", 1, now - 5), "it expired"),
        (command("g", "I10", 1, now + 600_000), "the longest time is 10000 ms"),
        ("nonsense".into(), "it is not a command"),
    ] {
        host.publish(to, command).await;
        let answer = host.json(from, |_| true).await;
        // a copy of a command is not refused: its first copy may be running, or was executed
        let expected = if answer["id"] == "a" { "repeated" } else { "refused" };
        assert_eq!(answer["result"], expected, "{answer}");
        assert!(answer["reason"].as_str().unwrap().contains(reason), "{answer}");
    }
    assert_eq!(robot.get(10), 0, "no refused command was executed");

    let events = fleet.stop().await;
    let audited: Vec<_> = events
        .iter()
        .filter_map(|event| match event {
            Event::Command { id, origin, result, .. } => Some((id.as_str(), origin.as_deref(), *result)),
            _ => None,
        })
        .collect();
    assert_eq!(audited[0], ("a", Some("mes"), CommandResult::Done));
    assert_eq!(audited.len(), 9);
    assert_eq!(audited[1], ("a", Some("mes"), CommandResult::Repeated));
    assert!(audited[2..].iter().all(|(.., result)| *result == CommandResult::Refused));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_that_has_no_reply_at_the_end_has_an_outcome() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let port = muting_proxy(robot.address, &["I10", "I11", "I12"], &Arc::new(AtomicBool::new(true))).await;
    let rules = "[commands]\nallow = [\"I/10-19\"]\nlongest_seconds = 60";
    let publish = "[[controller.publish]]\nnames = [\"I1\"]\ninterval_ms = 10";
    let text = config(broker.port, rules, &[&robot], publish);
    let text = text.replace(&robot.address.to_string(), &format!("127.0.0.1:{port}"));
    let mut host = Subscriber::start(broker.port, "bcap/plant/cell1/+").await;
    let fleet = Running::start(&text).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;
    for name in ["I10", "I11", "I12"] {
        host.publish("bcap/plant/cell1/command", command(name, name, 1, now_ms() + 60_000)).await;
    }
    while fleet.metric("bcap_commands_total").await < 3 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let outcome = |event: &Event| match event {
        Event::Command { id, result, reason, .. } => Some((id.clone(), *result, reason.clone().unwrap_or_default())),
        _ => None,
    };
    let outcomes: Vec<_> = fleet.stop().await.iter().filter_map(outcome).collect();
    let ids: BTreeSet<_> = outcomes.iter().map(|(id, ..)| id.as_str()).collect();
    assert_eq!((ids, outcomes.len()), (BTreeSet::from(["I10", "I11", "I12"]), 3), "{outcomes:?}");
    assert!(outcomes.iter().all(|(_, result, _)| *result != CommandResult::Done), "{outcomes:?}");
    let (_, result, reason) = outcomes.last().unwrap();
    assert!(*result == CommandResult::Unknown && reason.starts_with("this process ended"), "{outcomes:?}");
}

/// Accepts the connection of a fleet and its subscription as a broker.
async fn accept(broker: &TcpListener) -> TcpStream {
    let (mut stream, _) = broker.accept().await.unwrap();
    assert_eq!(packet(&mut stream).await.0, 0x10, "CONNECT");
    stream.write_all(&[0x20, 2, 0, 0]).await.unwrap();
    confirm_subscription(&mut stream).await;
    stream
}

/// Returns the next message of QoS 1: its topic, packet identifier and payload.
async fn published(stream: &mut TcpStream) -> (String, [u8; 2], Vec<u8>) {
    loop {
        let (kind, body) = packet(stream).await;
        if kind & 0xF0 == 0x30 {
            let (topic, rest) = body[2..].split_at(u16::from_be_bytes([body[0], body[1]]).into());
            return (String::from_utf8(topic.to_vec()).unwrap(), [rest[0], rest[1]], rest[2..].to_vec());
        }
    }
}

async fn acknowledge(stream: &mut TcpStream, packet: [u8; 2]) {
    stream.write_all(&[0x40, 2, packet[0], packet[1]]).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_that_arrives_while_the_process_ends_is_refused() {
    let broker = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let robot = Robot::start().await;
    let rules = "[commands]\nallow = [\"I/10\"]\nlongest_seconds = 10";
    let text = config(broker.local_addr().unwrap().port(), rules, &[&robot], FAST);
    let fleet = Running::start(&text).await;
    let mut stream = accept(&broker).await;
    let answered = tokio::spawn(async move {
        loop {
            let (topic, packet, payload) = published(&mut stream).await;
            if payload.windows(7).any(|part| part == b"offline") {
                let command = command("a", "I10", 7, now_ms() + 10_000);
                forward(&mut stream, "bcap/plant/cell1/command", &command).await;
            }
            acknowledge(&mut stream, packet).await;
            if topic == "bcap/plant/cell1/answer" {
                return payload;
            }
        }
    });
    while fleet.metric("bcap_published_total").await == 0 {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let events = fleet.stop().await;
    let outcome = |event: &Event| match event {
        Event::Command { id, result, reason, .. } => Some((id.clone(), *result, reason.clone().unwrap_or_default())),
        _ => None,
    };
    let outcomes: Vec<_> = events.iter().filter_map(outcome).collect();
    assert_eq!(outcomes, [("a".to_owned(), CommandResult::Refused, "this process ends".to_owned())]);
    let answer: serde_json::Value = serde_json::from_slice(&answered.await.unwrap()).unwrap();
    assert_eq!(answer, json!({"id": "a", "result": "refused", "reason": "this process ends"}));
    assert_eq!(robot.get(10), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_answer_is_sent_before_waiting_readings() {
    let broker = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let robot = Robot::start().await;
    let rules = "[commands]\nallow = [\"I/10\"]\nlongest_seconds = 10";
    let mut text = config(broker.local_addr().unwrap().port(), rules, &[&robot], FAST);
    // no controller listens on port 1, so all of these are published as unknown
    text += "[[controller]]\nname = \"cell2\"\naddress = \"tcp:127.0.0.1:1\"\n\
        [[controller.publish]]\nnames = [\"I1-1500\"]\n";
    let fleet = Running::start(&text).await;
    let mut stream = accept(&broker).await;
    fleet.event(|event| matches!(event, Event::RobotUp { .. })).await;
    // as many messages as may wait for the broker
    let mut waiting = Vec::new();
    while waiting.len() < 100 {
        waiting.push(published(&mut stream).await.1);
    }
    let command = command("a", "I10", 7, now_ms() + 10_000);
    forward(&mut stream, "bcap/plant/cell1/command", &command).await;
    fleet.event(|event| matches!(event, Event::Command { result: CommandResult::Done, .. })).await;
    for packet in waiting {
        acknowledge(&mut stream, packet).await;
    }
    let (topic, _, payload) = published(&mut stream).await;
    let answer: serde_json::Value = serde_json::from_slice(&payload).unwrap();
    assert_eq!((topic.as_str(), answer), ("bcap/plant/cell1/answer", json!({"id": "a", "result": "done"})));
    fleet.abort().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_rule_no_command_is_received() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let fleet = Running::start(&config(broker.port, "", &[&robot], FAST)).await;
    host.json("bcap/plant/cell1/I1", |json| json["quality"] == "good").await;
    host.publish("bcap/plant/cell1/command", command("a", "I1", 5, now_ms() + 5000)).await;
    // its own copy shows that the broker has forwarded it
    host.json("bcap/plant/cell1/command", |_| true).await;
    robot.set(1, 2);
    host.json("bcap/plant/cell1/I1", |json| json["value"] == 2).await;
    assert!(!fleet.stop().await.iter().any(|event| matches!(event, Event::Command { .. })));
}

/// `RESTARTS=50 cargo test -p bcap-fleet json::every_reading -- --nocapture` is the long run.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_reading_of_a_counter_arrives_once_or_is_counted_as_dropped() {
    let restarts = std::env::var("RESTARTS").ok().and_then(|n| n.parse().ok()).unwrap_or(4_usize);
    let Some(mut broker) = Mosquitto::open() else { return };
    let (_folder, path) = folder();
    let (lasts, frozen) = ([0; 3].map(|_| Arc::new(AtomicI32::new(0))), Arc::new(AtomicBool::new(false)));
    let mut text = config(broker.port, &format!("[buffer]\ndirectory = {path:?}\n"), &[], "");
    for (number, last) in (1..).zip(&lasts) {
        let address = counter(last, &frozen).await;
        text += &format!("[[controller]]\nname = \"cell{number}\"\naddress = \"tcp:{address}\"\n{COUNTED}\n");
    }
    let mut host = Subscriber::start(broker.port, "bcap/plant/+/I1").await;
    let fleet = Running::start(&text).await;
    let mut seen = [0; 3].map(|_| BTreeMap::<i32, BTreeMap<u64, u32>>::new());
    let mut note = |publish: &Publish| {
        let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
        let cell: usize = publish.topic["bcap/plant/cell".len()..][..1].parse().unwrap();
        if let (Some(value), None) = (json["value"].as_i64(), json.get("repeated")) {
            let ids = seen[cell - 1].entry(value.try_into().unwrap()).or_default();
            *ids.entry(json["id"].as_u64().unwrap()).or_default() += 1;
        }
        (json["historical"] == true, seen.iter().map(BTreeMap::len).sum::<usize>())
    };
    for number in 0..restarts {
        // some readings before the loss, then some during it
        for _ in 0..200 {
            note(&host.next().await);
        }
        broker.stop();
        let during = lasts[0].load(Ordering::SeqCst) + 100;
        while lasts[0].load(Ordering::SeqCst) < during {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        broker.restart();
        while !note(&host.next().await).0 {}
        println!("restart {number}: {:?}", lasts[0]);
    }
    frozen.store(true, Ordering::SeqCst);
    let read: i32 = lasts.iter().map(|last| last.load(Ordering::SeqCst)).sum();
    let read = usize::try_from(read).unwrap();
    let mut arrived = 0;
    while arrived + usize::try_from(fleet.metric("bcap_dropped_total").await).unwrap() < read {
        arrived = note(&host.next().await).1;
    }
    let dropped = fleet.metric("bcap_dropped_total").await;
    fleet.stop().await;
    assert_eq!(arrived + usize::try_from(dropped).unwrap(), read);
    let mut copies = 0;
    for ids in seen.iter().flat_map(BTreeMap::values) {
        assert_eq!(ids.len(), 1, "a reading has one id: {ids:?}");
        copies += ids.values().sum::<u32>() - 1;
    }
    println!("{restarts} restarts: {read} read, {arrived} arrived, {dropped} dropped, {copies} copies with a known id");
}

const COUNTED: &str = "[[controller.publish]]\nnames = [\"I1\"]\ninterval_ms = 5";
