//! Limits of decoders, which apply before data are buffered, and their strictness.

/// The limits of a decoder.
///
/// Lengths and counts that a peer announces are compared with them before any announced byte is stored or awaited.
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

/// The deepest nesting of VARIANTs that any [`Limits`] can allow; it limits the memory of every walk over a value.
pub const MAX_DEPTH: u8 = 16;

/// The largest datagram to send: the safe limit of the b-CAP Tester and the provider (b-CAP specification, Table 6-1).
pub const UDP_SEND_MAX: usize = 488;

/// The largest datagram to accept: 488 bytes of data and the framing, the largest that a known peer sends.
pub const UDP_RECEIVE_MAX: usize = 504;

/// The largest frame on a serial line, with its CRC.
pub const SERIAL_MAX: usize = 503;

impl Limits {
    /// The specification's bound: frames of up to 16 MiB (RAC specification, Table 2-3).
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

/// The strictness of a decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Strictness {
    /// All lengths and counts must agree.
    #[default]
    Strict,
    /// Accepts known deviations of real peers: unused bytes, a scalar's count other than 1, an argument length
    /// that disagrees with its value, an odd BSTR length, a VARTYPE that only its argument length can skip.
    ///
    /// It decodes everything that [`Strict`](Self::Strict) accepts to the same value.
    Lenient,
}
