//! Frames as lines of JSON and as lines of text.
//!
//! ```text
//! {"serial":4,"reserved":0,"code":101,"name":"VariableGetValue","args":[{"vt":3,"v":3}]}
//! ```
//!
//! `code` is the number on the wire: the function of a request, the HRESULT of a response (signed, so that errors are
//! negative). `name` is the name of that function or HRESULT, `null` if it has no name. A frame does not show whether it is a
//! request or a response, so the caller gives the role; requests are the default.

use std::borrow::Cow;
use std::fmt::Write as _;

use bcap_core::bcap::{Decoder, Frame, FrameWriter, FunctionId, Progress};
use bcap_core::error::DecodeError;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;
use serde::Deserialize;
use serde_json::value::RawValue;

use crate::error::ConvertError;
use crate::json::{self, LIMITS, Part};
use crate::role::Role;

/// Formats a frame as a line of JSON.
#[must_use]
pub fn to_json(frame: &Frame<'_>, role: Role) -> String {
    let name = role.name_of(frame.code).map_or("null".into(), |name| format!("\"{name}\""));
    let mut out = format!(
        "{{\"serial\":{},\"reserved\":{},\"code\":{},\"name\":{name},\"args\":[",
        frame.serial, frame.reserved, frame.code
    );
    for (i, value) in frame.args.iter().enumerate() {
        if i > 0 {
            out.push(',');
        }
        json::put_value(&mut out, value);
    }
    out.push_str("]}");
    out
}

/// Formats a frame as a line of text: `#4 Variable_GetValue(variable: I4(3))`, `#4 0x00000000 (S_OK): I4(1)`.
#[must_use]
pub fn to_line(frame: &Frame<'_>, role: Role) -> String {
    let mut out = format!("#{}", frame.serial);
    if frame.reserved != 0 && frame.reserved != frame.serial {
        // writing to a string cannot fail, here and below
        let _ = write!(out, " (retry of #{})", frame.reserved);
    }
    match role {
        Role::Request => {
            let _ = write!(out, " {}", to_call(frame.function(), frame.args.iter()));
        }
        Role::Response => {
            let _ = write!(out, " {}", frame.hresult());
            for (i, value) in frame.args.iter().enumerate() {
                let _ = write!(out, "{} {value:?}", if i > 0 { "," } else { ":" });
            }
        }
    }
    out
}

/// Formats a call: `Variable_GetValue(variable: I4(3))`.
pub fn to_call<'a>(function: FunctionId, values: impl Iterator<Item = Variant<'a>>) -> String {
    let mut out = format!("{function}(");
    let names = function.argument_names();
    for (i, value) in values.enumerate() {
        let separator = if i > 0 { ", " } else { "" };
        // writing to a string cannot fail
        let _ = match names.get(i) {
            Some(name) => write!(out, "{separator}{name}: {value:?}"),
            None => write!(out, "{separator}{value:?}"),
        };
    }
    out.push(')');
    out
}

/// The fields of a frame in JSON; the defaults suit a first request.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields<'a> {
    #[serde(default = "first_serial")]
    serial: u16,
    #[serde(default)]
    reserved: u16,
    #[serde(borrow)]
    code: Option<&'a RawValue>,
    #[serde(borrow)]
    name: Option<Cow<'a, str>>,
    #[serde(borrow, default)]
    args: Vec<&'a RawValue>,
}

fn first_serial() -> u16 {
    1
}

/// Encodes a frame from its line of JSON.
///
/// `code` has priority over `name`, which is used only if there is no code.
///
/// # Errors
///
/// The position of the first field that cannot be encoded.
pub fn from_json(text: &str, role: Role, crc: bool) -> Result<Vec<u8>, ConvertError> {
    let line = Part::whole(text);
    let fields: Fields<'_> = line.parse()?;
    let code = match (fields.code, &fields.name) {
        (Some(code), _) => json::code(line.of(code))?,
        (None, Some(name)) => {
            role.code_of(name).ok_or_else(|| line.error(format!("no {} is named {name:?}", noun(role))))?
        }
        (None, None) => return Err(line.error(format!("\"code\" or \"name\" of the {} is missing", noun(role)))),
    };
    if fields.args.len() > usize::from(u16::MAX) {
        return Err(line.error(format!("a frame has at most {} arguments", u16::MAX)));
    }
    let values = fields.args.iter().map(|raw| json::parse_value(line.of(raw))).collect::<Result<Vec<_>, _>>()?;
    let length = values.iter().map(|value| value.len() + 4).sum::<usize>() + 18;
    if u32::try_from(length).is_ok_and(|length| length > LIMITS.frame) {
        return Err(line.error(format!("the frame is over the limit of {} bytes", LIMITS.frame)));
    }
    let mut buffer = vec![0; length];
    let mut frame = FrameWriter::new(&mut buffer)?.with_crc(crc);
    for value in &values {
        frame.argument(&Variant::decode(value, &LIMITS, Strictness::Strict)?)?;
    }
    Ok(frame.finish(fields.serial, fields.reserved, code)?.to_vec())
}

/// Splits bytes into frames, such as a captured stream. `each` gets the bytes of each frame, and the frame.
///
/// # Errors
///
/// When bytes are not a frame, or the last frame is incomplete; the offset counts from the first byte.
pub fn split(bytes: &[u8], decoder: Decoder, mut each: impl FnMut(&[u8], &Frame<'_>)) -> Result<(), DecodeError> {
    let mut at = 0;
    while at == 0 || at < bytes.len() {
        let rest = bytes.get(at..).unwrap_or_default();
        let shifted = |mut error: DecodeError| {
            error.offset += at;
            error
        };
        let (frame, length) = match decoder.decode(rest).map_err(shifted)? {
            Progress::Complete(frame, length) => (frame, length),
            // its error says how many bytes are missing
            Progress::NeedMore(_) => (decoder.decode_datagram(rest).map_err(shifted)?, rest.len()),
        };
        each(rest.get(..length).unwrap_or(rest), &frame);
        at += length;
    }
    Ok(())
}

fn noun(role: Role) -> &'static str {
    match role {
        Role::Request => "function",
        Role::Response => "HRESULT",
    }
}
