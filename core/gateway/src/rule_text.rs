//! Rules as text: the one grammar for the command line of `bcap gateway` and the settings of a board.
//!
//! ```text
//! rule   = kind [ "/" index [ "-" index ] ] [ "=" range *( "," range ) ]
//! kind   = "I" / "F" / "D" / "S" / "V" / "P" / "J" / "T" / "IO"    ; in any case
//! index  = 1*DIGIT                                                 ; at most 4294967295
//! range  = number ".." number                                      ; minimum and maximum, both included
//! number = the text of an R8, as in a RAC line: -2.5, 4e2, inf
//! ```
//!
//! A rule without an index applies to all variables of the kind, with one index to this variable, with two to the variables
//! from the first to the last. A range allows an infinity only as its bound: `0..inf` allows it, `0..1e9` and no range do not.
//! No rule allows NaN. Each range applies to one element of the value, the last range also to all further elements.

use core::fmt;

use heapless::Vec;

use super::network::Network;
use super::rules::{Allow, Bounds};
use bcap_core::error::TextErrorKind;
use bcap_core::rac::VariableKind;
use bcap_core::variant::{Variant, parse_f64};

/// The maximum number of ranges of a rule: a T variable has most elements.
const RANGES: usize = VariableKind::T.elements();

/// A rule with the memory for its ranges of values.
///
/// # Examples
///
/// ```
/// use bcap_gateway::{Allow, AllowBuf, Bounds};
/// use bcap_core::rac::VariableKind;
///
/// let rule = AllowBuf::parse("I/0-99=-10..10")?;
/// let values = [Bounds { min: -10.0, max: 10.0 }];
/// assert_eq!(rule.as_allow(), Allow { values: &values, ..Allow::range(VariableKind::I, 0, 99) });
///
/// let error = AllowBuf::parse("I/3-1").unwrap_err();
/// assert_eq!(error.to_string(), "invalid index range 3-1: the first index is above the last, at column 3");
/// # Ok::<(), bcap_gateway::RuleError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct AllowBuf {
    kind: VariableKind,
    first: u32,
    last: u32,
    values: Vec<Bounds, RANGES>,
}

impl AllowBuf {
    /// Parses the text of one rule.
    ///
    /// # Errors
    ///
    /// A [`RuleError`] with the first column that is wrong.
    pub fn parse(text: &str) -> Result<Self, RuleError> {
        let at = |part: &str| {
            let column = column(text, part);
            move |kind| RuleError { kind, column }
        };
        let (variables, values) = split(text, '=');
        let (name, index) = split(variables, '/');
        let kind = VariableKind::from_name(name).ok_or(RuleErrorKind::Kind).map_err(at(name))?;
        let (first, last) = match index {
            None => (0, u32::MAX),
            Some(index) => {
                let (first, last) = split(index, '-');
                let last = last.unwrap_or(first);
                let range = (parse_index(first).map_err(at(first))?, parse_index(last).map_err(at(last))?);
                check_indices(range.0, range.1).map_err(at(index))?;
                range
            }
        };
        let mut rule = Self { kind, first, last, values: Vec::new() };
        let ranges = values.unwrap_or_default();
        for range in values.into_iter().flat_map(|values| values.split(',')) {
            let bounds = parse_bounds(text, range)?;
            check_bounds(bounds).map_err(at(range))?;
            let count = rule.values.len().saturating_add(1);
            check_count(kind, count).map_err(at(range))?;
            rule.values.push(bounds).map_err(|_| RuleErrorKind::TooManyRanges { kind, count }).map_err(at(ranges))?;
        }
        Ok(rule)
    }

    /// Views the rule as [`Rules`](crate::Rules) take it.
    #[must_use]
    pub fn as_allow(&self) -> Allow<'_> {
        Allow { kind: self.kind, first: self.first, last: self.last, values: &self.values, clients: Network::ANY }
    }
}

impl Allow<'_> {
    /// Checks a rule that was not parsed: the first index is not above the last, no minimum above its maximum, and there
    /// are no more ranges than the kind of variable has elements.
    ///
    /// # Errors
    ///
    /// A [`RuleError`] without a column.
    pub fn check(&self) -> Result<(), RuleError> {
        check_indices(self.first, self.last)
            .and_then(|()| check_count(self.kind, self.values.len()))
            .and_then(|()| self.values.iter().try_for_each(|bounds| check_bounds(*bounds)))
            .map_err(|kind| RuleError { kind, column: 0 })
    }
}

/// Why a rule is invalid, and where.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct RuleError {
    /// The kind of error.
    pub kind: RuleErrorKind,
    /// The byte of the text at which it was found, counted from 1; 0 for a rule that was not parsed.
    pub column: u32,
}

