//! Conversion of received values to Rust types, with the reason when it fails.
//!
//! ```text
//!  Rust                           from
//!  i16 i32 i64 u8 u16 u32 u64     any integer or float that equals such an integer
//!  f64                            any float; any integer that f64 represents exactly
//!  f32                            the same; R8 is rounded to the nearest f32
//!  bool                           BOOL; an integer 0, 1 or -1
//!  Bstr, String                   BSTR; String needs `alloc` and valid Unicode
//!  Currency, OleDate, CivilTime   CY, DATE, DATE within the years 100 to 9999
//!  HResult                        ERROR; I4, as GetCurErrorInfo sends codes
//!  ()                             EMPTY, NULL
//!  Option<T>                      EMPTY and NULL give None, other values convert to T
//!  [T; N], tuples of 1 to 8       an array of any VARTYPE with exactly this number of elements
//!  Vec<T>                         an array of any VARTYPE; needs `alloc`
//!  Variant, OwnedVariant          any value; OwnedVariant needs `alloc`
//! ```
//!
//! No conversion changes an integer: it is exact or an error. There is no conversion between numbers and text. A scalar
//! VARIANT converts as the value inside it.

use core::fmt;
use core::iter::Enumerate;

use super::{Array, Bstr, CivilTime, Currency, Elements, OleDate, SHORT_CUTS, VarType, Variant};
use crate::hresult::HResult;
use crate::num::{exact_f32, exact_f64_of_i64, exact_f64_of_u64, exact_i64, exact_u64, to_f32, to_u32};

/// A type that received values convert to. [`Encode`](super::Encode) is the other direction.
///
/// User variables P, J and T are arrays of R4, and `CurPos` and `CurJnt` are arrays of R8. Both convert to `[f64; N]`.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::VariantBuf;
///
/// let p1 = VariantBuf::<64>::new(&[400.5_f32, 0.0, 300.0])?;
/// assert_eq!(p1.as_variant().convert::<[f64; 3]>()?, [400.5, 0.0, 300.0]);
///
/// let entry = VariantBuf::<64>::new(&(7_i16, true, ()))?;
/// assert_eq!(entry.as_variant().convert::<(u8, bool, Option<i32>)>()?, (7, true, None));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait FromVariant<'a>: Sized {
    /// Converts a value.
    ///
    /// # Errors
    ///
    /// A [`ConvertError`] when the value has another type or number of elements, or this type cannot hold it.
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError>;
}

impl<'a> Variant<'a> {
    /// Converts the value to a Rust type.
    ///
    /// # Errors
    ///
    /// A [`ConvertError`] when the value has another type or number of elements, or the type cannot hold it.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::variant::Variant;
    ///
    /// assert_eq!(Variant::R4(2.0).convert::<i32>(), Ok(2));
    /// let error = Variant::I4(300).convert::<u8>().unwrap_err();
    /// assert_eq!(error.to_string(), "expected u8 (0 to 255), found VT_I4 with the value 300, which is out of range");
    /// ```
    #[inline]
    pub fn convert<T: FromVariant<'a>>(self) -> Result<T, ConvertError> {
        T::from_variant(self)
    }
}

/// A number of any VARTYPE, as errors show it.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::{ConvertErrorKind, Number, Variant};
///
/// let error = Variant::R8(2.5).convert::<i32>().unwrap_err();
/// assert_eq!(error.kind, ConvertErrorKind::Inexact(Number::Float(2.5)));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Number {
    /// I2, I4, I8, UI1, UI2 or UI4.
    Signed(i64),
    /// UI8.
    Unsigned(u64),
    /// R4, R8, or the days of DATE.
    Float(f64),
}

impl Number {
    fn of(value: &Variant<'_>) -> Option<Self> {
        Some(match *value {
            Variant::R4(n) => Self::Float(f64::from(n)),
            Variant::R8(n) => Self::Float(n),
            Variant::Ui8(n) => Self::Unsigned(n),
            _ => Self::Signed(value.as_i64()?),
        })
    }

