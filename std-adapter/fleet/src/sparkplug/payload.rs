//! The payload of Sparkplug B as a protocol buffer: the fields of `sparkplug_b.proto` that a node of plain values needs.
//!
//! A decoder skips the others: data sets, templates, meta data. The crate `srad-types` has them all; it depends on an older
//! `prost`, on `paste`, which is not maintained, and brings macros for templates.

use prost::{Message, Oneof};
use serde_json::Value;

#[derive(Clone, PartialEq, Message)]
pub(crate) struct Payload {
    /// Milliseconds since 1970.
    #[prost(uint64, optional, tag = "1")]
    pub(crate) timestamp: Option<u64>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) metrics: Vec<Metric>,
    #[prost(uint64, optional, tag = "3")]
    pub(crate) seq: Option<u64>,
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct Metric {
    #[prost(string, optional, tag = "1")]
    pub(crate) name: Option<String>,
    #[prost(uint64, optional, tag = "2")]
    pub(crate) alias: Option<u64>,
    #[prost(uint64, optional, tag = "3")]
    pub(crate) timestamp: Option<u64>,
    #[prost(uint32, optional, tag = "4")]
    pub(crate) datatype: Option<u32>,
    #[prost(bool, optional, tag = "5")]
    pub(crate) is_historical: Option<bool>,
    #[prost(bool, optional, tag = "7")]
    pub(crate) is_null: Option<bool>,
    #[prost(message, optional, tag = "9")]
    pub(crate) properties: Option<PropertySet>,
    #[prost(oneof = "Number", tags = "10, 11, 12, 13, 14, 15")]
    pub(crate) value: Option<Number>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(crate) enum Number {
    #[prost(uint32, tag = "10")]
    Int(u32),
    #[prost(uint64, tag = "11")]
    Long(u64),
    #[prost(float, tag = "12")]
    Float(f32),
    #[prost(double, tag = "13")]
    Double(f64),
    #[prost(bool, tag = "14")]
    Boolean(bool),
    #[prost(string, tag = "15")]
    Text(String),
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct PropertySet {
    #[prost(string, repeated, tag = "1")]
    pub(crate) keys: Vec<String>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) values: Vec<PropertyValue>,
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct PropertyValue {
    #[prost(uint32, optional, tag = "1")]
    pub(crate) datatype: Option<u32>,
    #[prost(oneof = "Property", tags = "3, 8")]
    pub(crate) value: Option<Property>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(crate) enum Property {
    #[prost(uint32, tag = "3")]
    Int(u32),
    #[prost(string, tag = "8")]
    Text(String),
}

impl PropertyValue {
    pub(crate) const fn int(datatype: u32, value: u32) -> Self {
        Self { datatype: Some(datatype), value: Some(Property::Int(value)) }
    }

    pub(crate) fn text(datatype: u32, value: &str) -> Self {
        Self { datatype: Some(datatype), value: Some(Property::Text(value.into())) }
    }
}

impl Metric {
    pub(crate) fn named(name: &str, datatype: u32, value: Number) -> Self {
        Self { name: Some(name.into()), datatype: Some(datatype), value: Some(value), ..Self::default() }
    }

    /// Returns the value as JSON; a float becomes the shortest number that stands for it.
    pub(crate) fn to_json(&self) -> Value {
        match &self.value {
            None => Value::Null,
            // the types Int8, Int16 and Int32 have a sign
            Some(Number::Int(n)) if self.datatype.is_none_or(|datatype| (1..=3).contains(&datatype)) => {
                n.cast_signed().into()
            }
            Some(Number::Int(n)) => (*n).into(),
            Some(Number::Long(n)) if self.datatype.is_none_or(|datatype| datatype == 4) => n.cast_signed().into(),
            Some(Number::Long(n)) => (*n).into(),
            Some(Number::Float(n)) => n.to_string().parse::<f64>().map_or(Value::Null, Value::from),
            Some(Number::Double(n)) => (*n).into(),
            Some(Number::Boolean(b)) => (*b).into(),
            Some(Number::Text(text)) => text.as_str().into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_those_of_the_specification() {
        let metric = Metric { alias: Some(2), ..Metric::named("I1", 3, Number::Int(7)) };
        let payload = Payload { timestamp: Some(1), metrics: vec![metric], seq: Some(5) };
        // written by hand from the numbers of the fields
        let bytes = [8, 1, 18, 10, 10, 2, b'I', b'1', 16, 2, 32, 3, 80, 7, 24, 5];
        assert_eq!(payload.encode_to_vec(), bytes);
        assert_eq!(Payload::decode(&bytes[..]).unwrap(), payload);
    }

    #[test]
    fn negative_numbers_are_their_bits() {
        let json = |datatype, value| Metric::named("a", datatype, value).to_json();
        assert_eq!(json(3, Number::Int(u32::MAX)), -1);
        assert_eq!(json(7, Number::Int(u32::MAX)), u32::MAX);
        assert_eq!(json(4, Number::Long(u64::MAX)), -1);
        assert_eq!(json(9, Number::Float(0.1)), 0.1);
    }
}
