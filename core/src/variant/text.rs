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

use nom::Parser as _;
use nom::error::{ErrorKind, ParseError};
use nom::sequence::preceded;

use super::encode::{head, put_bits};
use super::float::{Decimal, Format, MAX_DIGITS, divide_by_10, low};
use super::{Bstr, CivilTime, Layout, OUTER, OleDate, VarType, Variant, VariantBuf};
use crate::error::{TextError, TextErrorKind};
use crate::num::{to_u32, to_usize};
use crate::wire::{Reader, Writer};

/// Bytes of the type in front of a value's count.
const TYPE_LEN: usize = 2;

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
        Self::build(|out| parse(text, out))
    }
}

impl Variant<'_> {
    /// Appends the text of the value.
    ///
    /// # Errors
    ///
    /// A [`TextError`] without a column when the value has no text or does not fit; part of it may have been written.
    pub fn write_text(&self, out: &mut Writer<'_>) -> Result<(), TextError> {
        print(*self, out).map_err(TextError::printing)
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

// --- reading -------------------------------------------------------------------------------------------------------

/// What is wrong, and how many bytes of the text were left when it was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    kind: TextErrorKind,
    left: usize,
}

impl Fault {
    pub(crate) const fn new(kind: TextErrorKind, rest: &[u8]) -> Self {
        Self { kind, left: rest.len() }
    }

    /// Places the fault in a text of `total` bytes.
    pub(crate) fn at(self, total: usize) -> TextError {
        TextError { kind: self.kind, column: to_u32(total.wrapping_sub(self.left).wrapping_add(1)) }
    }
}

impl From<nom::Err<Self>> for Fault {
    fn from(error: nom::Err<Self>) -> Self {
        match error {
            nom::Err::Error(fault) | nom::Err::Failure(fault) => fault,
            // only nom's streaming parsers ask for more, and none are used
            nom::Err::Incomplete(_) => Self { kind: TextErrorKind::Missing, left: 0 },
        }
    }
}

/// Every parser here makes its own faults; nom's combinators only ask for the bound.
impl ParseError<&[u8]> for Fault {
    fn from_error_kind(rest: &[u8], _: ErrorKind) -> Self {
        Self::new(TextErrorKind::Unexpected, rest)
    }

    fn append(_: &[u8], _: ErrorKind, other: Self) -> Self {
        other
    }
}

/// The rest of the text, and what was read.
pub(crate) type Parsed<'a, T> = nom::IResult<&'a [u8], T, Fault>;

const fn fault<T>(kind: TextErrorKind, rest: &[u8]) -> Parsed<'_, T> {
    Err(nom::Err::Error(Fault::new(kind, rest)))
}

/// `blanks = { " " | TAB }`
#[cfg_attr(target_os = "none", inline(never))]
pub(crate) fn blanks(text: &[u8]) -> Parsed<'_, ()> {
    let mut rest = text;
    while let [b' ' | b'\t', behind @ ..] = rest {
        rest = behind;
    }
    Ok((rest, ()))
}

/// One byte; `kind` says what its absence is.
#[inline]
pub(crate) const fn byte(wanted: u8, kind: TextErrorKind) -> impl Fn(&[u8]) -> Parsed<'_, ()> {
    move |text| match text.split_first() {
        Some((found, rest)) if *found == wanted => Ok((rest, ())),
        _ => fault(kind, text),
    }
}

/// `digits = digit { digit }`, or none; the caller decides whether that is allowed.
#[cfg_attr(target_os = "none", inline(never))]
fn digits(text: &[u8]) -> Parsed<'_, &[u8]> {
    let len = text.iter().position(|b| !b.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at_checked(len).unwrap_or((text, &[]));
    Ok((rest, digits))
}

/// `sign = "+" | "-"`, or none; true for minus.
#[cfg_attr(target_os = "none", inline(never))]
const fn sign(text: &[u8]) -> (&[u8], bool) {
    match text {
        [b'-', rest @ ..] => (rest, true),
        [b'+', rest @ ..] => (rest, false),
        _ => (text, false),
    }
}

