//! Sparkplug B through a real Mosquitto, read by a decoder that is written from the specification alone.

use crate::common::{Publish, Robot, Running, Subscriber, folder, now_ms};
use bcap_core::hresult::HResult;
use bcap_fleet::Event;
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::proxy::Relay;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

/// A field of a protocol buffer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Field {
    Number(u64),
    Bytes(Vec<u8>),
}

/// Reads the fields of a message with their numbers.
fn fields(mut bytes: &[u8]) -> Vec<(u64, Field)> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut number = 0;
        for shift in (0..).step_by(7) {
            let (first, rest) = bytes.split_first().unwrap();
            *bytes = rest;
            number |= u64::from(first & 0x7F) << shift;
            if first & 0x80 == 0 {
                break;
            }
        }
        number
    }
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let field = match key & 7 {
            0 => Field::Number(varint(&mut bytes)),
            kind => {
                let length = match kind {
                    1 => 8,
                    2 => varint(&mut bytes).try_into().unwrap(),
                    5 => 4,
                    _ => panic!("wire type {kind}"),
                };
                let (data, rest) = bytes.split_at(length);
                bytes = rest;
                Field::Bytes(data.to_vec())
            }
        };
        fields.push((key >> 3, field));
    }
    fields
}

#[derive(Debug, Default, Clone)]
pub(crate) struct Metric {
    pub(crate) name: Option<String>,
    pub(crate) alias: Option<u64>,
    pub(crate) time: Option<u64>,
    pub(crate) datatype: Option<u64>,
    pub(crate) is_historical: bool,
    pub(crate) is_null: bool,
    /// Of any type.
    pub(crate) value: Option<Field>,
    /// The key, type and value of each property.
    pub(crate) properties: Vec<(String, u64, Field)>,
}

#[derive(Debug)]
pub(crate) struct Payload {
    pub(crate) time: u64,
    pub(crate) seq: Option<u64>,
    pub(crate) metrics: Vec<Metric>,
}

fn number(field: &Field) -> u64 {
    match field {
        Field::Number(number) => *number,
        Field::Bytes(_) => panic!("{field:?} is no number"),
    }
}

fn text(field: &Field) -> String {
    match field {
        Field::Bytes(bytes) => String::from_utf8(bytes.clone()).unwrap(),
        Field::Number(_) => panic!("{field:?} is no text"),
    }
}

fn bytes(field: Field) -> Vec<u8> {
    match field {
        Field::Bytes(bytes) => bytes,
        Field::Number(_) => panic!("{field:?} has no bytes"),
    }
}

fn metric(data: &[u8]) -> Metric {
    let mut metric = Metric::default();
    for (tag, field) in fields(data) {
        match tag {
            1 => metric.name = Some(text(&field)),
            2 => metric.alias = Some(number(&field)),
            3 => metric.time = Some(number(&field)),
            4 => metric.datatype = Some(number(&field)),
            5 => metric.is_historical = number(&field) == 1,
            7 => metric.is_null = number(&field) == 1,
            9 => {
                let set = fields(&bytes(field));
                let of = |kind| set.iter().filter(move |(tag, _)| *tag == kind).map(|(_, field)| field);
                assert_eq!(of(1).count(), of(2).count(), "as many keys as values");
                let values = of(2).map(|value| {
                    let value = fields(&bytes(value.clone()));
                    let find = |is: fn(u64) -> bool| value.iter().find(|(tag, _)| is(*tag)).unwrap().1.clone();
                    (number(&find(|tag| tag == 1)), find(|tag| tag >= 3))
                });
                metric.properties =
                    of(1).map(text).zip(values).map(|(key, (kind, value))| (key, kind, value)).collect();
            }
            10..=15 => metric.value = Some(field),
            _ => panic!("unexpected field {tag}"),
        }
    }
    metric
}

pub(crate) fn payload(publish: &Publish) -> Payload {
    let mut payload = Payload { time: 0, seq: None, metrics: Vec::new() };
    for (tag, field) in fields(&publish.payload) {
        match tag {
            1 => payload.time = number(&field),
            2 => payload.metrics.push(metric(&bytes(field))),
            3 => payload.seq = Some(number(&field)),
            _ => panic!("unexpected field {tag}"),
        }
    }
    payload
}

/// A host that checks the rules for all messages.
struct Host {
    subscriber: Subscriber,
    next: Option<u64>,
}

