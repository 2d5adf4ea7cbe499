//! Values with their names as lines of JSON: `{"name":"I1","vt":3,"v":5}`, as `bcap get --json` prints them.

use std::io::BufRead;

use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::variant::OwnedVariant as Value;
use serde::Deserialize;
use serde_json::value::RawValue;

use super::{data, to_json};
use crate::json::{self, LIMITS, Part};

/// A variable with its value, or with the reason why it has none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// The name of the variable.
    pub name: String,
    /// Its value.
    pub entry: Entry,
}

/// The known state of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Its value.
    Value(Value),
    /// The controller refused to read it.
    Refused(HResult),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JsonLine<'a> {
    name: String,
    vt: Option<u16>,
    #[serde(borrow)]
    v: Option<&'a RawValue>,
    refused: Option<i32>,
}

impl Named {
    /// Parses a line.
    ///
    /// # Errors
    ///
    /// The fault with its column.
    pub fn parse(line: &str) -> Result<Self, String> {
        let JsonLine { name, vt, v, refused } = serde_json::from_str(line).map_err(|error| {
            let text = error.to_string();
            // the caller names the line
            let at = text.find(" at line ").unwrap_or(text.len());
            format!("{} at column {}", &text[..at], error.column())
        })?;
        let entry = match (vt, refused) {
            (None, Some(code)) => Entry::Refused(HResult(code)),
            (Some(vt), None) => Entry::Value(value(vt, v.map_or("null", RawValue::get))?),
            _ => return Err(format!("{name}: the value is missing; write {{\"name\":..,\"vt\":..,\"v\":..}}")),
        };
        Ok(Self { name, entry })
    }

    /// Formats the line.
    #[must_use]
    pub fn to_json(&self) -> String {
        match &self.entry {
            Entry::Value(value) => shown(&self.name, value, true),
            Entry::Refused(code) => {
                format!("{{\"name\":{},\"refused\":{}}}", serde_json::Value::from(self.name.as_str()), code.0)
            }
        }
    }
}

fn value(vt: u16, data: &str) -> Result<Value, String> {
    let text = format!("{{\"vt\":{vt},\"v\":{data}}}");
    let bytes = json::parse_value(Part::whole(&text)).map_err(|error| error.message)?;
    Value::decode(&bytes, &LIMITS, Strictness::Strict).map_err(|error| error.to_string())
}

/// Reads all lines; `source` names them in errors. Empty lines are ignored.
///
/// # Errors
///
/// The fault with `source`, its line and its column.
pub fn read_lines(input: impl BufRead, source: &str) -> Result<Vec<Named>, String> {
    let wrong = |number: usize, error: String| format!("{source}, line {number}: {error}");
    let mut all = Vec::new();
    for (line, number) in input.lines().zip(1..) {
        let line = line.map_err(|error| wrong(number, error.to_string()))?;
        if !line.trim().is_empty() {
            all.push(Named::parse(&line).map_err(|error| wrong(number, error))?);
        }
    }
    Ok(all)
}

/// Formats a value with its name: `I1 = 5`, or `{"name":"I1","vt":3,"v":5}`.
#[must_use]
pub fn shown(name: &str, value: &Value, json: bool) -> String {
    if json {
        let name = serde_json::Value::from(name);
        format!("{{\"name\":{name},{}", &to_json(value.as_variant())[1..])
    } else {
        format!("{name} = {}", data::format(value.as_variant()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_read_back_to_the_same_values() {
        for line in [
            r#"{"name":"I1","vt":3,"v":5}"#,
            r#"{"name":"P\"1","vt":8196,"v":[1.5,-0.0,"NaN"]}"#,
            r#"{"name":"S1","vt":8,"v":"a\u0007\n"}"#,
            r#"{"name":"X","vt":0,"v":null}"#,
            r#"{"name":"S2","refused":-2147467259}"#,
        ] {
            assert_eq!(Named::parse(line).unwrap().to_json(), line);
        }
    }

    #[test]
    fn a_wrong_line_is_named_with_its_number() {
        for (text, part) in [
            (
                "{\"name\":\"I1\",\"vt\":3,\"v\":1}\n\n{\"name\":\"I2\",\"error\":\"no\"}",
                "x, line 3: unknown field `error`",
            ),
            ("{\"name\":\"I1\",\"vt\":3,\"v\":1.5}", "x, line 1: 1.5 is not an integer"),
            ("{\"name\":\"I1\"}", "x, line 1: I1: the value is missing"),
        ] {
            let Err(message) = read_lines(text.as_bytes(), "x") else { panic!("{text}") };
            assert!(message.contains(part), "{message}");
        }
    }
}
