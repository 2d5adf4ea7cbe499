//! Errors of decoding, encoding and parsing.
//!
//! | error           | whose fault             | raised by                                         |
//! |-----------------|-------------------------|---------------------------------------------------|
//! | [`DecodeError`] | the peer's              | `Decoder::decode`, `Variant::decode`              |
//! | [`EncodeError`] | the caller's            | `Encode`, `FrameWriter`                           |
//! | [`TextError`]   | the author of the text  | `VariantBuf::parse_text`, the RAC lines           |
//! |                 | the caller's            | `Variant::write_text`: the value has no text      |
//!
//! All are small, `Copy` and `Eq`. They contain the position: `offset` counts from the first decoded byte.

use core::fmt;

use crate::hresult::HResult;

/// Received bytes violate the specification, with the layer and the offset of the violation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct DecodeError {
    /// The kind of error.
    pub kind: DecodeErrorKind,
    /// The part of the frame that is invalid.
    pub layer: Layer,
    /// Offset of the invalid byte from the start of the frame (of the value, for [`Layer::Value`]).
    pub offset: usize,
}

/// A part of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Layer {
    /// Header, length, terminator or CRC.
    Frame,
    /// The argument with this number, counted from 1.
    Argument(u16),
    /// A VARIANT decoded by itself.
    Value,
}

/// The violation of the specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeErrorKind {
    /// The first byte is not SOH (0x01).
    Soh(u8),
    /// The length field is below the shortest frame (16 bytes, 18 with a CRC).
    FrameTooShort(u32),
    /// The length field is over the limit.
    FrameTooLong {
        /// The length field.
        length: u32,
        /// The limit.
        limit: u32,
    },
    /// The last byte is not EOT (0x04).
    Eot(u8),
    /// The CRC of a serial frame does not match.
    Crc {
        /// The CRC in the frame.
        found: u16,
        /// The CRC computed from its bytes.
        computed: u16,
    },
    /// The input ends inside a frame that must be complete (a datagram, a file).
    Incomplete {
        /// The length of the frame in bytes.
        needed: u32,
    },
    /// The frame has more arguments than the limit.
    TooManyArguments {
        /// The number in the header.
        count: u16,
        /// The limit.
        limit: u16,
    },
    /// An argument's length field disagrees with its value.
    ArgumentLength {
        /// The length field.
        declared: u32,
        /// The length of its value.
        used: u32,
    },
    /// Bytes are left after the last argument or value.
    Unused(u32),
    /// The input ends inside a value.
    Truncated {
        /// The length of the field in bytes.
        needed: u32,
        /// The number of bytes left.
        left: u32,
    },
    /// The VARTYPE is unknown.
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

    /// Returns the code of a server's reply to such bytes (RAC specification, Table 2-3).
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
            Self::FrameTooShort(length) => write!(f, "frame length {length} is below the shortest frame"),
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
            Self::ArrayCount(count) => write!(f, "array count {count} is above what the remaining bytes can hold"),
            Self::OddBstr(length) => write!(f, "BSTR byte length {length} is odd"),
            Self::TooDeep(limit) => write!(f, "VARIANTs are nested deeper than {limit}"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// A value or a frame cannot be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum EncodeError {
    /// It does not fit the buffer or the link's largest frame.
    Full,
    /// VARIANTs are nested deeper than [`MAX_DEPTH`](crate::limits::MAX_DEPTH).
    TooDeep,
    /// The value's VARTYPE cannot be sent.
    Unsendable(u16),
    /// The number or date is out of the range of its VARTYPE.
    OutOfRange(u16),
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full => f.write_str("the value does not fit the buffer"),
            Self::TooDeep => f.write_str("VARIANTs are nested too deep"),
            Self::Unsendable(vartype) => write!(f, "a value of VARTYPE 0x{vartype:04x} cannot be sent"),
            Self::OutOfRange(vartype) => {
                write!(f, "a number is not finite, or a value is out of the range of VARTYPE 0x{vartype:04x}")
            }
        }
    }
}

impl core::error::Error for EncodeError {}

