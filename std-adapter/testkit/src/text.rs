//! The oracle of the text format: a recursive, allocating parser with the standard library's floats, and the rule for which
//! values have a text.
//!
//! Both are written from the grammar, not from the core. Only the instants of dates use the core.

use bcap_core::limits::MAX_DEPTH;
use bcap_core::variant::{CivilTime, OleDate};

use crate::value::{ARRAY, VARIANT, Value};

/// The maximum length of a float that is read exactly.
const MAX_FLOAT: usize = 500;

/// Parses the text of one value; `None` when it is invalid.
#[must_use]
pub fn parse(text: &[u8]) -> Option<Value> {
    let mut rest = text;
    let value = value(&mut rest, Place { inside: false, in_array: false }, usize::from(MAX_DEPTH))?;
    rest.is_empty().then_some(value)
}

/// Parses a response of RAC without its CR: the HRESULT, and a value after a comma; `None` when it is invalid.
#[must_use]
pub fn response(line: &[u8]) -> Option<(i32, Option<Value>)> {
    let mut rest = line;
    blanks(&mut rest);
    let result = integer(ascii(run(&mut rest, |b| b != b',' && b != b' ' && b != b'\t')))?;
    let result = i32::try_from(result).ok().or_else(|| u32::try_from(result).ok().map(u32::cast_signed))?;
    blanks(&mut rest);
    if rest.is_empty() {
        return Some((result, None));
    }
    next(&mut rest, b',')?;
    parse(rest).map(|value| (result, Some(value)))
}

/// The context of a string.
#[derive(Clone, Copy)]
struct Place {
    /// In parentheses.
    inside: bool,
    in_array: bool,
}

fn next(rest: &mut &[u8], wanted: u8) -> Option<()> {
    let (first, behind) = rest.split_first()?;
    (*first == wanted).then(|| *rest = behind)
}

/// Splits off the longest prefix whose bytes are all of one kind.
fn run<'a>(rest: &mut &'a [u8], of: impl Fn(u8) -> bool) -> &'a [u8] {
    let (front, behind) = rest.split_at(rest.iter().take_while(|b| of(**b)).count());
    *rest = behind;
    front
}

fn blanks(rest: &mut &[u8]) -> usize {
    run(rest, |b| b == b' ' || b == b'\t').len()
}

fn value(rest: &mut &[u8], place: Place, depth: usize) -> Option<Value> {
    blanks(rest);
    let vartype: u16 = ascii(run(rest, |b| b.is_ascii_digit())).parse().ok()?;
    let (element, is_array) = (vartype & !ARRAY, vartype & ARRAY != 0);
    let place = Place { in_array: is_array, ..place };
    if element < 2 {
        if next(rest, b',').is_some() {
            blanks(rest);
        }
        let value = if element == 0 { Value::Empty } else { Value::Null };
        return (!is_array).then_some(value);
    }
    next(rest, b',')?;
    let mut items = Vec::new();
    loop {
        blanks(rest);
        items.push(match element {
            VARIANT => {
                next(rest, b'(')?;
                let inner = value(rest, Place { inside: true, in_array: false }, depth.checked_sub(1)?)?;
                next(rest, b')')?;
                blanks(rest);
                inner
            }
            8 => string(rest, place)?,
            _ => number(element, run(rest, |b| b != b',' && b != b')'))?,
        });
        if !is_array {
            let only = items.pop()?;
            return Some(if element == VARIANT { Value::Nested(Box::new(only)) } else { only });
        }
        if next(rest, b',').is_none() {
            return Some(Value::Array(element, items));
        }
    }
}

fn ascii(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).unwrap_or("not ASCII")
}

fn string(rest: &mut &[u8], place: Place) -> Option<Value> {
    let mut open = 0;
    let mut len = rest.len();
    for (at, b) in rest.iter().enumerate().filter(|_| place.inside || place.in_array) {
        match b {
            b'(' => open += 1,
            b')' if open > 0 => open -= 1,
            b')' | b',' if (*b == b')' && place.inside) || (*b == b',' && place.in_array && open == 0) => {
                len = at;
                break;
            }
            b')' => return None,
            b',' if place.in_array => return None,
            _ => {}
        }
    }
    let (text, behind) = rest.split_at(len);
    *rest = behind;
    let closed = open == 0 && (!place.inside || !behind.is_empty());
    let text = str::from_utf8(text).ok().filter(|text| closed && !text.contains(['\r', '\n']))?;
    Some(Value::text(text))
}

fn number(element: u16, text: &[u8]) -> Option<Value> {
    let text = str::from_utf8(text).ok()?;
    Some(match element {
        4 => Value::R4(single(text)?),
        5 => Value::R8(double(text)?),
        7 if text.contains('/') => Value::Date(date(text)?),
        7 => Value::Date(double(text)?),
        2 => Value::I2(integer(text)?.try_into().ok()?),
        3 => Value::I4(integer(text)?.try_into().ok()?),
        6 => Value::Cy(integer(text)?.try_into().ok()?),
        10 if text.contains(['x', 'X']) && !text.starts_with('-') => {
            Value::Error(u32::try_from(integer(text)?).ok()? as i32)
        }
        10 => Value::Error(integer(text)?.try_into().ok()?),
        11 => Value::Bool(i16::try_from(integer(text)?).ok()? != 0),
        17 => Value::Ui1(integer(text)?.try_into().ok()?),
        18 => Value::Ui2(integer(text)?.try_into().ok()?),
        19 => Value::Ui4(integer(text)?.try_into().ok()?),
        20 => Value::I8(integer(text)?.try_into().ok()?),
        21 => Value::Ui8(integer(text)?.try_into().ok()?),
        _ => return None,
    })
}

