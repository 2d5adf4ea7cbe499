//! Processes that are killed or stopped, with a real Mosquitto: one is active, the other takes over; the buffer outlasts them.

use std::collections::HashSet;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::time::{Duration, Instant};

use crate::common::{Robot, Running, Subscriber, counter, folder, now_ms};
use bcap_fleet::Event;
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::process::{Signal, send};
use bcap_tests::proxy::Relay;
use serde_json::{Value, json};
use tempfile::NamedTempFile;
use tokio::sync::watch;

const STATE: &str = "bcap/plant/edge1/state";
const VALUE: &str = "bcap/plant/cell1/I1";

fn config(port: u16, address: impl std::fmt::Display, more: &str) -> String {
    format!(
        "group = \"plant\"\nnode = \"edge1\"\n{more}\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n[metrics]\nport = 0\n\
         [[controller]]\nname = \"cell1\"\naddress = \"tcp:{address}\"\n\
         [[controller.publish]]\nnames = [\"I1\"]\ninterval_ms = 10\n"
    )
}

const FAST: &str = "[standby]\nafter_ms = 1000";

async fn is_active(fleet: &Running) {
    fleet.event(|event| matches!(event, Event::Active { .. })).await;
}

async fn is_standby(fleet: &Running) {
    fleet.event(|event| matches!(event, Event::Standby { .. })).await;
}

/// A value that was read just now.
fn is_new(json: &Value) -> bool {
    json["quality"] == "good" && json.get("historical").is_none() && json.get("repeated").is_none()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_process_reads_and_the_other_takes_over() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let text = config(broker.port, robot.address, FAST);
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let first = Running::start(&text).await;
    is_active(&first).await;
    let second = Running::start(&text).await;
    is_standby(&second).await;
    robot.set(1, 5);
    host.json(VALUE, |json| is_new(json) && json["value"] == 5).await;
    assert_eq!(second.metric("bcap_readings_total{controller=\"cell1\"}").await, 0);
    assert_eq!([first.metric("bcap_active").await, second.metric("bcap_active").await], [1, 0]);
    assert_eq!(second.metric("bcap_controller_up{controller=\"cell1\"}").await, 1, "its session is open");

    first.abort().await;
    host.json(STATE, |json| json["state"] == "offline").await;
    is_active(&second).await;
    host.json(VALUE, |json| is_new(json) && json["value"] == 5).await;
    let third = Running::start(&text).await;
    is_standby(&third).await;

    // an orderly end hands over as well
    second.stop().await;
    is_active(&third).await;
    robot.set(1, 6);
    host.json(VALUE, |json| is_new(json) && json["value"] == 6).await;
    third.stop().await;
    host.json(STATE, |json| json["state"] == "offline").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_whose_network_stalls_becomes_the_standby_and_sends_its_readings() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let first = Running::start(&config(proxy.tcp.port(), robot.address, FAST)).await;
    is_active(&first).await;
    let second = Running::start(&config(broker.port, robot.address, FAST)).await;
    is_standby(&second).await;
    proxy.hold(true);
    // read by the first process, which has not yet detected that it is no longer active
    robot.set(1, 7);
    let before = first.metric("bcap_readings_total{controller=\"cell1\"}").await;
    while first.metric("bcap_readings_total{controller=\"cell1\"}").await < before + 2 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    is_active(&second).await;
    robot.set(1, 8);
    host.json(VALUE, |json| is_new(json) && json["value"] == 8).await;
    proxy.hold(false);
    host.json(VALUE, |json| json["historical"] == true && json["value"] == 7).await;
    is_standby(&first).await;
    assert_eq!(first.metric("bcap_active").await, 0);
    first.stop().await;
    robot.set(1, 9);
    host.json(VALUE, |json| json["value"] == 9).await;
    assert_eq!(second.metric("bcap_active").await, 1, "the end of a standby changes nothing");
    second.stop().await;
}

