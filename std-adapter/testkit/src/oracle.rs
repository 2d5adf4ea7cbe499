//! The oracle of the binary format: a simple recursive, allocating decoder that the core is compared with.
//!
//! It returns the decoded value or rejects the bytes; it does not report the error. Unlike the core, it rejects a frame with more than
//! 262,144 elements of EMPTY and NULL, because each of them takes memory here and no bytes there.

use bcap_core::limits::{Limits, Strictness};

use crate::frame::{TestFrame, bitwise_crc, field};
use crate::value::{ARRAY, VARIANT, Value};

/// The rules to decode by.
#[derive(Clone, Copy, Debug)]
pub struct Oracle {
    /// The limits of accepted frames.
    pub limits: Limits,
    /// How strictly to decode.
    pub strictness: Strictness,
    /// Whether frames carry a CRC.
    pub crc: bool,
}

/// The oracle's verdict on the start of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// A frame, and its length.
    Frame(TestFrame, usize),
    /// A valid but incomplete frame.
    Incomplete,
    /// The bytes do not begin a valid frame.
    Refused,
}

/// The maximum number of array elements of EMPTY and NULL in a frame. A frame of up to 6 KiB cannot exceed it.
const MAX_EMPTY: u64 = 1 << 18;

/// The rest of the input.
type Input<'a> = &'a [u8];

fn take<'a>(input: &mut Input<'a>, len: usize) -> Option<&'a [u8]> {
    if len > input.len() {
        return None;
    }
    let (head, rest) = input.split_at(len);
    *input = rest;
    Some(head)
}