/// `[ sign ] ( digits | "0x" hexdigits )`, of a magnitude that fits 64 bits
fn integer(text: &str) -> Option<i128> {
    let unsigned = text.strip_prefix(['+', '-']).unwrap_or(text);
    let hex = unsigned.strip_prefix("0x").or(unsigned.strip_prefix("0X"));
    let (digits, radix) = hex.map_or((unsigned, 10), |digits| (digits, 16));
    if digits.starts_with(['+', '-']) {
        return None;
    }
    let magnitude = i128::from(u64::from_str_radix(digits, radix).ok()?);
    Some(if text.starts_with('-') { -magnitude } else { magnitude })
}

/// Returns the text of a float for the standard library; `None` for words that only the library accepts.
fn float(text: &str) -> Option<&str> {
    let unsigned = text.strip_prefix(['+', '-']).unwrap_or(text);
    if unsigned.eq_ignore_ascii_case("inf") || unsigned.eq_ignore_ascii_case("nan") {
        return Some(text);
    }
    let numeric = unsigned.bytes().all(|b| b.is_ascii_digit() || b".eE+-".contains(&b));
    (numeric && unsigned.len() <= MAX_FLOAT).then_some(text)
}

/// A number that is not 0 but would become 0, or that would become infinite, is out of range.
fn in_range(text: &str, zero: bool, infinite: bool) -> bool {
    let mantissa = text.split(['e', 'E']).next().unwrap_or_default();
    let word = text.to_ascii_lowercase().ends_with("inf");
    (!zero || !mantissa.contains(['1', '2', '3', '4', '5', '6', '7', '8', '9'])) && (!infinite || word)
}

fn single(text: &str) -> Option<u32> {
    let number: f32 = float(text)?.parse().ok()?;
    if number.is_nan() {
        return Some(0x7fc0_0000 | u32::from(text.starts_with('-')) << 31);
    }
    in_range(text, number == 0.0, number.is_infinite()).then_some(number.to_bits())
}

fn double(text: &str) -> Option<u64> {
    let number: f64 = float(text)?.parse().ok()?;
    if number.is_nan() {
        return Some(0x7ff8 << 48 | u64::from(text.starts_with('-')) << 63);
    }
    in_range(text, number == 0.0, number.is_infinite()).then_some(number.to_bits())
}

/// `digits "/" digits "/" digits blank blanks digits ":" digits ":" digits`
fn date(text: &str) -> Option<u64> {
    let mut rest = text.as_bytes();
    let mut fields = [0_i16; 6];
    for (index, field) in fields.iter_mut().enumerate() {
        match index {
            0 => {}
            3 if blanks(&mut rest) > 0 => {}
            3 => return None,
            1 | 2 => next(&mut rest, b'/')?,
            _ => next(&mut rest, b':')?,
        }
        let digits = run(&mut rest, |b| b.is_ascii_digit());
        *field = ascii(digits).parse().ok().filter(|_| digits.len() <= 4)?;
    }
    let small = |at: usize| u8::try_from(fields[at]).ok();
    let civil = CivilTime::date(fields[0], small(1)?, small(2)?).at(small(3)?, small(4)?, small(5)?);
    rest.is_empty().then(|| OleDate::from_civil(civil))?.map(|date| date.raw().to_bits())
}

/// Returns whether a value has a text form.
#[must_use]
pub fn has_text(value: &Value) -> bool {
    has_text_in(value, false)
}

fn has_text_in(value: &Value, inside: bool) -> bool {
    match value {
        Value::Nested(inner) => has_text_in(inner, true),
        Value::Array(_, items) if items.is_empty() => false,
        Value::Array(VARIANT, items) => items.iter().all(|item| has_text_in(item, true)),
        Value::Array(0 | 1, _) => false,
        Value::Array(_, items) => items.iter().all(|item| scalar_has_text(item, Place { inside, in_array: true })),
        scalar => scalar_has_text(scalar, Place { inside, in_array: false }),
    }
}

fn scalar_has_text(value: &Value, place: Place) -> bool {
    let plain_nan = |is_nan: bool, payload: u64, quiet: u64| !is_nan || payload == quiet;
    match value {
        Value::R4(bits) => plain_nan(f32::from_bits(*bits).is_nan(), u64::from(bits & 0x7f_ffff), 0x40_0000),
        Value::R8(bits) | Value::Date(bits) => {
            plain_nan(f64::from_bits(*bits).is_nan(), bits & 0xf_ffff_ffff_ffff, 0x8_0000_0000_0000)
        }
        Value::Bstr(units) => string_has_text(units, place),
        Value::Opaque(..) => false,
        _ => true,
    }
}

fn string_has_text(units: &[u16], place: Place) -> bool {
    let Ok(text) = String::from_utf16(units) else { return false };
    if text.starts_with([' ', '\t']) || text.contains(['\r', '\n']) || (place.in_array && text.contains(',')) {
        return false;
    }
    let mut open = 0;
    for c in text.chars().filter(|_| place.inside || place.in_array) {
        open += i32::from(c == '(') - i32::from(c == ')');
        if open < 0 {
            return false;
        }
    }
    open == 0
}
