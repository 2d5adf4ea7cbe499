//! What can be wrong with bytes, and with a value that should become bytes.
//!
//! | error           | whose fault             | raised by                                         |
//! |-----------------|-------------------------|---------------------------------------------------|
//! | [`DecodeError`] | the peer's              | `Decoder::decode`, `Variant::decode`              |
//! | [`EncodeError`] | the caller's            | `Encode`, `FrameWriter`                           |
//! | `TextError`     | whoever wrote the text  | `VariantBuf::parse_text`, the RAC lines           |
//!
//! All are small, `Copy` and `Eq`; they name the place (`offset` counts from the first byte of what was decoded).

use core::fmt;

use crate::hresult::HResult;

/// The bytes are not what the specification says; where, and in which layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DecodeError {
    /// What is wrong.
    pub kind: DecodeErrorKind,
    /// Which part of the frame it is in.
    pub layer: Layer,
    /// The byte at which it was found, from the start of the frame (of the value, for [`Layer::Value`]).
    pub offset: usize,
}

/// The part of a frame that an error is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Layer {
    /// Header, length, terminator or CRC.
    Frame,
    /// The argument with this number, counted from 1.
    Argument(u16),
    /// A VARIANT decoded by itself.
    Value,
}

/// What is wrong with the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeErrorKind {
    /// The first byte is not SOH (0x01).
    Soh(u8),
    /// The length field is below the least frame (16 bytes, 18 with a CRC).
    FrameTooShort(u32),
    /// The length field is over the limit.
    FrameTooLong {
        /// What the length field says.
        length: u32,
        /// What is allowed.
        limit: u32,
    },
    /// The last byte is not EOT (0x04).
    Eot(u8),
    /// The CRC of a serial frame does not match.
    Crc {
        /// The CRC that the frame carries.
        found: u16,
        /// The CRC of its bytes.
        computed: u16,
    },
    /// The input ends inside a frame that was to be whole (a datagram, a file).
    Incomplete {
        /// How many bytes the frame has.
        needed: u32,
    },
    /// The frame has more arguments than the limit.
    TooManyArguments {
        /// What the frame says.
        count: u16,
        /// What is allowed.
        limit: u16,
    },
    /// An argument's length field disagrees with its value.
    ArgumentLength {
        /// What the length field says.
        declared: u32,
        /// What the value takes.
        used: u32,
    },
    /// Bytes are left over behind the last argument or value.
    Unused(u32),
    /// The value ends before its data do.
    Truncated {
        /// How many more bytes this field takes.
        needed: u32,
        /// How many are there.
        left: u32,
    },
    /// The VARTYPE is none that the wire can carry.
    UnknownType(u16),
    /// A scalar's element count is not 1.
    ScalarCount(u32),
    /// An array claims more elements than the remaining bytes, or the limit for elements without data, can hold.
    ArrayCount(u32),
    /// A BSTR's byte length is odd.
    OddBstr(u32),
    /// VARIANTs are nested deeper than the limit.
    TooDeep(u8),
}

impl DecodeError {
    pub(crate) const fn frame(kind: DecodeErrorKind, offset: usize) -> Self {
        Self { kind, layer: Layer::Frame, offset }
    }

    /// Returns the code with which a server answers bytes like these (S0:169-177).
    #[must_use]
    pub const fn hresult(&self) -> HResult {
        match (self.kind, self.layer) {
            (DecodeErrorKind::FrameTooLong { .. }, _) => HResult::E_PACKETSIZEOVER,
            _ => HResult::E_INVALIDRCPACKET,
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at byte {}", self.kind, self.offset)?;
        match self.layer {
            Layer::Frame | Layer::Value => Ok(()),
            Layer::Argument(n) => write!(f, " (argument {n})"),
        }
    }
}

impl fmt::Display for DecodeErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Soh(found) => write!(f, "a frame starts with 0x01, found 0x{found:02x}"),
            Self::FrameTooShort(length) => write!(f, "frame length {length} is below the least frame"),
            Self::FrameTooLong { length, limit } => write!(f, "frame length {length} is over the limit of {limit}"),
            Self::Eot(found) => write!(f, "a frame ends with 0x04, found 0x{found:02x}"),
            Self::Crc { found, computed } => write!(f, "CRC is 0x{found:04x}, the bytes give 0x{computed:04x}"),
            Self::Incomplete { needed } => write!(f, "the input ends inside a frame of {needed} bytes"),
            Self::TooManyArguments { count, limit } => write!(f, "{count} arguments are over the limit of {limit}"),
            Self::ArgumentLength { declared, used } => {
                write!(f, "argument length {declared} disagrees with its value of {used} bytes")
            }
            Self::Unused(1) => write!(f, "1 unused byte"),
            Self::Unused(count) => write!(f, "{count} unused bytes"),
            Self::Truncated { needed, left } => write!(f, "truncated: {needed} bytes needed, {left} left"),
            Self::UnknownType(vartype) => write!(f, "unknown VARTYPE 0x{vartype:04x}"),
            Self::ScalarCount(count) => write!(f, "a scalar has the count 1, found {count}"),
            Self::ArrayCount(count) => write!(f, "array count {count} is more than can be there"),
            Self::OddBstr(length) => write!(f, "BSTR byte length {length} is odd"),
            Self::TooDeep(limit) => write!(f, "VARIANTs are nested deeper than {limit}"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// A value or a frame cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum EncodeError {
    /// It does not fit the buffer, or the link's largest frame; give more room or send less.
    Full,
    /// VARIANTs are nested deeper than [`MAX_DEPTH`](crate::limits::MAX_DEPTH).
    TooDeep,
    /// The value's VARTYPE cannot be sent.
    Unsendable(u16),
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full => f.write_str("the value does not fit the buffer"),
            Self::TooDeep => f.write_str("VARIANTs are nested too deep"),
            Self::Unsendable(vartype) => write!(f, "a value of VARTYPE 0x{vartype:04x} cannot be sent"),
        }
    }
}

impl core::error::Error for EncodeError {}