/// `type = digits`
fn vartype(text: &[u8]) -> Parsed<'_, VarType> {
    let (rest, digits) = digits(text)?;
    if digits.is_empty() {
        return fault(TextErrorKind::Type, text);
    }
    let number = digits.iter().try_fold(0_u16, |n, digit| n.checked_mul(10)?.checked_add(u16::from(digit & 0x0f)));
    match number.map(VarType) {
        Some(vartype) if vartype.is_known() => Ok((rest, vartype)),
        unknown => fault(TextErrorKind::UnknownType(unknown.map_or(u16::MAX, |t| t.0)), text),
    }
}

/// A container of VARIANTs whose end has not been read yet.
#[derive(Clone, Copy, Default)]
struct Level {
    is_array: bool,
    /// Where in the encoding the count stands.
    count_at: usize,
    count: u32,
}

impl Level {
    /// Writes the head of a container or array whose count is not known yet.
    fn open(vartype: VarType, out: &mut Writer<'_>) -> Result<Self, TextErrorKind> {
        let level = Self { is_array: vartype.is_array(), count_at: out.len().wrapping_add(TYPE_LEN), count: 1 };
        head(vartype, 1, out).map_err(|_| TextErrorKind::Full)?;
        Ok(level)
    }

    /// Goes on behind an element: to the next one if there is a comma, or to the end.
    fn next<'a>(&mut self, rest: &'a [u8], out: &mut Writer<'_>) -> (&'a [u8], bool) {
        match rest {
            [b',', behind @ ..] if self.is_array => {
                self.count = self.count.wrapping_add(1);
                (behind, true)
            }
            _ => {
                if self.is_array {
                    out.patch(self.count_at, self.count.to_le_bytes());
                }
                (rest, false)
            }
        }
    }
}

/// Parses the text of one value and appends its encoding.
pub(crate) fn parse(text: &[u8], out: &mut Writer<'_>) -> Result<(), TextError> {
    value(text, out).map_err(|fault| fault.at(text.len()))
}

/// `value = blanks type [ "," data ]`
pub(crate) fn value(text: &[u8], out: &mut Writer<'_>) -> Result<(), Fault> {
    let (rest, vartype) = preceded(blanks, vartype).parse_complete(text)?;
    let rest = match vartype.element() {
        VarType::VARIANT => tree(text, out)?,
        _ => leaf(vartype, rest, false, out)?,
    };
    if rest.is_empty() { Ok(()) } else { Err(Fault::new(TextErrorKind::Unexpected, rest)) }
}

/// A value of VARIANTs, `"(" value ")" blanks` each, down and up again
#[inline(never)]
fn tree<'a>(text: &'a [u8], out: &mut Writer<'_>) -> Result<&'a [u8], Fault> {
    let mut levels = [Level::default(); OUTER];
    let mut depth = 0_usize;
    let mut rest = text;
    loop {
        let (behind, vartype) = preceded(blanks, vartype).parse_complete(rest)?;
        if vartype.element() == VarType::VARIANT {
            let slot = levels.get_mut(depth).ok_or(Fault::new(TextErrorKind::TooDeep, rest))?;
            *slot = Level::open(vartype, out).map_err(|kind| Fault::new(kind, rest))?;
            depth = depth.wrapping_add(1);
            let (data, ()) = byte(b',', TextErrorKind::Comma)(behind)?;
            rest = open_paren(data)?.0;
            continue;
        }
        rest = leaf(vartype, behind, true, out)?;
        while let Some(level) = depth.checked_sub(1).and_then(|top| levels.get_mut(top)) {
            let (behind, ()) = byte(b')', TextErrorKind::Unbalanced)(rest)?;
            let (behind, ()) = blanks(behind)?;
            let (behind, more) = level.next(behind, out);
            rest = behind;
            if more {
                break;
            }
            depth = depth.wrapping_sub(1);
        }
        if depth == 0 {
            return Ok(rest);
        }
        rest = open_paren(rest)?.0;
    }
}

/// `blanks "("`
fn open_paren(text: &[u8]) -> Parsed<'_, ()> {
    preceded(blanks, byte(b'(', TextErrorKind::OpenParen)).parse_complete(text)
}

