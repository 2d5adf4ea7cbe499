//! VARIANT: the values of b-CAP (binary) and RAC (text).
//!
//! ```text
//!  u16 VARTYPE | u32 element count | data          all little-endian; a scalar's count is 1
//!
//!  VARTYPE     data of one element                 Rust, to send       Rust, received
//!   0 EMPTY    -                                   ()                  Variant::Empty
//!   1 NULL     -                                   Null                Variant::Null
//!   2 I2       i16                                 i16                 Variant::I2
//!   3 I4       i32                                 i32                 Variant::I4
//!   4 R4       f32                                 f32                 Variant::R4
//!   5 R8       f64                                 f64                 Variant::R8
//!   6 CY       i64 ten-thousandths                 Currency            Variant::Cy
//!   7 DATE     f64 days since 1899-12-30           OleDate             Variant::Date
//!   8 BSTR     u32 bytes | UTF-16LE                &str, Bstr          Variant::Bstr
//!  10 ERROR    i32 HRESULT                         HResult             Variant::Error
//!  11 BOOL     i16, -1 or 0                        bool                Variant::Bool
//!  12 VARIANT  a whole VARIANT                     -                   Variant::Nested
//!  17 UI1      u8                                  u8                  Variant::Ui1
//!  18 UI2      u16                                 u16                 Variant::Ui2
//!  19 UI4      u32                                 u32                 Variant::Ui4
//!  20 I8       i64                                 i64                 Variant::I8
//!  21 UI8      u64                                 u64                 Variant::Ui8
//!  0x2000 | T  count elements of T                 &[T], [T; N],       Variant::Array
//!                                                  tuples (of VARIANT)
//! ```
//!
//! [`Variant::decode`] or the frame decoder validates a received value with all nested values. The resulting [`Variant`] is a
//! `Copy` view of the bytes, and its accessors cannot fail. [`Variant::convert`] converts it to Rust types, with widening
//! ([`FromVariant`]). A [`VariantBuf`] owns a value; so does an `OwnedVariant`, of any size, with the feature `alloc`.
//! [`VariantBuf::parse_text`] reads the text form of RAC, and [`Variant::write_text`] writes it.
//!
//! # Examples
//!
//! ```
//! use bcap_core::limits::{Limits, Strictness};
//! use bcap_core::variant::{Variant, VariantBuf};
//!
//! let sent = VariantBuf::<64>::new(&[1.5_f64, -2.0])?;
//! assert_eq!(sent.as_bytes()[..6], [5, 0x20, 2, 0, 0, 0]);
//!
//! let received = Variant::decode(sent.as_bytes(), &Limits::STREAM, Strictness::Strict)?;
//! let numbers = received.as_array().and_then(|a| a.items::<f64>()).ok_or("not an array of R8")?;
//! assert_eq!(numbers.iter().sum::<f64>(), -0.5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod array;
mod bstr;
mod buf;
pub(crate) mod convert;
mod encode;
mod float;
#[cfg(feature = "alloc")]
mod owned;
mod scalar;
#[cfg(all(feature = "alloc", feature = "serde"))]
mod serial;
mod shape;
pub(crate) mod text;

pub use self::array::{Array, Elements, Items, Scalar};
pub use self::bstr::Bstr;
pub use self::buf::{VariantBuf, VariantBufError};
pub use self::convert::{ConvertError, ConvertErrorKind, FromVariant, Number};
pub use self::encode::{Element, Encode};
#[cfg(feature = "alloc")]
pub use self::owned::OwnedVariant;
pub use self::scalar::{CivilTime, Currency, Null, OleDate};
pub use self::shape::Shape;
pub use self::text::{parse_f64, write_integer};
pub use crate::wire::Writer;

use core::fmt;

use crate::error::{DecodeError, DecodeErrorKind, Layer};
use crate::hresult::HResult;
use crate::limits::{Limits, MAX_DEPTH, Strictness};
use crate::num::{to_u32, to_usize};
use crate::wire::Reader;

/// Limit for the elements of an array of EMPTY or NULL, which have no data, so that any count would be possible.
pub const MAX_EMPTY_ELEMENTS: u32 = 256;

