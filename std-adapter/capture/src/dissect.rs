//! A frame as a table: each field with its offset and its bytes.
//!
//! ```text
//! offset  bytes                          field
//!      0  01                             SOH
//!      1  1e 00 00 00                    length 30
//!      5  04 00                          serial 4
//!      7  00 00                          reserved
//!      9  65 00 00 00                    function 101 Variable_GetValue
//!     13  01 00                          1 argument
//!     15  0a 00 00 00                    10 bytes of argument 1
//!     19  03 00 01 00 00 00 03 00 00 00  variable: I4(3)
//!     29  04                             EOT
//! ```

use std::fmt::Write as _;
use std::ops::Range;

use bcap_core::bcap::header::field;
use bcap_core::bcap::{Decoder, Frame, HEADER_LEN};
use bcap_core::error::DecodeError;
use bcap_core::limits::Strictness;

use crate::hex;
use crate::json::LIMITS;
use crate::role::Role;

/// The bytes in a row; a longer field continues in the next row.
const ROW: usize = 16;

/// Writes the fields of a strictly decoded frame, one per row; `bytes` is the encoded frame.
#[must_use]
pub fn dissect(bytes: &[u8], frame: &Frame<'_>, role: Role, crc: bool) -> String {
    let fields = fields(bytes, frame, role, crc);
    let widest = fields.iter().map(|(range, _)| range.len().min(ROW)).max().unwrap_or(0) * 3;
    let mut out = format!("offset  {:widest$} field", "bytes");
    for (range, text) in fields {
        let mut rows = bytes.get(range.clone()).unwrap_or_default().chunks(ROW);
        let first = rows.next().map(hex::spaced).unwrap_or_default();
        // writing to a string cannot fail
        let _ = write!(out, "\n{:6}  {first:widest$} {text}", range.start);
        for (i, row) in rows.enumerate() {
            let _ = write!(out, "\n{:6}  {}", range.start + (i + 1) * ROW, hex::spaced(row));
        }
    }
    out
}

/// A field of a frame: its bytes and its text.
pub type Field = (Range<usize>, String);

/// Returns the fields of a frame without CRC, which cover all of its bytes.
///
/// # Errors
///
/// A fault of the frame.
pub fn fields_of(bytes: &[u8], role: Role) -> Result<Vec<Field>, DecodeError> {
    let decoder = Decoder { limits: LIMITS, strictness: Strictness::Strict, crc: false };
    Ok(fields(bytes, &decoder.decode_datagram(bytes)?, role, false))
}

/// Writes a strictly decoded frame without CRC in few rows: its header, then its arguments, each with its bytes.
///
/// ```text
/// 01 2a 00 00 00 05 00 00 00 66 00 00 00 02 00     #5 Variable_PutValue, 42 bytes
/// 0a 00 00 00 03 00 01 00 00 00 03 00 00 00        variable: I4(3)
/// 08 00 00 00 0b 00 01 00 00 00 ff ff 04           value: BOOL(true)
/// ```
#[must_use]
pub fn outline(bytes: &[u8], frame: &Frame<'_>, role: Role) -> String {
    let code = match role {
        Role::Request => frame.function().to_string(),
        Role::Response => frame.hresult().to_string(),
    };
    let retry = match frame.reserved {
        0 => String::new(),
        first if first == frame.serial => ", first attempt".into(),
        first => format!(", retry of #{first}"),
    };
    let mut rows: Vec<Field> = vec![(0..HEADER_LEN, format!("#{} {code}, {} bytes{retry}", frame.serial, bytes.len()))];
    rows.extend(
        arguments(bytes, frame, role).map(|argument| (argument.length.start..argument.value.end, argument.text)),
    );
    if let Some((range, _)) = rows.last_mut() {
        range.end += 1;
    }
    table(bytes, &rows, ROW * 3)
}

/// Writes rows of bytes, with a text next to the first row of each field.
fn table(bytes: &[u8], fields: &[Field], width: usize) -> String {
    let mut lines = Vec::new();
    for (range, text) in fields {
        for (i, row) in bytes.get(range.clone()).unwrap_or_default().chunks(ROW).enumerate() {
            let text = if i == 0 { text.as_str() } else { "" };
            lines.push(format!("{:width$} {text}", hex::spaced(row)).trim_end().to_owned());
        }
    }
    lines.join("\n")
}

fn fields(bytes: &[u8], frame: &Frame<'_>, role: Role, crc: bool) -> Vec<Field> {
    let code = match (role, frame.function().name()) {
        (Role::Request, Some(_)) => format!("function {} {}", frame.code, frame.function()),
        (Role::Request, None) => format!("unknown function {}", frame.code),
        (Role::Response, _) => format!("HRESULT {}", frame.hresult()),
    };
    let reserved = match frame.reserved {
        0 => "reserved".into(),
        first => format!("reserved: first sent as serial {first}"),
    };
    let count = frame.args.len();
    let mut fields = vec![
        (field::SOH, "SOH".into()),
        (field::LENGTH, format!("length {}", bytes.len())),
        (field::SERIAL, format!("serial {}", frame.serial)),
        (field::RESERVED, reserved),
        (field::CODE, code),
        (field::COUNT, if count == 1 { "1 argument".into() } else { format!("{count} arguments") }),
    ];
    let mut at = HEADER_LEN;
    for (i, argument) in arguments(bytes, frame, role).enumerate() {
        at = argument.value.end;
        fields.push((argument.length, format!("{} bytes of argument {}", argument.value.len(), i + 1)));
        fields.push((argument.value, argument.text));
    }
    if crc {
        fields.push((at..at + 2, "CRC".into()));
        at += 2;
    }
    fields.push((at..at + 1, "EOT".into()));
    fields
}

/// An argument: the positions of its length and its value, and its text.
struct ArgumentSpan {
    length: Range<usize>,
    value: Range<usize>,
    text: String,
}

fn arguments<'a>(bytes: &'a [u8], frame: &Frame<'a>, role: Role) -> impl Iterator<Item = ArgumentSpan> + use<'a> {
    let names = if role == Role::Request { frame.function().argument_names() } else { &[] };
    let mut at = HEADER_LEN;
    frame.args.iter().enumerate().map(move |(i, value)| {
        let declared = bytes.get(at..).and_then(<[u8]>::first_chunk).map_or(0, |length| u32::from_le_bytes(*length));
        let length = at..at + 4;
        at = length.end + usize::try_from(declared).unwrap_or(0);
        let name = names.get(i).map(|name| format!("{name}: ")).unwrap_or_default();
        ArgumentSpan { value: length.end..at, length, text: format!("{name}{value:?}") }
    })
}