/// A text is invalid, with the column, or a value has no text.
///
/// # Examples
///
/// ```
/// use bcap_core::error::TextErrorKind;
/// use bcap_core::variant::VariantBuf;
///
/// let error = VariantBuf::<32>::parse_text(b"8194,1,x").unwrap_err();
/// assert_eq!((error.kind, error.column), (TextErrorKind::Digit, 8));
/// assert_eq!(error.to_string(), "not a digit of the number at column 8");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct TextError {
    /// The kind of error.
    pub kind: TextErrorKind,
    /// The first invalid byte, counted from 1; 0 for a value without text.
    pub column: u32,
}

/// The reason why a text is invalid, or why a value has no text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum TextErrorKind {
    /// The VARTYPE of a value is not a decimal number.
    Type,
    /// The VARTYPE is unknown; a number above 16 bits is reported as 65535.
    UnknownType(u16),
    /// There is no comma after a VARTYPE.
    Comma,
    /// A number or date is missing.
    Missing,
    /// A character in a number is not a digit.
    Digit,
    /// There is a blank after a number.
    BlankBehind,
    /// The number does not fit its VARTYPE, or is so small that it would become 0.
    OutOfRange,
    /// The number is longer than 500 characters.
    NumberTooLong,
    /// A currency amount has a point; its text is a whole number of ten-thousandths.
    CurrencyPoint,
    /// A date is not in the form `YYYY/MM/DD hh:mm:ss`.
    DateLayout,
    /// The date or time does not exist, or the year is not 100 to 9999.
    NoSuchDate,
    /// There is text after EMPTY or NULL, which have no data.
    NoData,
    /// A VARIANT does not begin with `(`.
    OpenParen,
    /// Parentheses are not paired: `)` without `(`, or the text ends before `)`.
    Unbalanced,
    /// A string of an array has a comma inside parentheses.
    CommaInString,
    /// A string has a CR or an LF, which end lines.
    LineBreak,
    /// The bytes are not UTF-8.
    Utf8,
    /// VARIANTs are nested deeper than [`MAX_DEPTH`](crate::limits::MAX_DEPTH).
    TooDeep,
    /// There is text after the end of the value.
    Unexpected,
    /// The array is empty, which text cannot express.
    EmptyArray,
    /// An array of EMPTY or NULL has no text.
    ArrayOfNothing,
    /// A string begins with a blank, which the reader would drop.
    LeadingBlank,
    /// A string has an unpaired surrogate, which UTF-8 cannot express.
    LoneSurrogate,
    /// A NaN has a payload.
    NanPayload,
    /// The value's VARTYPE cannot be sent.
    Unsendable(u16),
    /// It does not fit the buffer, or the 256 bytes of a line.
    Full,
    /// The verb is not GET or PUT.
    Verb,
    /// The controller's name is not `RC8`.
    PartName,
    /// The index is not a decimal number of at most 32 bits.
    Index,
    /// The variable type is not one of I F D S V P J T IO.
    VariableType,
    /// There is no colon after this part of a request.
    Colon(RequestPart),
    /// A GET has data after its last colon.
    GetWithData,
    /// A PUT has no value.
    PutWithoutData,
    /// A response does not begin with a result: a decimal number or `0x` and hex digits, of 32 bits.
    ResultCode,
    /// The line is over 256 bytes with its CR.
    LineTooLong,
}

/// A part of a RAC request, in the specification's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RequestPart {
    /// GET or PUT.
    Verb,
    /// `RC8`.
    PartName,
    /// The index of the variable.
    Index,
    /// I F D S V P J T or IO.
    VariableType,
}

impl TextError {
    /// Creates an error; `column` is counted from 1, and is 0 for a value without text.
    #[must_use]
    pub const fn new(kind: TextErrorKind, column: u32) -> Self {
        Self { kind, column }
    }

    pub(crate) const fn printing(kind: TextErrorKind) -> Self {
        Self { kind, column: 0 }
    }

