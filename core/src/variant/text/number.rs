//! Numbers and dates: from text to the bits of an element.

use super::grammar::{Parsed, blanks, byte, complete, fault};
use crate::error::{TextError, TextErrorKind};
use crate::num::to_u32;
use crate::variant::encode::put_bits;
use crate::variant::float::{Decimal, FloatFormat, MAX_DIGITS};
use crate::variant::{CivilTime, Layout, OleDate, VarType};
use crate::wire::Writer;

/// `element = integer | float | date | string`, without the strings; appends its data
#[cfg_attr(not(target_os = "none"), inline(always))]
pub(super) fn number<'a>(element: VarType, text: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, ()> {
    let (rest, (bits, width)) = match element {
        VarType::DATE if is_date(text) => {
            let (rest, bits) = date(text)?;
            (rest, (bits, 8))
        }
        VarType::R4 | VarType::R8 | VarType::DATE => {
            let (format, width) =
                if element == VarType::R4 { (FloatFormat::Single, 4) } else { (FloatFormat::Double, 8) };
            let (rest, bits) = float(text, format)?;
            (rest, (bits, width))
        }
        _ => {
            let (rest, number) = integer(text)?;
            let Some(data) = number.to_wire(element) else { return fault(TextErrorKind::OutOfRange, text) };
            (rest, data)
        }
    };
    match put_bits(bits, width, out) {
        Ok(()) => Ok((rest, ())),
        Err(_) => fault(TextErrorKind::Full, text),
    }
}

/// `digits = digit { digit }`
#[cfg_attr(target_os = "none", inline(never))]
pub(super) fn digits(text: &[u8]) -> Parsed<'_, &[u8]> {
    let len = text.iter().position(|b| !b.is_ascii_digit()).unwrap_or(text.len());
    match text.split_at_checked(len) {
        Some((digits @ [_, ..], rest)) => Ok((rest, digits)),
        _ => fault(TextErrorKind::Digit, text),
    }
}

/// `[ sign ]`, `sign = "+" | "-"`; true for minus
#[cfg_attr(target_os = "none", inline(never))]
const fn sign(text: &[u8]) -> (&[u8], bool) {
    match text {
        [b'-', rest @ ..] => (rest, true),
        [b'+', rest @ ..] => (rest, false),
        _ => (text, false),
    }
}

/// Returns the error for a number without digits.
const fn no_digit(rest: &[u8]) -> TextErrorKind {
    if matches!(rest, [] | [b',' | b')', ..]) { TextErrorKind::Missing } else { TextErrorKind::Digit }
}

/// An integer before its type is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Integer {
    negative: bool,
    magnitude: u64,
    hex: bool,
}

impl Integer {
    /// Returns the number as a sign-extended integer of `width` bytes; `None` if it is out of range.
    #[cfg_attr(target_os = "none", inline(never))]
    fn bits(self, width: u8, signed: bool) -> Option<u64> {
        let spare = 64_u32.checked_sub(u32::from(width).checked_mul(8)?)?;
        let most = u64::MAX.checked_shr(spare.checked_add(u32::from(signed))?)?;
        match self.negative {
            false => (self.magnitude <= most).then_some(self.magnitude),
            true if signed => (self.magnitude <= most.checked_add(1)?).then_some(self.magnitude.wrapping_neg()),
            true => (self.magnitude == 0).then_some(0),
        }
    }

    /// Returns the number as 32 bits. `unsigned` also accepts decimal numbers above `i32::MAX`.
    pub(crate) fn to_code(self, unsigned: bool) -> Option<i32> {
        let [a, b, c, d, ..] = self.bits(4, self.negative || !(unsigned || self.hex))?.to_le_bytes();
        Some(i32::from_le_bytes([a, b, c, d]))
    }

    /// Returns the data of an element and their width in bytes.
    fn to_wire(self, element: VarType) -> Option<(u64, u8)> {
        let Layout::Fixed(width) = element.layout() else { return None };
        let bits = match element {
            VarType::ERROR => u64::from(self.to_code(false)?.cast_unsigned()),
            // every true is -1 on the wire
            VarType::BOOL => u64::from(self.bits(width, true)? != 0).wrapping_neg(),
            VarType::UI1 | VarType::UI2 | VarType::UI4 | VarType::UI8 => self.bits(width, false)?,
            _ => self.bits(width, true)?,
        };
        Some((bits, width))
    }
}