fn command(id: &str, value: i32, expires: u64) -> String {
    json!({"id": id, "name": "I10", "value": value, "expires": expires}).to_string()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_command_is_executed_by_both() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let rules = format!("{FAST}\n[commands]\nallow = [\"I/10\"]\nper_second = 1000\nlongest_seconds = 10");
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let first = Running::start(&config(proxy.tcp.port(), robot.address, &rules)).await;
    is_active(&first).await;
    let second = Running::start(&config(broker.port, robot.address, &rules)).await;
    is_standby(&second).await;
    let (to, from) = ("bcap/plant/cell1/command", "bcap/plant/cell1/answer");

    // accepted again and again until the first process has been active for long enough
    let mut number = 0;
    let executed = loop {
        let (id, expires) = (format!("first{number}"), now_ms() + 9900);
        host.publish(to, command(&id, 1, expires)).await;
        let answer = host.json(from, |_| true).await;
        if answer["result"] == "done" {
            break command(&id, 2, expires);
        }
        assert!(answer["reason"].as_str().unwrap().contains("started or taken over"), "{answer}");
        number += 1;
    };

    // this one waits in the network until another process is active
    proxy.hold(true);
    let late = command("late", 3, now_ms() + 9900);
    host.publish(to, late.clone()).await;
    is_active(&second).await;
    for copy in [executed, late] {
        host.publish(to, copy).await;
        let answer = host.json(from, |_| true).await;
        assert_eq!(answer["result"], "unknown", "{answer}");
        assert!(answer["reason"].as_str().unwrap().contains("started or taken over"), "{answer}");
    }
    // until `after` has passed since its last acknowledged message, the first process may still execute what it receives
    tokio::time::sleep(Duration::from_millis(1000)).await;
    proxy.hold(false);
    is_standby(&first).await;
    assert_eq!(robot.get(10), 1);

    // new commands are executed again after a while
    loop {
        host.publish(to, command(&format!("second{number}"), 4, now_ms() + 9900)).await;
        if host.json(from, |_| true).await["result"] == "done" {
            break;
        }
        number += 1;
    }
    assert_eq!(robot.get(10), 4);
    first.stop().await;
    second.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_that_may_not_be_active_any_more_refuses_commands() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let rules = format!("{FAST}\n[commands]\nallow = [\"I/10\"]\nlongest_seconds = 600");
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let fleet = Running::start(&config(proxy.tcp.port(), robot.address, &rules)).await;
    is_active(&fleet).await;
    // what arrives now was sent before the connection stalls
    host.json(VALUE, is_new).await;
    proxy.hold_up(true);
    let stalled = now_ms();
    while now_ms() < stalled + 1000 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    host.publish("bcap/plant/cell1/command", command("a", 1, now_ms() + 10_000)).await;
    let refused = |event: &Event| {
        let text = "another process of this node may be active";
        matches!(event, Event::Command { id, reason: Some(reason), .. } if id == "a" && reason.contains(text))
    };
    fleet.event(refused).await;
    proxy.hold(false);
    host.json("bcap/plant/cell1/answer", |json| json["result"] == "unknown").await;
    fleet.stop().await;
}

/// The program `bcap-fleet` in a separate process.
struct Process {
    child: Child,
    /// Whether it is active; `None` before its first event.
    role: watch::Receiver<Option<bool>>,
    _config: NamedTempFile,
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Process {
    fn start(config: &str) -> Self {
        let mut file = NamedTempFile::new().unwrap();
        file.write_all(config.as_bytes()).unwrap();
        let mut program = Command::new(env!("CARGO_BIN_EXE_bcap-fleet"));
        let mut child = program.arg(file.path()).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (sender, role) = watch::channel(None);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let event: Value = serde_json::from_str(&line).unwrap_or_default();
                if let Some(word @ ("active" | "standby")) = event["event"].as_str() {
                    sender.send_replace(Some(word == "active"));
                }
            }
        });
        Self { child, role, _config: file }
    }

    /// Returns whether it is active; `None` before its first event.
    fn role(&self) -> Option<bool> {
        *self.role.borrow()
    }
}

