//! Times in options and files.

use std::time::Duration;

/// Parses a time: a number of milliseconds, or a number with `ms`, `s` or `min`, from 1 ms to a day.
///
/// # Errors
///
/// Another text; the error says what is accepted.
pub fn parse(text: &str) -> Result<Duration, String> {
    const DAY: u64 = 86_400_000;
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor = match unit {
        "" | "ms" => Some(1),
        "s" => Some(1000),
        "min" => Some(60_000),
        _ => None,
    };
    let time = number.parse::<u64>().ok().zip(factor).and_then(|(number, factor)| number.checked_mul(factor));
    let time = time.filter(|ms| (1..=DAY).contains(ms)).map(Duration::from_millis);
    time.ok_or_else(|| "write a time from 1 ms to a day, such as 500, 500ms, 2s or 1min".into())
}