fn le(input: &mut Input<'_>, len: usize) -> Option<u64> {
    Some(take(input, len)?.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
}

impl Oracle {
    /// Decodes bytes that are exactly one frame.
    #[must_use]
    pub fn decode_packet(&self, bytes: &[u8]) -> Option<TestFrame> {
        match self.decode(bytes) {
            Verdict::Frame(frame, length) if length == bytes.len() => Some(frame),
            _ => None,
        }
    }

    /// Decodes the frame at the front of a stream.
    #[must_use]
    pub fn decode(&self, bytes: &[u8]) -> Verdict {
        if bytes.is_empty() {
            return Verdict::Incomplete;
        }
        if bytes[0] != 1 {
            return Verdict::Refused;
        }
        let Some(length) = field::length(bytes) else { return Verdict::Incomplete };
        if length < if self.crc { 18 } else { 16 } || length > self.limits.frame {
            return Verdict::Refused;
        }
        if bytes.len() < length as usize {
            return Verdict::Incomplete;
        }
        match self.whole(&bytes[..length as usize]) {
            Some(frame) => Verdict::Frame(frame, length as usize),
            None => Verdict::Refused,
        }
    }

    /// Decodes a frame whose length is right.
    fn whole(&self, bytes: &[u8]) -> Option<TestFrame> {
        let (eot, mut rest) = bytes[1..].split_last()?;
        if *eot != 4 {
            return None;
        }
        if self.crc {
            let (covered, crc) = rest.split_at(rest.len() - 2);
            if crc != bitwise_crc(covered).to_le_bytes() {
                return None;
            }
            rest = covered;
        }
        le(&mut rest, 4)?;
        let (serial, reserved) = (le(&mut rest, 2)? as u16, le(&mut rest, 2)? as u16);
        let (code, count) = (le(&mut rest, 4)? as u32 as i32, le(&mut rest, 2)?);
        if count > u64::from(self.limits.arguments) {
            return None;
        }
        let mut empty = MAX_EMPTY;
        let args = (0..count).map(|_| self.argument(&mut rest, &mut empty)).collect::<Option<Vec<_>>>()?;
        if self.strictness == Strictness::Strict && !rest.is_empty() {
            return None;
        }
        Some(TestFrame { serial, reserved, code, args })
    }

    /// Decodes an argument; `empty` is the number of elements without data that the frame may still have.
    fn argument(&self, input: &mut Input<'_>, empty: &mut u64) -> Option<Value> {
        let declared = le(input, 4)? as usize;
        if self.strictness == Strictness::Strict {
            let mut value = take(input, declared)?;
            let decoded = self.value(&mut value, empty)?;
            return value.is_empty().then_some(decoded);
        }
        // a value of unknown type takes the length of its argument, any other value its actual length
        let mut ahead = *input;
        let vartype = le(&mut ahead, 2)? as u16;
        if width(vartype & !ARRAY).is_none() {
            if declared < 6 {
                return None;
            }
            let bytes = take(input, declared)?[2..].to_vec();
            return Some(Value::Opaque(vartype, bytes));
        }
        self.value(input, empty)
    }

    /// Decodes bytes that should be one value.
    #[must_use]
    pub fn decode_value(&self, mut bytes: &[u8]) -> Option<Value> {
        let mut empty = MAX_EMPTY;
        let value = self.value(&mut bytes, &mut empty)?;
        (bytes.is_empty() || self.strictness == Strictness::Lenient).then_some(value)
    }

    fn value(&self, input: &mut Input<'_>, empty: &mut u64) -> Option<Value> {
        self.nested(input, usize::from(self.limits.depth.min(bcap_core::limits::MAX_DEPTH)), empty)
    }

    fn nested(&self, input: &mut Input<'_>, depth: usize, empty: &mut u64) -> Option<Value> {
        let (vartype, count) = (le(input, 2)? as u16, le(input, 4)?);
        let element = vartype & !ARRAY;
        if vartype & ARRAY == 0 {
            if self.strictness == Strictness::Strict && count != 1 {
                return None;
            }
            return self.element(element, input, depth, empty);
        }
        // elements without data could be claimed by the billion
        if width(element)? == 0 {
            if count > 256 {
                return None;
            }
            *empty = empty.checked_sub(count)?;
        }
        let mut items = Vec::new();
        for _ in 0..count {
            items.push(match element {
                VARIANT => self.nested(input, depth.checked_sub(1)?, empty)?,
                _ => self.element(element, input, depth, empty)?,
            });
        }
        Some(Value::Array(element, items))
    }

    fn element(&self, element: u16, input: &mut Input<'_>, depth: usize, empty: &mut u64) -> Option<Value> {
        Some(match element {
            0 => Value::Empty,
            1 => Value::Null,
            2 => Value::I2(le(input, 2)? as i16),
            3 => Value::I4(le(input, 4)? as i32),
            4 => Value::R4(le(input, 4)? as u32),
            5 => Value::R8(le(input, 8)?),
            6 => Value::Cy(le(input, 8)? as i64),
            7 => Value::Date(le(input, 8)?),
            8 => self.bstr(input)?,
            10 => Value::Error(le(input, 4)? as i32),
            11 => Value::Bool(le(input, 2)? != 0),
            VARIANT => Value::Nested(Box::new(self.nested(input, depth.checked_sub(1)?, empty)?)),
            17 => Value::Ui1(le(input, 1)? as u8),
            18 => Value::Ui2(le(input, 2)? as u16),
            19 => Value::Ui4(le(input, 4)? as u32),
            20 => Value::I8(le(input, 8)? as i64),
            21 => Value::Ui8(le(input, 8)?),
            _ => return None,
        })
    }

    fn bstr(&self, input: &mut Input<'_>) -> Option<Value> {
        let length = le(input, 4)? as usize;
        if self.strictness == Strictness::Strict && length % 2 == 1 {
            return None;
        }
        let units = take(input, length)?.chunks_exact(2).map(|unit| u16::from_le_bytes([unit[0], unit[1]])).collect();
        Some(Value::Bstr(units))
    }
}

/// Returns the minimum number of bytes of an element; `None` for types that the wire cannot carry.
fn width(element: u16) -> Option<usize> {
    Some(match element {
        0 | 1 => 0,
        17 => 1,
        2 | 11 | 18 => 2,
        3 | 4 | 8 | 10 | 19 => 4,
        5 | 6 | 7 | 20 | 21 => 8,
        VARIANT => 6,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decodes a frame with one argument for each count: an array of this number of arrays of 256 EMPTY.
    fn is_accepted(strictness: Strictness, counts: &[u32]) -> bool {
        let argument = |count: &u32| {
            let mut bytes = count.to_le_bytes().to_vec();
            bytes.extend([0_u8, 0x20, 0, 1, 0, 0].repeat(*count as usize));
            Value::Opaque(ARRAY | VARIANT, bytes)
        };
        let args = counts.iter().map(argument).collect();
        let bytes = TestFrame { serial: 1, reserved: 0, code: 0, args }.to_wire(false);
        Oracle { limits: Limits::STREAM, strictness, crc: false }.decode_packet(&bytes).is_some()
    }

    #[test]
    fn a_frame_with_too_many_elements_without_data_is_rejected() {
        for strictness in [Strictness::Strict, Strictness::Lenient] {
            assert!(is_accepted(strictness, &[1024]) && is_accepted(strictness, &[512, 512]));
            assert!(!is_accepted(strictness, &[1025]) && !is_accepted(strictness, &[512, 513]));
            // 64 KiB
            assert!(!is_accepted(strictness, &[10_900]));
        }
    }
}
