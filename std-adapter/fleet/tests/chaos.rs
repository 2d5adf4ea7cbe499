//! The broker, the robots and the network fail at random: no reading is lost uncounted, and no command is executed twice.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::{Running, Subscriber, folder, free_port, now_ms};
use bcap_core::device::{Device, DeviceVariable};
use bcap_core::hresult::HResult;
use bcap_std::server::Server;
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::proxy::Relay;
use serde_json::{Value, json};
use tokio::task::JoinHandle;

const CELLS: usize = 3;

/// The commands for each failure.
const COMMANDS: usize = 50;

/// The topic of the last message.
const END: &str = "bcap/plant/end/end";

/// The calls of a robot over all its restarts.
#[derive(Default)]
struct Record {
    /// The reads of I1, which counts them.
    reads: i32,
    /// The writes of I10 with each value.
    writes: HashMap<i32, u32>,
}

/// A robot whose I1 counts its reads, and whose I10 stores the written value.
struct Cell {
    record: Arc<Mutex<Record>>,
    address: SocketAddr,
    server: Option<JoinHandle<()>>,
}

impl Cell {
    async fn start() -> Self {
        let address = SocketAddr::from(([127, 0, 0, 1], free_port()));
        let mut cell = Self { record: Arc::default(), address, server: None };
        cell.restart().await;
        cell
    }

    async fn restart(&mut self) {
        type State = Arc<Mutex<Record>>;
        let count = DeviceVariable::new("I1", |record: &State, reply| {
            let mut record = record.lock().unwrap();
            record.reads += 1;
            reply.set(&record.reads)
        });
        let write = DeviceVariable::new("I10", |_: &State, reply| reply.set(&0_i32)).writable(|record, value| {
            let value: i32 = value.convert().map_err(|_| HResult::E_INVALIDARGTYPE)?;
            *record.lock().unwrap().writes.entry(value).or_default() += 1;
            Ok(())
        });
        let server = loop {
            let device = Device::new(Arc::clone(&self.record), [count.clone(), write.clone()]);
            match Server::new(device).bcap_tcp(self.address).await {
                Ok(server) => break server,
                // the port of the life before may not be free yet
                Err(_) => tokio::time::sleep(Duration::from_millis(1)).await,
            }
        };
        self.server = Some(tokio::spawn(async move { drop(server.run(std::future::pending()).await) }));
    }

    async fn kill(&mut self) {
        if let Some(server) = self.server.take() {
            server.abort();
            let _ = server.await;
        }
    }
}

/// Numbers that look random, the same ones in each run.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }
}

/// The messages that a subscriber has received.
#[derive(Default)]
struct Received {
    /// The ids of each value of a robot, and the number of times that each arrived.
    readings: BTreeMap<(usize, i64), BTreeMap<u64, u32>>,
    /// The results of each command.
    answers: HashMap<String, HashSet<String>>,
}

impl Received {
    /// Receives a message; returns whether there are more.
    async fn next(&mut self, host: &mut Subscriber) -> bool {
        let publish = host.next().await;
        if publish.topic == END {
            return false;
        }
        let json: Value = serde_json::from_slice(&publish.payload).unwrap();
        let mut levels = publish.topic.split('/').skip(2);
        let (cell, leaf) = (levels.next().unwrap(), levels.next().unwrap());
        match (leaf, json["value"].as_i64()) {
            ("I1", Some(value)) if json.get("repeated").is_none() => {
                let cell: usize = cell["cell".len()..].parse().unwrap();
                let ids = self.readings.entry((cell, value)).or_default();
                *ids.entry(json["id"].as_u64().unwrap()).or_default() += 1;
            }
            ("answer", _) => {
                let [id, result] = ["id", "result"].map(|key| json[key].as_str().unwrap().to_owned());
                self.answers.entry(id).or_default().insert(result);
            }
            _ => {}
        }
        true
    }
}

fn config(port: u16, buffer: &std::path::Path, cells: &[Cell]) -> String {
    let mut text = format!(
        "group = \"plant\"\nnode = \"edge1\"\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n[metrics]\nport = 0\n\
         [buffer]\ndirectory = {buffer:?}\n[commands]\nallow = [\"I/10\"]\nper_second = 10000\nlongest_seconds = 10\n"
    );
    for (number, cell) in cells.iter().enumerate() {
        text += &format!(
            "[[controller]]\nname = \"cell{number}\"\naddress = \"tcp:{}\"\n\
             [[controller.publish]]\nnames = [\"I1\"]\ninterval_ms = 5\n",
            cell.address
        );
    }
    text
}

