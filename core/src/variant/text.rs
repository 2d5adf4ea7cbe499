//! The text form of values, as the lines of RAC carry it: `<type>,<data>`.
//!
//! ```text
//!  3,123                       I4 123                 8,Sample,Test            BSTR "Sample,Test"
//!  8196,1,2.5,-3e9             R4[1, 2.5, -3e9]       8200,Sample,Test         BSTR["Sample", "Test"]
//!  12,(8,Sample)               VARIANT holding        8204,(8,Sample),(2,100)  VARIANT["Sample", I2 100]
//!                              BSTR "Sample"          0,   1,                  EMPTY, NULL
//!
//!  value    = blanks type [ "," data ]            data and its comma are left out for EMPTY and NULL only
//!  type     = digits                              a VARTYPE, 8192 (0x2000) added for arrays
//!  data     = blanks ( element | element { "," blanks element } )      one for a scalar, more for an array
//!  element  = "(" value ")" blanks                VARIANT
//!           | integer                             I2 I4 I8 UI1 UI2 UI4 UI8 ERROR; BOOL, 0 is false; CY, unscaled
//!           | float                               R4 R8
//!           | date | float                        DATE
//!           | string                              BSTR
//!  integer  = [ sign ] ( digits | "0x" hexdigits )
//!  float    = [ sign ] ( decimal [ "e" [ sign ] digits ] | "inf" | "nan" )
//!  decimal  = digits [ "." [ digits ] ] | "." digits
//!  date     = digits "/" digits "/" digits blank blanks digits ":" digits ":" digits
//!  string   = UTF-8 without CR and LF; of its own and at the top to the end of the text; inside of a VARIANT with
//!             paired parentheses; in an array with paired parentheses and without a comma
//! ```
//!
//! There is no quoting and no escaping, so some values have no text. What is guaranteed:
//!
//! * What [`Variant::write_text`] writes parses back to the same bits, -0 and NaN included; floats take the fewest
//!   digits that do. A value without text is an error: an empty array, an array of EMPTY or NULL (peers crash on
//!   it), a string that begins with a blank (readers drop blanks behind commas), has a line break, a lone surrogate, or
//!   parentheses or commas that its place cannot carry, a NaN with a payload.
//! * Numbers are checked against their type; a leading 0 does not make them octal; a float that is not 0 but would
//!   become 0, or that would become infinite, is out of range. ERROR takes `0x80070057` as its bits. Blanks are
//!   dropped behind commas, in front of types and behind `)`, nowhere else; none are written.
//! * A DATE is written as a date when that is the same instant to the bit, else as its raw number.
//! * Text is read once from front to back, and nesting takes no stack: both ways keep a few words a level, for at most
//!   [`MAX_DEPTH`](crate::limits::MAX_DEPTH) levels.
//!
//! The parsers are built with nom. They hold no reference of their own into the text, and what they cannot read is a
//! [`Fault`]: what is wrong, and how much text was left then.

pub(super) mod number;
mod parse;
mod print;
mod string;

pub(crate) use self::number::{Integer, integer};
pub(crate) use self::parse::{Parsed, blanks, complete, expect, fault, value};
pub(crate) use self::print::put_integer;

use super::{Variant, VariantBuf};
use crate::error::{TextError, TextErrorKind};
use crate::wire::Writer;

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

/// Where a string is, which decides what it cannot hold.
#[derive(Clone, Copy)]
struct Place {
    /// Inside the parentheses of a VARIANT.
    nested: bool,
    in_array: bool,
}

#[cfg(test)]
mod tests;
