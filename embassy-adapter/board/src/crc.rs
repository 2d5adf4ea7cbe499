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
    pub fn and(self, bytes: &[u8]) -> Self {
        // bit by bit: a table costs 1 KiB of flash and saves less than a millisecond
        let bit = |crc: u32, _| if crc & 1 == 0 { crc >> 1 } else { crc >> 1 ^ POLYNOMIAL };
        Self(bytes.iter().fold(self.0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), bit)))
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