/// Everything behind the type of a value that holds no VARIANT.
fn leaf<'a>(vartype: VarType, text: &'a [u8], nested: bool, out: &mut Writer<'_>) -> Result<&'a [u8], Fault> {
    if matches!(vartype.element(), VarType::EMPTY | VarType::NULL) {
        return nothing(vartype, text, nested, out);
    }
    let (data, ()) = byte(b',', TextErrorKind::Comma)(text)?;
    let mut level = Level::open(vartype, out).map_err(|kind| Fault::new(kind, text))?;
    let mut rest = data;
    loop {
        let (element, ()) = blanks(rest)?;
        let bounds = Bounds { nested, in_array: vartype.is_array() };
        rest = match vartype.element() {
            VarType::BSTR => string(element, bounds, out)?,
            _ if level.count == 1 && level.is_array && at_end(element, nested) => {
                return Err(Fault::new(TextErrorKind::EmptyArray, element));
            }
            scalar => number(scalar, element, nested, out)?,
        };
        let (behind, more) = level.next(rest, out);
        rest = behind;
        if !more {
            break;
        }
    }
    if at_end(rest, nested) { Ok(rest) } else { Err(Fault::new(behind_number(vartype.element(), rest), rest)) }
}

const fn at_end(rest: &[u8], nested: bool) -> bool {
    matches!(rest, []) || nested && matches!(rest, [b')', ..])
}

/// What it means that something stands behind a number.
const fn behind_number(element: VarType, rest: &[u8]) -> TextErrorKind {
    match rest {
        [b' ' | b'\t', ..] => TextErrorKind::BlankBehind,
        [b'.', ..] if matches!(element, VarType::CY) => TextErrorKind::CurrencyPoint,
        [b',' | b')', ..] => TextErrorKind::Unexpected,
        _ => TextErrorKind::Digit,
    }
}

/// `[ "," blanks ]`
fn nothing<'a>(vartype: VarType, text: &'a [u8], nested: bool, out: &mut Writer<'_>) -> Result<&'a [u8], Fault> {
    if vartype.is_array() {
        return Err(Fault::new(TextErrorKind::ArrayOfNothing, text));
    }
    head(vartype, 1, out).map_err(|_| Fault::new(TextErrorKind::Full, text))?;
    let rest = match text {
        [b',', behind @ ..] => blanks(behind)?.0,
        _ => text,
    };
    if at_end(rest, nested) { Ok(rest) } else { Err(Fault::new(TextErrorKind::NoData, rest)) }
}

/// Where a string stands, which decides what it cannot hold.
#[derive(Clone, Copy)]
struct Bounds {
    /// Inside of a VARIANT's parentheses.
    nested: bool,
    in_array: bool,
}

/// `string`
fn string<'a>(text: &'a [u8], bounds: Bounds, out: &mut Writer<'_>) -> Result<&'a [u8], Fault> {
    let len = string_len(text, bounds)?;
    let (bytes, rest) = text.split_at_checked(len).unwrap_or((text, &[]));
    if let Some(at) = bytes.iter().position(|b| matches!(b, b'\r' | b'\n')) {
        return Err(Fault { kind: TextErrorKind::LineBreak, left: text.len().wrapping_sub(at) });
    }
    let full = Fault::new(TextErrorKind::Full, text);
    let head_at = out.len();
    out.put([0; 4]).map_err(|_| full)?;
    let mut left = bytes;
    while !left.is_empty() {
        let (c, behind) =
            character(left).ok_or(Fault { kind: TextErrorKind::Utf8, left: rest.len().wrapping_add(left.len()) })?;
        left = behind;
        for unit in c.encode_utf16(&mut [0; 2]) {
            out.put(unit.to_le_bytes()).map_err(|_| full)?;
        }
    }
    let len = out.len().wrapping_sub(head_at).wrapping_sub(4);
    out.patch(head_at, to_u32(len).to_le_bytes());
    Ok(rest)
}

