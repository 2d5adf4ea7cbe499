//! An owned frame for tests, with an encoder that shares no code with the core.

use bcap_core::bcap::Frame;
use bcap_core::hresult::HResult;

use crate::value::Value;

/// The offsets of a frame (b-CAP specification, sections 4.1.1 to 4.1.5): the only description of the layout that the judge uses, apart from the decoder.
pub mod field {
    use std::ops::Range;

    /// The length of the whole frame.
    pub const LENGTH: Range<usize> = 1..5;
    /// The serial number.
    pub const SERIAL: Range<usize> = 5..7;
    /// The reserved field: on links that repeat calls, the serial of the first attempt.
    pub const RESERVED: Range<usize> = 7..9;
    /// The function or the HRESULT.
    pub const CODE: Range<usize> = 9..13;
    /// The number of arguments.
    pub const COUNT: Range<usize> = 13..15;
    /// The length of the first argument.
    pub const ARGUMENT: Range<usize> = 15..19;
    /// The VARTYPE of the first argument.
    pub const VARTYPE: Range<usize> = 19..21;
    /// The number of elements of the first argument.
    pub const ELEMENTS: Range<usize> = 21..25;
    /// The data of the first argument; of a BSTR, its length.
    pub const DATA: Range<usize> = 25..29;

    /// Reads the length field.
    #[must_use]
    pub fn length(bytes: &[u8]) -> Option<u32> {
        bytes.get(LENGTH)?.try_into().ok().map(u32::from_le_bytes)
    }

    /// Reads the serial number.
    #[must_use]
    pub fn serial(bytes: &[u8]) -> Option<u16> {
        bytes.get(SERIAL)?.try_into().ok().map(u16::from_le_bytes)
    }

    /// Reads the function or the HRESULT.
    #[must_use]
    pub fn code(bytes: &[u8]) -> Option<i32> {
        bytes.get(CODE)?.try_into().ok().map(i32::from_le_bytes)
    }
}

/// A frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TestFrame {
    /// The serial number.
    pub serial: u16,
    /// The reserved field.
    pub reserved: u16,
    /// The function or the HRESULT.
    pub code: i32,
    /// The arguments.
    pub args: Vec<Value>,
}

impl TestFrame {
    /// Returns the canonical encoding, with a CRC for serial lines.
    #[must_use]
    pub fn to_wire(&self, crc: bool) -> Vec<u8> {
        let args: Vec<Vec<u8>> = self.args.iter().map(Value::to_wire).collect();
        let length = 16 + if crc { 2 } else { 0 } + args.iter().map(|arg| 4 + arg.len()).sum::<usize>();
        let mut wire = vec![1];
        wire.extend((length as u32).to_le_bytes());
        wire.extend(self.serial.to_le_bytes());
        wire.extend(self.reserved.to_le_bytes());
        wire.extend(self.code.to_le_bytes());
        wire.extend((args.len() as u16).to_le_bytes());
        for arg in args {
            wire.extend((arg.len() as u32).to_le_bytes());
            wire.extend(arg);
        }
        if crc {
            wire.extend(bitwise_crc(&wire[1..]).to_le_bytes());
        }
        wire.push(4);
        wire
    }

    /// Returns the HRESULT of a reply.
    #[must_use]
    pub const fn result(&self) -> HResult {
        HResult(self.code)
    }

    /// Returns the value of a reply.
    #[must_use]
    pub fn value(&self) -> Option<&Value> {
        self.args.first()
    }

    /// Returns a reply in one line, such as `#4 0x00000000 (S_OK): I4(3)`.
    #[must_use]
    pub fn text(&self) -> String {
        let args = self.args.iter().map(Value::short).collect::<Vec<_>>().join(", ");
        let separator = if self.args.is_empty() { "" } else { ": " };
        let reserved = if self.reserved == 0 { String::new() } else { format!(" (reserved field {})", self.reserved) };
        format!("#{} {}{separator}{args}{reserved}", self.serial, self.result())
    }

    /// Copies a value that the core decoded, through its public accessors.
    #[must_use]
    pub fn read(frame: &Frame<'_>) -> Self {
        let args = frame.args.iter().map(Value::read).collect();
        Self { serial: frame.serial, reserved: frame.reserved, code: frame.code, args }
    }
}

/// CRC-16 with polynomial 0x1021 and start 0xffff, a bit at a time.
#[must_use]
pub fn bitwise_crc(bytes: &[u8]) -> u16 {
    let mut crc = 0xffff_u16;
    for byte in bytes {
        crc ^= u16::from(*byte) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 };
        }
    }
    crc
}