impl Host {
    async fn start(port: u16) -> Self {
        Self { subscriber: Subscriber::start(port, "spBv1.0/plant/#").await, next: None }
    }

    /// Waits for a message of a kind, such as `DBIRTH/edge1/cell1`, and checks the sequence of all messages before it.
    async fn next(&mut self, kind: &str) -> Payload {
        loop {
            let publish = self.subscriber.next().await;
            if publish.topic.contains("CMD/") {
                continue;
            }
            let payload = payload(&publish);
            let is_birth = publish.topic.contains("/NBIRTH/");
            if is_birth {
                assert_eq!(payload.seq, Some(0), "NBIRTH begins the sequence");
            } else if !publish.topic.contains("/NDEATH/") {
                assert_eq!(payload.seq, self.next, "{}", publish.topic);
            }
            self.next = payload.seq.map(|seq| (seq + 1) % 256).or(self.next);
            assert!(payload.time.abs_diff(now_ms()) < 60_000 && !publish.retain);
            if publish.topic == format!("spBv1.0/plant/{kind}") {
                return payload;
            }
        }
    }

    /// Waits for data of an alias.
    async fn data(&mut self, cell: &str, alias: u64) -> Metric {
        loop {
            let payload = self.next(&format!("DDATA/edge1/{cell}")).await;
            if let Some(metric) = payload.metrics.into_iter().find(|metric| metric.alias == Some(alias)) {
                return metric;
            }
        }
    }
}

pub(crate) fn named<'a>(payload: &'a Payload, name: &str) -> &'a Metric {
    payload.metrics.iter().find(|metric| metric.name.as_deref() == Some(name)).unwrap_or_else(|| panic!("{payload:?}"))
}

fn property(metric: &Metric, key: &str) -> Option<Field> {
    metric.properties.iter().find(|(name, ..)| name == key).map(|(.., value)| value.clone())
}

pub(crate) fn config(port: u16, more: &str, robots: &[&Robot]) -> String {
    let mut config = format!(
        "group = \"plant\"\nnode = \"edge1\"\nformat = \"sparkplug\"\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n{more}\n"
    );
    for (number, robot) in (1..).zip(robots) {
        config += &format!(
            "[[controller]]\nname = \"cell{number}\"\naddress = \"tcp:{}\"\n[[controller.publish]]\n\
             names = [\"I1\", \"I9999999\", \"P1\", \"IO128\", \"S1\", \"mode\"]\ninterval_ms = 10\n",
            robot.address
        );
    }
    config
}

/// Encodes a command of a host by hand: a metric with a name, a time, a type and a value.
fn write(name: &str, time: u64, datatype: u8, tag: u8, value: u64) -> Vec<u8> {
    fn varint(mut number: u64, out: &mut Vec<u8>) {
        while number >= 0x80 {
            out.push((number & 0x7F) as u8 | 0x80);
            number >>= 7;
        }
        out.push(number as u8);
    }
    let mut metric = vec![10, name.len() as u8];
    metric.extend(name.as_bytes());
    metric.push(3 << 3);
    varint(time, &mut metric);
    metric.extend([4 << 3, datatype, tag << 3]);
    varint(value, &mut metric);
    let mut payload = vec![8];
    varint(time, &mut payload);
    payload.extend([2 << 3 | 2, metric.len() as u8]);
    payload.extend(metric);
    payload
}

/// Reads an MQTT packet: its first byte, and the bytes after its length.
pub(crate) async fn packet(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let kind = stream.read_u8().await.unwrap();
    let mut length = 0;
    for shift in (0..).step_by(7) {
        let byte = stream.read_u8().await.unwrap();
        length |= usize::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            break;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).await.unwrap();
    (kind, body)
}

/// Sends a short message of QoS 0 as a broker.
pub(crate) async fn forward(stream: &mut TcpStream, topic: &str, payload: &str) {
    let length = u8::try_from(2 + topic.len() + payload.len()).unwrap();
    assert!(length < 0x80, "a longer message has another header");
    let head = [0x30, length, 0, u8::try_from(topic.len()).unwrap()];
    stream.write_all(&[&head[..], topic.as_bytes(), payload.as_bytes()].concat()).await.unwrap();
}