/// Splits a character off UTF-8; `None` when that is broken.
///
/// The standard library's check takes 620 bytes with its table, which nothing else on a board needs.
fn character(text: &[u8]) -> Option<(char, &[u8])> {
    let (first, mut rest) = text.split_first()?;
    // the least code of so many bytes, which a longer form must not be used for
    let (least, count, bits) = match first {
        0..0x80 => (0, 0, *first),
        0xc0..0xe0 => (0x80, 1, first & 0x1f),
        0xe0..0xf0 => (0x800, 2, first & 0x0f),
        0xf0..0xf8 => (0x1_0000, 3, first & 0x07),
        _ => return None,
    };
    let mut code = u32::from(bits);
    for _ in 0..count {
        let (next, behind) = rest.split_first().filter(|(next, _)| **next & 0xc0 == 0x80)?;
        code = code << 6 | u32::from(next & 0x3f);
        rest = behind;
    }
    let c = char::from_u32(code).filter(|_| code >= least)?;
    Some((c, rest))
}

/// Finds the end of a string.
fn string_len(text: &[u8], bounds: Bounds) -> Result<usize, Fault> {
    if !bounds.nested && !bounds.in_array {
        return Ok(text.len());
    }
    let mut open = 0_u32;
    for (at, b) in text.iter().enumerate() {
        let fault = |kind| Err(Fault { kind, left: text.len().wrapping_sub(at) });
        match b {
            b'(' => open = open.wrapping_add(1),
            b')' => match open.checked_sub(1) {
                Some(outer) => open = outer,
                None if bounds.nested => return Ok(at),
                None => return fault(TextErrorKind::Unbalanced),
            },
            b',' if bounds.in_array && open > 0 => return fault(TextErrorKind::CommaInString),
            b',' if bounds.in_array => return Ok(at),
            _ => {}
        }
    }
    if open > 0 || bounds.nested { Err(Fault { kind: TextErrorKind::Unbalanced, left: 0 }) } else { Ok(text.len()) }
}

/// One number or date, appended as the data of an element.
fn number<'a>(element: VarType, text: &'a [u8], nested: bool, out: &mut Writer<'_>) -> Result<&'a [u8], Fault> {
    if at_end(text, nested) {
        return Err(Fault::new(TextErrorKind::Missing, text));
    }
    let (rest, (bits, width)) = match element {
        VarType::DATE if is_date(text) => {
            let (rest, bits) = date(text)?;
            (rest, (bits, 8))
        }
        VarType::R4 | VarType::R8 | VarType::DATE => {
            let (format, width) = if element == VarType::R4 { (Format::Single, 4) } else { (Format::Double, 8) };
            let (rest, bits) = float(text, format)?;
            (rest, (bits, width))
        }
        _ => {
            let (rest, number) = integer(text)?;
            (rest, number.to_wire(element).ok_or(Fault::new(TextErrorKind::OutOfRange, text))?)
        }
    };
    put_bits(bits, width, out).map_err(|_| Fault::new(TextErrorKind::Full, text))?;
    Ok(rest)
}

/// An integer as it was written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Integer {
    negative: bool,
    magnitude: u64,
    hex: bool,
}

impl Integer {
    /// Returns the number as the bits of an integer of `width` bytes, the sign repeated above them; `None` when it is
    /// out of range.
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

    /// Returns the number as 32 bits: signed, or unsigned as the bits of it when `unsigned` allows that.
    pub(crate) fn to_code(self, unsigned: bool) -> Option<i32> {
        let [a, b, c, d, ..] = self.bits(4, self.negative || !(unsigned || self.hex))?.to_le_bytes();
        Some(i32::from_le_bytes([a, b, c, d]))
    }

    /// Returns the number as the data of an element, and how many bytes that are.
    fn to_wire(self, element: VarType) -> Option<(u64, u8)> {
        let Layout::Fixed(width) = element.layout() else { return None };
        let bits = match element {
            VarType::ERROR => u64::from(self.to_code(false)?.cast_unsigned()),
            // true is -1 on the wire, whatever was written
            VarType::BOOL => u64::from(self.bits(width, true)? != 0).wrapping_neg(),
            VarType::UI1 | VarType::UI2 | VarType::UI4 | VarType::UI8 => self.bits(width, false)?,
            _ => self.bits(width, true)?,
        };
        Some((bits, width))
    }
}

