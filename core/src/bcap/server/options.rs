//! The option string of Service_Start: `WDT=400,InvokeTimeout=180000`.
//!
//! ```text
//!  options = [ option { "," option } ]
//!  option  = [ key "=" value ]           blanks around both are dropped; the first option of a key counts
//!  value   = text | "(" text ")" | "[" text "]" | "{" text "}" | "<" text ">"
//! ```
//!
//! Keys are case-insensitive; unknown keys and empty options are ignored (b-CAP specification, Table 4-1).

use core::fmt;
use core::time::Duration;

use crate::variant::Variant;

/// The options that a client sends in Service_Start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct StartOptions {
    /// `WDT`: the interval of S_EXECUTING while a call runs; without it, the server sends no S_EXECUTING.
    pub watchdog: Option<Duration>,
    /// `InvokeTimeout`: how long a call may run; without it, the server's default.
    pub invoke_timeout: Option<Duration>,
}

/// Why an option string was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OptionError {
    /// It is not a string, not ASCII, or longer than 128 characters.
    NoText,
    /// The value of this key is not a number of milliseconds.
    NoNumber(&'static str),
    /// The value of this key is below the minimum of 80 ms.
    TooShort(&'static str),
}

impl fmt::Display for OptionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoText => f.write_str("the options are not an ASCII string of at most 128 characters"),
            Self::NoNumber(key) => write!(f, "{key} is not a number of milliseconds"),
            Self::TooShort(key) => write!(f, "{key} is below the minimum of 80 ms"),
        }
    }
}

impl core::error::Error for OptionError {}

impl StartOptions {
    /// The minimum of both options (b-CAP specification, Table 4-1).
    pub const MIN: Duration = Duration::from_millis(80);

    /// Reads the argument of Service_Start; without one the options are empty.
    ///
    /// # Errors
    ///
    /// An [`OptionError`] that names the key.
    pub fn read(argument: Option<Variant<'_>>) -> Result<Self, OptionError> {
        let text = match argument {
            None | Some(Variant::Empty | Variant::Null) => return Ok(Self::default()),
            Some(value) => value.as_bstr().ok_or(OptionError::NoText)?,
        };
        let mut buffer = [0; 128];
        Self::parse(text.to_str(&mut buffer).ok_or(OptionError::NoText)?)
    }

    /// Parses an option string.
    ///
    /// # Errors
    ///
    /// An [`OptionError`] that names the key.
    pub fn parse(text: &str) -> Result<Self, OptionError> {
        Ok(Self { watchdog: millis(text, "WDT")?, invoke_timeout: millis(text, "InvokeTimeout")? })
    }
}

fn millis(text: &str, key: &'static str) -> Result<Option<Duration>, OptionError> {
    let Some(value) = value_of(text.as_bytes(), key.as_bytes()) else { return Ok(None) };
    let number = number(value).ok_or(OptionError::NoNumber(key))?;
    let duration = Duration::from_millis(u64::from(number));
    if duration < StartOptions::MIN { Err(OptionError::TooShort(key)) } else { Ok(Some(duration)) }
}

/// Finds the value of a key.
fn value_of<'a>(text: &'a [u8], key: &[u8]) -> Option<&'a [u8]> {
    text.split(|b| *b == b',').find_map(|option| {
        let mut parts = option.splitn(2, |b| *b == b'=');
        let found = parts.next()?.trim_ascii();
        let value = parts.next()?.trim_ascii();
        found.eq_ignore_ascii_case(key).then_some(unwrap(value))
    })
}

/// Removes a pair of brackets.
fn unwrap(value: &[u8]) -> &[u8] {
    match value {
        [b'(', inner @ .., b')'] | [b'[', inner @ .., b']'] | [b'{', inner @ .., b'}'] | [b'<', inner @ .., b'>'] => {
            inner.trim_ascii()
        }
        other => other,
    }
}

/// Reads a decimal number, or a hexadecimal one with the prefix `0x`.
fn number(text: &[u8]) -> Option<u32> {
    let (digits, radix) = match text {
        [b'0', b'x' | b'X', digits @ ..] => (digits, 16),
        digits => (digits, 10),
    };
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u32, |number, digit| {
        let digit = char::from(*digit).to_digit(radix)?;
        number.checked_mul(radix)?.checked_add(digit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both(watchdog: u64, invoke: u64) -> StartOptions {
        let time = |ms| (ms > 0).then(|| Duration::from_millis(ms));
        StartOptions { watchdog: time(watchdog), invoke_timeout: time(invoke) }
    }

    #[test]
    fn the_forms_in_use_are_read() {
        for (text, expected) in [
            ("", both(0, 0)),
            ("WDT=400", both(400, 0)),
            (",WDT=400,InvokeTimeout=180000", both(400, 180_000)),
            (" wdt = ( 0x190 ) , other = 5, WDT=900", both(400, 0)),
            ("InvokeTimeout=[80]", both(0, 80)),
            ("WDT", both(0, 0)),
        ] {
            assert_eq!(StartOptions::parse(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn a_bad_number_names_its_key() {
        for (text, expected) in [
            ("WDT=abc", OptionError::NoNumber("WDT")),
            ("WDT=-1", OptionError::NoNumber("WDT")),
            ("WDT=", OptionError::NoNumber("WDT")),
            ("WDT=0x", OptionError::NoNumber("WDT")),
            ("WDT=4294967296", OptionError::NoNumber("WDT")),
            ("WDT=100=5", OptionError::NoNumber("WDT")),
            ("WDT=79", OptionError::TooShort("WDT")),
            ("InvokeTimeout=(100", OptionError::NoNumber("InvokeTimeout")),
        ] {
            assert_eq!(StartOptions::parse(text), Err(expected), "{text}");
        }
        assert_eq!(StartOptions::read(Some(Variant::I4(1))), Err(OptionError::NoText));
        assert_eq!(StartOptions::read(None), Ok(StartOptions::default()));
    }
}