/// Whether the most frequent types have short cuts. An image for a board has none: they would take 300 bytes of flash.
const SHORT_CUTS: bool = cfg!(not(target_os = "none"));

/// The first byte of the encoding of an I4.
const I4: u8 = VarType::I4.0.to_le_bytes()[0];

/// Bytes of the type and count at the start of a value.
const HEAD: usize = 6;

/// [`MAX_DEPTH`] as the length of an array.
const OUTER: usize = 16;
#[expect(clippy::as_conversions, reason = "u8 to usize is lossless")]
const _: () = assert!(OUTER == MAX_DEPTH as usize);

/// A VARTYPE: the type of a value, with [`ARRAY`](Self::ARRAY) or'ed in for arrays.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VarType(pub u16);

macro_rules! vartypes {
    ($($(#[$doc:meta])* $name:ident = $value:literal, $text:literal, $layout:expr;)*) => {
        impl VarType {
            $($(#[$doc])* pub const $name: Self = Self($value);)*

            /// Returns the name of the element type, as in `VT_BSTR`; `None` when the wire cannot carry it.
            #[must_use]
            pub const fn name(self) -> Option<&'static str> {
                match self.element() {
                    $(Self::$name => Some($text),)*
                    _ => None,
                }
            }
        }

        /// Layouts by element type: one load instead of a jump table.
        const LAYOUTS: [Layout; 22] = {
            let mut table = [Layout::Unknown; 22];
            $(table[$value] = $layout;)*
            table
        };

        /// Bytes of one element, by element type; 0 for a type that is not a number.
        // a separate table, because a match on the layout is a jump table
        const WIDTHS: [u8; 22] = {
            let mut table = [0; 22];
            $(if let Layout::Fixed(width) = $layout { table[$value] = width; })*
            table
        };
    };
}

vartypes! {
    /// No value.
    EMPTY = 0, "VT_EMPTY", Layout::Fixed(0);
    /// The null value.
    NULL = 1, "VT_NULL", Layout::Fixed(0);
    /// A signed 16-bit integer.
    I2 = 2, "VT_I2", Layout::Fixed(2);
    /// A signed 32-bit integer.
    I4 = 3, "VT_I4", Layout::Fixed(4);
    /// A 32-bit float.
    R4 = 4, "VT_R4", Layout::Fixed(4);
    /// A 64-bit float.
    R8 = 5, "VT_R8", Layout::Fixed(8);
    /// A currency amount.
    CY = 6, "VT_CY", Layout::Fixed(8);
    /// A date and time.
    DATE = 7, "VT_DATE", Layout::Fixed(8);
    /// A UTF-16 string.
    BSTR = 8, "VT_BSTR", Layout::Bstr;
    /// An HRESULT.
    ERROR = 10, "VT_ERROR", Layout::Fixed(4);
    /// A truth value.
    BOOL = 11, "VT_BOOL", Layout::Fixed(2);
    /// Any value, with its own type.
    VARIANT = 12, "VT_VARIANT", Layout::Variant;
    /// An unsigned 8-bit integer.
    UI1 = 17, "VT_UI1", Layout::Fixed(1);
    /// An unsigned 16-bit integer.
    UI2 = 18, "VT_UI2", Layout::Fixed(2);
    /// An unsigned 32-bit integer.
    UI4 = 19, "VT_UI4", Layout::Fixed(4);
    /// A signed 64-bit integer.
    I8 = 20, "VT_I8", Layout::Fixed(8);
    /// An unsigned 64-bit integer.
    UI8 = 21, "VT_UI8", Layout::Fixed(8);
}

/// The layout of an element's data on the wire.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Layout {
    /// This many bytes, at most 8.
    Fixed(u8),
    Bstr,
    Variant,
    Unknown,
}

impl VarType {
    /// The bit that makes an array of any other type.
    pub const ARRAY: Self = Self(0x2000);

    /// Returns whether this is an array.
    #[must_use]
    pub const fn is_array(self) -> bool {
        self.0 & Self::ARRAY.0 != 0
    }

    /// Returns the type of the elements; a scalar's own type.
    #[must_use]
    pub const fn element(self) -> Self {
        Self(self.0 & !Self::ARRAY.0)
    }

    /// Returns the type of an array of this.
    #[must_use]
    pub const fn array_of(self) -> Self {
        Self(self.0 | Self::ARRAY.0)
    }

    /// Returns whether values of this type can be sent.
    #[must_use]
    pub fn is_known(self) -> bool {
        self.layout() != Layout::Unknown
    }

    /// Returns the bytes of one element; `None` if the length varies (BSTR, VARIANT) or the wire cannot carry the type.
    #[must_use]
    pub fn element_bytes(self) -> Option<u8> {
        match self.layout() {
            Layout::Fixed(bytes) => Some(bytes),
            Layout::Bstr | Layout::Variant | Layout::Unknown => None,
        }
    }

    /// Iterates over the types of scalars, ascending.
    pub fn scalars() -> impl Iterator<Item = Self> + Clone {
        (0_u16..).take(LAYOUTS.len()).map(Self).filter(|vartype| vartype.is_known())
    }

    /// Returns the bytes of one element if it is a number, otherwise 0.
    #[inline]
    fn width(self) -> u8 {
        match self.layout() {
            Layout::Fixed(width) if !SHORT_CUTS => width,
            _ if !SHORT_CUTS => 0,
            _ => WIDTHS.get(usize::from(self.element().0)).copied().unwrap_or(0),
        }
    }

    fn layout(self) -> Layout {
        LAYOUTS.get(usize::from(self.element().0)).copied().unwrap_or(Layout::Unknown)
    }
}

impl fmt::Debug for VarType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) if self.is_array() => write!(f, "VT_ARRAY|{name}"),
            Some(name) => f.write_str(name),
            None => write!(f, "VarType(0x{:04x})", self.0),
        }
    }
}

