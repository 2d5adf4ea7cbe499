//! A value that was read of a controller.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::variant::Variant;
use serde::{Deserialize, Deserializer, Serialize};

/// A value as JSON and Sparkplug have it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Value {
    Bool(bool),
    Integer(i64),
    Number(f64),
    Text(String),
    Numbers(#[serde(deserialize_with = "numbers")] Vec<f64>),
    Texts(BTreeMap<String, String>),
}

/// Reads numbers. NaN and the infinities are null in JSON, and are read as NaN.
fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let numbers = Vec::<Option<f64>>::deserialize(deserializer)?;
    Ok(numbers.into_iter().map(|number| number.unwrap_or(f64::NAN)).collect())
}

impl Value {
    /// Converts a value of a controller; `None` if it is EMPTY or of a type that has no counterpart.
    pub(crate) fn of(value: &Variant<'_>) -> Option<Self> {
        Some(match value.flatten() {
            Variant::Bool(b) => Self::Bool(b),
            Variant::Error(code) => Self::Integer(code.0.into()),
            Variant::R4(n) => Self::Number(shortest(n)),
            Variant::R8(n) => Self::Number(n),
            Variant::Bstr(text) => Self::Text(text.to_string()),
            Variant::Array(array) => {
                Self::Numbers(array.iter().map(|element| number(&element)).collect::<Option<_>>()?)
            }
            Variant::Date(date) => Self::Number(date.raw()),
            other => Self::Integer(other.as_i64()?),
        })
    }

    /// Returns whether two values are equal within a dead band.
    pub(crate) fn is_near(&self, other: &Self, dead_band: f64) -> bool {
        // a NaN must not be published with every reading
        let near = |a: f64, b: f64| (a - b).abs() <= dead_band || a.to_bits() == b.to_bits();
        match (self, other) {
            (Self::Integer(a), Self::Integer(b)) => a == b || near(*a as f64, *b as f64) && dead_band > 0.0,
            (Self::Number(a), Self::Number(b)) => near(*a, *b),
            (Self::Numbers(a), Self::Numbers(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| near(*a, *b)),
            (a, b) => a == b,
        }
    }
}

fn number(value: &Variant<'_>) -> Option<f64> {
    match value.flatten() {
        Variant::R4(n) => Some(shortest(n)),
        other => other.as_f64(),
    }
}

/// Converts a number of 32 bits so that 0.1 stays 0.1.
fn shortest(n: f32) -> f64 {
    n.to_string().parse().unwrap_or(f64::from(n))
}

/// Whether a value can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Quality {
    Good,
    Bad,
    /// It was not read, because that may end a stream of Slave Mode.
    Skipped,
}

/// A value that was read, and its time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Reading {
    /// The index of the controller.
    pub(crate) cell: usize,
    /// The index of the point.
    pub(crate) point: usize,
    /// Milliseconds since 1970, when the reply arrived.
    pub(crate) time: u64,
    /// A number that no other reading of this node has.
    pub(crate) id: u64,
    /// `None` if the value is unknown.
    pub(crate) value: Option<Value>,
    pub(crate) quality: Quality,
    /// Whether the broker was disconnected when it was read, or may have received it before.
    pub(crate) historical: bool,
}

/// Returns the time in milliseconds since 1970.
pub(crate) fn now_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| u64::try_from(time.as_millis()).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dead_band_applies_to_numbers() {
        assert!(Value::Number(1.0).is_near(&Value::Number(1.5), 0.5));
        assert!(!Value::Number(1.0).is_near(&Value::Number(1.6), 0.5));
        assert!(Value::Number(f64::NAN).is_near(&Value::Number(f64::NAN), 0.0));
        assert!(Value::Integer(i64::MAX).is_near(&Value::Integer(i64::MAX), 0.0));
        assert!(!Value::Integer(i64::MAX).is_near(&Value::Integer(i64::MAX - 1), 0.0));
        assert!(!Value::Numbers(vec![1.0, 2.0]).is_near(&Value::Numbers(vec![1.0]), 9.0));
        assert!(!Value::Text("a".into()).is_near(&Value::Text("b".into()), 9.0));
    }

    #[test]
    fn a_number_of_32_bits_keeps_its_digits() {
        assert_eq!(Value::of(&Variant::R4(0.1)), Some(Value::Number(0.1)));
        assert_eq!(Value::of(&Variant::Empty), None);
    }
}
