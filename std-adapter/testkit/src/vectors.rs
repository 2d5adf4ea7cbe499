//! The frames and lines of the specifications: `vectors/*.jsonl`.
//!
//! Some headings and kinds of the RC8 guide's frames are wrong there (`rc8_24` is a response that is called a request),
//! so only their names are used; bytes, serials, codes and values are compared.

use serde_json::Value as Json;

use crate::step::unhex;
use crate::value::{ARRAY, VARIANT, Value};

const GUIDE: &str = include_str!("../vectors/bcap-rc8-guide.jsonl");
const SPEC: &str = include_str!("../vectors/bcap-rc9-spec.jsonl");
const RAC: &str = include_str!("../vectors/rac-spec.jsonl");

/// A frame as a specification prints it.
#[derive(Clone, Debug)]
pub struct FrameVector {
    /// Its name.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// The serial number.
    pub serial: u16,
    /// The reserved field.
    pub reserved: u16,
    /// The function or the HRESULT.
    pub code: i32,
    /// The number of arguments.
    pub count: usize,
    /// The arguments, if the file lists them.
    pub args: Option<Vec<Value>>,
}

/// A text or a line of RAC.
#[derive(Clone, Debug)]
pub struct TextVector {
    /// Its name.
    pub name: String,
    /// The text; lines of the protocol have their CR.
    pub text: String,
}

/// Reads the 108 frames.
///
/// # Panics
///
/// When a file does not have the expected form.
#[must_use]
pub fn frames() -> Vec<FrameVector> {
    GUIDE.lines().chain(SPEC.lines()).map(frame).collect()
}

/// Reads the 43 texts.
///
/// # Panics
///
/// When a file does not have the expected form.
#[must_use]
pub fn texts() -> Vec<TextVector> {
    let text = |line| {
        let json: Json = serde_json::from_str(line).expect("a line of JSON");
        TextVector { name: string(&json, "name"), text: string(&json, "text") }
    };
    RAC.lines().map(text).collect()
}

fn string(json: &Json, key: &str) -> String {
    json[key].as_str().unwrap_or_else(|| panic!("no {key} in {json}")).to_owned()
}

fn frame(line: &str) -> FrameVector {
    let json: Json = serde_json::from_str(line).expect("a line of JSON");
    let number = |key: &str| json[key].as_i64().unwrap_or_else(|| panic!("no {key} in {json}"));
    let args: Option<Vec<Value>> = json["args"].as_array().map(|args| args.iter().map(value).collect());
    FrameVector {
        name: string(&json, "name"),
        bytes: unhex(&string(&json, "hex")).expect("hexadecimal digits"),
        serial: number("serial") as u16,
        // the RC8 guide's lines leave it out where it is 0
        reserved: json["reserved"].as_i64().unwrap_or(0) as u16,
        code: number("code") as u32 as i32,
        count: args.as_ref().map_or_else(|| number("argc") as usize, Vec::len),
        args,
    }
}

/// Reads `{"vt": .., "v": ..}`.
fn value(json: &Json) -> Value {
    let vartype = json["vt"].as_u64().expect("a vt") as u16;
    let element = vartype & !ARRAY;
    match json["v"].as_array() {
        Some(items) if element == VARIANT => Value::Array(element, items.iter().map(value).collect()),
        Some(items) => Value::Array(element, items.iter().map(|item| scalar(element, item)).collect()),
        None => scalar(vartype, &json["v"]),
    }
}

fn scalar(vartype: u16, json: &Json) -> Value {
    let int = || json.as_i64().unwrap_or_else(|| panic!("{json} is no integer"));
    let float = || json.as_f64().unwrap_or_else(|| panic!("{json} is no number"));
    match vartype {
        0 => Value::Empty,
        2 => Value::I2(int() as i16),
        3 => Value::I4(int() as i32),
        4 => Value::R4((float() as f32).to_bits()),
        5 => Value::R8(float().to_bits()),
        8 => Value::text(json.as_str().expect("a string")),
        11 => Value::Bool(int() != 0),
        other => panic!("no vector has the VARTYPE {other} yet"),
    }
}
