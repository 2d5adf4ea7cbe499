//! Sparkplug B: births, data and deaths of the node and of its devices, which are the controllers.
//!
//! | message | when                                                                                    |
//! |---------|-----------------------------------------------------------------------------------------|
//! | NBIRTH  | after each connection, and when a host asks for a rebirth                                |
//! | NDEATH  | by will, and before an orderly end                                                       |
//! | DBIRTH  | when there is a session with the controller and each of its points was read              |
//! | DDATA   | readings, by alias; `is_historical` if the broker was disconnected                        |
//! | DDEATH  | when the session is lost                                                                 |
//!
//! Data refer to a birth. So historical data of a disconnected device are sent between an additional DBIRTH and DDEATH.
//!
//! A metric that cannot be read is null, with the property `Quality` 0. A position has a metric for each element, with its unit
//! as the property `engUnit`. The specification demands QoS 0 for births and data.

mod payload;

use prost::Message as _;
use rumqttc::QoS;

pub(crate) use self::payload::Payload;
use self::payload::{Metric, Number, PropertySet, PropertyValue};
use crate::config::Config;
use crate::message::Message;
use crate::point::Point;
use crate::reading::{Quality, Reading, Value, now_ms};
use crate::units::elements;

/// The metric by which a host asks for births.
const REBIRTH: &str = "Node Control/Rebirth";

/// The metric that joins births and deaths of a node.
const BD_SEQ: &str = "bdSeq";

/// The most readings of one message.
const JOINED: usize = 100;

/// The most bytes of one message with more than one reading.
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

/// The types in use, with their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DataType {
    Int32 = 3,
    Int64 = 4,
    Float = 9,
    Double = 10,
    Boolean = 11,
    String = 12,
}

/// A command of a host to this node or a device.
#[derive(Debug, PartialEq)]
pub(crate) struct HostCommand {
    pub(crate) writes: Vec<HostWrite>,
    pub(crate) rebirth: bool,
}