    /// Returns the code with which a RAC server answers a line like this.
    ///
    /// The specification names codes but not when they are sent; this is the choice made here:
    ///
    /// | the line                                    | code                       |
    /// |---------------------------------------------|----------------------------|
    /// | has an unknown verb, part or variable type  | `E_INVALIDCOMMAND`         |
    /// | has a bad index, or a colon or value missing or too much | `E_INVALIDARG` |
    /// | has a value that cannot be read             | `E_INVALIDARGTYPE`         |
    /// | has a value that the server has no room for | `E_ARGSIZEOVER`            |
    /// | is over 256 bytes                           | `E_PACKETSIZEOVER`         |
    #[must_use]
    pub const fn hresult(&self) -> HResult {
        match self.kind {
            TextErrorKind::Verb | TextErrorKind::PartName | TextErrorKind::VariableType => HResult::E_INVALIDCOMMAND,
            TextErrorKind::Index
            | TextErrorKind::Colon(_)
            | TextErrorKind::GetWithData
            | TextErrorKind::PutWithoutData => HResult::E_INVALIDARG,
            TextErrorKind::LineTooLong => HResult::E_PACKETSIZEOVER,
            TextErrorKind::Full => HResult::E_ARGSIZEOVER,
            _ => HResult::E_INVALIDARGTYPE,
        }
    }
}

impl From<EncodeError> for TextError {
    fn from(error: EncodeError) -> Self {
        Self::printing(match error {
            EncodeError::Full => TextErrorKind::Full,
            EncodeError::TooDeep => TextErrorKind::TooDeep,
            EncodeError::Unsendable(vartype) => TextErrorKind::Unsendable(vartype),
            EncodeError::OutOfRange(_) => TextErrorKind::OutOfRange,
        })
    }
}

impl fmt::Display for TextError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.column {
            0 => self.kind.fmt(f),
            column => write!(f, "{} at column {column}", self.kind),
        }
    }
}

impl fmt::Display for TextErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::UnknownType(vartype) => return write!(f, "unknown VARTYPE {vartype}"),
            Self::Unsendable(vartype) => return write!(f, "a value of VARTYPE 0x{vartype:04x} cannot be sent"),
            Self::Colon(part) => return write!(f, "a colon is missing after the {part}"),
            Self::Type => "a value begins with its VARTYPE, a decimal number",
            Self::Comma => "a comma is missing after the VARTYPE",
            Self::Missing => "a number is missing",
            Self::Digit => "not a digit of the number",
            Self::BlankBehind => "a blank after a number",
            Self::OutOfRange => "the number is out of the range of its VARTYPE",
            Self::NumberTooLong => "the number has too many characters",
            Self::CurrencyPoint => "a currency amount has no point: write the count of ten-thousandths",
            Self::DateLayout => "a date is written YYYY/MM/DD hh:mm:ss",
            Self::NoSuchDate => "there is no such date or time",
            Self::NoData => "EMPTY and NULL have no data",
            Self::OpenParen => "a VARIANT is written (type,data)",
            Self::Unbalanced => "parentheses are not paired",
            Self::CommaInString => "a comma in a string of an array",
            Self::LineBreak => "a string has a line break",
            Self::Utf8 => "not UTF-8",
            Self::TooDeep => "VARIANTs are nested too deep",
            Self::Unexpected => "text after the end of the value",
            Self::EmptyArray => "an empty array has no text",
            Self::ArrayOfNothing => "an array of EMPTY or NULL has no text",
            Self::LeadingBlank => "a string that begins with a blank has no text",
            Self::LoneSurrogate => "a string with a lone surrogate has no text",
            Self::NanPayload => "a NaN with a payload has no text",
            Self::Full => "the value does not fit",
            Self::Verb => "the verb is GET or PUT",
            Self::PartName => "the part name is RC8, or empty",
            Self::Index => "the index is a decimal number of at most 32 bits",
            Self::VariableType => "the variable type is one of I F D S V P J T IO",
            Self::GetWithData => "a GET ends with the colon after its variable type",
            Self::PutWithoutData => "a PUT has a value after its last colon",
            Self::ResultCode => "a response begins with its result, a number of 32 bits",
            Self::LineTooLong => "the line is over 256 bytes",
        })
    }
}

impl fmt::Display for RequestPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Verb => "verb",
            Self::PartName => "part name",
            Self::Index => "index",
            Self::VariableType => "variable type",
        })
    }
}

impl core::error::Error for TextError {}
