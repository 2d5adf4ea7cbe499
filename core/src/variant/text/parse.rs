//! The grammar of values as nom parsers; each quotes its rule.
//!
//! A parser that reads a value appends the encoding to a [`Writer`], so the text is read once and needs no other memory.
//! Every error is final: the first bytes determine which rule applies, so no parser tries a second rule.

use nom::Parser;
use nom::sequence::preceded;

use super::grammar::{Parsed, StringContext, blanks, byte, fault};
use super::number::{digits, number};
use super::string::string;
use crate::error::TextErrorKind;
use crate::variant::encode::head;
use crate::variant::{OUTER, VarType};
use crate::wire::Writer;

/// `blanks type`, `type = digits`
#[cfg_attr(target_os = "none", inline(never))]
fn vartype(text: &[u8]) -> Parsed<'_, VarType> {
    let text = blanks(text);
    let Ok((rest, digits)) = digits(text) else { return fault(TextErrorKind::Type, text) };
    let number = digits.iter().try_fold(0_u16, |n, digit| n.checked_mul(10)?.checked_add(u16::from(digit & 0x0f)));
    match number.map(VarType) {
        Some(vartype) if vartype.is_known() => Ok((rest, vartype)),
        unknown => fault(TextErrorKind::UnknownType(unknown.map_or(u16::MAX, |t| t.0)), text),
    }
}

/// `value = blanks type data`
pub(crate) fn value<'a>(text: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, ()> {
    let (rest, vartype) = vartype(text)?;
    match vartype.element() {
        VarType::VARIANT => tree(text, out),
        _ => data(vartype, rest, false, out),
    }
}

/// `blanks "("`
fn open(text: &[u8]) -> Parsed<'_, ()> {
    let rest = blanks(text);
    byte(b'(', TextErrorKind::OpenParen)(rest)
}

/// `")" blanks`
fn close(text: &[u8]) -> Parsed<'_, ()> {
    let (rest, ()) = byte(b')', TextErrorKind::Unbalanced)(text)?;
    Ok((blanks(rest), ()))
}

/// A `value` of VARIANTs: `blanks type { "," blanks "(" value ")" blanks }`, without recursion
#[inline(never)]
fn tree<'a>(text: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, ()> {
    // open containers, the outermost first
    let mut levels = [Level::default(); OUTER];
    let mut depth = 0_usize;
    let mut rest = text;
    loop {
        let (after, vartype) = vartype(rest)?;
        if vartype.element() == VarType::VARIANT {
            let Some(slot) = levels.get_mut(depth) else { return fault(TextErrorKind::TooDeep, rest) };
            let (_, level) = Level::open(vartype, rest, out)?;
            *slot = level;
            depth = depth.wrapping_add(1);
            (rest, ()) = preceded(byte(b',', TextErrorKind::Comma), open).parse_complete(after)?;
            continue;
        }
        (rest, ()) = data(vartype, after, true, out)?;
        while let Some(level) = depth.checked_sub(1).and_then(|top| levels.get_mut(top)) {
            (rest, ()) = close(rest)?;
            if let Some(element) = level.next(rest) {
                rest = element;
                break;
            }
            level.close(out);
            depth = depth.wrapping_sub(1);
        }
        if depth == 0 {
            return Ok((rest, ()));
        }
        (rest, ()) = open(rest)?;
    }
}

/// A value whose type is already written and whose elements are still being read.
#[derive(Clone, Copy, Default)]
struct Level {
    is_array: bool,
    /// Offset of the count in the encoding.
    count_at: usize,
    count: u32,
}

impl Level {
    /// Appends type and count; the count is 1 until [`close`](Self::close).
    fn open<'a>(vartype: VarType, text: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, Self> {
        const TYPE_LEN: usize = 2;
        let level = Self { is_array: vartype.is_array(), count_at: out.len().wrapping_add(TYPE_LEN), count: 1 };
        match head(vartype, 1, out) {
            Ok(()) => Ok((text, level)),
            Err(_) => fault(TextErrorKind::Full, text),
        }
    }

    /// Counts the next element of an array and returns its text; `None` without a comma.
    fn next<'a>(&mut self, rest: &'a [u8]) -> Option<&'a [u8]> {
        let (b',', element) = rest.split_first().filter(|_| self.is_array)? else { return None };
        self.count = self.count.wrapping_add(1);
        Some(element)
    }

    /// Writes the count of an array.
    fn close(&self, out: &mut Writer<'_>) {
        if self.is_array {
            out.patch(self.count_at, self.count.to_le_bytes());
        }
    }
}

/// `data = { "," blanks element }` of types that hold no VARIANT: one element for a scalar, one or more for an array
fn data<'a>(vartype: VarType, text: &'a [u8], nested: bool, out: &mut Writer<'_>) -> Parsed<'a, ()> {
    match vartype.element() {
        VarType::EMPTY | VarType::NULL => nothing(vartype, text, nested, out),
        // positions are R4: a copy for them saves a quarter of their instructions, and a board has no flash for it
        VarType::R4 if cfg!(not(target_os = "none")) => elements(VarType::R4, vartype, text, nested, out),
        element => elements(element, vartype, text, nested, out),
    }
}

/// `data` of an `element` type that may be a constant
#[cfg_attr(not(target_os = "none"), inline(always))]
fn elements<'a>(
    element: VarType,
    vartype: VarType,
    text: &'a [u8],
    nested: bool,
    out: &mut Writer<'_>,
) -> Parsed<'a, ()> {
    let context = StringContext { nested, in_array: vartype.is_array() };
    let (text, mut level) = Level::open(vartype, text, out)?;
    let (mut element_text, ()) = byte(b',', TextErrorKind::Comma)(text)?;
    let rest = loop {
        let text = blanks(element_text);
        let (rest, ()) = match element {
            VarType::BSTR => string(text, context, out)?,
            _ if level.count == 1 && level.is_array && at_end(text, nested) => {
                return fault(TextErrorKind::EmptyArray, text);
            }
            _ => number(element, text, out)?,
        };
        match level.next(rest) {
            Some(next) => element_text = next,
            None => break rest,
        }
    };
    level.close(out);
    if at_end(rest, nested) { Ok((rest, ())) } else { fault(after_number(element, rest), rest) }
}

const fn at_end(rest: &[u8], nested: bool) -> bool {
    matches!(rest, []) || nested && matches!(rest, [b')', ..])
}

/// Returns the error for text that follows a number.
const fn after_number(element: VarType, rest: &[u8]) -> TextErrorKind {
    match rest {
        [b' ' | b'\t', ..] => TextErrorKind::BlankBehind,
        [b'.', ..] if matches!(element, VarType::CY) => TextErrorKind::CurrencyPoint,
        [b',' | b')', ..] => TextErrorKind::Unexpected,
        _ => TextErrorKind::Digit,
    }
}

/// `data = [ "," blanks ]` of EMPTY and NULL
fn nothing<'a>(vartype: VarType, text: &'a [u8], nested: bool, out: &mut Writer<'_>) -> Parsed<'a, ()> {
    if vartype.is_array() {
        return fault(TextErrorKind::ArrayOfNothing, text);
    }
    Level::open(vartype, text, out)?;
    let rest = match text {
        [b',', rest @ ..] => blanks(rest),
        _ => text,
    };
    if at_end(rest, nested) { Ok((rest, ())) } else { fault(TextErrorKind::NoData, rest) }
}
