//! The CRC-32 of Ethernet and zip files.

/// The polynomial, with its bits reversed.
const POLYNOMIAL: u32 = 0xedb8_8320;

/// A CRC-32 over bytes that arrive in parts.
///
/// # Examples
///
/// ```
/// use bcap_board::crc::Crc32;
///
/// assert_eq!(Crc32::new().and(b"1234").and(b"56789").value(), 0xcbf4_3926);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Crc32(u32);

impl Crc32 {
    /// The CRC of no bytes.
    #[must_use]
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Adds bytes.
    #[must_use]
    pub const fn and(self, mut bytes: &[u8]) -> Self {
        // bit by bit: a table costs 1 KiB of flash and saves less than a millisecond
        let Self(mut crc) = self;
        while let Some((byte, rest)) = bytes.split_first() {
            bytes = rest;
            // `u32::from` is not const
            crc ^= u32::from_le_bytes([*byte, 0, 0, 0]);
            let mut bit = 0;
            while bit < 8 {
                crc = if crc & 1 == 0 { crc >> 1 } else { crc >> 1 ^ POLYNOMIAL };
                bit += 1;
            }
        }
        Self(crc)
    }

    /// Returns the CRC of the bytes so far.
    #[must_use]
    pub const fn value(self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}
