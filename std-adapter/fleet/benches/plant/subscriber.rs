//! The subscriber, which counts and times what arrives; and the plain client that publishes the same again.

use std::collections::HashMap;
use std::io::Write as _;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use hdrhistogram::Histogram;
use prost::Message as _;

use crate::mqtt::{self, Message};
use crate::{Failure, clock};

/// The first level of the topics of Sparkplug.
const SPARKPLUG: &str = "spBv1.0/";

/// The messages that have arrived.
pub(crate) struct Seen {
    pub(crate) messages: u64,
    pub(crate) values: u64,
    /// From the change of a value to its arrival, in microseconds.
    changed: Histogram<u64>,
    /// From the reading to its arrival, in milliseconds.
    read: Histogram<u64>,
    /// The last message of each topic.
    pub(crate) sample: Vec<Message>,
}

impl Seen {
    pub(crate) fn print(&self) {
        for (name, times, unit) in
            [("change to arrival", &self.changed, 1000.0), ("reading to arrival", &self.read, 1.0)]
        {
            let [p50, p99] = [0.5, 0.99].map(|share| times.value_at_quantile(share) as f64 / unit);
            println!("  {name:<20} p50 {p50:>7.1} ms, p99 {p99:>7.1} ms, max {:>7.1} ms", times.max() as f64 / unit);
        }
    }
}

struct Counts {
    messages: u64,
    values: u64,
    changed: Histogram<u64>,
    read: Histogram<u64>,
    sample: HashMap<String, Message>,
}

impl Counts {
    fn new() -> Result<Self, Failure> {
        let (changed, read) = (Histogram::new(3)?, Histogram::new(3)?);
        Ok(Self { messages: 0, values: 0, changed, read, sample: HashMap::new() })
    }

    fn value(&mut self, value: i32, time: u64) {
        self.values += 1;
        let micros = clock().wrapping_sub(value) & i32::MAX;
        let _ = self.changed.record(u64::try_from(micros).unwrap_or(0));
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let _ = self.read.record(u64::try_from(now.as_millis()).unwrap_or(0).saturating_sub(time));
    }

    fn message(&mut self, message: Message) {
        self.messages += 1;
        if message.topic.starts_with(SPARKPLUG) {
            let payload = Payload::decode(message.payload.as_slice()).unwrap_or_default();
            for metric in payload.metrics {
                if let (Some(value), Some(time)) = (metric.value, metric.timestamp) {
                    self.value(value.cast_signed(), time);
                }
            }
        } else {
            let one = serde_json::from_slice(&message.payload).map(|reading| vec![reading]);
            let Ok(readings) = one.or_else(|_| serde_json::from_slice::<Vec<Reading>>(&message.payload)) else {
                return;
            };
            for Reading { value, time } in readings {
                if let Some(value) = value {
                    self.value(value, time);
                }
            }
        }
        self.sample.insert(message.topic.clone(), message);
    }
}

/// A reading as plain JSON.
#[derive(serde::Deserialize)]
struct Reading {
    value: Option<i32>,
    time: u64,
}

/// The part of a Sparkplug payload that is measured.
#[derive(Clone, PartialEq, prost::Message)]
struct Payload {
    #[prost(message, repeated, tag = "2")]
    metrics: Vec<Metric>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Metric {
    #[prost(uint64, optional, tag = "3")]
    timestamp: Option<u64>,
    #[prost(uint32, optional, tag = "10")]
    value: Option<u32>,
}

/// A subscriber of all readings, in a thread.
pub(crate) struct Subscriber {
    counts: Arc<Mutex<Counts>>,
}

impl Subscriber {
    pub(crate) fn start(port: u16) -> Result<Self, Failure> {
        let (mut stream, mut packets) = mqtt::connect(port, "subscriber")?;
        mqtt::subscribe(&mut stream, &mut packets, "#")?;
        let counts = Arc::new(Mutex::new(Counts::new()?));
        let shared = Arc::clone(&counts);
        thread::spawn(move || {
            while let Ok(message) = packets.message() {
                shared.lock().unwrap_or_else(PoisonError::into_inner).message(message);
            }
        });
        Ok(Self { counts })
    }

    /// Returns the messages since the last call.
    pub(crate) fn take(&self) -> Seen {
        let mut counts: MutexGuard<'_, Counts> = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = Seen {
            messages: counts.messages,
            values: counts.values,
            changed: counts.changed.clone(),
            read: counts.read.clone(),
            sample: counts.sample.drain().map(|(_, message)| message).collect(),
        };
        (counts.messages, counts.values) = (0, 0);
        counts.changed.reset();
        counts.read.reset();
        seen
    }
}

/// Number of messages that a plain client sends together, before it waits for the acknowledgements of the previous batch.
const BATCH: usize = 500;

/// Publishes messages again and again with QoS 1, as fast as the broker acknowledges them.
pub(crate) fn flood(port: u16, sample: &[Message], time: Duration) -> Result<(), Failure> {
    let (mut stream, mut packets) = mqtt::connect(port, "plain")?;
    // encoded before, so that the client costs little
    let mut batches = Vec::new();
    for (number, batch) in (0..100_u16).cycle().zip(sample.chunks(BATCH)) {
        let mut bytes = Vec::new();
        for (message, id) in batch.iter().zip(1 + number * 500..) {
            let retain = !message.topic.starts_with(SPARKPLUG) && !message.topic.ends_with("/values");
            bytes.extend(mqtt::publish(&Message { qos: 1, retain, ..message.clone() }, id)?);
        }
        batches.push((bytes, batch.len()));
    }
    let (began, mut waiting) = (Instant::now(), 0);
    for (bytes, count) in batches.iter().cycle() {
        stream.write_all(bytes)?;
        // one batch is in flight while the next is written
        for _ in 0..std::mem::replace(&mut waiting, *count) {
            while packets.next()?.0 != 0x40 {}
        }
        if began.elapsed() > time {
            return Ok(());
        }
    }
    Ok(())
}