/// Waits until one process is active and the other is the standby, and swaps them if necessary.
async fn settle(active: &mut Process, other: &mut Process) {
    let began = Instant::now();
    while [active.role(), other.role()] != [Some(true), Some(false)] {
        if [active.role(), other.role()] == [Some(false), Some(true)] {
            std::mem::swap(active, other);
            return;
        }
        assert!(began.elapsed() < Duration::from_secs(30), "{:?}", [active.role(), other.role()]);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// Returns how long it takes until a value arrives that was read and sent after a failure.
async fn takeover(host: &mut Subscriber, fail: impl FnOnce()) -> Duration {
    let (began, time) = (Instant::now(), now_ms());
    fail();
    host.json(VALUE, |json| is_new(json) && json["time"].as_u64() > Some(time)).await;
    began.elapsed()
}

/// Prints the median and the longest time.
fn print(what: &str, mut times: Vec<Duration>) {
    times.sort_unstable();
    println!("{what}: {} takeovers, p50 {:?}, max {:?}", times.len(), times[times.len() / 2], times[times.len() - 1]);
}

/// `just takeover` is the long run with the default of `after_ms`.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn processes_that_are_killed_or_stopped_are_replaced() {
    let count = std::env::var("TAKEOVERS").ok().and_then(|n| n.parse().ok());
    let standby = if count.is_some() { "[standby]" } else { FAST };
    let count = count.unwrap_or(1);
    let Some(mut broker) = Mosquitto::open() else { return };
    let last = Arc::new(AtomicI32::new(0));
    let address = counter(&last, &Arc::new(AtomicBool::new(false))).await;
    let text = config(broker.port, address, standby);
    let mut host = Subscriber::start(broker.port, "bcap/#").await;
    let (mut active, mut other) = (Process::start(&text), Process::start(&text));
    let [mut killed, mut stopped, mut restarted] = [const { Vec::new() }; 3];
    for _ in 0..count {
        settle(&mut active, &mut other).await;
        killed.push(takeover(&mut host, || send(Signal::KILL, &active.child)).await);
        active = std::mem::replace(&mut other, Process::start(&text));
    }
    print("SIGKILL", killed);
    for _ in 0..count {
        settle(&mut active, &mut other).await;
        stopped.push(takeover(&mut host, || send(Signal::STOP, &active.child)).await);
        send(Signal::CONT, &active.child);
    }
    print("SIGSTOP", stopped);
    for _ in 0..count {
        settle(&mut active, &mut other).await;
        if count > 1 {
            // each restart is measured separately: the backoff is reset after 2 s
            tokio::time::sleep(Duration::from_millis(2500)).await;
        }
        broker.stop();
        restarted.push(takeover(&mut host, || broker.restart()).await);
    }
    print("restart of the broker", restarted);
    settle(&mut active, &mut other).await;
    assert!(last.load(Ordering::SeqCst) > 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_killed_process_has_on_disk_is_sent_by_the_next_one() {
    let Some(mut broker) = Mosquitto::open() else { return };
    let (_folder, path) = folder();
    let last = Arc::new(AtomicI32::new(0));
    let address = counter(&last, &Arc::new(AtomicBool::new(false))).await;
    let text = config(broker.port, address, &format!("[buffer]\ndirectory = {path:?}"));
    let mut host = Subscriber::start(broker.port, VALUE).await;
    let first = Process::start(&text);
    host.json(VALUE, is_new).await;
    broker.stop();
    let before = last.load(Ordering::SeqCst);
    let on_disk = || -> Vec<String> {
        let files = std::fs::read_dir(&path).unwrap();
        let texts = files.map(|entry| std::fs::read_to_string(entry.unwrap().path()).unwrap());
        texts.flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>()).collect()
    };
    while on_disk().len() < 100 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    drop(first);
    let killed = last.load(Ordering::SeqCst);
    let lines: Vec<Value> = on_disk().iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    let mut missing: HashSet<_> = lines.iter().map(|line| line["id"].as_u64().unwrap()).collect();
    println!("{} readings on disk, {} since the end of the broker", missing.len(), killed - before);
    assert!(missing.len() >= 90);
    broker.restart();
    let _second = Process::start(&text);
    while !missing.is_empty() {
        let json: Value = serde_json::from_slice(&host.next().await.payload).unwrap();
        missing.remove(&json["id"].as_u64().unwrap());
    }
}