/// `integer = [ sign ] ( digits | "0x" hexdigits )`
#[cfg_attr(target_os = "none", inline(never))]
pub(crate) fn integer(text: &[u8]) -> Parsed<'_, Integer> {
    let (unsigned, negative) = sign(text);
    let (first, hex) = match unsigned {
        [b'0', b'x' | b'X', rest @ ..] => (rest, true),
        _ => (unsigned, false),
    };
    let (mut rest, mut magnitude) = (first, 0_u64);
    while let [b, after @ ..] = rest {
        let digit = match b {
            b'0'..=b'9' => b & 0x0f,
            b'a'..=b'f' | b'A'..=b'F' if hex => (b & 0x0f).wrapping_add(9),
            _ => break,
        };
        let product = magnitude.checked_mul(if hex { 16 } else { 10 });
        let Some(sum) = product.and_then(|product| product.checked_add(u64::from(digit))) else {
            return fault(TextErrorKind::OutOfRange, text);
        };
        magnitude = sum;
        rest = after;
    }
    if rest.len() == first.len() {
        return fault(no_digit(rest), rest);
    }
    Ok((rest, Integer { negative, magnitude, hex }))
}

/// Parses a text that is one `float` of the grammar of RAC and nothing else.
///
/// # Errors
///
/// When the text is something else, or a number that is out of range.
pub fn parse_f64(text: &[u8]) -> Result<f64, TextError> {
    complete(text, |text| float(text, FloatFormat::Double)).map(f64::from_bits)
}

/// `float = [ sign ] ( "inf" | "nan" | decimal )`, words in any case; its bits
#[cfg_attr(not(target_os = "none"), inline(always))]
fn float(text: &[u8], format: FloatFormat) -> Parsed<'_, u64> {
    let (unsigned, negative) = sign(text);
    let (rest, magnitude) = match unsigned {
        [b'i' | b'I', b'n' | b'N', b'f' | b'F', rest @ ..] => (rest, Some(format.infinity())),
        [b'n' | b'N', b'a' | b'A', b'n' | b'N', rest @ ..] => (rest, Some(format.nan())),
        _ => decimal_bits(unsigned, format)?,
    };
    match magnitude {
        Some(bits) => Ok((rest, if negative { bits | format.sign() } else { bits })),
        None => fault(TextErrorKind::OutOfRange, text),
    }
}

/// The bits of a [`decimal`]; `None` if it is out of range
#[cfg_attr(not(target_os = "none"), inline(always))]
fn decimal_bits(text: &[u8], format: FloatFormat) -> Parsed<'_, Option<u64>> {
    #[cfg(not(target_os = "none"))]
    if let Some((rest, bits)) = short_decimal(text, format) {
        return Ok((rest, Some(bits)));
    }
    decimal(text).map(|(rest, number)| (rest, format.of_decimal(&number)))
}

/// Parses a [`decimal`] of at most 15 digits without exponent, like almost all numbers of robots, to its bits; `None`
/// otherwise.
#[cfg(not(target_os = "none"))]
#[inline(always)]
fn short_decimal(text: &[u8], format: FloatFormat) -> Option<(&[u8], u64)> {
    let (mut rest, mut number) = add_short_digits(text, 0);
    let (mut count, mut places) = (text.len().wrapping_sub(rest.len()), 0);
    if let [b'.', fraction @ ..] = rest {
        (rest, number) = add_short_digits(fraction, number);
        places = fraction.len().wrapping_sub(rest.len());
        count = count.wrapping_add(places);
    }
    if !matches!(count, 1..=15) || matches!(rest, [b'e' | b'E', ..]) {
        return None;
    }
    Some((rest, format.of_short_decimal(number, places)?))
}

/// `[ digits ]`, appended to a number, which wraps after 19 digits.
#[cfg(not(target_os = "none"))]
#[inline(always)]
fn add_short_digits(text: &[u8], mut number: u64) -> (&[u8], u64) {
    let mut rest = text;
    while let [digit @ b'0'..=b'9', after @ ..] = rest {
        number = number.wrapping_mul(10).wrapping_add(u64::from(digit & 0x0f));
        rest = after;
    }
    (rest, number)
}

