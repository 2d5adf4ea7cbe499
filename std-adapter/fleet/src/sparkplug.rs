//! Sparkplug B: births, data and deaths of the node and of its devices, which are the controllers.
//!
//! | message | when                                                                                    |
//! |---------|-----------------------------------------------------------------------------------------|
//! | NBIRTH  | after each connection, and when a host requests a rebirth                               |
//! | NDEATH  | by will, and before an orderly end                                                       |
//! | DBIRTH  | when there is a session with the controller and each of its points was read              |
//! | DDATA   | readings, by alias; `is_historical` if the broker was disconnected                        |
//! | DDEATH  | when the session is lost                                                                 |
//!
//! Data refer to a birth. So historical data of a disconnected device are sent between an additional DBIRTH and DDEATH.
//!
//! A metric that cannot be read is null, with the property `Quality` 0. A position has a metric for each element, with its unit
//! as the property `engUnit`. The specification demands QoS 0 for births and data.

mod metric;
mod payload;

use prost::Message as _;
use rumqttc::QoS;

use self::metric::{DataType, type_of, typed, values};
use self::payload::{Metric, Number, Payload, PropertySet};
use crate::command::{Command, canonical};
use crate::config::Config;
use crate::encoder::{CellCache, Decoded, Encoder, Outbox};
use crate::message::Message;
use crate::point::Point;
use crate::queue::State;
use crate::reading::{Reading, now_ms};
use crate::shorten::LARGEST;
use crate::units::elements;

/// The metric with which a host requests births.
const REBIRTH: &str = "Node Control/Rebirth";

/// The metric that joins births and deaths of a node.
const BD_SEQ: &str = "bdSeq";

/// The maximum number of readings of one message.
const JOINED: usize = 100;

/// The maximum size of one message with more than one reading in bytes.
const JOINED_BYTES: usize = 32 * 1024;

/// The state of the encoder.
#[derive(Debug)]
pub(crate) struct Sparkplug {
    /// The number of the next message after NBIRTH.
    seq: u8,
    /// Joins NBIRTH with the NDEATH of the same connection; 0 follows 255.
    bd_seq: u8,
    devices: Vec<Device>,
}

#[derive(Debug, Default)]
struct Device {
    is_born: bool,
    /// The first alias and the type of each point.
    points: Vec<(u64, Option<DataType>)>,
}

impl Encoder for Sparkplug {
    fn has_births(&self) -> bool {
        true
    }

    fn will(&mut self, config: &Config) -> Option<Message> {
        self.bd_seq = self.bd_seq.wrapping_add(1);
        self.death(config)
    }

    fn death(&self, config: &Config) -> Option<Message> {
        let payload = Payload { timestamp: Some(now_ms()), metrics: vec![self.bd_seq_metric()], seq: None };
        Some(Message { qos: QoS::AtLeastOnce, ..message(topic(config, "NDEATH", None), &payload, Vec::new()) })
    }

    fn topics(&self, config: &Config, are_on: bool) -> Vec<String> {
        let mut topics = vec![topic(config, "NCMD", None)];
        topics.extend(are_on.then(|| topic(config, "DCMD", None) + "/+"));
        topics
    }

    fn introduce(&mut self, outbox: &mut Outbox<'_>) {
        let birth = self.birth(outbox.config);
        outbox.push(birth);
        (0..outbox.cells.len()).for_each(|cell| self.try_birth(outbox, cell));
    }

    /// Births contain all values.
    fn repeat(&mut self, outbox: &mut Outbox<'_>) {
        self.introduce(outbox);
    }

    /// A birth waits for the first readings of the session.
    fn state(&mut self, outbox: &mut Outbox<'_>, state: &State) {
        outbox.messages.extend(self.device_death(outbox.config, state.cell));
    }

    fn reading(&mut self, outbox: &mut Outbox<'_>, reading: Reading) -> Option<Reading> {
        let (config, index) = (outbox.config, reading.cell);
        let cell = &mut outbox.cells[index];
        if !cell.is_connected() {
            // the death of the device has said that all values are unknown
            cell.latest[reading.point] = None;
            return None;
        }
        let before = cell.latest[reading.point].replace(reading.clone());
        if !self.is_born(index) {
            // the birth carries the latest reading only; a historical one is in the buffer
            self.try_birth(outbox, index);
            return before.filter(|before| !before.historical);
        }
        if self.has_type(config, &reading) {
            self.add_data(outbox, reading);
        } else {
            let birth = self.device_birth(config, index, &cell.latest);
            outbox.push(birth);
        }
        None
    }