/// Answers the next packet of a node, a subscription, as a broker.
pub(crate) async fn confirm_subscription(stream: &mut TcpStream) {
    let (kind, body) = packet(stream).await;
    assert_eq!(kind, 0x82, "SUBSCRIBE");
    stream.write_all(&[0x90, 3, body[0], body[1], 1]).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_is_born_after_the_broker_has_answered_its_subscription() {
    let broker = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let robot = Robot::start().await;
    let text = format!("{}[metrics]\nport = 0\n", config(broker.local_addr().unwrap().port(), "", &[&robot]));
    let fleet = Running::start(&text).await;
    let (mut stream, _) = broker.accept().await.unwrap();
    assert_eq!(packet(&mut stream).await.0, 0x10, "CONNECT");
    stream.write_all(&[0x20, 2, 0, 0]).await.unwrap();
    let (kind, body) = packet(&mut stream).await;
    assert_eq!((kind, &body[4..body.len() - 1]), (0x82, &b"spBv1.0/plant/NCMD/edge1"[..]));
    // the node has readings to publish
    while fleet.metric("bcap_readings_total{controller=\"cell1\"}").await < 3 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    let early = stream.try_read(&mut [0]).unwrap_err();
    assert_eq!(early.kind(), std::io::ErrorKind::WouldBlock, "a message before the answer");
    stream.write_all(&[0x90, 3, body[0], body[1], 1]).await.unwrap();
    let (kind, body) = packet(&mut stream).await;
    assert_eq!((kind & 0xF0, &body[2..26]), (0x30, &b"spBv1.0/plant/NBIRTH/edge1"[..24]));
    fleet.abort().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_error_of_the_robot_is_an_event_with_its_remedy() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let text = config(broker.port, "", &[&robot]).replace("names = [", "names = [\"error\", ");
    let fleet = Running::start(&text).await;
    fleet.event(|event| matches!(event, Event::RobotUp { .. })).await;
    robot.controller.lock().unwrap().inject_error(HResult::from_u32(0x8120_4071), bcap_std::now());
    fleet.event(|event| matches!(event, Event::RobotError { .. })).await;
    let errors: Vec<_> =
        fleet.stop().await.into_iter().filter(|event| matches!(event, Event::RobotError { .. })).collect();
    let [Event::RobotError { controller, code, meaning: Some(_), remedy: Some(_) }] = &errors[..] else {
        panic!("{errors:?}")
    };
    assert_eq!((controller.as_str(), code.as_str()), ("cell1", "0x81204071"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn births_data_deaths_and_rebirth() {
    let Some(broker) = Mosquitto::open() else { return };
    let (mut one, two) = (Robot::start().await, Robot::start().await);
    one.set(1, -5);
    let mut host = Host::start(broker.port).await;
    let fleet = Running::start(&config(broker.port, "", &[&one, &two])).await;

    let node = host.next("NBIRTH/edge1").await;
    let bd_seq = named(&node, "bdSeq").value.clone().unwrap();
    assert_eq!(bd_seq, Field::Number(0), "the first birth of a process");
    assert_eq!(named(&node, "Node Control/Rebirth").value, Some(Field::Number(0)));
    for metric in &node.metrics {
        assert!(metric.time.unwrap().abs_diff(now_ms()) < 60_000, "{metric:?}");
    }

    let birth = host.next("DBIRTH/edge1/cell1").await;
    let i1 = named(&birth, "I1").clone();
    // Int32, as its bits; quality 192 is good
    assert_eq!((i1.datatype, &i1.value), (Some(3), &Some(Field::Number(u64::from((-5_i32).cast_unsigned())))));
    assert_eq!((property(&i1, "Quality"), i1.is_null), (Some(Field::Number(192)), false));
    assert!(i1.time.unwrap().abs_diff(now_ms()) < 60_000);
    let missing = named(&birth, "I9999999");
    assert_eq!((missing.is_null, property(missing, "Quality")), (true, Some(Field::Number(0))));
    let x = named(&birth, "P1/X");
    assert_eq!((x.datatype, property(x, "engUnit")), (Some(9), Some(Field::Bytes(b"mm".to_vec()))));
    assert_eq!(property(named(&birth, "P1/RX"), "engUnit"), Some(Field::Bytes(b"deg".to_vec())));
    assert_eq!((named(&birth, "IO128").datatype, named(&birth, "S1").datatype), (Some(11), Some(12)));
    let mut aliases: Vec<_> = birth.metrics.iter().map(|metric| metric.alias.unwrap()).collect();
    aliases.dedup();
    assert_eq!(aliases.len(), 12, "an alias for each metric: {birth:?}");

    one.set(1, 6);
    let data = loop {
        // readings from before the connection are historical
        let data = host.data("cell1", i1.alias.unwrap()).await;
        if !data.is_historical {
            break data;
        }
    };
    assert_eq!((data.value, data.name), (Some(Field::Number(6)), None));

    one.kill().await;
    assert!(host.next("DDEATH/edge1/cell1").await.metrics.is_empty());
    one.restart().await;
    assert_eq!(named(&host.next("DBIRTH/edge1/cell1").await, "I1").value, Some(Field::Number(6)));

    // a host requests all births
    let rebirth = write("Node Control/Rebirth", now_ms(), 11, 14, 1);
    host.subscriber.publish("spBv1.0/plant/NCMD/edge1", rebirth).await;
    assert_eq!(named(&host.next("NBIRTH/edge1").await, "bdSeq").value, Some(bd_seq.clone()));
    host.next("DBIRTH/edge1/cell1").await;
    host.next("DBIRTH/edge1/cell2").await;

    fleet.stop().await;
    assert_eq!(named(&host.next("NDEATH/edge1").await, "bdSeq").value, Some(bd_seq));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_requests_for_births_are_one_a_second() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Host::start(broker.port).await;
    let fleet = Running::start(&config(broker.port, "", &[&robot])).await;
    host.next("DBIRTH/edge1/cell1").await;
    let began = std::time::Instant::now();
    for _ in 0..200 {
        let rebirth = write("Node Control/Rebirth", now_ms(), 11, 14, 1);
        host.subscriber.publish("spBv1.0/plant/NCMD/edge1", rebirth).await;
    }
    host.next("NBIRTH/edge1").await;
    host.next("DBIRTH/edge1/cell1").await;
    fleet.stop().await;
    let mut births = 1;
    loop {
        let publish = host.subscriber.next().await;
        births += u64::from(publish.topic.contains("/NBIRTH/"));
        if publish.topic.contains("/NDEATH/") {
            break;
        }
    }
    assert!(births <= 2 + began.elapsed().as_secs(), "{births}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_host_writes_an_allowed_value_and_no_other() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Host::start(broker.port).await;
    let rules = "[commands]\nallow = [\"I/1=-10..10\"]";
    let fleet = Running::start(&config(broker.port, rules, &[&robot])).await;
    let birth = host.next("DBIRTH/edge1/cell1").await;
    let alias = named(&birth, "I1").alias.unwrap();
    fleet.accepts_commands().await;

    let command = "spBv1.0/plant/DCMD/edge1/cell1";
    host.subscriber.publish(command, write("I1", now_ms(), 3, 10, 11)).await;
    host.subscriber.publish(command, write("I2", now_ms(), 3, 10, 1)).await;
    host.subscriber.publish(command, write("I1", now_ms() - 3_600_000, 3, 10, 1)).await;
    host.subscriber.publish(command, b"\xFF".to_vec()).await;
    host.subscriber.publish(command, write("I1", now_ms() + 500, 3, 10, 9)).await;
    let data = loop {
        // readings from before the connection are historical
        let data = host.data("cell1", alias).await;
        if !data.is_historical {
            break data;
        }
    };
    assert_eq!(data.value, Some(Field::Number(9)), "the first change is the allowed one");
    assert_eq!((robot.get(1), robot.get(2)), (9, 0));
    let events = serde_json::to_value(fleet.stop().await).unwrap();
    let results: Vec<_> = events.as_array().unwrap().iter().filter(|event| event["event"] == "command").collect();
    let results: Vec<_> = results.iter().map(|event| event["result"].as_str().unwrap()).collect();
    assert_eq!(results, ["refused", "refused", "refused", "refused", "done"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readings_without_a_broker_are_sent_as_historical() {
    let Some(mut broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let mut host = Host::start(broker.port).await;
    let fleet = Running::start(&config(broker.port, "[metrics]\nport = 0", &[&robot])).await;
    let alias = named(&host.next("DBIRTH/edge1/cell1").await, "I1").alias.unwrap();
    broker.stop();
    for value in 1..=5 {
        let before = fleet.metric("bcap_readings_total{controller=\"cell1\"}").await;
        robot.set(1, value);
        // each point was read twice
        while fleet.metric("bcap_readings_total{controller=\"cell1\"}").await < before + 12 {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
    }
    broker.restart();
    host.next("NBIRTH/edge1").await;
    assert_eq!(named(&host.next("DBIRTH/edge1/cell1").await, "I1").value, Some(Field::Number(5)));
    for value in 1..=5 {
        let data = host.data("cell1", alias).await;
        assert_eq!((data.value, data.is_historical), (Some(Field::Number(value)), true));
    }
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn history_of_a_disconnected_device_ends_with_its_death() {
    let Some(mut broker) = Mosquitto::open() else { return };
    let mut robot = Robot::start().await;
    let mut host = Host::start(broker.port).await;
    let fleet = Running::start(&config(broker.port, "[metrics]\nport = 0", &[&robot])).await;
    let alias = named(&host.next("DBIRTH/edge1/cell1").await, "I1").alias.unwrap();
    broker.stop();
    let before = fleet.metric("bcap_readings_total{controller=\"cell1\"}").await;
    robot.set(1, 7);
    // each point was read twice
    while fleet.metric("bcap_readings_total{controller=\"cell1\"}").await < before + 12 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    robot.kill().await;
    while fleet.metric("bcap_controller_up{controller=\"cell1\"}").await != 0 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    broker.restart();
    host.next("NBIRTH/edge1").await;
    let birth = host.next("DBIRTH/edge1/cell1").await;
    assert!(birth.metrics.iter().all(|metric| metric.is_null), "{birth:?}");
    let data = host.data("cell1", alias).await;
    assert_eq!((data.value, data.is_historical), (Some(Field::Number(7)), true));
    host.next("DDEATH/edge1/cell1").await;
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readings_before_the_birth_of_their_device_are_not_lost() {
    let Some(broker) = Mosquitto::open() else { return };
    let (_folder, path) = folder();
    let (one, mut two) = (Robot::start().await, Robot::start().await);
    two.set(1, 42);
    // it is read only after the node is born
    two.kill().await;
    let mut host = Host::start(broker.port).await;
    let more = format!("[metrics]\nport = 0\n[buffer]\ndirectory = {path:?}");
    let mut text = config(broker.port, &more, &[&one, &two]);
    // the second controller reads this for the first time after half a minute, and is born then
    text += "[[controller.publish]]\nnames = [\"I2\"]\ninterval_ms = 60000\n";
    let fleet = Running::start(&text).await;
    host.next("DBIRTH/edge1/cell1").await;
    two.restart().await;
    // each point was read twice
    while fleet.metric("bcap_readings_total{controller=\"cell2\"}").await < 12 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    fleet.stop().await;
    let files = std::fs::read_dir(&path).unwrap();
    let texts: String = files.filter_map(|file| std::fs::read_to_string(file.unwrap().path()).ok()).collect();
    assert!(texts.contains("42"), "{texts:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_births_of_two_processes_follow_each_other() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let mut host = Subscriber::start(broker.port, "spBv1.0/plant/#").await;
    // the will of a killed process is much faster than this
    let text = |port| config(port, "[standby]\nafter_ms = 3000", &[&robot]);
    let mut active = Running::start(&text(broker.port)).await;
    let is_active = |event: &Event| matches!(event, Event::Active { .. });
    active.event(is_active).await;
    // whether the node is born, and its bdSeq
    let mut node = (false, u64::MAX);
    for number in 1..=4 {
        // the second one to take over has a network that stalls; the others are killed
        let other = Running::start(&text(if number == 2 { proxy.tcp.port() } else { broker.port })).await;
        other.event(|event| matches!(event, Event::Standby { .. })).await;
        if number == 3 {
            proxy.hold(true);
        } else {
            active.abort().await;
        }
        other.event(is_active).await;
        active = other;
        loop {
            let publish = host.next().await;
            let payload = payload(&publish);
            let bd_seq = || match named(&payload, "bdSeq").value {
                Some(Field::Number(number)) => number,
                _ => panic!("{payload:?}"),
            };
            match publish.topic.split('/').nth(2).unwrap() {
                "NBIRTH" => {
                    assert_eq!((node.0, bd_seq()), (false, node.1.wrapping_add(1)), "one birth at a time");
                    node = (true, bd_seq());
                }
                "NDEATH" => {
                    assert_eq!((node.0, bd_seq()), (true, node.1), "the death of the present birth");
                    node.0 = false;
                }
                // of the process that has just taken over
                "DBIRTH" if node == (true, number) => break,
                _ => {}
            }
        }
    }
    active.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readings_that_a_broken_connection_has_lost_are_sent_as_historical() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    let proxy = Relay::tcp(([127, 0, 0, 1], broker.port).into());
    let mut host = Host::start(broker.port).await;
    let fleet = Running::start(&config(proxy.tcp.port(), "[metrics]\nport = 0", &[&robot])).await;
    let alias = named(&host.next("DBIRTH/edge1/cell1").await, "I1").alias.unwrap();
    proxy.hold_up(true);
    for value in 1..=5 {
        let before = fleet.metric("bcap_readings_total{controller=\"cell1\"}").await;
        robot.set(1, value);
        // each point was read twice
        while fleet.metric("bcap_readings_total{controller=\"cell1\"}").await < before + 12 {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
    }
    proxy.disconnect();
    fleet.event(|event| matches!(event, Event::BrokerDown { .. })).await;
    proxy.hold_up(false);
    host.next("NBIRTH/edge1").await;
    for value in 1..=5 {
        let data = host.data("cell1", alias).await;
        assert_eq!((data.value, data.is_historical), (Some(Field::Number(value)), true));
    }
    fleet.stop().await;
}

fn host_state(online: bool, timestamp: u64) -> String {
    format!("{{\"online\":{online},\"timestamp\":{timestamp}}}")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_published_while_the_primary_host_is_offline() {
    let Some(broker) = Mosquitto::open() else { return };
    let robot = Robot::start().await;
    robot.set(1, 1);
    let mut host = Host::start(broker.port).await;
    let state = async |host: &Host, online, time| {
        host.subscriber.retain("spBv1.0/STATE/scada", host_state(online, time)).await;
    };
    let text = format!("primary_host = \"scada\"\n{}", config(broker.port, "[metrics]\nport = 0", &[&robot]));
    let fleet = Running::start(&text).await;
    let up = |event: &Event| matches!(event, Event::BrokerUp {});
    fleet.event(up).await;
    let readings = "bcap_readings_total{controller=\"cell1\"}";
    for value in 1..=3 {
        let before = fleet.metric(readings).await;
        robot.set(1, value);
        // each point was read twice
        while fleet.metric(readings).await < before + 12 {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
    }
    assert_eq!(fleet.metric("bcap_published_total").await, 0);
    state(&host, true, 1000).await;
    let bd_seq = named(&host.next("NBIRTH/edge1").await, "bdSeq").value.clone();
    let alias = named(&host.next("DBIRTH/edge1/cell1").await, "I1").alias.unwrap();
    for value in 1..=3 {
        let data = host.data("cell1", alias).await;
        assert_eq!((data.value, data.is_historical), (Some(Field::Number(value)), true));
    }

    // the will of an earlier connection of the host changes nothing
    state(&host, false, 999).await;
    robot.set(1, 4);
    while host.data("cell1", alias).await.value != Some(Field::Number(4)) {}

    state(&host, false, 2000).await;
    assert_eq!(named(&host.next("NDEATH/edge1").await, "bdSeq").value, bd_seq);
    fleet.event(|event| *event == Event::BrokerDown { reason: "the primary host is offline".into() }).await;
    // a state that is older than the last one arrives late
    state(&host, true, 1999).await;
    let before = fleet.metric(readings).await;
    robot.set(1, 5);
    while fleet.metric(readings).await < before + 12 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    state(&host, true, 3000).await;
    assert_ne!(named(&host.next("NBIRTH/edge1").await, "bdSeq").value, bd_seq);
    loop {
        let data = host.data("cell1", alias).await;
        if data.value == Some(Field::Number(5)) {
            assert!(data.is_historical);
            break;
        }
    }
    fleet.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_leaves_an_offline_host_although_the_broker_acknowledges_nothing() {
    let broker = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let robot = Robot::start().await;
    let text = config(broker.local_addr().unwrap().port(), "", &[&robot]);
    let fleet = Running::start(&format!("primary_host = \"scada\"\n{text}")).await;
    let (mut stream, _) = broker.accept().await.unwrap();
    assert_eq!(packet(&mut stream).await.0, 0x10, "CONNECT");
    stream.write_all(&[0x20, 2, 0, 0]).await.unwrap();
    confirm_subscription(&mut stream).await;
    forward(&mut stream, "spBv1.0/STATE/scada", &host_state(true, 1000)).await;
    confirm_subscription(&mut stream).await;
    assert_eq!(packet(&mut stream).await.0 & 0xF0, 0x30, "NBIRTH");
    forward(&mut stream, "spBv1.0/STATE/scada", &host_state(false, 2000)).await;
    fleet.event(|event| matches!(event, Event::BrokerDown { .. })).await;
    fleet.abort().await;
}