impl fmt::Display for VarType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// A value, as a view of its encoding.
///
/// Two values are equal when they would be sent as the same bytes: a NaN equals itself, and 0.0 is not -0.0.
#[derive(Clone, Copy)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Variant<'a> {
    /// No value.
    Empty,
    /// The null value.
    Null,
    /// A signed 16-bit integer.
    I2(i16),
    /// A signed 32-bit integer.
    I4(i32),
    /// A 32-bit float.
    R4(f32),
    /// A 64-bit float.
    R8(f64),
    /// A currency amount.
    Cy(Currency),
    /// A date and time.
    Date(OleDate),
    /// A string.
    Bstr(Bstr<'a>),
    /// An HRESULT.
    Error(HResult),
    /// A truth value; any number but 0 was true on the wire.
    Bool(bool),
    /// A VARIANT that holds one other value, RAC's `12,(8,Sample)`.
    Nested(Nested<'a>),
    /// An unsigned 8-bit integer.
    Ui1(u8),
    /// An unsigned 16-bit integer.
    Ui2(u16),
    /// An unsigned 32-bit integer.
    Ui4(u32),
    /// A signed 64-bit integer.
    I8(i64),
    /// An unsigned 64-bit integer.
    Ui8(u64),
    /// Elements of one type.
    Array(Array<'a>),
    /// A value of unknown VARTYPE that a lenient decoder skipped by its argument's length; it cannot be sent.
    Opaque(Opaque<'a>),
}

/// The value inside a scalar VARIANT.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Nested<'a>(
    /// One validated value.
    &'a [u8],
);

impl<'a> Nested<'a> {
    /// Returns the value.
    #[must_use]
    pub fn value(self) -> Variant<'a> {
        Variant::from_checked(self.0)
    }
}

impl fmt::Debug for Nested<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.value().fmt(f)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Nested<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{}", self.value());
    }
}

/// A value of unknown VARTYPE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Opaque<'a> {
    /// Its type.
    pub vartype: VarType,
    /// Its bytes after the type: the count, and data of unknown layout.
    pub bytes: &'a [u8],
}

