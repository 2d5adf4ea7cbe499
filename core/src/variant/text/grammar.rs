//! The common part of the parsers of this grammar: their result, their errors with a position, and the smallest rules.

use nom::Parser;
use nom::combinator::all_consuming;
use nom::error::{ErrorKind, ParseError};

use crate::error::{TextError, TextErrorKind};
use crate::num::to_u32;

/// The rest of the text and the result.
pub(crate) type Parsed<'a, T> = nom::IResult<&'a [u8], T, ParseFault>;

/// An error and its position, as the number of bytes that were left.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ParseFault {
    kind: TextErrorKind,
    left: usize,
}

impl ParseError<&[u8]> for ParseFault {
    fn from_error_kind(rest: &[u8], _: ErrorKind) -> Self {
        Self { kind: TextErrorKind::Unexpected, left: rest.len() }
    }

    fn append(_: &[u8], _: ErrorKind, other: Self) -> Self {
        other
    }
}

/// Fails with an error at the first byte of `rest`.
pub(crate) const fn fault<T>(kind: TextErrorKind, rest: &[u8]) -> Parsed<'_, T> {
    Err(nom::Err::Error(ParseFault { kind, left: rest.len() }))
}

/// Applies a parser to the whole text, and converts its error to one with a column.
pub(crate) fn complete<'a, T>(
    text: &'a [u8],
    parser: impl Parser<&'a [u8], Output = T, Error = ParseFault>,
) -> Result<T, TextError> {
    let ParseFault { kind, left } = match all_consuming(parser).parse_complete(text) {
        Ok((_, value)) => return Ok(value),
        Err(nom::Err::Error(fault) | nom::Err::Failure(fault)) => fault,
        // only streaming parsers request more text
        Err(nom::Err::Incomplete(_)) => ParseFault { kind: TextErrorKind::Missing, left: 0 },
    };
    Err(TextError { kind, column: to_u32(text.len().wrapping_sub(left).wrapping_add(1)) })
}

/// Replaces any error of a parser by `kind` at its first byte.
pub(crate) fn expect<'a, T>(
    kind: TextErrorKind,
    mut parser: impl Parser<&'a [u8], Output = T>,
) -> impl FnMut(&'a [u8]) -> Parsed<'a, T> {
    move |text| parser.parse_complete(text).or(fault(kind, text))
}

/// Accepts one byte; `kind` is the error for any other.
#[inline]
pub(crate) const fn byte(wanted: u8, kind: TextErrorKind) -> impl Fn(&[u8]) -> Parsed<'_, ()> {
    move |text| match text.split_first() {
        Some((found, rest)) if *found == wanted => Ok((rest, ())),
        _ => fault(kind, text),
    }
}

/// `blanks = { " " | TAB }`
#[cfg_attr(target_os = "none", inline(never))]
pub(crate) const fn blanks(text: &[u8]) -> &[u8] {
    let mut rest = text;
    while let [b' ' | b'\t', after @ ..] = rest {
        rest = after;
    }
    rest
}

/// The context of a string, which determines the characters that it cannot contain.
#[derive(Clone, Copy)]
pub(super) struct StringContext {
    /// Inside the parentheses of a VARIANT.
    pub(super) nested: bool,
    pub(super) in_array: bool,
}
