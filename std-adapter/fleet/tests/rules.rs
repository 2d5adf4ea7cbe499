//! The rules of the Sparkplug TCK (specification 3.0) by their ids: those that hold here, those that other tests show, those that
//! the node does not hold in full, and those that cannot be tested with it. The test prints the numbers.
//!
//! The ids are taken from a published compatibility matrix of the specification. A small broker records the packets of a fleet, with
//! the flags that a real broker does not pass on.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::{Arc, Mutex};

use tokio::io::AsyncWriteExt as _;
use tokio::net::{TcpListener, TcpStream};

use crate::common::{Publish, Robot, Running, now_ms};
use crate::sparkplug::{Field, Metric, Payload, config, named, packet, payload};

/// A message that the fleet has sent, or its will.
struct Message {
    /// Such as `DBIRTH`.
    kind: String,
    topic: String,
    qos: u8,
    retain: bool,
    payload: Payload,
}

/// All that a fleet has sent on one connection.
#[derive(Default)]
struct Recording {
    /// The level of the protocol, and whether the session is clean.
    connect: (u8, bool),
    will: Option<Message>,
    /// The topics with their QoS, before the first message.
    subscriptions: Vec<(String, u8)>,
    messages: Vec<Message>,
    /// Whether DISCONNECT was the last packet.
    is_disconnected: bool,
}

impl Recording {
    fn will(&self, check: impl Fn(&Message) -> bool) -> bool {
        self.will.as_ref().is_some_and(check)
    }

    fn of<'a>(&'a self, kind: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |message| message.kind == kind)
    }

    /// Returns whether there are messages of a kind, and all of them pass.
    fn all(&self, kind: &str, check: impl Fn(&Message) -> bool) -> bool {
        self.of(kind).count() > 0 && self.of(kind).all(check)
    }

    /// Returns whether all messages of a kind have the topic of the specification, QoS 0 and no retain flag.
    fn is_plain(&self, kind: &str, device: &str) -> bool {
        let topic = format!("spBv1.0/plant/{kind}/edge1{device}");
        self.all(kind, |message| message.topic == topic && message.qos == 0 && !message.retain)
    }

    fn has_times(&self, kind: &str) -> bool {
        self.all(kind, |message| message.payload.time.abs_diff(now_ms()) < 60_000)
    }

    /// Returns whether each sequence number of a kind follows the number of the previous message.
    fn follows(&self, kind: &str) -> bool {
        let numbered: Vec<_> = self.messages.iter().filter(|message| message.kind != "NDEATH").collect();
        let pairs = numbered.windows(2).filter(|pair| pair[1].kind == kind);
        pairs.clone().count() > 0
            && pairs.clone().all(|pair| pair[1].payload.seq == pair[0].payload.seq.map(|seq| (seq + 1) % 256))
    }

    /// Returns whether the first message of a kind follows the first message of each other kind.
    fn comes_after(&self, kind: &str, others: &[&str]) -> bool {
        let first = |kind: &str| self.messages.iter().position(|message| message.kind == kind);
        others.iter().all(|other| first(other).is_some() && first(other) < first(kind))
    }

    /// Returns whether all metrics of these kinds pass.
    fn metrics(&self, kinds: &[&str], check: impl Fn(&Metric) -> bool) -> bool {
        let passes =
            |message: &Message| !message.payload.metrics.is_empty() && message.payload.metrics.iter().all(&check);
        kinds.iter().all(|kind| self.all(kind, passes))
    }

    fn rebirth(&self, check: impl Fn(&Metric) -> bool) -> bool {
        self.all("NBIRTH", |node| check(named(&node.payload, "Node Control/Rebirth")))
    }

    /// Returns whether a kind has the bdSeq of the will, an Int64.
    fn bd_seq(&self, kind: &str) -> bool {
        let number = |message: &Message| {
            let metric = named(&message.payload, "bdSeq");
            (metric.datatype, metric.value.clone())
        };
        self.will(|will| number(will).0 == Some(4) && self.all(kind, |message| number(message) == number(will)))
    }

    /// Returns the values of each alias that are not historical, with their times, from the birth of the device on.
    fn current(&self) -> Vec<Vec<(Option<u64>, Option<Field>)>> {
        let mut current: BTreeMap<_, Vec<_>> = BTreeMap::new();
        let data = self.messages.iter().filter(|message| ["DBIRTH", "DDATA"].contains(&message.kind.as_str()));
        for metric in data.flat_map(|message| &message.payload.metrics).filter(|metric| !metric.is_historical) {
            current.entry(metric.alias.unwrap()).or_default().push((metric.time, metric.value.clone()));
        }
        current.into_values().collect()
    }
}

