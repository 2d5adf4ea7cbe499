//! The text form of values in RAC lines: `<type>,<data>`.
//!
//! ```text
//!  3,123                       I4 123                 8,Sample,Test            BSTR "Sample,Test"
//!  8196,1,2.5,-3e9             R4[1, 2.5, -3e9]       8200,Sample,Test         BSTR["Sample", "Test"]
//!  12,(8,Sample)               VARIANT holding        8204,(8,Sample),(2,100)  VARIANT["Sample", I2 100]
//!                              BSTR "Sample"          0,   1,                  EMPTY, NULL
//!
//!  value    = blanks type data
//!  type     = digits                              a VARTYPE, 8192 (0x2000) added for arrays
//!  data     = { "," blanks element }              exactly one for a scalar, one or more for an array
//!           | [ "," blanks ]                      EMPTY NULL
//!  element  = "(" value ")" blanks                VARIANT
//!           | integer                             I2 I4 I8 UI1 UI2 UI4 UI8 ERROR; BOOL, 0 is false; CY, unscaled
//!           | float                               R4 R8
//!           | date | float                        DATE
//!           | string                              BSTR
//!  integer  = [ sign ] ( digits | "0x" hexdigits )
//!  float    = [ sign ] ( "inf" | "nan" | decimal )
//!  decimal  = mantissa [ "e" exponent ]
//!  mantissa = digits [ "." [ digits ] ] | "." digits
//!  exponent = [ sign ] digits
//!  date     = digits "/" digits "/" digits blank blanks digits ":" digits ":" digits
//!  string   = { character - CR - LF }             UTF-8; a scalar outside of a VARIANT ends with the text; inside a
//!                                                 VARIANT parentheses are paired; in an array, commas are not allowed either
//! ```
//!
//! There is no quoting and no escaping, so some values have no text. Guarantees:
//!
//! * The output of [`Variant::write_text`] parses back to the same bits, -0 and NaN included. Floats have the fewest
//!   digits that allow this.
//! * A value without text is an error: an empty array; an array of EMPTY or NULL (peers crash on it); a NaN with a payload;
//!   a string that begins with a blank (readers drop blanks after commas), or contains a line break, a lone surrogate, or
//!   a comma or parenthesis that is invalid in its place.
//! * Numbers are checked against their type. A leading 0 does not mean octal. A float is out of range if it would become
//!   infinite, or 0 without being 0. ERROR accepts its bits in hexadecimal: `0x80070057`.
//! * Blanks are dropped only after commas, before types and after `)`. None are written.
//! * A DATE is written as a date if that is exactly the same instant, and otherwise as its raw number.
//! * Text is read once, from front to back. Nesting uses no recursion: both directions keep a few words for each of at most
//!   [`MAX_DEPTH`](crate::limits::MAX_DEPTH) levels.

mod grammar;
pub(super) mod number;
mod parse;
mod print;
mod string;

pub(crate) use self::grammar::{Parsed, blanks, complete, expect, fault};
pub use self::number::parse_f64;
pub(crate) use self::number::{Integer, integer};
pub(crate) use self::parse::value;
pub(crate) use self::print::put_integer;

use super::{Variant, VariantBuf};
use crate::error::{TextError, TextErrorKind};
use crate::wire::Writer;

/// Writes a number as its decimal digits.
///
/// # Errors
///
/// When the buffer is full.
pub fn write_integer(number: u64, out: &mut Writer<'_>) -> Result<(), TextError> {
    put_integer(false, number, out).map_err(TextError::printing)
}

impl<const N: usize> VariantBuf<N> {
    /// Parses the text of one value, such as `8196,1,2.5,-3` or `8204,(8,Sample),(2,100)`.
    ///
    /// # Errors
    ///
    /// A [`TextError`] with the column; [`TextErrorKind::Full`] when the value is over `N` bytes.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::variant::VariantBuf;
    ///
    /// let pose = VariantBuf::<64>::parse_text(b"8196,1,2,3,4,5,6,-1")?;
    /// let items = pose.as_variant().as_array().and_then(|a| a.items::<f32>()).ok_or("not R4")?;
    /// assert_eq!(items.to_array(), Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0]));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn parse_text(text: &[u8]) -> Result<Self, TextError> {
        Self::build(|out| complete(text, |text| value(text, out)))
    }
}

impl Variant<'_> {
    /// Appends the text of the value.
    ///
    /// # Errors
    ///
    /// A [`TextError`] without a column when the value has no text or does not fit; part of it may have been written.
    pub fn write_text(&self, out: &mut Writer<'_>) -> Result<(), TextError> {
        print::print(*self, out).map_err(TextError::printing)
    }

    /// Writes the text of the value to the front of `buffer` and returns it.
    ///
    /// # Errors
    ///
    /// A [`TextError`] without a column when the value has no text or does not fit.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::variant::VariantBuf;
    ///
    /// let value = VariantBuf::<64>::new(&("Sample", 100_i16, 0.1_f32))?;
    /// assert_eq!(value.as_variant().to_text(&mut [0; 64])?, "8204,(8,Sample),(2,100),(4,0.1)");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn to_text<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b str, TextError> {
        let mut out = Writer::new(buffer);
        self.write_text(&mut out)?;
        core::str::from_utf8(out.into_bytes()).map_err(|_| TextError::printing(TextErrorKind::Utf8))
    }
}

#[cfg(test)]
mod tests;