    fn historical(&mut self, outbox: &mut Outbox<'_>, reading: Reading, has_more: bool) {
        let (config, index) = (outbox.config, reading.cell);
        if !self.is_born(index) {
            // aliases are unknown before a birth; its unread values are null
            let birth = self.device_birth(config, index, &outbox.cells[index].latest);
            outbox.push(birth);
        }
        self.add_data(outbox, reading);
        if !outbox.cells[index].is_connected() && !has_more {
            // the birth was for its history only
            outbox.messages.extend(self.device_death(config, index));
        }
    }

    /// Readings wait for the birth of their device. Historical ones are in the buffer.
    fn take_unsent(&mut self, index: usize, cell: &mut CellCache) -> Vec<Reading> {
        let unborn = !self.is_born(index);
        let latest = cell.latest.iter_mut().filter_map(Option::take);
        latest
            .filter(|reading| unborn && !reading.historical)
            .map(|reading| Reading { historical: true, ..reading })
            .collect()
    }

    fn decode(&self, config: &Config, topic: &str, payload: &[u8], longest: u64) -> Decoded {
        if topic == self::topic(config, "NCMD", None) {
            let asks = Payload::decode(payload).is_ok_and(|payload| payload.metrics.iter().any(is_rebirth));
            return if asks { Decoded::Repeat } else { Decoded::Nothing };
        }
        let name = topic.split('/').nth(4).unwrap_or_default();
        let Some(cell) = config.controllers.iter().position(|cell| cell.name == name) else { return Decoded::Nothing };
        match self.commands(config, cell, payload, longest) {
            Ok(commands) => Decoded::Commands(cell, commands),
            Err(reason) => Decoded::Invalid(cell, String::new(), reason),
        }
    }

    fn lead(&self) -> u64 {
        1000
    }

    fn bd_seq(&self) -> Option<u8> {
        Some(self.bd_seq)
    }

    fn follow(&mut self, bd_seq: u8) {
        self.bd_seq = bd_seq;
    }

    fn death_topic(&self, config: &Config) -> Option<String> {
        Some(topic(config, "NDEATH", None))
    }

    fn is_death(&self, payload: &[u8]) -> bool {
        let metrics = Payload::decode(payload).map(|payload| payload.metrics).unwrap_or_default();
        let number = Some(Number::Long(self.bd_seq.into()));
        metrics.iter().any(|metric| metric.name.as_deref() == Some(BD_SEQ) && metric.value == number)
    }
}

impl Sparkplug {
    pub(crate) fn new(config: &Config) -> Self {
        // 0 is bdSeq
        let mut alias = 1;
        let mut next = |point: &Point| {
            let first = alias;
            alias += elements(point.kind).len().max(1) as u64;
            (first, typed(point))
        };
        let devices = config.controllers.iter();
        let devices =
            devices.map(|cell| Device { is_born: false, points: cell.points.iter().map(&mut next).collect() });
        // the will of the first connection counts it to 0
        Self { seq: 0, bd_seq: u8::MAX, devices: devices.collect() }
    }

    /// Adds the birth of a device when each of its points was read.
    fn try_birth(&mut self, outbox: &mut Outbox<'_>, index: usize) {
        let cell = &outbox.cells[index];
        if cell.is_connected() && cell.latest.iter().all(Option::is_some) {
            let birth = self.device_birth(outbox.config, index, &cell.latest);
            outbox.push(birth);
        }
    }

    /// Adds the data of a reading, to the last message if it fits.
    fn add_data(&mut self, outbox: &mut Outbox<'_>, reading: Reading) {
        let config = outbox.config;
        if !outbox.messages.back_mut().is_some_and(|last| self.join(config, last, &reading)) {
            let data = self.data(config, reading);
            outbox.push(data);
        }
    }

    fn bd_seq_metric(&self) -> Metric {
        Metric::named(BD_SEQ, DataType::Int64 as u32, Number::Long(self.bd_seq.into()))
    }

    /// Returns the birth of the node. After it, all devices need a birth.
    fn birth(&mut self, config: &Config) -> Message {
        self.seq = 0;
        self.devices.iter_mut().for_each(|device| device.is_born = false);
        let rebirth = Metric::named(REBIRTH, DataType::Boolean as u32, Number::Boolean(false));
        let metrics = [self.bd_seq_metric(), rebirth].map(|metric| Metric { timestamp: Some(now_ms()), ..metric });
        self.numbered(topic(config, "NBIRTH", None), metrics.into(), Vec::new())
    }

