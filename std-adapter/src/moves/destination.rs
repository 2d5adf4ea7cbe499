//! The text of a destination. A text that cannot be a destination is refused before the first call.
//!
//! ```text
//!   P1  J[2]  T3                                     a variable of a pose
//!   J(J1, J2, J3, J4 [, ... J8])                     joints, in degrees or mm
//!   P(X, Y, Z, RX, RY, RZ [, FIG])                   mm and degrees
//!   T(X, Y, Z, OX, OY, OZ, AX, AY, AZ [, FIG])       mm and vectors
//!   ... EX((7, 30.5))  ... EXA((7, 30.5), (8, 90))   each of them with extended joints
//! ```
//!
//! FIG is a whole number; the extended joints are 7 and 8, each once. The text is ASCII, because it is sent as it is.

use std::ops::RangeInclusive;
use std::str::FromStr;

use thiserror::Error;

use super::Destination;

/// The forms of a destination, for errors.
const EXPECTED: &str = "write a variable such as P1, J2 or T3, or a value such as J(0, 45, 90, 0, 45, 0)";

/// A text that is not the destination of a motion: what is wrong, and what to write.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct DestinationError(String);

/// Checks a text of the controller's language, such as `P1` or `J(0, 45, 90, 0, 45, 0)`, and keeps it as it is.
impl FromStr for Destination {
    type Err = DestinationError;

    fn from_str(text: &str) -> Result<Self, DestinationError> {
        check(text).map_err(DestinationError)?;
        Ok(Self::Text(text.to_owned()))
    }
}

/// Checks the text of a destination.
fn check(text: &str) -> Result<(), String> {
    if let Some(wrong) = text.chars().find(|c| !(' '..='~').contains(c)) {
        return Err(format!("{text:?}: {wrong:?} is no part of a destination: {EXPECTED}"));
    }
    let trimmed = text.trim();
    let lower = trimmed.to_ascii_lowercase();
    let (trimmed, extended) = lower.find(" ex").map_or((trimmed, None), |at| {
        let (pose, extended) = trimmed.split_at(at);
        (pose.trim_end(), Some(extended.trim_start()))
    });
    extended.map_or(Ok(()), |extended| check_extended(text, extended))?;
    let letters = trimmed.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(trimmed.len());
    let (kind, rest) = trimmed.split_at(letters);
    let kind = kind.to_ascii_uppercase();
    let Some(counts) = counts(&kind) else {
        return Err(format!("{text} is not the destination of a motion: {EXPECTED}"));
    };
    match rest.trim_start().strip_prefix('(') {
        Some(list) => check_numbers(text, list, &kind, counts),
        None => check_index(text, rest),
    }
}

/// Returns how many numbers a pose may have; `None` if variables of this kind hold no pose.
fn counts(kind: &str) -> Option<RangeInclusive<usize>> {
    match kind {
        "J" => Some(4..=8),
        "P" => Some(6..=7),
        "T" => Some(9..=10),
        _ => None,
    }
}

/// Checks the index of a variable: `1` or `[1]`.
fn check_index(text: &str, rest: &str) -> Result<(), String> {
    let index = match rest.strip_prefix('[') {
        Some(index) => {
            index.strip_suffix(']').ok_or_else(|| format!("{text}: the bracket ] is missing; {EXPECTED}"))?
        }
        None => rest,
    };
    let is_index = !index.is_empty() && index.bytes().all(|byte| byte.is_ascii_digit());
    if is_index && index.parse::<u32>().is_ok() {
        return Ok(());
    }
    Err(format!("{text} is not the destination of a motion: {EXPECTED}"))
}

/// Checks the numbers after the first bracket.
fn check_numbers(text: &str, list: &str, kind: &str, counts: RangeInclusive<usize>) -> Result<(), String> {
    let Some(list) = list.strip_suffix(')') else {
        return Err(format!("{text}: the bracket ) is missing at the end"));
    };
    let numbers: Vec<&str> = list.split(',').map(str::trim).collect();
    let is_number = |word: &&&str| !word.parse::<f64>().is_ok_and(f64::is_finite);
    if let Some(wrong) = numbers.iter().find(is_number) {
        return Err(format!("{text}: {wrong:?} is not a finite number"));
    }
    let (least, most) = counts.into_inner();
    if (least..=most).contains(&numbers.len()) {
        let figure = numbers.last().filter(|_| kind != "J" && numbers.len() == most);
        return match figure {
            Some(figure) if figure.parse::<i32>().is_err() => {
                Err(format!("{text}: the figure {figure:?} is no whole number"))
            }
            _ => Ok(()),
        };
    }
    Err(format!("{text}: a value of type {kind} has {least} to {most} numbers, and this one has {}", numbers.len()))
}