impl<'a> Variant<'a> {
    /// Validates `bytes` as exactly one value.
    ///
    /// # Errors
    ///
    /// A [`DecodeError`] of [`Layer::Value`], with the offset from the start of `bytes`.
    pub fn decode(bytes: &'a [u8], limits: &Limits, strictness: Strictness) -> Result<Self, DecodeError> {
        let located = |error: CheckError| error.at(bytes.len(), Layer::Value);
        let mut reader = Reader::new(bytes);
        check(&mut reader, limits, strictness).map_err(located)?;
        if reader.left() > 0 && strictness == Strictness::Strict {
            return Err(located(CheckError {
                kind: DecodeErrorKind::Unused(to_u32(reader.left())),
                left: reader.left(),
            }));
        }
        let used = bytes.len().wrapping_sub(reader.left());
        Ok(Self::from_checked(bytes.get(..used).unwrap_or_default()))
    }

    /// Views a value that [`check`] accepted.
    // the most frequent number without a call; a board has one copy of this function
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(crate) fn from_checked(bytes: &'a [u8]) -> Self {
        match bytes.first_chunk() {
            Some(&[I4, 0, _, _, _, _, a, b, c, d]) if SHORT_CUTS => Self::I4(i32::from_le_bytes([a, b, c, d])),
            _ => Self::from_checked_of_any_type(bytes),
        }
    }

    #[cfg_attr(not(target_os = "none"), inline(never))]
    fn from_checked_of_any_type(bytes: &'a [u8]) -> Self {
        let mut r = Reader::new(bytes);
        let Some((vartype, count)) = head(&mut r) else { return Self::Empty };
        if SHORT_CUTS && vartype == VarType::BSTR {
            return Self::read_bstr(&mut r);
        }
        // a pose
        if SHORT_CUTS && vartype == const { VarType::R8.array_of() } {
            return Self::Array(Array::from_checked(VarType::R8, count, r.rest()));
        }
        match vartype.layout() {
            // only possible for an argument of a lenient frame
            Layout::Unknown => Self::Opaque(Opaque { vartype, bytes: bytes.get(2..).unwrap_or_default() }),
            _ if vartype.is_array() => Self::Array(Array::from_checked(vartype.element(), count, r.rest())),
            Layout::Variant => Self::Nested(Nested(r.rest())),
            // a copy of the reader, so that the compiler can keep `r` in registers for the other arms
            Layout::Fixed(_) | Layout::Bstr => Self::read_data(vartype, &mut { r }),
        }
    }

    /// Splits the first of several validated values off, and views it.
    fn read(r: &mut Reader<'a>) -> Self {
        let start = *r;
        let Some((vartype, count)) = head(r) else { return Self::Empty };
        if vartype.is_array() || vartype == VarType::VARIANT {
            let count = if vartype.is_array() { count } else { 1 };
            if skip_elements(vartype.element(), count, r).is_none() {
                return Self::Empty;
            }
            let used = start.left().wrapping_sub(r.left());
            return Self::from_checked(start.rest().get(..used).unwrap_or_default());
        }
        Self::read_data(vartype, r)
    }

    /// Splits the data of an array's first element off, and views it.
    // the most frequent number without a call; a board has one copy of this function
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn read_element(element: VarType, r: &mut Reader<'a>) -> Self {
        match r.rest().split_first_chunk() {
            Some((&[I4, 0, _, _, _, _, a, b, c, d], rest)) if SHORT_CUTS && element == VarType::VARIANT => {
                *r = Reader::new(rest);
                Self::I4(i32::from_le_bytes([a, b, c, d]))
            }
            _ => Self::read_element_of_any_type(element, r),
        }
    }

    #[cfg_attr(not(target_os = "none"), inline(never))]
    fn read_element_of_any_type(element: VarType, r: &mut Reader<'a>) -> Self {
        if element == VarType::VARIANT { Self::read(r) } else { Self::read_data(element, r) }
    }