/// `decimal = mantissa [ "e" exponent ]`
#[cfg_attr(not(target_os = "none"), inline(always))]
pub(in crate::variant) fn decimal(text: &[u8]) -> Parsed<'_, Decimal<'_>> {
    let (mut rest, mut number) = mantissa(text)?;
    if let [b'e' | b'E', after @ ..] = rest {
        let power;
        (rest, power) = exponent(after)?;
        number.exponent = number.exponent.wrapping_add(power);
    }
    // with the exponent, which would otherwise have no bound
    if text.len().wrapping_sub(rest.len()) > MAX_DIGITS {
        return fault(TextErrorKind::NumberTooLong, text);
    }
    Ok((rest, number))
}

/// `mantissa = digits [ "." [ digits ] ] | "." digits`
#[cfg_attr(not(target_os = "none"), inline(always))]
fn mantissa(text: &[u8]) -> Parsed<'_, Decimal<'_>> {
    let mut number = Decimal { digits: text, count: 0, number: 0, exponent: 0 };
    let mut rest = add_digits(text, &mut number);
    let mut has_digits = rest.len() < text.len();
    if let [b'.', fraction @ ..] = rest {
        rest = add_digits(fraction, &mut number);
        has_digits |= rest.len() < fraction.len();
        number.exponent = 0_i32.wrapping_sub_unsigned(to_u32(fraction.len().wrapping_sub(rest.len())));
    }
    if !has_digits {
        return fault(no_digit(text), text);
    }
    number.digits = text.get(..text.len().wrapping_sub(rest.len())).unwrap_or_default();
    Ok((rest, number))
}

/// `[ digits ]`, appended to the digits of a number
#[cfg_attr(not(target_os = "none"), inline(always))]
fn add_digits<'a>(text: &'a [u8], number: &mut Decimal<'_>) -> &'a [u8] {
    let mut rest = text;
    while let [digit @ b'0'..=b'9', after @ ..] = rest {
        // wraps after 19 digits, and is not used then
        number.number = number.number.wrapping_mul(10).wrapping_add(u64::from(digit & 0x0f));
        number.count = number.count.wrapping_add(u32::from(number.count > 0 || *digit != b'0'));
        rest = after;
    }
    rest
}

/// `exponent = [ sign ] digits`
fn exponent(text: &[u8]) -> Parsed<'_, i32> {
    let (rest, negative) = sign(text);
    let (rest, digits) = digits(rest)?;
    // the limit is far above the exponent of any float
    let add = |n: i32, digit: &u8| n.wrapping_mul(10).wrapping_add(i32::from(digit & 0x0f)).min(99_999);
    let size = digits.iter().fold(0, add);
    Ok((rest, if negative { size.wrapping_neg() } else { size }))
}

/// Distinguishes a date from a float: a slash precedes the end of the element.
fn is_date(text: &[u8]) -> bool {
    text.iter().find(|b| matches!(b, b'/' | b',' | b')')) == Some(&b'/')
}

/// `date = digits "/" digits "/" digits blank blanks digits ":" digits ":" digits`; the bits of its number
#[cfg_attr(target_os = "none", inline(never))]
fn date(text: &[u8]) -> Parsed<'_, u64> {
    let mut numbers = [0; 6];
    let mut rest = text;
    for (number, separator) in numbers.iter_mut().zip(b"// ::.") {
        (rest, *number) = date_number(rest)?;
        (rest, ()) = match (separator, rest) {
            (b'.', _) => (rest, ()),
            (b' ', [b' ' | b'\t', ..]) => (blanks(rest), ()),
            (wanted, _) => byte(*wanted, TextErrorKind::DateLayout)(rest)?,
        };
    }
    let [year, month, day, hour, minute, second] = numbers;
    let small = |number: i16| u8::try_from(number).ok();
    let civil =
        || Some(CivilTime::date(year, small(month)?, small(day)?).at(small(hour)?, small(minute)?, small(second)?));
    match civil().and_then(OleDate::from_civil) {
        Some(date) => Ok((rest, date.raw().to_bits())),
        None => fault(TextErrorKind::NoSuchDate, text),
    }
}

/// `digits`, at most four of them
fn date_number(text: &[u8]) -> Parsed<'_, i16> {
    match digits(text) {
        Ok((rest, digits)) if digits.len() <= 4 => {
            let add = |n: i16, digit: &u8| n.wrapping_mul(10).wrapping_add(i16::from(digit & 0x0f));
            Ok((rest, digits.iter().fold(0, add)))
        }
        _ => fault(TextErrorKind::DateLayout, text),
    }
}
