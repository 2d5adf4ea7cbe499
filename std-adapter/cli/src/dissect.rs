//! A frame taken apart: every field beside its offset and its bytes.
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

use bcap_core::bcap::{Frame, HEADER_LEN};

use crate::frame::Role;
use crate::hex;

/// Bytes of a row; a longer field goes on in the next.
const ROW: usize = 16;

/// Writes the fields of a strictly checked frame, one a row; `bytes` are those that it was decoded from.
pub(crate) fn dissect(bytes: &[u8], frame: &Frame<'_>, role: Role, crc: bool) -> String {
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

type Field = (std::ops::Range<usize>, String);

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
        (0..1, "SOH".into()),
        (1..5, format!("length {}", bytes.len())),
        (5..7, format!("serial {}", frame.serial)),
        (7..9, reserved),
        (9..13, code),
        (13..15, if count == 1 { "1 argument".into() } else { format!("{count} arguments") }),
    ];
    let names = if role == Role::Request { frame.function().argument_names() } else { &[] };
    let mut at = HEADER_LEN;
    for (i, value) in frame.args.iter().enumerate() {
        let length = bytes.get(at..).and_then(<[u8]>::first_chunk).map_or(0, |length| u32::from_le_bytes(*length));
        let end = at + 4 + usize::try_from(length).unwrap_or(0);
        fields.push((at..at + 4, format!("{length} bytes of argument {}", i + 1)));
        let name = names.get(i).map(|name| format!("{name}: ")).unwrap_or_default();
        fields.push((at + 4..end, format!("{name}{value:?}")));
        at = end;
    }
    if crc {
        fields.push((at..at + 2, "CRC".into()));
        at += 2;
    }
    fields.push((at..at + 1, "EOT".into()));
    fields
}