    /// Splits the data of a value that is neither an array nor a VARIANT off, and views it.
    // a board has one copy of this function; elsewhere a call would be slower
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn read_data(vartype: VarType, r: &mut Reader<'a>) -> Self {
        // most numbers
        match vartype {
            VarType::I4 => return Self::I4(r.array().map_or(0, i32::from_le_bytes)),
            VarType::R4 => return Self::R4(r.array().map_or(0.0, f32::from_le_bytes)),
            VarType::R8 if SHORT_CUTS => return Self::R8(r.array().map_or(0.0, f64::from_le_bytes)),
            VarType::BSTR if SHORT_CUTS => return Self::read_bstr(r),
            _ => {}
        }
        Self::read_number(vartype, r)
    }

    fn read_bstr(r: &mut Reader<'a>) -> Self {
        Self::Bstr(Bstr::truncated(crate::wire::length_prefixed(r).unwrap_or_default()))
    }

    #[cfg_attr(not(target_os = "none"), inline(never))]
    fn read_number(vartype: VarType, r: &mut Reader<'a>) -> Self {
        // all other numbers as 8 bytes: a copy of this code for each type would be large
        let bytes = match vartype.layout() {
            Layout::Fixed(width) => next(width, r),
            _ => return Self::read_bstr(r),
        };
        let [a, b, c, d, ..] = bytes;
        match vartype {
            VarType::NULL => Self::Null,
            VarType::I2 => Self::I2(i16::from_le_bytes([a, b])),
            VarType::CY => Self::Cy(Currency::from_wire(bytes)),
            VarType::DATE => Self::Date(OleDate::from_wire(bytes)),
            VarType::ERROR => Self::Error(HResult::from_wire([a, b, c, d])),
            VarType::BOOL => Self::Bool(bool::from_wire([a, b])),
            VarType::UI1 => Self::Ui1(a),
            VarType::UI2 => Self::Ui2(u16::from_le_bytes([a, b])),
            VarType::UI4 => Self::Ui4(u32::from_le_bytes([a, b, c, d])),
            VarType::I8 => Self::I8(i64::from_le_bytes(bytes)),
            VarType::UI8 => Self::Ui8(u64::from_le_bytes(bytes)),
            VarType::R8 => Self::R8(f64::from_le_bytes(bytes)),
            _ => Self::Empty,
        }
    }

    /// Returns the VARTYPE.
    #[must_use]
    pub const fn vartype(&self) -> VarType {
        match self {
            Self::Empty => VarType::EMPTY,
            Self::Null => VarType::NULL,
            Self::I2(_) => VarType::I2,
            Self::I4(_) => VarType::I4,
            Self::R4(_) => VarType::R4,
            Self::R8(_) => VarType::R8,
            Self::Cy(_) => VarType::CY,
            Self::Date(_) => VarType::DATE,
            Self::Bstr(_) => VarType::BSTR,
            Self::Error(_) => VarType::ERROR,
            Self::Bool(_) => VarType::BOOL,
            Self::Nested(_) => VarType::VARIANT,
            Self::Ui1(_) => VarType::UI1,
            Self::Ui2(_) => VarType::UI2,
            Self::Ui4(_) => VarType::UI4,
            Self::I8(_) => VarType::I8,
            Self::Ui8(_) => VarType::UI8,
            Self::Array(array) => array.element().array_of(),
            Self::Opaque(opaque) => opaque.vartype,
        }
    }

    /// Returns the value inside, when this is a scalar VARIANT, however deep; otherwise the value itself.
    #[must_use]
    pub fn flatten(self) -> Self {
        let mut value = self;
        for _ in 0..=MAX_DEPTH {
            match value {
                Self::Nested(nested) => value = nested.value(),
                other => return other,
            }
        }
        value
    }

    /// Returns the number of any integer type that fits; `None` for other types.
    #[must_use]
    pub fn as_i64(&self) -> Option<i64> {
        Some(match *self {
            Self::I2(n) => i64::from(n),
            Self::I4(n) => i64::from(n),
            Self::I8(n) => n,
            Self::Ui1(n) => i64::from(n),
            Self::Ui2(n) => i64::from(n),
            Self::Ui4(n) => i64::from(n),
            Self::Ui8(n) => i64::try_from(n).ok()?,
            _ => return None,
        })
    }