/// A write that a host asks for.
#[derive(Debug, PartialEq)]
pub(crate) struct HostWrite {
    /// The name of the variable.
    pub(crate) name: String,
    /// The value as JSON.
    pub(crate) value: serde_json::Value,
    /// When the host sent it, in milliseconds since 1970: the time of the metric, or else of the payload; 0 without any.
    pub(crate) time: u64,
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
        Self { seq: 0, bd_seq: 0, devices: devices.collect() }
    }

    /// Returns the will of the next connection.
    pub(crate) fn will(&mut self, config: &Config) -> Message {
        self.bd_seq = self.bd_seq.wrapping_add(1);
        self.death(config)
    }

    /// Returns the number that joins births and deaths of the present connection.
    pub(crate) const fn bd_seq(&self) -> u8 {
        self.bd_seq
    }

    /// Continues the numbers of another process of this node.
    pub(crate) const fn follow(&mut self, bd_seq: u8) {
        self.bd_seq = bd_seq;
    }

    /// Returns the death of the node.
    pub(crate) fn death(&self, config: &Config) -> Message {
        let payload = Payload { timestamp: Some(now_ms()), metrics: vec![self.bd_seq_metric()], seq: None };
        Message { qos: QoS::AtLeastOnce, ..message(topic(config, "NDEATH", None), &payload, Vec::new()) }
    }

    /// Returns whether a payload is the death of the birth with the number that was followed last.
    pub(crate) fn is_death(&self, payload: &[u8]) -> bool {
        let metrics = Payload::decode(payload).map(|payload| payload.metrics).unwrap_or_default();
        let number = Some(Number::Long(self.bd_seq.into()));
        metrics.iter().any(|metric| metric.name.as_deref() == Some(BD_SEQ) && metric.value == number)
    }

    fn bd_seq_metric(&self) -> Metric {
        Metric::named(BD_SEQ, DataType::Int64 as u32, Number::Long(self.bd_seq.into()))
    }

    /// Returns the birth of the node. All devices need a birth after it.
    pub(crate) fn birth(&mut self, config: &Config) -> Message {
        self.seq = 0;
        self.devices.iter_mut().for_each(|device| device.is_born = false);
        let rebirth = Metric::named(REBIRTH, DataType::Boolean as u32, Number::Boolean(false));
        self.numbered(topic(config, "NBIRTH", None), vec![self.bd_seq_metric(), rebirth], Vec::new())
    }

    pub(crate) fn is_born(&self, cell: usize) -> bool {
        self.devices[cell].is_born
    }

    /// Returns the birth of a device; points without a reading are null.
    pub(crate) fn device_birth(&mut self, config: &Config, cell: usize, latest: &[Option<Reading>]) -> Message {
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
    pub(crate) fn device_death(&mut self, config: &Config, cell: usize) -> Option<Message> {
        std::mem::take(&mut self.devices[cell].is_born)
            .then(|| self.numbered(topic(config, "DDEATH", Some(cell)), Vec::new(), Vec::new()))
    }

    /// Returns whether a value has the type that the birth has announced.
    pub(crate) fn has_type(&self, config: &Config, reading: &Reading) -> bool {
        let point = &config.controllers[reading.cell].points[reading.point];
        let announced = self.devices[reading.cell].points[reading.point].1;
        typed(point).is_some() || reading.value.as_ref().is_none_or(|value| announced == Some(type_of(value)))
    }

    /// Returns the data of a reading.
    pub(crate) fn data(&mut self, config: &Config, reading: Reading) -> Message {
        let metrics = self.metrics(config, &reading);
        self.numbered(topic(config, "DDATA", Some(reading.cell)), metrics, vec![reading])
    }

    /// Adds a reading to the data of other points of the same controller; returns whether it was added. A scan reads many
    /// points at once, and one message for all of them costs the broker and its subscribers much less.
    pub(crate) fn join(&self, config: &Config, message: &mut Message, reading: &Reading) -> bool {
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

    /// Returns the request of a host to the node (`cell` is `None`) or to a device.
    pub(crate) fn command(&self, config: &Config, cell: Option<usize>, payload: &[u8]) -> Result<HostCommand, String> {
        let payload = Payload::decode(payload).map_err(|error| format!("the payload is not Sparkplug B: {error}"))?;
        let mut command = HostCommand { writes: Vec::new(), rebirth: false };
        for metric in payload.metrics {
            let name = metric.name.clone().or_else(|| self.name(config, cell?, metric.alias?));
            let name = name.ok_or("a metric has neither a name nor a known alias")?;
            let time = metric.timestamp.or(payload.timestamp).unwrap_or(0);
            match cell {
                None => command.rebirth |= name == REBIRTH && metric.value == Some(Number::Boolean(true)),
                Some(_) => command.writes.push(HostWrite { name, value: metric.to_json(), time }),
            }
        }
        Ok(command)
    }

    /// Returns the name of the point with an alias.
    fn name(&self, config: &Config, cell: usize, alias: u64) -> Option<String> {
        let index = self.devices[cell].points.iter().position(|(first, _)| *first == alias)?;
        Some(config.controllers[cell].points[index].name.clone())
    }
}

/// Returns the topic of a message of the node or of a device.
pub(crate) fn topic(config: &Config, kind: &str, cell: Option<usize>) -> String {
    let node = format!("spBv1.0/{}/{kind}/{}", config.group, config.node);
    cell.map_or_else(|| node.clone(), |cell| format!("{node}/{}", config.controllers[cell].name))
}

fn message(topic: String, payload: &Payload, readings: Vec<Reading>) -> Message {
    Message { topic, payload: payload.encode_to_vec(), qos: QoS::AtMostOnce, retain: false, readings }
}

/// Returns the type of a point that its kind of variable decides.
fn typed(point: &Point) -> Option<DataType> {
    use bcap_core::rac::VariableKind as Kind;
    Some(match point.kind? {
        Kind::I => DataType::Int32,
        Kind::F | Kind::V | Kind::P | Kind::J | Kind::T => DataType::Float,
        Kind::D => DataType::Double,
        Kind::S => DataType::String,
        Kind::Io => DataType::Boolean,
    })
}

const fn type_of(value: &Value) -> DataType {
    match value {
        Value::Bool(_) => DataType::Boolean,
        Value::Integer(_) => DataType::Int64,
        Value::Number(_) => DataType::Double,
        Value::Text(_) | Value::Numbers(_) | Value::Texts(_) => DataType::String,
    }
}

/// Returns a metric for each element of a value, with name, type, unit and quality.
fn values(point: &Point, value: Option<&Value>, kind: DataType) -> Vec<Metric> {
    let parts = elements(point.kind);
    if parts.is_empty() {
        return vec![metric(point.name.clone(), "", value.and_then(|value| number(value, kind)), kind)];
    }
    let numbers = match value {
        Some(Value::Numbers(numbers)) => numbers.as_slice(),
        _ => &[],
    };
    let one = |(index, (part, unit)): (usize, &(&str, &str))| {
        let value = numbers.get(index).and_then(|n| number(&Value::Number(*n), kind));
        metric(format!("{}/{part}", point.name), unit, value, kind)
    };
    parts.iter().enumerate().map(one).collect()
}

fn metric(name: String, unit: &str, value: Option<Number>, kind: DataType) -> Metric {
    let quality = if value.is_some() { Quality::Good } else { Quality::Bad };
    let properties = PropertySet::new(quality, unit);
    Metric {
        name: Some(name),
        datatype: Some(kind as u32),
        is_null: value.is_none().then_some(true),
        value,
        properties: Some(properties),
        ..Metric::default()
    }
}

/// Converts a value to a type; `None` if it does not fit.
fn number(value: &Value, kind: DataType) -> Option<Number> {
    Some(match (kind, value) {
        (DataType::Boolean, Value::Bool(b)) => Number::Boolean(*b),
        // Sparkplug sends negative numbers as their bits
        (DataType::Int32, Value::Integer(n)) => Number::Int(i32::try_from(*n).ok()?.cast_unsigned()),
        (DataType::Int64, Value::Integer(n)) => Number::Long(n.cast_unsigned()),
        (DataType::Float, Value::Number(n)) => Number::Float(*n as f32),
        (DataType::Double, Value::Number(n)) => Number::Double(*n),
        (DataType::String, Value::Text(text)) => Number::Text(text.clone()),
        (DataType::String, value) => Number::Text(serde_json::to_string(value).ok()?),
        _ => return None,
    })
}

impl PropertySet {
    fn new(quality: Quality, unit: &str) -> Self {
        let code = if quality == Quality::Good { 192 } else { 0 };
        let mut set =
            Self { keys: vec!["Quality".into()], values: vec![PropertyValue::int(DataType::Int32 as u32, code)] };
        if !unit.is_empty() {
            set.keys.push("engUnit".into());
            set.values.push(PropertyValue::text(DataType::String as u32, unit));
        }
        set
    }

    fn quality_only(mut self) -> Self {
        self.keys.truncate(1);
        self.values.truncate(1);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