    fn is_born(&self, cell: usize) -> bool {
        self.devices[cell].is_born
    }

    /// Returns the birth of a device; points without a reading are null.
    fn device_birth(&mut self, config: &Config, cell: usize, latest: &[Option<Reading>]) -> Message {
        let points = &config.controllers[cell].points;
        let mut metrics = Vec::new();
        for ((point, reading), (alias, kind)) in points.iter().zip(latest).zip(&mut self.devices[cell].points) {
            let value = reading.as_ref().and_then(|reading| reading.value.as_ref());
            *kind = typed(point).or_else(|| value.map(type_of)).or(*kind);
            let time = reading.as_ref().map_or_else(now_ms, |reading| reading.time);
            for (part, metric) in (0..).zip(values(point, value, kind.unwrap_or(DataType::String))) {
                metrics.push(Metric { alias: Some(*alias + part), timestamp: Some(time), ..metric });
            }
        }
        self.devices[cell].is_born = true;
        self.numbered(topic(config, "DBIRTH", Some(cell)), metrics, Vec::new())
    }

    /// Returns the death of a device, if it was born.
    fn device_death(&mut self, config: &Config, cell: usize) -> Option<Message> {
        std::mem::take(&mut self.devices[cell].is_born)
            .then(|| self.numbered(topic(config, "DDEATH", Some(cell)), Vec::new(), Vec::new()))
    }

    /// Returns whether a value has the type that the birth has announced.
    fn has_type(&self, config: &Config, reading: &Reading) -> bool {
        let point = &config.controllers[reading.cell].points[reading.point];
        let announced = self.devices[reading.cell].points[reading.point].1;
        typed(point).is_some() || reading.value.as_ref().is_none_or(|value| announced == Some(type_of(value)))
    }

    /// Returns the data of a reading.
    fn data(&mut self, config: &Config, reading: Reading) -> Message {
        let metrics = self.metrics(config, &reading);
        self.numbered(topic(config, "DDATA", Some(reading.cell)), metrics, vec![reading])
    }

    /// Adds a reading to the data of other points of the same controller; returns whether it was added. A scan reads many
    /// points together, and one message for all of them costs the broker and its subscribers much less.
    fn join(&self, config: &Config, message: &mut Message, reading: &Reading) -> bool {
        let fits = |other: &Reading| {
            other.cell == reading.cell && other.point != reading.point && other.historical == reading.historical
        };
        if message.readings.is_empty() || message.readings.len() >= JOINED || !message.readings.iter().all(fits) {
            return false;
        }
        // a protocol buffer is extended by more elements of a repeated field
        let more = Payload { timestamp: None, metrics: self.metrics(config, reading), seq: None }.encode_to_vec();
        let can_join = message.payload.len() + more.len() <= JOINED_BYTES;
        if can_join {
            message.payload.extend(more);
            message.readings.push(reading.clone());
        }
        can_join
    }

    /// Returns the metrics of a reading, by alias.
    fn metrics(&self, config: &Config, reading: &Reading) -> Vec<Metric> {
        let point = &config.controllers[reading.cell].points[reading.point];
        let (alias, kind) = self.devices[reading.cell].points[reading.point];
        let metrics = (0..).zip(values(point, reading.value.as_ref(), kind.unwrap_or(DataType::String)));
        let metrics = metrics.map(|(part, metric)| Metric {
            name: None,
            datatype: None,
            alias: Some(alias + part),
            timestamp: Some(reading.time),
            is_historical: reading.historical.then_some(true),
            // units are in the birth only, the quality in both
            properties: metric.properties.map(PropertySet::quality_only),
            ..metric
        });
        metrics.collect()
    }

    /// Returns a message with the next sequence number.
    fn numbered(&mut self, topic: String, metrics: Vec<Metric>, readings: Vec<Reading>) -> Message {
        let payload = Payload { timestamp: Some(now_ms()), metrics, seq: Some(self.seq.into()) };
        self.seq = self.seq.wrapping_add(1);
        message(topic, &payload, readings)
    }