const BIRTHS: &[&str] = &["NBIRTH", "DBIRTH"];
const DATA: &[&str] = &["NBIRTH", "DBIRTH", "DDATA"];
const NUMBERED: [&str; 4] = ["NBIRTH", "DBIRTH", "DDATA", "DDEATH"];

/// Rules with the same meaning, and whether a recording holds them.
type Rule = (&'static str, fn(&Recording) -> bool);

const RULES: &[Rule] = &[
    (
        "intro-group-id-string intro-group-id-chars intro-edge-node-id-string intro-edge-node-id-chars \
         intro-device-id-string intro-device-id-chars topic-structure topic-structure-namespace-a \
         topic-structure-namespace-valid-group-id topic-structure-namespace-valid-edge-node-id \
         topic-structure-namespace-valid-device-id topic-structure-namespace-device-id-associated-message-types \
         topics-nbirth-topic topics-nbirth-mqtt topics-dbirth-topic topics-dbirth-mqtt topics-ddata-topic \
         topics-ddata-mqtt topics-ddeath-topic topics-ddeath-mqtt \
         message-flow-edge-node-birth-publish-nbirth-topic message-flow-edge-node-birth-publish-nbirth-payload \
         message-flow-edge-node-birth-publish-nbirth-qos message-flow-edge-node-birth-publish-nbirth-retained \
         message-flow-device-birth-publish-dbirth-topic \
         message-flow-device-birth-publish-dbirth-match-edge-node-topic \
         message-flow-device-birth-publish-dbirth-payload message-flow-device-birth-publish-dbirth-qos \
         message-flow-device-birth-publish-dbirth-retained payloads-nbirth-qos payloads-nbirth-retain \
         payloads-dbirth-qos payloads-dbirth-retain payloads-ddata-qos payloads-ddata-retain",
        |sent| {
            sent.is_plain("NBIRTH", "")
                && ["DBIRTH", "DDATA", "DDEATH"].iter().all(|kind| sent.is_plain(kind, "/cell1"))
        },
    ),
    ("principles-birth-certificates-order message-flow-edge-node-birth-publish-connect", |sent| {
        sent.messages.first().is_some_and(|first| first.kind == "NBIRTH")
    }),
    ("principles-persistence-clean-session-311", |sent| sent.connect == (4, true)),
    ("message-flow-edge-node-ncmd-subscribe", |sent| {
        sent.subscriptions.contains(&("spBv1.0/plant/NCMD/edge1".into(), 1))
    }),
    ("message-flow-device-dcmd-subscribe", |sent| {
        sent.subscriptions.contains(&("spBv1.0/plant/DCMD/edge1/+".into(), 1))
    }),
    (
        "message-flow-edge-node-birth-publish-will-message \
         message-flow-edge-node-birth-publish-will-message-topic \
         message-flow-edge-node-birth-publish-will-message-payload \
         message-flow-edge-node-birth-publish-will-message-qos \
         message-flow-edge-node-birth-publish-will-message-will-retained topics-ndeath-topic \
         payloads-ndeath-will-message payloads-ndeath-will-message-qos payloads-ndeath-will-message-retain",
        |sent| {
            sent.will(|will| (will.topic.as_str(), will.qos, will.retain) == ("spBv1.0/plant/NDEATH/edge1", 1, false))
        },
    ),
    ("topics-ndeath-payload topics-ndeath-seq payloads-ndeath-seq", |sent| {
        let is_bare = |death: &Message| death.payload.seq.is_none() && death.payload.metrics.len() == 1;
        sent.will(is_bare) && sent.all("NDEATH", is_bare)
    }),
    (
        "topics-nbirth-bdseq-included topics-nbirth-bdseq-matching payloads-nbirth-bdseq \
         payloads-nbirth-bdseq-repeat message-flow-edge-node-birth-publish-nbirth-payload-bdSeq \
         message-flow-edge-node-birth-publish-will-message-payload-bdSeq",
        |sent| sent.bd_seq("NBIRTH"),
    ),
    ("payloads-ndeath-bdseq", |sent| sent.bd_seq("NDEATH")),
    ("payloads-ndeath-will-message-publisher operational-behavior-edge-node-intentional-disconnect-ndeath", |sent| {
        sent.of("NDEATH").count() == 1
    }),
    (
        "payloads-ndeath-will-message-publisher-disconnect-mqtt311 \
         operational-behavior-edge-node-intentional-disconnect-packet",
        |sent| sent.messages.last().is_some_and(|last| last.kind == "NDEATH") && sent.is_disconnected,
    ),
    (
        "operational-behavior-data-commands-rebirth-name operational-behavior-data-commands-rebirth-name-aliases \
         operational-behavior-data-commands-rebirth-datatype operational-behavior-data-commands-rebirth-value \
         topics-nbirth-rebirth-metric payloads-nbirth-rebirth-req",
        |sent| {
            let is_false = Some(Field::Number(0));
            sent.rebirth(|rebirth| (rebirth.alias, rebirth.datatype, &rebirth.value) == (None, Some(11), &is_false))
        },
    ),
    ("topics-nbirth-metric-reqs operational-behavior-data-publish-nbirth", |sent| {
        let names = |node: &Message| node.payload.metrics.iter().filter_map(|metric| metric.name.clone()).collect();
        let all = BTreeSet::from(["bdSeq".to_owned(), "Node Control/Rebirth".to_owned()]);
        sent.all("NBIRTH", |node| all == names(node)) && sent.of("NDATA").count() == 0
    }),
    ("topics-dbirth-metric-reqs operational-behavior-data-publish-dbirth", |sent| {
        let aliases = |kind| -> BTreeSet<_> {
            sent.of(kind).flat_map(|message| &message.payload.metrics).filter_map(|metric| metric.alias).collect()
        };
        !aliases("DDATA").is_empty() && aliases("DDATA").is_subset(&aliases("DBIRTH"))
    }),
    ("topics-nbirth-metrics topics-dbirth-metrics payloads-metric-datatype-req", |sent| {
        sent.metrics(BIRTHS, |metric| metric.name.is_some() && metric.datatype.is_some())
    }),
    ("operational-behavior-data-publish-nbirth-values operational-behavior-data-publish-dbirth-values", |sent| {
        sent.metrics(BIRTHS, |metric| metric.value.is_some() != metric.is_null)
    }),
    ("principles-rbe-recommended topics-ddata-payload operational-behavior-data-publish-dbirth-change", |sent| {
        let current = sent.current();
        current.iter().any(|values| values.len() > 3)
            && current.iter().all(|values| values.windows(2).all(|pair| pair[0].1 != pair[1].1))
    }),
    ("operational-behavior-data-publish-nbirth-order operational-behavior-data-publish-dbirth-order", |sent| {
        sent.current().iter().all(|values| values.is_sorted_by_key(|(time, _)| *time))
    }),
    ("payloads-sequence-num-always-included payloads-ddeath-seq-number", |sent| {
        NUMBERED.iter().all(|kind| sent.all(kind, |message| message.payload.seq.is_some_and(|seq| seq <= 255)))
    }),
    (
        "payloads-sequence-num-zero-nbirth topics-nbirth-seq-num payloads-nbirth-seq \
         message-flow-edge-node-birth-publish-nbirth-payload-seq",
        |sent| sent.all("NBIRTH", |node| node.payload.seq == Some(0)),
    ),
    (
        "topics-dbirth-seq payloads-dbirth-seq payloads-dbirth-seq-inc \
         message-flow-device-birth-publish-dbirth-payload-seq",
        |sent| sent.follows("DBIRTH"),
    ),
    ("topics-ddata-seq-num payloads-ddata-seq payloads-ddata-seq-inc", |sent| sent.follows("DDATA")),
    ("topics-ddeath-seq-num payloads-ddeath-seq payloads-ddeath-seq-inc", |sent| sent.follows("DDEATH")),
    ("payloads-sequence-num-incrementing", |sent| {
        ["DBIRTH", "DDATA", "DDEATH"].into_iter().all(|kind| sent.follows(kind))
    }),
    (
        "payloads-timestamp-in-UTC topics-nbirth-timestamp topics-dbirth-timestamp topics-ddata-timestamp \
         payloads-nbirth-timestamp payloads-dbirth-timestamp payloads-ddata-timestamp payloads-ddeath-timestamp",
        |sent| NUMBERED.iter().all(|kind| sent.has_times(kind)),
    ),
    ("payloads-name-birth-data-requirement payloads-metric-timestamp-in-UTC", |sent| {
        sent.metrics(DATA, |metric| metric.time.is_some_and(|time| time.abs_diff(now_ms()) < 60_000))
    }),
    ("payloads-name-requirement", |sent| sent.metrics(&["NBIRTH"], |metric| metric.name.is_some())),
    ("payloads-alias-uniqueness", |sent| {
        let birth = sent.of("DBIRTH").take(1).flat_map(|birth| &birth.payload.metrics);
        let aliases: Vec<_> = birth.map(|metric| metric.alias).collect();
        aliases.iter().collect::<HashSet<_>>().len() == aliases.len()
    }),
    ("payloads-alias-data-cmd-requirement", |sent| {
        sent.metrics(&["DDATA"], |metric| metric.alias.is_some() && metric.name.is_none())
    }),
    ("payloads-metric-datatype-not-req", |sent| sent.metrics(&["DDATA"], |metric| metric.datatype.is_none())),
    ("payloads-metric-datatype-value payloads-metric-datatype-value-type", |sent| {
        sent.metrics(BIRTHS, |metric| (1..=34).contains(&metric.datatype.unwrap_or(0)))
    }),
    (
        "payloads-propertyset-keys-array-size payloads-propertyset-values-array-size \
         payloads-metric-propertyvalue-type-type payloads-metric-propertyvalue-type-value \
         payloads-metric-propertyvalue-type-req",
        // the decoder fails if the sizes differ, or if there is no type
        |sent| {
            sent.metrics(&["DBIRTH"], |metric| {
                !metric.properties.is_empty() && metric.properties.iter().all(|(_, kind, _)| (1..=34).contains(kind))
            })
        },
    ),
    ("payloads-propertyset-quality-value-type payloads-propertyset-quality-value-value", |sent| {
        let is_valid = |(key, kind, value): &(String, u64, Field)| {
            key != "Quality" || *kind == 3 && [0, 192].iter().any(|code| *value == Field::Number(*code))
        };
        sent.metrics(&["DBIRTH"], |metric| metric.properties.iter().all(is_valid))
    }),
    ("payloads-dbirth-order message-flow-device-birth-publish-nbirth-wait", |sent| {
        sent.comes_after("DBIRTH", &["NBIRTH"]) && sent.comes_after("DDATA", &["DBIRTH"])
    }),
    ("payloads-ddata-order", |sent| sent.comes_after("DDATA", &["NBIRTH", "DBIRTH"])),
    ("operational-behavior-device-ddeath", |sent| sent.of("DDEATH").count() == 1),
];

/// Rules that other tests show: the test, and the rules.
const ELSEWHERE: &[(&str, &str)] = &[
    (
        "sparkplug::nothing_is_published_while_the_primary_host_is_offline",
        "message-flow-edge-node-birth-publish-phid-wait message-flow-edge-node-birth-publish-phid-wait-id \
         message-flow-edge-node-birth-publish-phid-wait-online \
         message-flow-edge-node-birth-publish-phid-wait-timestamp \
         message-flow-edge-node-birth-publish-phid-offline \
         operational-behavior-edge-node-termination-host-offline \
         operational-behavior-edge-node-termination-host-offline-reconnect \
         operational-behavior-edge-node-termination-host-offline-timestamp",
    ),
    (
        "sparkplug::births_data_deaths_and_rebirth",
        "operational-behavior-data-commands-rebirth-action-2 operational-behavior-data-commands-rebirth-action-3",
    ),
    ("sparkplug::the_births_of_two_processes_follow_each_other", "topics-nbirth-bdseq-increment"),
    ("config::tests::an_error_says_what_is_wrong_and_where", "topic-structure-namespace-unique-device-id"),
];

/// Rules that the node does not hold in full, and why.
const NOT_HELD: &[(&str, &str)] = &[
    (
        "operational-behavior-data-commands-rebirth-action-1",
        "a request less than a second after the last births waits, and data are sent until then",
    ),
    ("payloads-alias-birth-requirement", "NBIRTH has no aliases, because Rebirth must not have one; DBIRTH has both"),
];

/// Rules that cannot be tested with this node: the reason, and a common prefix with the ends of the ids.
const CANNOT: &[(&str, &str, &str)] = &[
    ("the node sends no NDATA", "topics-ndata-", "topic mqtt seq-num timestamp payload"),
    ("the node sends no NDATA", "payloads-ndata-", "timestamp seq seq-inc order qos retain"),
    ("the node sends no NDATA", "operational-behavior-data-publish-nbirth-", "change"),
    ("the node speaks MQTT 3.1.1", "principles-persistence-clean-session-", "50"),
    ("the node speaks MQTT 3.1.1", "payloads-ndeath-will-message-publisher-disconnect-", "mqtt50"),
    ("it is about all nodes of a plant", "intro-edge-node-id-", "uniqueness"),
    (
        "it is about all nodes of a plant",
        "topic-structure-namespace-",
        "unique-edge-node-descriptor duplicate-device-id-across-edge-node",
    ),
    ("it is about all nodes of a plant", "payloads-nbirth-", "edge-node-descriptor"),
    ("names come from the configuration", "case-sensitivity-", "sparkplug-ids metric-names"),
    (
        "the node has one broker",
        "operational-behavior-primary-application-state-with-multiple-servers-",
        "state-subs state single-server walk",
    ),
    ("the node has one broker", "operational-behavior-edge-node-birth-sequence-", "wait"),
    ("the node has no templates", "topics-nbirth-", "templates"),
    (
        "the node has no templates",
        "payloads-template-",
        "dataset-value definition-nbirth-only definition-is-definition definition-ref definition-members \
         definition-nbirth definition-parameters definition-parameters-default instance-is-definition \
         instance-ref instance-members instance-members-birth instance-members-data instance-parameters version \
         ref-definition ref-instance is-definition is-definition-definition is-definition-instance \
         parameter-name-required parameter-name-type parameter-value-type parameter-type-value parameter-type-req \
         parameter-value",
    ),
    (
        "the node has no data sets",
        "payloads-dataset-",
        "column-size column-num-headers types-def types-num types-type types-value parameter-type-req",
    ),
    ("hosts send it", "topics-ncmd-", "topic mqtt timestamp payload"),
    ("hosts send it", "topics-dcmd-", "topic mqtt timestamp payload"),
    ("hosts send it", "payloads-ncmd-", "timestamp seq qos retain"),
    ("hosts send it", "payloads-dcmd-", "timestamp seq qos retain"),
    ("hosts send it", "payloads-name-cmd-", "requirement"),
    (
        "hosts send it",
        "operational-behavior-data-commands-",
        "ncmd-rebirth-verb ncmd-rebirth-name ncmd-rebirth-value ncmd-verb ncmd-metric-name ncmd-metric-value \
         dcmd-verb dcmd-metric-name dcmd-metric-value",
    ),
    (
        "hosts send it",
        "payloads-state-",
        "will-message will-message-qos will-message-retain will-message-payload subscribe birth birth-payload",
    ),
    (
        "it is about hosts",
        "host-topic-phid-",
        "birth-message birth-qos birth-retain birth-topic birth-sub-required birth-required birth-payload \
         birth-payload-timestamp death-qos death-retain death-topic death-required death-payload \
         death-payload-connect death-payload-disconnect-clean death-payload-disconnect-with-no-disconnect-packet",
    ),
    (
        "it is about hosts",
        "message-flow-phid-sparkplug-",
        "clean-session-311 clean-session-50 subscription state-publish state-publish-payload \
         state-publish-payload-timestamp",
    ),
    (
        "it is about hosts",
        "operational-behavior-host-application-",
        "host-id connect-will connect-will-topic connect-will-payload connect-will-qos connect-will-retained \
         connect-birth connect-birth-topic connect-birth-payload connect-birth-qos connect-birth-retained \
         multi-server-timestamp termination death-topic death-payload death-qos death-retained \
         disconnect-intentional",
    ),
    (
        "it is about hosts",
        "operational-behavior-edge-node-termination-host-action-",
        "ndeath-node-offline ndeath-node-tags-stale ndeath-devices-offline ndeath-devices-tags-stale \
         ddeath-devices-offline ddeath-devices-tags-stale",
    ),
    ("it is about hosts", "operational-behavior-host-reordering-", "param start rebirth success"),
    (
        "it is about hosts",
        "",
        "intro-sparkplug-host-state components-ph-state message-flow-hid-sparkplug-state-message-delivered \
         conformance-primary-host",
    ),
    (
        "it is about brokers",
        "conformance-mqtt-",
        "qos0 qos1 will-messages retained aware-basic aware-store aware-nbirth-mqtt-topic \
         aware-nbirth-mqtt-retain aware-dbirth-mqtt-topic aware-dbirth-mqtt-retain aware-ndeath-timestamp",
    ),
];

/// Splits text with a length of two bytes from the rest.
fn text(bytes: &[u8]) -> (&[u8], &[u8]) {
    let (length, rest) = bytes.split_first_chunk().unwrap();
    rest.split_at(u16::from_be_bytes(*length).into())
}

fn message(topic: &[u8], flags: (u8, bool), bytes: &[u8]) -> Message {
    let topic = String::from_utf8(topic.to_vec()).unwrap();
    let kind = topic.split('/').nth(2).unwrap().to_owned();
    let payload = payload(&Publish { topic: topic.clone(), payload: bytes.to_vec(), retain: false });
    Message { kind, topic, qos: flags.0, retain: flags.1, payload }
}

/// Serves one connection, and records its packets.
async fn serve(mut stream: TcpStream, recording: Arc<Mutex<Recording>>) {
    loop {
        let (head, body) = packet(&mut stream).await;
        let answer = {
            let mut recording = recording.lock().unwrap();
            match head >> 4 {
                1 => {
                    // after the name and the level of the protocol and the keep-alive, and the client id
                    let (flags, rest) = (body[7], text(&body[10..]).1);
                    let (topic, rest) = text(rest);
                    recording.connect = (body[6], flags & 2 != 0);
                    recording.will = Some(message(topic, (flags >> 3 & 3, flags & 0x20 != 0), text(rest).0));
                    vec![0x20, 2, 0, 0]
                }
                3 => {
                    let ((topic, mut rest), qos) = (text(&body), head >> 1 & 3);
                    let mut answer = Vec::new();
                    if qos > 0 {
                        answer = [&[0x40, 2], &rest[..2]].concat();
                        rest = &rest[2..];
                    }
                    if topic.starts_with(b"spBv1.0/") {
                        recording.messages.push(message(topic, (qos, head & 1 != 0), rest));
                    }
                    answer
                }
                8 => {
                    let (topic, qos) = text(&body[2..]);
                    if recording.messages.is_empty() {
                        recording.subscriptions.push((String::from_utf8(topic.to_vec()).unwrap(), qos[0]));
                    }
                    [&[0x90, 3], &body[..2], &[1]].concat()
                }
                12 => vec![0xd0, 0],
                _ => {
                    recording.is_disconnected = head >> 4 == 14;
                    return;
                }
            }
        };
        stream.write_all(&answer).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_rules_of_the_tck_hold() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let recording: Arc<Mutex<Recording>> = Arc::default();
    let recorded = Arc::clone(&recording);
    let broker = tokio::spawn(async move { serve(listener.accept().await.unwrap().0, recorded).await });
    let mut robot = Robot::start().await;
    let fleet = Running::start(&config(port, "[commands]\nallow = [\"I/1\"]", &[&robot])).await;
    let seen = async |kind: &str, count: usize| {
        while recording.lock().unwrap().of(kind).count() < count {
            tokio::time::sleep(std::time::Duration::from_millis(1)).await;
        }
    };
    seen("DBIRTH", 1).await;
    for value in 1..=3 {
        let before = recording.lock().unwrap().of("DDATA").count();
        robot.set(1, value);
        seen("DDATA", before + 1).await;
    }
    robot.kill().await;
    seen("DDEATH", 1).await;
    fleet.stop().await;
    broker.await.unwrap();
    let recording = std::mem::take(&mut *recording.lock().unwrap());
    let broken: Vec<_> = RULES.iter().filter(|(_, holds)| !holds(&recording)).map(|(ids, _)| ids).collect();
    assert!(broken.is_empty(), "{broken:?}");
    report();
}

/// Prints the rules that do not hold here, and the numbers of all.
fn report() {
    for (test, ids) in ELSEWHERE {
        println!("{test}: {ids}");
    }
    for (id, reason) in NOT_HELD {
        println!("not held in full: {id}: {reason}");
    }
    for (reason, prefix, ends) in CANNOT {
        println!("cannot be tested, {reason}: {prefix}: {ends}");
    }
    let words = |ids: &str| ids.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    let cannot = |(_, prefix, ends): &(&str, &str, &str)| {
        ends.split_whitespace().map(|end| format!("{prefix}{end}")).collect::<Vec<_>>()
    };
    let lists: [Vec<String>; 4] = [
        RULES.iter().flat_map(|(ids, _)| words(ids)).collect(),
        ELSEWHERE.iter().flat_map(|(_, ids)| words(ids)).collect(),
        NOT_HELD.iter().map(|(id, _)| (*id).to_owned()).collect(),
        CANNOT.iter().flat_map(cannot).collect(),
    ];
    let ids: BTreeSet<_> = lists.iter().flatten().collect();
    let [here, elsewhere, not_held, cannot] = lists.each_ref().map(Vec::len);
    println!("{here} rules hold here, {elsewhere} in other tests, {not_held} not in full, {cannot} cannot be tested");
    assert_eq!(ids.len(), here + elsewhere + not_held + cannot, "an id is listed twice");
}