/// `integer = [ sign ] ( digits | "0x" hexdigits )`
pub(crate) fn integer(text: &[u8]) -> Parsed<'_, Integer> {
    let (rest, negative) = sign(text);
    let (rest, hex) = match rest {
        [b'0', b'x' | b'X', rest @ ..] => (rest, true),
        _ => (rest, false),
    };
    let mut magnitude = 0_u64;
    let mut behind = rest;
    while let [b, next @ ..] = behind {
        let digit = match b {
            b'0'..=b'9' => b & 0x0f,
            b'a'..=b'f' | b'A'..=b'F' if hex => (b & 0x0f).wrapping_add(9),
            _ => break,
        };
        let Some(sum) = magnitude.checked_mul(if hex { 16 } else { 10 }).and_then(|m| m.checked_add(u64::from(digit)))
        else {
            return fault(TextErrorKind::OutOfRange, text);
        };
        magnitude = sum;
        behind = next;
    }
    if behind.len() == rest.len() {
        let kind = if matches!(rest, [] | [b',' | b')', ..]) { TextErrorKind::Missing } else { TextErrorKind::Digit };
        return fault(kind, rest);
    }
    Ok((behind, Integer { negative, magnitude, hex }))
}

/// Parses a text that is one R8 and nothing else.
pub(crate) fn double(text: &[u8]) -> Result<f64, TextError> {
    match float(text, Format::Double) {
        Ok(([], bits)) => Ok(f64::from_bits(bits)),
        Ok((rest, _)) => Err(Fault::new(TextErrorKind::Digit, rest).at(text.len())),
        Err(error) => Err(Fault::from(error).at(text.len())),
    }
}

/// `float = [ sign ] ( decimal [ "e" [ sign ] digits ] | "inf" | "nan" )`, words in any case; its bits
fn float(text: &[u8], format: Format) -> Parsed<'_, u64> {
    let (unsigned, negative) = sign(text);
    let (word, behind) = unsigned.split_at_checked(3).unwrap_or_default();
    let (rest, bits) = match word.first_chunk().map(|word: &[u8; 3]| word.map(|byte| byte | 0x20)) {
        Some([b'i', b'n', b'f']) => (behind, format.infinity()),
        Some([b'n', b'a', b'n']) => (behind, format.nan()),
        _ => {
            let (rest, decimal) = decimal(unsigned)?;
            match format.of_decimal(&decimal) {
                Some(bits) => (rest, bits),
                None => return fault(TextErrorKind::OutOfRange, text),
            }
        }
    };
    Ok((rest, if negative { bits | format.sign() } else { bits }))
}

/// `decimal [ "e" [ sign ] digits ]`, `decimal = digits [ "." [ digits ] ] | "." digits`
pub(super) fn decimal(text: &[u8]) -> Parsed<'_, Decimal<'_>> {
    let mut number = Decimal { digits: text, count: 0, number: 0, exponent: 0 };
    let (mut rest, mut has_digits, mut has_point) = (text, false, false);
    while let [byte, behind @ ..] = rest {
        match byte {
            b'0'..=b'9' => {
                has_digits = true;
                // all three are right as far as they are used; too many digits are refused below
                number.exponent = number.exponent.wrapping_sub(i32::from(has_point));
                number.number = number.number.wrapping_mul(10).wrapping_add(u64::from(byte & 0x0f));
                number.count = number.count.wrapping_add(u32::from(number.count > 0 || *byte != b'0'));
            }
            b'.' if !has_point => has_point = true,
            _ => break,
        }
        rest = behind;
    }
    if !has_digits {
        let kind = if matches!(text, [] | [b',' | b')', ..]) { TextErrorKind::Missing } else { TextErrorKind::Digit };
        return fault(kind, text);
    }
    number.digits = text.get(..text.len().wrapping_sub(rest.len())).unwrap_or_default();
    if let [b'e' | b'E', behind @ ..] = rest {
        let exponent;
        (rest, exponent) = exponent_of(behind)?;
        number.exponent = number.exponent.wrapping_add(exponent);
    }
    // the exponent counts, or the time to read one would have no bound
    if text.len().wrapping_sub(rest.len()) > MAX_DIGITS {
        return fault(TextErrorKind::NumberTooLong, text);
    }
    Ok((rest, number))
}