    /// Returns the integer that equals it. Every integer VARTYPE is within i64 or u64.
    fn to_integer<T: TryFrom<i64> + TryFrom<u64>>(self) -> Result<T, ConvertErrorKind> {
        let integer = match self {
            Self::Signed(n) => T::try_from(n).ok(),
            Self::Unsigned(n) => T::try_from(n).ok(),
            Self::Float(n) => match (exact_i64(n), exact_u64(n)) {
                (Some(n), _) => T::try_from(n).ok(),
                (None, Some(n)) => T::try_from(n).ok(),
                // above 2^53 every finite float is an integer
                (None, None) if n.abs() < 9e15 || n.is_nan() => return Err(ConvertErrorKind::Inexact(self)),
                (None, None) => None,
            },
        };
        integer.ok_or(ConvertErrorKind::OutOfRange(self))
    }

    fn to_f64(self) -> Result<f64, ConvertErrorKind> {
        let exact = match self {
            Self::Signed(n) => exact_f64_of_i64(n),
            Self::Unsigned(n) => exact_f64_of_u64(n),
            Self::Float(n) => Some(n),
        };
        exact.ok_or(ConvertErrorKind::Inexact(self))
    }

    fn to_f32(self) -> Result<f32, ConvertErrorKind> {
        match self {
            Self::Float(n) if n.is_finite() && !to_f32(n).is_finite() => Err(ConvertErrorKind::OutOfRange(self)),
            Self::Float(n) => Ok(to_f32(n)),
            integer => exact_f32(integer.to_f64()?).ok_or(ConvertErrorKind::Inexact(self)),
        }
    }

    /// Returns the truth value of 0, 1 and -1.
    fn to_bool(self) -> Result<bool, ConvertErrorKind> {
        match self {
            Self::Signed(0) | Self::Unsigned(0) => Ok(false),
            Self::Signed(1 | -1) | Self::Unsigned(1) => Ok(true),
            Self::Signed(_) | Self::Unsigned(_) => Err(ConvertErrorKind::OutOfRange(self)),
            Self::Float(_) => Err(ConvertErrorKind::Type),
        }
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Signed(n) => n.fmt(f),
            Self::Unsigned(n) => n.fmt(f),
            Self::Float(n) => write!(f, "{n:?}"),
        }
    }
}

/// A value that does not convert to the requested type.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::{ConvertErrorKind, VarType, VariantBuf};
///
/// let value = VariantBuf::<64>::new(&(1, "P1"))?;
/// let error = value.as_variant().convert::<[f64; 2]>().unwrap_err();
/// assert_eq!((error.element, error.found, error.kind), (Some(1), VarType::BSTR, ConvertErrorKind::Type));
/// assert_eq!(error.to_string(), "element 1: expected f64, found VT_BSTR");
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct ConvertError {
    /// The kind of error.
    pub kind: ConvertErrorKind,
    /// The requested type, in words.
    pub wanted: &'static str,
    /// The VARTYPE of the value, or of its element that does not convert.
    pub found: VarType,
    /// The number of elements of `found`; 1 for a scalar.
    pub count: u32,
    /// The index of the element that does not convert, in the outermost array.
    pub element: Option<u32>,
}

/// The reason why a value does not convert.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::{ConvertErrorKind, VariantBuf};
///
/// let three = VariantBuf::<32>::new(&[1, 2, 3])?;
/// let error = three.as_variant().convert::<[i32; 2]>().unwrap_err();
/// assert_eq!(error.kind, ConvertErrorKind::Count { least: 2, most: 2 });
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ConvertErrorKind {
    /// The value has another type.
    Type,
    /// The array has too few or too many elements.
    Count {
        /// Minimum number of elements.
        least: u32,
        /// Maximum number of elements.
        most: u32,
    },
    /// The number is too large or too small for the type.
    OutOfRange(Number),
    /// The type can hold only a rounded number.
    Inexact(Number),
    /// The string has an unpaired surrogate.
    Surrogate,
}

