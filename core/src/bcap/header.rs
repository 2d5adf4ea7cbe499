//! The header of a frame: the 15 bytes before its arguments.
//!
//! ```text
//!  offset  size  field
//!       0     1  SOH 0x01
//!       1     4  length of the whole frame, SOH to EOT
//!       5     2  serial number; a reply repeats its request's
//!       7     2  reserved; on UDP and serial lines the serial of a call's first attempt
//!       9     4  request: function number; reply: HRESULT
//!      13     2  number of arguments
//! ```
//!
//! All fields are little-endian. Source: b-CAP guide for RC8, "Packet format" (b-CAP specification, sections 4.1.1 to
//! 4.1.5). Only this file contains their offsets, apart from bcap-testkit, whose decoder is independent. The decoder, the frame
//! writer, the client, the server and tools that show or damage single fields use [`Header`] and [`field`].
//!
//! # Examples
//!
//! ```
//! use bcap_core::bcap::FunctionId;
//! use bcap_core::bcap::header::{Header, field};
//!
//! let mut frame = *b"\x01\x10\0\0\0\x04\0\0\0\x02\0\0\0\0\0\x04";
//! let header = Header::read(&frame).ok_or("less than a header")?;
//! assert_eq!((header.length, header.serial), (16, 4));
//! assert_eq!(header.function(), FunctionId::SERVICE_STOP);
//!
//! // an invalid length, for a test
//! frame[field::LENGTH].copy_from_slice(&15_u32.to_le_bytes());
//! assert_eq!(Header::read_length(&frame), Some(15));
//! # Ok::<(), &str>(())
//! ```

use core::ops::Range;

use crate::bcap::function::FunctionId;
use crate::hresult::HResult;

/// The first byte of every frame.
pub const SOH: u8 = 0x01;
/// Bytes before the arguments.
pub const HEADER_LEN: usize = field::COUNT.end;

/// The byte ranges of the fields, in ascending order and without gaps.
pub mod field {
    use core::ops::Range;

    /// [`SOH`](super::SOH).
    pub const SOH: Range<usize> = 0..1;
    /// The length of the whole frame.
    pub const LENGTH: Range<usize> = 1..5;
    /// The serial number.
    pub const SERIAL: Range<usize> = 5..7;
    /// The reserved field: on links that repeat calls, the serial number of the first attempt.
    pub const RESERVED: Range<usize> = 7..9;
    /// The function of a request, or the HRESULT of a reply.
    pub const CODE: Range<usize> = 9..13;
    /// The number of arguments.
    pub const COUNT: Range<usize> = 13..15;
}

/// The offset of the length, for errors.
pub(crate) const LENGTH_AT: usize = field::LENGTH.start;
/// The offset of the number of arguments, for errors.
pub(crate) const COUNT_AT: usize = field::COUNT.start;

/// The fields of a header, not checked: any 15 bytes are a header.
///
/// [`Decoder`](crate::bcap::Decoder) checks whole frames. A header is for code that needs a field before the rest of the frame
/// has arrived, or of a frame that is damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// The length of the whole frame, in bytes.
    pub length: u32,
    /// The serial number; a reply repeats its request's.
    pub serial: u16,
    /// On UDP and serial lines the serial number of a call's first attempt; otherwise 0.
    pub reserved: u16,
    /// The function number of a request, or the HRESULT of a reply.
    pub code: i32,
    /// The number of arguments.
    pub count: u16,
}

impl Header {
    /// Reads the header at the front of `bytes`; `None` while it is incomplete. SOH is not checked.
    #[inline]
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Self> {
        bytes.first_chunk().map(Self::from_bytes)
    }

    /// Reads a header. SOH is not checked.
    #[inline]
    #[must_use]
    pub fn from_bytes(header: &[u8; HEADER_LEN]) -> Self {
        Self {
            length: u32::from_le_bytes(get(header, field::LENGTH)),
            serial: u16::from_le_bytes(get(header, field::SERIAL)),
            reserved: u16::from_le_bytes(get(header, field::RESERVED)),
            code: i32::from_le_bytes(get(header, field::CODE)),
            count: u16::from_le_bytes(get(header, field::COUNT)),
        }
    }

    /// Reads the length alone, which arrives before the rest of the header; `None` while it is incomplete.
    #[inline]
    #[must_use]
    pub fn read_length(bytes: &[u8]) -> Option<u32> {
        let length = bytes.get(field::LENGTH)?.first_chunk()?;
        Some(u32::from_le_bytes(*length))
    }

    /// Returns the function of a request.
    #[inline]
    #[must_use]
    pub const fn function(&self) -> FunctionId {
        FunctionId(self.code)
    }

    /// Returns the HRESULT of a reply.
    #[inline]
    #[must_use]
    pub const fn hresult(&self) -> HResult {
        HResult(self.code)
    }

    /// Returns the header's bytes, with SOH.
    #[inline]
    #[must_use]
    pub fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        put(&mut bytes, field::SOH, [SOH]);
        put(&mut bytes, field::LENGTH, self.length.to_le_bytes());
        put(&mut bytes, field::SERIAL, self.serial.to_le_bytes());
        put(&mut bytes, field::RESERVED, self.reserved.to_le_bytes());
        put(&mut bytes, field::CODE, self.code.to_le_bytes());
        put(&mut bytes, field::COUNT, self.count.to_le_bytes());
        bytes
    }

    /// Changes serial and reserved field of a finished frame.
    #[inline]
    pub(crate) fn renumber(frame: &mut [u8], serial: u16, reserved: u16) {
        if let Some(header) = frame.first_chunk_mut::<HEADER_LEN>() {
            put(header, field::SERIAL, serial.to_le_bytes());
            put(header, field::RESERVED, reserved.to_le_bytes());
        }
    }
}

// the ranges are constants within the array, so the compiler removes the fallbacks
#[inline(always)]
fn get<const N: usize>(header: &[u8; HEADER_LEN], field: Range<usize>) -> [u8; N] {
    header.get(field).and_then(<[u8]>::first_chunk).copied().unwrap_or([0; N])
}

#[inline(always)]
fn put<const N: usize>(header: &mut [u8; HEADER_LEN], field: Range<usize>, value: [u8; N]) {
    if let Some(bytes) = header.get_mut(field).and_then(<[u8]>::first_chunk_mut) {
        *bytes = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_of_a_header_belongs_to_one_field() {
        let bytes = [SOH, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        let header = Header::read(&bytes).unwrap();
        let expected =
            Header { length: 0x0504_0302, serial: 0x0706, reserved: 0x0908, code: 0x0d0c_0b0a, count: 0x0f0e };
        assert_eq!(header, expected);
        assert_eq!(header.to_bytes(), bytes);
        assert_eq!(Header::read_length(&bytes[..5]), Some(0x0504_0302));
        assert_eq!((Header::read_length(&bytes[..4]), Header::read(&bytes[..14])), (None, None));
        let fields = [field::SOH, field::LENGTH, field::SERIAL, field::RESERVED, field::CODE, field::COUNT];
        assert!(fields.into_iter().flatten().eq(0..HEADER_LEN));
    }

    #[test]
    fn a_frame_is_renumbered_in_place() {
        let mut frame = [0xa5; 17];
        Header::renumber(&mut frame, 0x0102, 0x0304);
        assert_eq!(frame[..10], [0xa5, 0xa5, 0xa5, 0xa5, 0xa5, 0x02, 0x01, 0x04, 0x03, 0xa5]);
        assert_eq!(frame[10..], [0xa5; 7]);
    }
}
