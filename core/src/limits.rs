//! The bounds that a decoder holds before anything is buffered, and how forgiving it is.

/// What a decoder accepts at most.
///
/// A field is compared with what the peer *claims*, before a byte of the claimed data is stored or waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Limits {
    /// Bytes of a whole frame, SOH to EOT.
    pub frame: u32,
    /// Arguments of a frame.
    pub arguments: u16,
    /// VARIANTs inside VARIANTs: 0 refuses any nesting, 1 takes an array of scalars; at most [`MAX_DEPTH`].
    pub depth: u8,
}

/// The deepest nesting of VARIANTs that any [`Limits`] can allow; it bounds the stack of every walk over a value.
pub const MAX_DEPTH: u8 = 16;

/// The largest datagram that is sent: the safe limit of the b-CAP Tester and the provider (S2:1487).
pub const UDP_SEND_MAX: usize = 488;

/// The largest datagram that is accepted; 488 bytes of data plus framing, as the widest of the known peers sends.
pub const UDP_RECEIVE_MAX: usize = 504;

/// The largest frame on a serial line, CRC included.
pub const SERIAL_MAX: usize = 503;

impl Limits {
    /// The specification's bound: frames of up to 16 MiB (S0:176).
    pub const STREAM: Self = Self { frame: 16 * 1024 * 1024, arguments: 64, depth: 8 };
    /// One datagram.
    pub const DATAGRAM: Self = Self { frame: 504, ..Self::STREAM };
    /// One frame of a serial line.
    pub const SERIAL: Self = Self { frame: 503, ..Self::STREAM };
}

impl Default for Limits {
    fn default() -> Self {
        Self::STREAM
    }
}

/// How much a decoder forgives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Strictness {
    /// Every length and count must agree with every other.
    #[default]
    Strict,
    /// Tolerates what peers in the field leave behind: unused bytes, a scalar's count other than 1, an argument length
    /// that disagrees with its value, an odd BSTR length, a VARTYPE that only its argument length can skip.
    ///
    /// Whatever [`Strict`](Self::Strict) accepts is accepted alike, with the same value.
    Lenient,
}