    /// Returns the number of any integer type that fits; `None` for other types.
    #[must_use]
    #[inline]
    pub fn as_i32(&self) -> Option<i32> {
        match *self {
            Self::I4(n) => Some(n),
            other if SHORT_CUTS => other.narrowed(),
            _ => i32::try_from(self.as_i64()?).ok(),
        }
    }

    /// Returns the number of an integer type other than I4.
    // by value, so that the compiler can keep an I4 in a register
    #[cfg_attr(not(target_os = "none"), inline(never))]
    fn narrowed(self) -> Option<i32> {
        i32::try_from(self.as_i64()?).ok()
    }

    /// Returns the number of R4, R8, or an integer of at most 32 bits; all of them convert exactly.
    #[must_use]
    pub fn as_f64(&self) -> Option<f64> {
        match *self {
            Self::R4(n) => Some(f64::from(n)),
            Self::R8(n) => Some(n),
            Self::Ui4(n) => Some(f64::from(n)),
            _ => self.as_i32().map(f64::from),
        }
    }

    /// Returns the truth value of BOOL, or of an integer (0 is false).
    #[must_use]
    pub fn as_bool(&self) -> Option<bool> {
        match *self {
            Self::Bool(b) => Some(b),
            Self::Ui8(n) => Some(n != 0),
            _ => self.as_i64().map(|n| n != 0),
        }
    }

    /// Returns the string of BSTR.
    #[must_use]
    pub const fn as_bstr(&self) -> Option<Bstr<'a>> {
        match *self {
            Self::Bstr(text) => Some(text),
            _ => None,
        }
    }

    /// Returns the array.
    #[must_use]
    pub const fn as_array(&self) -> Option<Array<'a>> {
        match *self {
            Self::Array(array) => Some(array),
            _ => None,
        }
    }

    /// Returns whether there is no value: EMPTY or NULL.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        matches!(self, Self::Empty | Self::Null)
    }
}

impl PartialEq for Variant<'_> {
    fn eq(&self, other: &Self) -> bool {
        match (*self, *other) {
            (Self::R4(a), Self::R4(b)) => a.to_bits() == b.to_bits(),
            (Self::R8(a), Self::R8(b)) => a.to_bits() == b.to_bits(),
            (Self::Cy(a), Self::Cy(b)) => a == b,
            (Self::Date(a), Self::Date(b)) => a == b,
            (Self::Bstr(a), Self::Bstr(b)) => a == b,
            (Self::Error(a), Self::Error(b)) => a == b,
            (Self::Bool(a), Self::Bool(b)) => a == b,
            (Self::Nested(a), Self::Nested(b)) => a.value() == b.value(),
            (Self::Array(a), Self::Array(b)) => a == b,
            (Self::Opaque(a), Self::Opaque(b)) => a == b,
            (Self::Ui8(a), Self::Ui8(b)) => a == b,
            // integers, EMPTY and NULL
            (a, b) => a.vartype() == b.vartype() && a.as_i64() == b.as_i64(),
        }
    }
}

impl Eq for Variant<'_> {}

/// Writes the value in Rust's syntax, with its VARTYPE where that is not obvious: `I4(7)`, `"text"`, `R8[1.0, 2.0]`.
impl fmt::Debug for Variant<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("EMPTY"),
            Self::Null => f.write_str("NULL"),
            Self::I2(n) => write!(f, "I2({n})"),
            Self::I4(n) => write!(f, "I4({n})"),
            Self::R4(n) => write!(f, "R4({n:?})"),
            Self::R8(n) => write!(f, "R8({n:?})"),
            Self::Cy(n) => write!(f, "CY({n})"),
            Self::Date(date) => match date.to_civil() {
                Some(civil) => write!(f, "DATE({civil})"),
                None => write!(f, "DATE({:?})", date.raw()),
            },
            Self::Bstr(text) => text.fmt(f),
            Self::Error(code) => write!(f, "ERROR({code:?})"),
            Self::Bool(b) => write!(f, "BOOL({b})"),
            Self::Nested(nested) => write!(f, "VARIANT({nested:?})"),
            Self::Ui1(n) => write!(f, "UI1({n})"),
            Self::Ui2(n) => write!(f, "UI2({n})"),
            Self::Ui4(n) => write!(f, "UI4({n})"),
            Self::I8(n) => write!(f, "I8({n})"),
            Self::Ui8(n) => write!(f, "UI8({n})"),
            Self::Array(array) => array.fmt(f),
            Self::Opaque(opaque) => write!(f, "{:?}({} bytes)", opaque.vartype, opaque.bytes.len()),
        }
    }
}