impl ConvertError {
    #[cold]
    pub(crate) fn new(kind: ConvertErrorKind, wanted: &'static str, value: &Variant<'_>) -> Self {
        let count = value.as_array().map_or(1, |array| to_u32(array.len()));
        Self { kind, wanted, found: value.vartype(), count, element: None }
    }

    /// Returns the error with the index of the array element that it concerns.
    pub(crate) fn at(self, index: usize) -> Self {
        Self { element: Some(to_u32(index)), ..self }
    }
}

impl fmt::Display for ConvertError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(index) = self.element {
            write!(f, "element {index}: ")?;
        }
        write!(f, "expected {}", self.wanted)?;
        match self.kind {
            ConvertErrorKind::Count { least, most } if least == most => write!(f, " of {}", Counted(most))?,
            ConvertErrorKind::Count { least, most } => write!(f, " of {least} to {}", Counted(most))?,
            _ => {}
        }
        write!(f, ", found {}", self.found)?;
        if self.found.is_array() {
            write!(f, " of {}", Counted(self.count))?;
        }
        match self.kind {
            ConvertErrorKind::Type | ConvertErrorKind::Count { .. } => Ok(()),
            ConvertErrorKind::OutOfRange(n) => write!(f, " with the value {n}, which is out of range"),
            ConvertErrorKind::Inexact(n) => write!(f, " with the value {n}, which is not exact in this type"),
            ConvertErrorKind::Surrogate => f.write_str(" with an unpaired surrogate"),
        }
    }
}

impl core::error::Error for ConvertError {}

/// A number of elements, in words.
struct Counted(u32);

impl fmt::Display for Counted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} element{}", self.0, if self.0 == 1 { "" } else { "s" })
    }
}

/// Converts a number with `read`.
fn number<T>(
    value: &Variant<'_>,
    wanted: &'static str,
    read: impl FnOnce(Number) -> Result<T, ConvertErrorKind>,
) -> Result<T, ConvertError> {
    let value = value.flatten();
    let read = Number::of(&value).ok_or(ConvertErrorKind::Type).and_then(read);
    read.map_err(|kind| ConvertError::new(kind, wanted, &value))
}

/// `$same` is the VARTYPE of `$type`: its value is returned by the inlined part of the function.
macro_rules! from_numbers {
    ($($type:ty, $same:ident, $wanted:literal, $read:ident;)*) => {$(
        impl<'a> FromVariant<'a> for $type {
            #[cfg_attr(not(target_os = "none"), inline)]
            fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
                #[cfg_attr(not(target_os = "none"), inline(never))]
                fn other(value: &Variant<'_>) -> Result<$type, ConvertError> {
                    number(value, $wanted, Number::$read)
                }
                match value {
                    Variant::$same(number) if SHORT_CUTS => Ok(number),
                    value => other(&value),
                }
            }
        }
    )*};
}

from_numbers! {
    u8, Ui1, "u8 (0 to 255)", to_integer;
    i16, I2, "i16 (-32768 to 32767)", to_integer;
    u16, Ui2, "u16 (0 to 65535)", to_integer;
    i32, I4, "i32 (-2147483648 to 2147483647)", to_integer;
    u32, Ui4, "u32 (0 to 4294967295)", to_integer;
    i64, I8, "i64 (-2^63 to 2^63 - 1)", to_integer;
    u64, Ui8, "u64 (0 to 2^64 - 1)", to_integer;
    f32, R4, "f32", to_f32;
    f64, R8, "f64", to_f64;
}

impl<'a> FromVariant<'a> for bool {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        match value.flatten() {
            Variant::Bool(b) => Ok(b),
            other => number(&other, "a truth value (BOOL, 0, 1 or -1)", Number::to_bool),
        }
    }
}

macro_rules! from_scalars {
    ($($type:ty, $wanted:literal, $($pattern:pat => $result:expr),+;)*) => {$(
        impl<'a> FromVariant<'a> for $type {
            fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
                match value.flatten() {
                    $($pattern => Ok($result),)+
                    other => Err(ConvertError::new(ConvertErrorKind::Type, $wanted, &other)),
                }
            }
        }
    )*};
}