/// Checks the extended joints: pairs of an axis and a number, `EX((7, 1), (8, 2))` or `EX(7, 1)`.
fn check_extended(text: &str, extended: &str) -> Result<(), String> {
    let wrong = || {
        format!("{text}: {extended:?} are no extended joints; write them as EX((7, 30.5)) or EXA((7, 30.5), (8, 90))")
    };
    let letters = extended.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(extended.len());
    let (name, list) = extended.split_at(letters);
    let list = list.trim().strip_prefix('(').and_then(|list| list.strip_suffix(')')).ok_or_else(wrong)?.trim();
    let mut axes: Vec<u8> = Vec::new();
    // the pairs end with a bracket; a single one has none
    let inner = list.strip_prefix('(').map_or(Some(list), |inner| inner.strip_suffix(')')).ok_or_else(wrong)?;
    let pairs: Vec<&str> = if inner.len() == list.len() { vec![list] } else { inner.split(')').collect() };
    for (pair, at) in pairs.iter().zip(0..) {
        // between two pairs: `, (`
        let pair = if at == 0 {
            Some(*pair)
        } else {
            pair.trim().strip_prefix(',').and_then(|pair| pair.trim_start().strip_prefix('('))
        };
        let (axis, number) = pair.and_then(|pair| pair.split_once(',')).ok_or_else(wrong)?;
        let is_finite = number.trim().parse::<f64>().is_ok_and(f64::is_finite);
        match axis.trim().parse() {
            Ok(axis @ 7..=8) if is_finite && !axes.contains(&axis) => axes.push(axis),
            _ => return Err(wrong()),
        }
    }
    if matches!(&*name.to_ascii_uppercase(), "EX" | "EXA") { Ok(()) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_and_values_of_poses_are_destinations() {
        for text in [
            "P1",
            "j[12]",
            "T3",
            "J(0, 45, 90, 0, 45, 0)",
            "J(0,45,90,0,45,0,1,2)",
            "P(400, 0, 300, 180, 0, 180, 5)",
            "p (400, 0, 300, 180, 0, 180)",
            "T(400, 0, 300, 1, 0, 0, 0, 0, -1, 5)",
            "J(60.5, 30.3, 400, 90)",
            "P1 EX((7, 30.5))",
            "J100 EXA((7, 30.5), (8, 90.5))",
            "J100 exa(7, 30.5)",
            "J(0, 45, 90, 0, 45, 0) EXA( (7, 30.5) , ( 8 , -1 ) )",
            "P(400, 0, 300, 180, 0, 180, -1)",
        ] {
            assert_eq!(check(text), Ok(()), "{text}");
        }
    }

    #[test]
    fn other_texts_name_what_is_wrong() {
        for (text, wrong) in [
            ("I1", "I1 is not the destination of a motion"),
            ("F2", "F2 is not the destination of a motion"),
            ("D3", "D3 is not the destination of a motion"),
            ("S1", "S1 is not the destination of a motion"),
            ("V1", "V1 is not the destination of a motion"),
            ("IO5", "IO5 is not the destination of a motion"),
            ("", " is not the destination of a motion"),
            ("P", "P is not the destination of a motion"),
            ("P-1", "P-1 is not the destination of a motion"),
            ("P99999999999", "P99999999999 is not the destination of a motion"),
            ("P[1", "P[1: the bracket ] is missing"),
            ("J(0, 45, 90, 0, 45, 0", "J(0, 45, 90, 0, 45, 0: the bracket ) is missing"),
            ("J(0, nan, 90, 0, 45, 0)", "\"nan\" is not a finite number"),
            ("J(0, inf, 90, 0, 45, 0)", "\"inf\" is not a finite number"),
            ("J(0, 1e999, 90, 0)", "\"1e999\" is not a finite number"),
            ("J()", "\"\" is not a finite number"),
            ("J(1,2,3,4,5,6,7,8,9)", "a value of type J has 4 to 8 numbers, and this one has 9"),
            ("J(1, 2)", "a value of type J has 4 to 8 numbers, and this one has 2"),
            ("P(1, 2)", "a value of type P has 6 to 7 numbers, and this one has 2"),
            ("P1 EX((7, 30.5)", "are no extended joints"),
            ("P1 EX((7, nan))", "are no extended joints"),
            ("P1 EX((7))", "are no extended joints"),
            ("P1 EXX((7, 1))", "are no extended joints"),
            ("P1 EX((9, 1))", "are no extended joints"),
            ("P1 EX((-7, 1))", "are no extended joints"),
            ("P1 EX((7.5, 1))", "are no extended joints"),
            ("P1 EX((7, 1), (7, 2))", "are no extended joints"),
            ("P1 EX(()7, 1)", "are no extended joints"),
            ("P1 EX((7, 1)(8, 1))", "are no extended joints"),
            ("P1 EX((7, 1)), (8, 1)", "are no extended joints"),
            ("P1 EX()", "are no extended joints"),
            ("P(400, 0, 300, 180, 0, 180, 5.5)", "the figure \"5.5\" is no whole number"),
            ("T(400, 0, 300, 1, 0, 0, 0, 0, -1, 1e1)", "the figure \"1e1\" is no whole number"),
            ("\u{a0}P1", "'\\u{a0}' is no part of a destination"),
            ("P1\n", "'\\n' is no part of a destination"),
            ("P1 P2", "P1 P2 is not the destination of a motion"),
        ] {
            let error = check(text).unwrap_err();
            assert!(error.contains(wrong), "{text}: {error}");
        }
    }
}
