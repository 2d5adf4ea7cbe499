//! Strings: where they end, and their UTF-8 as UTF-16.

use super::grammar::{Parsed, StringContext, fault};
use crate::error::TextErrorKind;
use crate::num::to_u32;
use crate::wire::Writer;

/// `string = { character - CR - LF }`, up to the end that its context gives it; appends its data
pub(super) fn string<'a>(text: &'a [u8], context: StringContext, out: &mut Writer<'_>) -> Parsed<'a, ()> {
    let (rest, string) = extent(text, context)?;
    if let Some(at) = string.iter().position(|b| matches!(b, b'\r' | b'\n')) {
        return fault(TextErrorKind::LineBreak, from(text, at));
    }
    let head_at = out.len();
    let written = out.put([0; 4]).and_then(|()| {
        let mut left = string;
        while let Some((c, after)) = character(left) {
            left = after;
            c.encode_utf16(&mut [0; 2]).iter().try_for_each(|unit| out.put(unit.to_le_bytes()))?;
        }
        Ok(left)
    });
    match written {
        Ok([]) => {}
        Ok(broken) => return fault(TextErrorKind::Utf8, from(text, string.len().wrapping_sub(broken.len()))),
        Err(_) => return fault(TextErrorKind::Full, text),
    }
    let len = out.len().wrapping_sub(head_at).wrapping_sub(4);
    out.patch(head_at, to_u32(len).to_le_bytes());
    Ok((rest, ()))
}

/// Returns the text from a byte of it on.
fn from(text: &[u8], at: usize) -> &[u8] {
    text.get(at..).unwrap_or_default()
}

/// Splits the bytes of a string off: all of the text at the top; in an array up to the next comma outside of
/// parentheses; in a VARIANT up to the parenthesis that closes it.
fn extent(text: &[u8], StringContext { nested, in_array }: StringContext) -> Parsed<'_, &[u8]> {
    if !nested && !in_array {
        return Ok((&[], text));
    }
    let mut open = 0_u32;
    for (at, b) in text.iter().enumerate() {
        match b {
            b'(' => open = open.wrapping_add(1),
            b')' => match open.checked_sub(1) {
                Some(outer) => open = outer,
                None if nested => return Ok((from(text, at), text.get(..at).unwrap_or_default())),
                None => return fault(TextErrorKind::Unbalanced, from(text, at)),
            },
            b',' if in_array && open > 0 => return fault(TextErrorKind::CommaInString, from(text, at)),
            b',' if in_array => return Ok((from(text, at), text.get(..at).unwrap_or_default())),
            _ => {}
        }
    }
    if open > 0 || nested { fault(TextErrorKind::Unbalanced, &[]) } else { Ok((&[], text)) }
}

/// Splits the first character off UTF-8; `None` if it is invalid.
///
/// The standard library's check takes 620 bytes with its table, which nothing else on a board needs.
pub(super) fn character(text: &[u8]) -> Option<(char, &[u8])> {
    let (first, mut rest) = text.split_first()?;
    // the smallest code point of this length; a smaller one is an overlong form
    let (least, count, bits) = match first {
        0..0x80 => (0, 0, *first),
        0xc0..0xe0 => (0x80, 1, first & 0x1f),
        0xe0..0xf0 => (0x800, 2, first & 0x0f),
        0xf0..0xf8 => (0x1_0000, 3, first & 0x07),
        _ => return None,
    };
    let mut code = u32::from(bits);
    for _ in 0..count {
        let (next, after) = rest.split_first().filter(|(next, _)| **next & 0xc0 == 0x80)?;
        code = code << 6 | u32::from(next & 0x3f);
        rest = after;
    }
    let c = char::from_u32(code).filter(|_| code >= least)?;
    Some((c, rest))
}
