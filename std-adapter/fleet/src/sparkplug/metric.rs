//! Metrics: the types of points, and the values of their elements with unit and quality.

use super::payload::{Metric, Number, PropertySet, PropertyValue};
use crate::point::Point;
use crate::reading::{Quality, Value};
use crate::units::elements;

/// The types in use, with their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DataType {
    Int32 = 3,
    Int64 = 4,
    Float = 9,
    Double = 10,
    Boolean = 11,
    String = 12,
}

/// Returns the type of a point, if its kind of variable determines the type.
pub(super) fn typed(point: &Point) -> Option<DataType> {
    use bcap_core::rac::VariableKind as Kind;
    Some(match point.kind? {
        Kind::I => DataType::Int32,
        Kind::F | Kind::V | Kind::P | Kind::J | Kind::T => DataType::Float,
        Kind::D => DataType::Double,
        Kind::S => DataType::String,
        Kind::Io => DataType::Boolean,
    })
}

pub(super) const fn type_of(value: &Value) -> DataType {
    match value {
        Value::Bool(_) => DataType::Boolean,
        Value::Integer(_) => DataType::Int64,
        Value::Number(_) => DataType::Double,
        Value::Text(_) | Value::Numbers(_) | Value::Texts(_) => DataType::String,
    }
}

/// Returns a metric for each element of a value, with name, type, unit and quality.
pub(super) fn values(point: &Point, value: Option<&Value>, kind: DataType) -> Vec<Metric> {
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

    pub(super) fn quality_only(mut self) -> Self {
        self.keys.truncate(1);
        self.values.truncate(1);
        self
    }
}