/// Reads at most 8 bytes of validated data.
#[inline]
fn next(width: u8, r: &mut Reader<'_>) -> [u8; 8] {
    let mut bytes = [0; 8];
    for (slot, byte) in bytes.iter_mut().zip(r.slice(usize::from(width)).unwrap_or_default()) {
        *slot = *byte;
    }
    bytes
}

/// Reads type and count.
#[inline]
fn head(r: &mut Reader<'_>) -> Option<(VarType, u32)> {
    let (&[t0, t1, c0, c1, c2, c3], rest) = r.rest().split_first_chunk::<HEAD>()?;
    *r = Reader::new(rest);
    Some((VarType(u16::from_le_bytes([t0, t1])), u32::from_le_bytes([c0, c1, c2, c3])))
}

/// An error and its position, as the number of bytes that were left.
pub(crate) struct CheckError {
    pub(crate) kind: DecodeErrorKind,
    pub(crate) left: usize,
}

impl CheckError {
    /// Places the error in an input of `total` bytes.
    pub(crate) const fn at(&self, total: usize, layer: Layer) -> DecodeError {
        DecodeError { kind: self.kind, layer, offset: total.saturating_sub(self.left) }
    }
}

/// Validates one value with all nested values, and steps over it; received bytes become values only by this function.
///
/// It does not recurse: an array contains the number of remaining values of each level.
#[inline(always)]
pub(crate) fn check(r: &mut Reader<'_>, limits: &Limits, strictness: Strictness) -> Result<(), CheckError> {
    match check_one(r, strictness)? {
        0 => Ok(()),
        inner => check_inner(r, inner, limits, strictness),
    }
}

#[inline(never)]
fn check_inner(inner: &mut Reader<'_>, count: u32, limits: &Limits, strictness: Strictness) -> Result<(), CheckError> {
    // except on a board, a copy, which the compiler keeps in registers
    let mut copy = *inner;
    let r = if SHORT_CUTS { &mut copy } else { &mut *inner };
    let max = limits.depth.min(MAX_DEPTH);
    if max == 0 {
        return Err(CheckError { kind: DecodeErrorKind::TooDeep(max), left: r.left() });
    }
    // remaining values of each outer level; `here` counts the innermost
    let mut outer = [0_u32; OUTER];
    let mut depth = 1_u8;
    let mut here = count;
    loop {
        if here == 0 {
            depth = depth.wrapping_sub(1);
            if depth == 0 {
                let rest = *r;
                *inner = rest;
                return Ok(());
            }
            here = outer.get(usize::from(depth)).copied().unwrap_or(0);
            continue;
        }
        here = here.wrapping_sub(1);
        let at = r.left();
        let within = check_one(r, strictness)?;
        if within > 0 {
            if depth >= max {
                return Err(CheckError { kind: DecodeErrorKind::TooDeep(max), left: at });
            }
            if let Some(slot) = outer.get_mut(usize::from(depth)) {
                *slot = here;
            }
            depth = depth.wrapping_add(1);
            here = within;
        }
    }
}

