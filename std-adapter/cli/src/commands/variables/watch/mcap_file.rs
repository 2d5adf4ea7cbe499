//! The file of `bcap watch --mcap`: a topic for each variable.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bcap_capture::mcap::{self, NUMBER, Schema};
use bcap_core::variant::{OwnedVariant as Value, Variant};
use serde_json::{Value as Json, json};

use crate::failure::{Failure, of_file};
use bcap_capture::value::data;

const BOOL: Schema =
    Schema { name: "bcap.Bool", json: r#"{"type":"object","properties":{"value":{"type":"boolean"}}}"# };
const TEXT: Schema =
    Schema { name: "bcap.Text", json: r#"{"type":"object","properties":{"value":{"type":"string"}}}"# };
const NUMBERS: Schema = Schema {
    name: "bcap.Numbers",
    json: r#"{"type":"object","properties":{"value":{"type":"array","items":{"type":"number"}}}}"#,
};
const BOOLS: Schema = Schema {
    name: "bcap.Bools",
    json: r#"{"type":"object","properties":{"value":{"type":"array","items":{"type":"boolean"}}}}"#,
};

/// A file of samples that is being written.
pub(crate) struct Samples {
    series: mcap::Log<BufWriter<File>>,
    path: PathBuf,
    /// The wall clock at the start, since 1970.
    start: Duration,
}

impl Samples {
    /// Creates the file, in place of one that exists.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let start = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Self { series: mcap::Log::create(path).map_err(of_file(path))?, path: path.to_owned(), start })
    }

    /// Adds a value that was read `elapsed` after the start, as `{"value":5}` of the topic `/I1`.
    pub(crate) fn push(&mut self, name: &str, elapsed: Duration, value: &Value) -> Result<(), Failure> {
        let (schema, value) = sample(value.as_variant());
        let at = self.time(elapsed);
        self.series.push(&format!("/{name}"), schema, at, &json!({ "value": value })).map_err(of_file(&self.path))
    }

    /// Writes values that were read a second ago, also while they do not change.
    pub(crate) fn end_round(&mut self, elapsed: Duration) -> Result<(), Failure> {
        self.series.write_older(self.time(elapsed)).map_err(of_file(&self.path))
    }

    /// Returns a time in nanoseconds since 1970.
    fn time(&self, elapsed: Duration) -> u64 {
        u64::try_from((self.start + elapsed).as_nanos()).unwrap_or(u64::MAX)
    }

    /// Completes the file.
    pub(crate) fn end(&mut self) -> Result<(), Failure> {
        self.series.end().map_err(of_file(&self.path))
    }
}

/// Converts a value to JSON. NaN and infinities become null, because JSON does not have them.
fn sample(value: Variant<'_>) -> (Schema, Json) {
    match value {
        Variant::Bool(on) => (BOOL, on.into()),
        Variant::Array(array) => {
            let values: Vec<Json> = array.iter().map(|element| sample(element).1).collect();
            let has = |is: fn(&Json) -> bool| values.iter().all(is);
            match values {
                _ if has(|value| value.is_number() || value.is_null()) => (NUMBERS, values.into()),
                _ if has(Json::is_boolean) => (BOOLS, values.into()),
                _ => (TEXT, data::format(value).into()),
            }
        }
        // the shortest decimal of the float, not of the double with the same value
        Variant::R4(number) => (NUMBER, number.to_string().parse::<f64>().map_or(Json::Null, Json::from)),
        value => match value.as_i64() {
            Some(number) => (NUMBER, number.into()),
            None => value.as_f64().map_or_else(|| (TEXT, data::format(value).into()), |number| (NUMBER, number.into())),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::Encode;

    #[test]
    fn values_are_json() {
        let sample = |value: &dyn Encode| {
            let value = Value::new(value).unwrap();
            let (schema, json) = super::sample(value.as_variant());
            format!("{} {json}", schema.name)
        };
        assert_eq!(sample(&5_i32), "bcap.Number 5");
        assert_eq!(sample(&0.1_f32), "bcap.Number 0.1");
        assert_eq!(sample(&f64::NAN), "bcap.Number null");
        assert_eq!(sample(&f32::INFINITY), "bcap.Number null");
        assert_eq!(sample(&true), "bcap.Bool true");
        assert_eq!(sample(&"a\"b"), "bcap.Text \"a\\\"b\"");
        assert_eq!(sample(&[400.5_f32, -1.0]), "bcap.Numbers [400.5,-1.0]");
        assert_eq!(sample(&[true, false]), "bcap.Bools [true,false]");
        assert_eq!(sample(&["a", "b"]), "bcap.Text \"a,b\"");
        assert_eq!(sample(&()), "bcap.Text \"EMPTY\"");
    }

    #[test]
    fn schemas_are_json() {
        for schema in [NUMBER, BOOL, TEXT, NUMBERS, BOOLS] {
            assert_eq!(serde_json::from_str::<Json>(schema.json).unwrap()["type"], "object");
        }
    }
}