/// The kind of an error in a rule.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RuleErrorKind {
    /// The rule does not begin with a kind of variable.
    Kind,
    /// The index is not a decimal number of at most 32 bits.
    Index,
    /// The first index is above the last.
    IndexRange {
        /// The first index.
        first: u32,
        /// The last index.
        last: u32,
    },
    /// A range of values has no `..`.
    Range,
    /// A bound of a range is not a number.
    Number(TextErrorKind),
    /// The minimum is above the maximum, or one of them is NaN.
    ValueRange(Bounds),
    /// There are more ranges than elements.
    TooManyRanges {
        /// The kind of variable.
        kind: VariableKind,
        /// The number of ranges.
        count: usize,
    },
}

impl fmt::Display for RuleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.column {
            0 => self.kind.fmt(f),
            column => write!(f, "{}, at column {column}", self.kind),
        }
    }
}

impl fmt::Display for RuleErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kind => f.write_str("unknown kind of variable: expected one of I F D S V P J T IO"),
            Self::Index => write!(f, "invalid index: expected a number from 0 to {}", u32::MAX),
            Self::IndexRange { first, last } => {
                write!(f, "invalid index range {first}-{last}: the first index is above the last")
            }
            Self::Range => f.write_str("invalid value range: expected MIN..MAX, such as -10..10"),
            Self::Number(error) => write!(f, "invalid bound of a value range: {error}"),
            Self::ValueRange(bounds) if bounds.min.is_nan() || bounds.max.is_nan() => {
                write!(f, "invalid value range {bounds}: a bound cannot be NaN")
            }
            Self::ValueRange(bounds) => {
                write!(f, "invalid value range {bounds}: the minimum is above the maximum")
            }
            Self::TooManyRanges { kind, count } => {
                write!(
                    f,
                    "too many value ranges: {count}, but a variable of kind {kind} has {} elements",
                    kind.elements()
                )
            }
        }
    }
}

impl core::error::Error for RuleError {}

/// Writes the range as a rule has it: `-10..10`.
impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (mut min, mut max) = ([0; NUMBER], [0; NUMBER]);
        let number = |number, buffer| Variant::R8(number).to_text(buffer).unwrap_or_default();
        let (min, max) = (number(self.min, &mut min), number(self.max, &mut max));
        let data = |text: &str| text.split_once(',').map_or(0, |(vartype, _)| vartype.len().saturating_add(1));
        let (min, max) = (min.get(data(min)..), max.get(data(max)..));
        write!(f, "{}..{}", min.unwrap_or_default(), max.unwrap_or_default())
    }
}

/// Bytes of the longest text of an R8, its type included: `5,-2.2250738585072014e-308`.
const NUMBER: usize = 32;

/// Splits a text at the first separator.
fn split(text: &str, separator: char) -> (&str, Option<&str>) {
    text.split_once(separator).map_or((text, None), |(part, rest)| (part, Some(rest)))
}

/// Returns the column of a part of a text.
fn column(text: &str, part: &str) -> u32 {
    let offset = part.as_ptr().addr().wrapping_sub(text.as_ptr().addr());
    u32::try_from(offset).unwrap_or(u32::MAX).saturating_add(1)
}

fn parse_index(text: &str) -> Result<u32, RuleErrorKind> {
    // the library's parser also takes `+5`
    let digits = Some(text).filter(|text| text.bytes().all(|byte| byte.is_ascii_digit()));
    digits.and_then(|digits| digits.parse().ok()).ok_or(RuleErrorKind::Index)
}

fn parse_bounds(text: &str, range: &str) -> Result<Bounds, RuleError> {
    // searching for a `str` with the library would leave a panic in the image of a board
    let dots = range.as_bytes().windows(2).position(|pair| pair == b"..");
    let parts = dots.and_then(|dots| range.split_at_checked(dots));
    let parts = parts.and_then(|(min, max)| Some((min, max.strip_prefix("..")?)));
    let (min, max) = parts.ok_or(RuleError { kind: RuleErrorKind::Range, column: column(text, range) })?;
    let number = |part: &str| {
        parse_f64(part.as_bytes()).map_err(|error| RuleError {
            kind: RuleErrorKind::Number(error.kind),
            column: column(text, part).saturating_add(error.column).saturating_sub(1),
        })
    };
    Ok(Bounds { min: number(min)?, max: number(max)? })
}

const fn check_indices(first: u32, last: u32) -> Result<(), RuleErrorKind> {
    if first <= last { Ok(()) } else { Err(RuleErrorKind::IndexRange { first, last }) }
}