/// Steps over one value up to its nested values, and returns their number.
// a board has one copy of this function; elsewhere a call would be slower
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline(always))]
fn check_one(r: &mut Reader<'_>, strictness: Strictness) -> Result<u32, CheckError> {
    let Some((vartype, mut count)) = head(r) else { return Err(truncated(r, HEAD)) };
    let scalar = !vartype.is_array();
    if scalar {
        if count != 1 && strictness == Strictness::Strict && vartype.is_known() {
            return Err(CheckError { kind: DecodeErrorKind::ScalarCount(count), left: r.left().wrapping_add(4) });
        }
        count = 1;
    }
    let width = vartype.width();
    if width > 0 {
        // at most 8 times 4 G, which fits; a sum above `usize::MAX` also exceeds the bytes that are left
        let needed = usize::try_from(u64::from(width).wrapping_mul(u64::from(count))).unwrap_or(usize::MAX);
        return match r.slice(needed) {
            Some(_) => Ok(0),
            None => Err(if scalar { truncated(r, needed) } else { too_many(r, count) }),
        };
    }
    // before the match, which is a jump table
    if vartype.layout() == Layout::Bstr {
        // a string has at least its length field
        if !scalar && to_usize(count) > r.left() >> 2 {
            return Err(too_many(r, count));
        }
        for _ in 0..count {
            check_bstr(r, strictness)?;
        }
        return Ok(0);
    }
    match vartype.layout() {
        // those without data, EMPTY and NULL
        Layout::Fixed(_) if count > MAX_EMPTY_ELEMENTS => Err(too_many(r, count)),
        Layout::Fixed(_) => Ok(0),
        // a value has at least its head
        Layout::Variant if !scalar && u64::from(count).wrapping_mul(6) > u64::from(to_u32(r.left())) => {
            Err(too_many(r, count))
        }
        Layout::Variant => Ok(count),
        Layout::Bstr | Layout::Unknown => {
            Err(CheckError { kind: DecodeErrorKind::UnknownType(vartype.0), left: r.left().wrapping_add(HEAD) })
        }
    }
}

#[inline]
fn check_bstr(r: &mut Reader<'_>, strictness: Strictness) -> Result<(), CheckError> {
    let Some(length) = r.u32() else { return Err(truncated(r, 4)) };
    if length & 1 != 0 && strictness == Strictness::Strict {
        return Err(CheckError { kind: DecodeErrorKind::OddBstr(length), left: r.left().wrapping_add(4) });
    }
    match r.slice(to_usize(length)) {
        Some(_) => Ok(()),
        None => Err(truncated(r, to_usize(length))),
    }
}

/// Returns the error for `needed` missing bytes.
#[cold]
fn truncated(r: &Reader<'_>, needed: usize) -> CheckError {
    let left = r.left();
    CheckError { kind: DecodeErrorKind::Truncated { needed: to_u32(needed), left: to_u32(left) }, left }
}

/// Returns the error for an array with too many elements, directly after its count.
#[cold]
fn too_many(r: &Reader<'_>, count: u32) -> CheckError {
    CheckError { kind: DecodeErrorKind::ArrayCount(count), left: r.left().wrapping_add(4) }
}

/// Returns whether the value at the start of `bytes` has an unknown VARTYPE, which only an argument's length can skip.
pub(crate) fn is_opaque(bytes: &[u8]) -> bool {
    bytes.first_chunk::<2>().is_some_and(|t| !VarType(u16::from_le_bytes(*t)).is_known())
}

/// Steps over the data of validated elements, without validating them again.
///
/// It finds their end by counting the remaining values of all levels.
#[inline]
fn skip_elements(element: VarType, count: u32, r: &mut Reader<'_>) -> Option<()> {
    let mut values = skip_level(element, count, r)?;
    while values > 0 {
        let (vartype, count) = head(r)?;
        let count = if vartype.is_array() { count } else { 1 };
        let inner = skip_level(vartype.element(), count, r)?;
        values = values.wrapping_sub(1).checked_add(inner)?;
    }
    Some(())
}

/// Steps over the data of elements up to their nested values, and returns the number of these.
#[inline]
fn skip_level(element: VarType, count: u32, r: &mut Reader<'_>) -> Option<u32> {
    let width = element.width();
    if width > 0 {
        let len = usize::try_from(u64::from(width).wrapping_mul(u64::from(count))).ok()?;
        return r.slice(len).map(|_| 0);
    }
    match element.layout() {
        // EMPTY and NULL
        Layout::Fixed(_) => Some(0),
        Layout::Bstr => {
            for _ in 0..count {
                crate::wire::length_prefixed(r)?;
            }
            Some(0)
        }
        Layout::Variant => Some(count),
        Layout::Unknown => None,
    }
}

#[cfg(test)]
mod tests;