from_scalars! {
    (), "no value", Variant::Empty | Variant::Null => ();
    Bstr<'a>, "a string", Variant::Bstr(text) => text;
    Currency, "a currency amount", Variant::Cy(amount) => amount;
    OleDate, "a date", Variant::Date(date) => date;
    HResult, "an HRESULT", Variant::Error(code) => code, Variant::I4(code) => HResult(code);
}

impl<'a> FromVariant<'a> for CivilTime {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        let date = value.convert::<OleDate>()?;
        let kind = ConvertErrorKind::OutOfRange(Number::Float(date.raw()));
        date.to_civil().ok_or_else(|| ConvertError::new(kind, "a date of the years 100 to 9999", &value.flatten()))
    }
}

impl<'a> FromVariant<'a> for Variant<'a> {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        Ok(value)
    }
}

impl<'a, T: FromVariant<'a>> FromVariant<'a> for Option<T> {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        if value.flatten().is_empty() { Ok(None) } else { T::from_variant(value).map(Some) }
    }
}

/// Returns the array in a value.
fn array_in(value: Variant<'_>) -> Result<Array<'_>, ConvertError> {
    let value = value.flatten();
    value.as_array().ok_or_else(|| ConvertError::new(ConvertErrorKind::Type, "an array", &value))
}

/// Returns the elements of an array. It must have `least` to `most` elements.
pub(crate) fn elements(value: Variant<'_>, least: usize, most: usize) -> Result<Enumerate<Elements<'_>>, ConvertError> {
    let array = array_in(value)?;
    if (least..=most).contains(&array.len()) {
        return Ok(array.iter().enumerate());
    }
    let kind = ConvertErrorKind::Count { least: to_u32(least), most: to_u32(most) };
    Err(ConvertError::new(kind, "an array", &Variant::Array(array)))
}

/// Converts an element of an array.
pub(crate) fn element<'a, T: FromVariant<'a>>((index, value): (usize, Variant<'a>)) -> Result<T, ConvertError> {
    T::from_variant(value).map_err(|error| error.at(index))
}

impl<'a, T: FromVariant<'a>, const N: usize> FromVariant<'a> for [T; N] {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        let mut items = heapless::Vec::<T, N>::new();
        for item in elements(value, N, N)? {
            // the number of elements was checked, so there is room
            let _ = items.push(element(item)?);
        }
        items.into_array().map_err(|_| ConvertError::new(ConvertErrorKind::Type, "an array", &value))
    }
}

macro_rules! from_tuples {
    ($($count:literal: $($name:ident)+;)*) => {$(
        #[doc = "An array of VARIANT or of any other type with this number of elements."]
        impl<'a, $($name: FromVariant<'a>),+> FromVariant<'a> for ($($name,)+) {
            fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
                let mut items = elements(value, $count, $count)?;
                // the number of elements was checked
                Ok(($(element::<$name>(items.next().unwrap_or((0, Variant::Empty)))?,)+))
            }
        }
    )*};
}

from_tuples! {
    1: A;
    2: A B;
    3: A B C;
    4: A B C D;
    5: A B C D E;
    6: A B C D E F;
    7: A B C D E F G;
    8: A B C D E F G H;
}

#[cfg(feature = "alloc")]
impl<'a> FromVariant<'a> for alloc::string::String {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        let text = value.convert::<Bstr<'a>>()?;
        let converted = text.chars().collect::<Result<Self, u16>>();
        converted.map_err(|_| ConvertError::new(ConvertErrorKind::Surrogate, "a Unicode string", &value.flatten()))
    }
}

#[cfg(feature = "alloc")]
impl<'a, T: FromVariant<'a>> FromVariant<'a> for alloc::vec::Vec<T> {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        array_in(value)?.iter().enumerate().map(element).collect()
    }
}

#[cfg(test)]
mod tests;