/// Fails for NaN, too: it is not less than or equal to anything.
fn check_bounds(bounds: Bounds) -> Result<(), RuleErrorKind> {
    if bounds.min <= bounds.max { Ok(()) } else { Err(RuleErrorKind::ValueRange(bounds)) }
}

const fn check_count(kind: VariableKind, count: usize) -> Result<(), RuleErrorKind> {
    if count <= kind.elements() { Ok(()) } else { Err(RuleErrorKind::TooManyRanges { kind, count }) }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use VariableKind as Kind;
    use std::string::ToString;

    #[test]
    fn every_form_of_the_grammar_is_parsed() {
        let range = |min, max| Bounds { min, max };
        let pose = [range(-400.0, 400.0), range(-400.0, 400.5), range(0.0, f64::INFINITY)];
        for (text, allow) in [
            ("F", Allow::all(Kind::F)),
            ("io/128", Allow::range(Kind::Io, 128, 128)),
            ("I/0-4294967295", Allow::range(Kind::I, 0, u32::MAX)),
            ("S=0..20", Allow { values: &[range(0.0, 20.0)], ..Allow::all(Kind::S) }),
            ("I/5=-1..2.5", Allow { values: &[range(-1.0, 2.5)], ..Allow::range(Kind::I, 5, 5) }),
            ("I=3..3", Allow { values: &[range(3.0, 3.0)], ..Allow::all(Kind::I) }),
            ("P/7=-400..400,-4e2..400.5,0..inf", Allow { values: &pose, ..Allow::range(Kind::P, 7, 7) }),
        ] {
            let rule = AllowBuf::parse(text).unwrap();
            assert_eq!(rule.as_allow(), allow, "{text}");
            assert_eq!(rule.as_allow().check(), Ok(()));
        }
    }

    #[test]
    fn an_error_says_what_is_wrong_and_where() {
        let kind = "unknown kind of variable: expected one of I F D S V P J T IO, at column 1";
        let index = "invalid index: expected a number from 0 to 4294967295, at column ";
        let range = "invalid value range: expected MIN..MAX, such as -10..10, at column ";
        for (text, error, column) in [
            ("", kind, ""),
            ("X", kind, ""),
            ("=0..1", kind, ""),
            ("I/", index, "3"),
            ("I/x", index, "3"),
            ("I/+1", index, "3"),
            ("I/-1", index, "3"),
            ("I/1-", index, "5"),
            ("I/1-2-3", index, "5"),
            ("I/4294967296", index, "3"),
            ("I/3-1", "invalid index range 3-1: the first index is above the last, at column 3", ""),
            ("I=", range, "3"),
            ("I=1", range, "3"),
            ("P=0..1,", range, "8"),
            ("I=..", "invalid bound of a value range: a number is missing, at column 3", ""),
            ("I=a..b", "invalid bound of a value range: not a digit of the number, at column 3", ""),
            ("I/1=0..1x", "invalid bound of a value range: text after the end of the value, at column 9", ""),
            ("I=2..-1.5", "invalid value range 2..-1.5: the minimum is above the maximum, at column 3", ""),
            ("I=nan..1", "invalid value range NaN..1: a bound cannot be NaN, at column 3", ""),
            ("I=0..1,0..1", "too many value ranges: 2, but a variable of kind I has 1 elements, at column 8", ""),
        ] {
            assert_eq!(AllowBuf::parse(text).unwrap_err().to_string(), [error, column].concat(), "{text}");
        }
    }

    #[test]
    fn a_rule_that_was_not_parsed_is_checked_alike() {
        let ranges = [Bounds { min: 0.0, max: 1.0 }; 11];
        for kind in Kind::ALL {
            let allow = |count| Allow { values: &ranges[..count], ..Allow::all(kind) };
            assert_eq!(allow(kind.elements()).check(), Ok(()));
            let count = kind.elements() + 1;
            let error = RuleError { kind: RuleErrorKind::TooManyRanges { kind, count }, column: 0 };
            assert_eq!(allow(count).check(), Err(error));
            let text = std::format!("{kind}={}0..1", "0..1,".repeat(kind.elements()));
            assert_eq!(AllowBuf::parse(&text).unwrap_err().kind, error.kind);
        }
        let error = Allow::range(Kind::I, 3, 1).check().unwrap_err();
        assert_eq!(error.to_string(), "invalid index range 3-1: the first index is above the last");
        let reversed = [Bounds { min: 3.0, max: 1.0 }];
        let error = Allow { values: &reversed, ..Allow::all(Kind::I) }.check().unwrap_err();
        assert_eq!(error.to_string(), "invalid value range 3..1: the minimum is above the maximum");
    }
}