/// Sends commands, each twice, as a sender that got no answer does.
async fn send(host: &Subscriber, numbers: std::ops::Range<usize>) {
    for number in numbers {
        let command = json!({"id": format!("c{number}"), "name": "I10", "value": number, "expires": now_ms() + 9_900});
        for _ in 0..2 {
            host.publish(&format!("bcap/plant/cell{}/command", number % CELLS), command.to_string()).await;
        }
        // a controller may execute 16 at the same time
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// Lets everything fail a number of times. A broker that `crashes` loses messages that it has acknowledged; these
/// losses are only counted.
async fn chaos(failures: usize, crashes: bool) {
    let Some(mut broker) = Mosquitto::open() else { return };
    let (_folder, buffer) = folder();
    let mut cells = Vec::new();
    for _ in 0..CELLS {
        cells.push(Cell::start().await);
    }
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let mut host = Subscriber::start(broker.port, "bcap/plant/#").await;
    let sender = Subscriber::start(broker.port, "unused").await;
    let fleet = Running::start(&config(proxy.tcp.port(), &buffer, &cells)).await;
    let (mut random, mut received) = (Random(0x9E37_79B9_7F4A_7C15), Received::default());
    let pause = |milliseconds| tokio::time::sleep(Duration::from_millis(milliseconds));
    for failure in 0..failures {
        let commands = failure * COMMANDS..(failure + 1) * COMMANDS;
        let last = format!("c{}", commands.end - 1);
        let fail = async {
            // somewhere among the commands
            pause(random.below(50)).await;
            match failure % 4 {
                0 => {
                    if crashes {
                        broker.kill()
                    } else {
                        broker.stop()
                    }
                    pause(random.below(300)).await;
                    broker.restart();
                }
                1 => {
                    let cell = &mut cells[usize::try_from(random.below(CELLS as u64)).unwrap()];
                    cell.kill().await;
                    pause(random.below(300)).await;
                    cell.restart().await;
                }
                stalled => {
                    proxy.hold(true);
                    pause(random.below(500)).await;
                    if stalled == 3 {
                        proxy.disconnect();
                    }
                    proxy.hold(false);
                }
            }
        };
        let receive = async {
            // readings are received until the fleet answers again, or the answer is lost
            let until = tokio::time::Instant::now() + Duration::from_secs(3);
            while !received.answers.contains_key(&last) && tokio::time::Instant::now() < until {
                let _ = tokio::time::timeout_at(until, received.next(&mut host)).await;
            }
        };
        tokio::join!(send(&sender, commands), fail, receive);
    }
    let mut read = 0;
    for (number, cell) in cells.iter_mut().enumerate() {
        cell.kill().await;
        let metric = |name: &str| format!("{name}{{controller=\"cell{number}\"}}");
        reaches(&fleet, &metric("bcap_controller_up"), 0).await;
        read += fleet.metric(&metric("bcap_readings_total")).await;
    }
    reaches(&fleet, "bcap_queued", 0).await;
    reaches(&fleet, "bcap_stored_bytes", 0).await;
    let dropped = fleet.metric("bcap_dropped_total").await;
    fleet.stop().await;
    sender.publish(END, "").await;
    while received.next(&mut host).await {}
    check(crashes, &cells, &received, read, dropped);
}

/// Waits until a number of the metrics has a value.
async fn reaches(fleet: &Running, name: &str, value: u64) {
    let reached = async {
        while fleet.metric(name).await != value {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), reached).await.unwrap_or_else(|_| panic!("{name} is not {value}"));
}

fn check(crashes: bool, cells: &[Cell], received: &Received, read: u64, dropped: u64) {
    let arrived = received.readings.len() as u64;
    let mut copies = 0;
    for ids in received.readings.values() {
        assert_eq!(ids.len(), 1, "a reading has one id: {ids:?}");
        copies += ids.values().sum::<u32>() - 1;
    }
    println!("{read} read, {arrived} arrived, {dropped} dropped, {copies} copies with a known id");
    if crashes {
        println!("{} were lost by the broker, which had acknowledged them", read - arrived - dropped);
    } else {
        assert_eq!(arrived + dropped, read);
    }

    let writes = |number: usize| {
        let record = cells[number % CELLS].record.lock().unwrap();
        record.writes.get(&i32::try_from(number).unwrap()).copied().unwrap_or(0)
    };
    let mut counts = BTreeMap::<Option<&str>, u32>::new();
    for (id, results) in &received.answers {
        let number = id["c".len()..].parse().unwrap();
        let result =
            ["done", "failed", "unknown", "refused", "repeated"].into_iter().find(|result| results.contains(*result));
        *counts.entry(result).or_default() += 1;
        match result {
            Some("done") => assert_eq!(writes(number), 1, "{id}"),
            Some("failed") => assert_eq!(writes(number), 0, "{id}"),
            // the answer to the first copy may be lost
            _ => {}
        }
    }
    let mut executed = 0;
    for cell in cells {
        let record = cell.record.lock().unwrap();
        assert!(record.writes.values().all(|count| *count == 1), "executed twice: {:?}", record.writes);
        executed += record.writes.len();
    }
    println!("{executed} commands executed; results {counts:?}");
    assert!(executed > 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_lost_uncounted_and_nothing_is_executed_twice() {
    chaos(failures(), false).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_broker_that_crashes_causes_no_command_to_be_executed_twice() {
    chaos(failures(), true).await;
}

/// The number of failures; every fourth is one of the broker. `just chaos` is the long run.
fn failures() -> usize {
    std::env::var("FAILURES").ok().and_then(|n| n.parse().ok()).unwrap_or(8)
}
