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
//! All fields are little-endian (S2:200-384). Only this file contains their offsets.

use core::ops::Range;

/// The first byte of every frame.
pub const SOH: u8 = 0x01;
/// Bytes before the arguments.
pub const HEADER_LEN: usize = 15;

/// The byte ranges of the fields.
mod field {
    use super::Range;

    pub(super) const SOH: usize = 0;
    pub(super) const LENGTH: Range<usize> = 1..5;
    pub(super) const SERIAL: Range<usize> = 5..7;
    pub(super) const RESERVED: Range<usize> = 7..9;
    pub(super) const CODE: Range<usize> = 9..13;
    pub(super) const COUNT: Range<usize> = 13..super::HEADER_LEN;
}

/// The offset of the length, for errors.
pub(crate) const LENGTH_AT: usize = field::LENGTH.start;
/// The offset of the number of arguments, for errors.
pub(crate) const COUNT_AT: usize = field::COUNT.start;

/// The fields of a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// The length of the whole frame, in bytes.
    pub(crate) length: u32,
    pub(crate) serial: u16,
    pub(crate) reserved: u16,
    /// The function number of a request, or the HRESULT of a reply.
    pub(crate) code: i32,
    /// The number of arguments.
    pub(crate) count: u16,
}

impl Header {
    /// Reads the header at the front of `bytes`; `None` while it is incomplete. SOH is not checked.
    #[inline]
    pub(crate) fn read(bytes: &[u8]) -> Option<Self> {
        bytes.first_chunk().map(Self::from_bytes)
    }

    #[inline]
    pub(crate) fn from_bytes(header: &[u8; HEADER_LEN]) -> Self {
        Self {
            length: u32::from_le_bytes(get(header, field::LENGTH)),
            serial: u16::from_le_bytes(get(header, field::SERIAL)),
            reserved: u16::from_le_bytes(get(header, field::RESERVED)),
            code: i32::from_le_bytes(get(header, field::CODE)),
            count: u16::from_le_bytes(get(header, field::COUNT)),
        }
    }

    /// Reads the length alone, which arrives before the rest of the header.
    #[inline]
    pub(crate) fn read_length(bytes: &[u8]) -> Option<u32> {
        let length = bytes.get(field::LENGTH)?.first_chunk()?;
        Some(u32::from_le_bytes(*length))
    }

    /// Returns the header's bytes.
    #[inline]
    pub(crate) fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        put(&mut bytes, field::SOH..LENGTH_AT, [SOH]);
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
    }

    #[test]
    fn a_frame_is_renumbered_in_place() {
        let mut frame = [0xa5; 17];
        Header::renumber(&mut frame, 0x0102, 0x0304);
        assert_eq!(frame[..10], [0xa5, 0xa5, 0xa5, 0xa5, 0xa5, 0x02, 0x01, 0x04, 0x03, 0xa5]);
        assert_eq!(frame[10..], [0xa5; 7]);
    }
}