/// `[ sign ] digits`, behind the `e`
fn exponent_of(text: &[u8]) -> Parsed<'_, i32> {
    let (rest, negative) = sign(text);
    let (behind, digits) = digits(rest)?;
    if digits.is_empty() {
        return fault(TextErrorKind::Digit, rest);
    }
    // no float has an exponent near the bound, whatever its digits
    let size =
        digits.iter().fold(0_i32, |n, digit| n.wrapping_mul(10).wrapping_add(i32::from(digit & 0x0f)).min(99_999));
    Ok((behind, if negative { size.wrapping_neg() } else { size }))
}

/// Tells a date from the raw number of one.
fn is_date(text: &[u8]) -> bool {
    text.iter().take_while(|b| !matches!(b, b',' | b')')).any(|b| *b == b'/')
}

/// `date = digits "/" digits "/" digits blank blanks digits ":" digits ":" digits`
fn date(text: &[u8]) -> Parsed<'_, u64> {
    let mut numbers = [0; 6];
    let mut rest = text;
    for (number, separator) in numbers.iter_mut().zip(b"// ::.") {
        (rest, *number) = field(rest)?;
        rest = match (separator, rest) {
            (b'.', _) => rest,
            (b' ', [b' ' | b'\t', ..]) => blanks(rest)?.0,
            (wanted, _) => byte(*wanted, TextErrorKind::DateLayout)(rest)?.0,
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
fn field(text: &[u8]) -> Parsed<'_, i16> {
    let (rest, digits) = digits(text)?;
    if digits.is_empty() || digits.len() > 4 {
        return fault(TextErrorKind::DateLayout, text);
    }
    let number = digits.iter().fold(0_i16, |n, digit| n.wrapping_mul(10).wrapping_add(i16::from(digit & 0x0f)));
    Ok((rest, number))
}

// --- writing -------------------------------------------------------------------------------------------------------

type Printed = Result<(), TextErrorKind>;

#[cfg_attr(target_os = "none", inline(never))]
fn put(bytes: &[u8], out: &mut Writer<'_>) -> Printed {
    out.put_slice(bytes).map_err(|_| TextErrorKind::Full)
}

#[cfg_attr(target_os = "none", inline(never))]
fn put_byte(byte: u8, out: &mut Writer<'_>) -> Printed {
    out.put([byte]).map_err(|_| TextErrorKind::Full)
}

fn put_type(vartype: VarType, out: &mut Writer<'_>) -> Printed {
    put_integer(false, u64::from(vartype.0), out)?;
    put_byte(b',', out)
}

fn print(value: Variant<'_>, out: &mut Writer<'_>) -> Printed {
    if let Variant::Opaque(opaque) = value {
        return Err(TextErrorKind::Unsendable(opaque.vartype.0));
    }
    put_type(value.vartype(), out)?;
    match value {
        Variant::Nested(nested) => print_inner(&mut Reader::new(nested.0), 1, out),
        Variant::Array(array) if array.element() == VarType::VARIANT => {
            print_inner(&mut Reader::new(array.as_bytes()), to_u32(array.len()), out)
        }
        Variant::Array(array) => {
            let bounds = Bounds { nested: false, in_array: true };
            print_elements(array.element(), to_u32(array.len()), bounds, &mut Reader::new(array.as_bytes()), out)
        }
        scalar => print_scalar(scalar, Bounds { nested: false, in_array: false }, out),
    }
}

/// Writes `count` values of a container, each in parentheses, and what is inside of them.
fn print_inner(r: &mut Reader<'_>, count: u32, out: &mut Writer<'_>) -> Printed {
    // values still to come on each outer level; `here` is the innermost
    let mut outer = [0_u32; OUTER];
    let mut depth = 0_usize;
    let mut here = count;
    loop {
        here = here.checked_sub(1).ok_or(TextErrorKind::EmptyArray)?;
        put_byte(b'(', out)?;
        let (vartype, count) = split_head(r).unwrap_or_default();
        put_type(vartype, out)?;
        if vartype.element() == VarType::VARIANT {
            *outer.get_mut(depth).ok_or(TextErrorKind::TooDeep)? = here;
            depth = depth.wrapping_add(1);
            here = count;
            continue;
        }
        print_elements(vartype.element(), count, Bounds { nested: true, in_array: vartype.is_array() }, r, out)?;
        put_byte(b')', out)?;
        while here == 0 {
            let Some(up) = depth.checked_sub(1) else { return Ok(()) };
            depth = up;
            here = outer.get(up).copied().unwrap_or(0);
            put_byte(b')', out)?;
        }
        put_byte(b',', out)?;
    }
}

/// Splits type and count of a checked value off; a scalar counts 1.
fn split_head(r: &mut Reader<'_>) -> Option<(VarType, u32)> {
    let vartype = VarType(u16::from_le_bytes(r.array()?));
    let count = r.u32()?;
    Some((vartype, if vartype.is_array() { count } else { 1 }))
}

/// Writes the elements of an array, or the one of a scalar, that are no VARIANTs.
fn print_elements(element: VarType, count: u32, bounds: Bounds, r: &mut Reader<'_>, out: &mut Writer<'_>) -> Printed {
    match element {
        VarType::EMPTY | VarType::NULL if bounds.in_array => return Err(TextErrorKind::ArrayOfNothing),
        _ if count == 0 => return Err(TextErrorKind::EmptyArray),
        _ => {}
    }
    for index in 0..to_usize(count) {
        if index > 0 {
            put_byte(b',', out)?;
        }
        print_scalar(Variant::read_data(element, r), bounds, out)?;
    }
    Ok(())
}

fn print_scalar(value: Variant<'_>, bounds: Bounds, out: &mut Writer<'_>) -> Printed {
    let number = match value {
        Variant::R4(n) => return print_float(u64::from(n.to_bits()), Format::Single, out),
        Variant::R8(n) => return print_float(n.to_bits(), Format::Double, out),
        Variant::Date(date) => return print_date(date, out),
        Variant::Bstr(text) => return print_string(text, bounds, out),
        Variant::Ui8(n) => return put_integer(false, n, out),
        Variant::Bool(b) => i64::from(b).wrapping_neg(),
        Variant::Error(code) => i64::from(code.0),
        Variant::Cy(amount) => amount.raw(),
        other => match other.as_i64() {
            Some(n) => n,
            // EMPTY and NULL
            None => return Ok(()),
        },
    };
    put_integer(number < 0, number.unsigned_abs(), out)
}

/// The most digits of 64 bits.
const MAX_INTEGER: usize = 20;

/// Writes a decimal number.
pub(crate) fn put_integer(negative: bool, magnitude: u64, out: &mut Writer<'_>) -> Printed {
    if negative {
        put_byte(b'-', out)?;
    }
    if magnitude < 10 {
        return put_byte(digit(low(magnitude)), out);
    }
    put(decimal_digits(magnitude, &mut [0; MAX_INTEGER]), out)
}

/// Writes the digits of a number that is not 0 to the end of a buffer, and returns them.
fn decimal_digits(number: u64, buffer: &mut [u8; MAX_INTEGER]) -> &[u8] {
    let (mut left, mut from) = (number, buffer.len());
    for slot in buffer.iter_mut().rev() {
        if left == 0 {
            break;
        }
        let last;
        (left, last) = divide_by_10(left);
        *slot = digit(last);
        from = from.wrapping_sub(1);
    }
    buffer.get(from..).unwrap_or_default()
}

#[inline]
fn digit(number: u32) -> u8 {
    b'0' | u8::try_from(number).unwrap_or(0)
}

/// Writes a number of the calendar, with a zero in front if it is below `least`.
fn put_padded(least: u16, number: u16, out: &mut Writer<'_>) -> Printed {
    if number < least {
        put_byte(b'0', out)?;
    }
    put_integer(false, u64::from(number), out)
}

/// Writes a float of its bits.
///
/// Without an exponent where that takes at most 16 digits in front of the point, or four zeros behind it.
fn print_float(bits: u64, format: Format, out: &mut Writer<'_>) -> Printed {
    let magnitude = bits & !format.sign();
    if magnitude > format.infinity() && magnitude != format.nan() {
        return Err(TextErrorKind::NanPayload);
    }
    if magnitude != bits {
        put_byte(b'-', out)?;
    }
    if magnitude >= format.infinity() {
        return put(if magnitude == format.infinity() { b"inf" } else { b"NaN" }, out);
    }
    if let Some(whole) = format.whole(magnitude) {
        return put_integer(false, whole, out);
    }
    let (number, exponent) = format.shortest(magnitude);
    let mut buffer = [0; MAX_INTEGER];
    put_decimal(decimal_digits(number, &mut buffer), exponent, out)
}

/// Writes `digits * 10^exponent`, the last digit of which is not 0.
fn put_decimal(digits: &[u8], exponent: i32, out: &mut Writer<'_>) -> Printed {
    // how many digits are in front of the point
    let point = exponent.wrapping_add_unsigned(to_u32(digits.len()));
    let (front, zeros) = match point {
        1..=16 => (point, exponent.max(0)),
        -4..=0 => (0, point.wrapping_neg()),
        _ => (1, 0),
    };
    let (integer, fraction) = digits.split_at_checked(to_usize(front.unsigned_abs())).unwrap_or((digits, &[]));
    if front == 0 {
        put(b"0.", out)?;
    }
    put(integer, out)?;
    (0..zeros).try_for_each(|_| put_byte(b'0', out))?;
    if front > 0 && !fraction.is_empty() {
        put_byte(b'.', out)?;
    }
    put(fraction, out)?;
    if (-4..=16).contains(&point) {
        return Ok(());
    }
    put_byte(b'e', out)?;
    let exponent = point.wrapping_sub(1);
    put_integer(exponent < 0, u64::from(exponent.unsigned_abs()), out)
}

fn print_date(date: OleDate, out: &mut Writer<'_>) -> Printed {
    let same = |civil: &CivilTime| civil.millisecond == 0 && OleDate::from_civil(*civil) == Some(date);
    let Some(civil) = date.to_civil().filter(same) else {
        return print_float(date.raw().to_bits(), Format::Double, out);
    };
    let numbers = [civil.month, civil.day, civil.hour, civil.minute, civil.second];
    put_padded(1000, civil.year.unsigned_abs(), out)?;
    for (separator, number) in b"// ::".iter().zip(numbers) {
        put_byte(*separator, out)?;
        put_padded(10, u16::from(number), out)?;
    }
    Ok(())
}

fn print_string(text: Bstr<'_>, bounds: Bounds, out: &mut Writer<'_>) -> Printed {
    let mut open = 0_u32;
    let mut first = true;
    for c in text.chars() {
        let c = c.map_err(|_| TextErrorKind::LoneSurrogate)?;
        match c {
            ' ' | '\t' if first => return Err(TextErrorKind::LeadingBlank),
            '\r' | '\n' => return Err(TextErrorKind::LineBreak),
            ',' if bounds.in_array => return Err(TextErrorKind::CommaInString),
            '(' => open = open.wrapping_add(1),
            ')' if bounds.nested || bounds.in_array => open = open.checked_sub(1).ok_or(TextErrorKind::Unbalanced)?,
            _ => {}
        }
        first = false;
        let slot = out.reserve(c.len_utf8()).map_err(|_| TextErrorKind::Full)?;
        super::bstr::put_utf8(c, slot).ok_or(TextErrorKind::Full)?;
    }
    if open > 0 && (bounds.nested || bounds.in_array) { Err(TextErrorKind::Unbalanced) } else { Ok(()) }
}

#[cfg(test)]
mod tests;