    /// Returns the writes that a host requests from a device. The send time of a write is the time of its metric, or else of
    /// the payload.
    fn commands(&self, config: &Config, cell: usize, payload: &[u8], longest: u64) -> Result<Vec<Command>, String> {
        if payload.is_empty() {
            return Err(format!("it is empty, or has more than {LARGEST} bytes"));
        }
        let payload = Payload::decode(payload).map_err(|error| format!("the payload is not Sparkplug B: {error}"))?;
        let command = |metric: Metric| {
            let name = metric.name.clone().or_else(|| self.name(config, cell, metric.alias?));
            let name = name.ok_or("a metric has neither a name nor a known alias")?;
            let time = metric.timestamp.or(payload.timestamp).unwrap_or(0);
            let (id, expires) = (format!("{time}/{}", canonical(&name)), time.saturating_add(longest));
            Ok(Command { id, name, value: metric.to_json(), expires, origin: None })
        };
        payload.metrics.into_iter().map(command).collect()
    }

    /// Returns the name of the point with an alias.
    fn name(&self, config: &Config, cell: usize, alias: u64) -> Option<String> {
        let index = self.devices[cell].points.iter().position(|(first, _)| *first == alias)?;
        Some(config.controllers[cell].points[index].name.clone())
    }
}

/// Returns whether a metric requests births.
fn is_rebirth(metric: &Metric) -> bool {
    metric.name.as_deref() == Some(REBIRTH) && metric.value == Some(Number::Boolean(true))
}

/// Returns the topic of a message of the node or of a device.
fn topic(config: &Config, kind: &str, cell: Option<usize>) -> String {
    let node = format!("spBv1.0/{}/{kind}/{}", config.group, config.node);
    cell.map_or_else(|| node.clone(), |cell| format!("{node}/{}", config.controllers[cell].name))
}

fn message(topic: String, payload: &Payload, readings: Vec<Reading>) -> Message {
    let (payload, qos) = (payload.encode_to_vec(), QoS::AtMostOnce);
    Message { topic, payload, qos, retain: false, entries: 0, readings }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reading::{Quality, Value};

    #[test]
    fn readings_of_one_scan_are_one_message() {
        let config = "group = \"g\"\nnode = \"n\"\nformat = \"sparkplug\"\n[broker]\nhost = \"h\"\n[[controller]]\n\
            name = \"a\"\naddress = \"tcp:h\"\n[[controller.publish]]\nnames = [\"I1-2\"]\n";
        let config = Config::parse(config).unwrap();
        let mut sparkplug = Sparkplug::new(&config);
        sparkplug.birth(&config);
        sparkplug.device_birth(&config, 0, &[None, None]);
        let reading = |point, value| Reading {
            cell: 0,
            point,
            time: 5,
            id: 1,
            value: Some(Value::Integer(value)),
            quality: Quality::Good,
            historical: false,
        };
        let mut message = sparkplug.data(&config, reading(0, 7));
        assert!(sparkplug.join(&config, &mut message, &reading(1, 8)));
        // a host may take only one value of a metric from a message
        assert!(!sparkplug.join(&config, &mut message, &reading(1, 9)));
        assert!(!sparkplug.join(&config, &mut message, &Reading { historical: true, ..reading(0, 9) }));
        let mut birth = sparkplug.device_birth(&config, 0, &[None, None]);
        assert!(!sparkplug.join(&config, &mut birth, &reading(0, 9)));

        let payload = Payload::decode(message.payload.as_slice()).unwrap();
        let metrics: Vec<_> = payload.metrics.into_iter().map(|metric| (metric.alias, metric.value)).collect();
        assert_eq!(metrics, [(Some(1), Some(Number::Int(7))), (Some(2), Some(Number::Int(8)))]);
        // 0 and 1 are the births
        assert_eq!((payload.seq, message.readings.len()), (Some(2), 2));
    }

    #[test]
    fn long_texts_are_messages_of_their_own() {
        let config = "group = \"g\"\nnode = \"n\"\nformat = \"sparkplug\"\n[broker]\nhost = \"h\"\n[[controller]]\n\
            name = \"a\"\naddress = \"tcp:h\"\n[[controller.publish]]\nnames = [\"S1-4\"]\n";
        let config = Config::parse(config).unwrap();
        let mut sparkplug = Sparkplug::new(&config);
        sparkplug.device_birth(&config, 0, &[const { None }; 4]);
        let reading = |point| Reading {
            cell: 0,
            point,
            time: 5,
            id: 1,
            value: Some(Value::Text("a".repeat(10_000))),
            quality: Quality::Good,
            historical: false,
        };
        let mut message = sparkplug.data(&config, reading(0));
        let joined = [1, 2, 3].map(|point| sparkplug.join(&config, &mut message, &reading(point)));
        assert_eq!((joined, message.readings.len()), ([true, true, false], 3));
    }
}
