//! Messages of syslog (RFC 5424), a datagram each.
//!
//! ```text
//!  <132>1 - cell-7 gateway - refused - 192.168.0.7:40000: PUT:RC8:5:I:3,7: read-only
//!   │      │ │      │       │ │       │ text
//!   │      │ │      │       │ │       └ no structured data
//!   │      │ │      │       │ └ the kind of the message
//!   │      │ │      │       └ no process
//!   │      │ │      └ the image
//!   │      │ └ the name of the board in its settings, or `-`
//!   │      └ the time, if a server of SNTP has told it; otherwise the collector writes the time of arrival
//!   └ the facility local0 and the severity
//! ```
//!
//! UDP can lose messages.

use core::fmt;

use crate::sntp::Utc;

/// The UDP port of syslog (RFC 5426).
pub const PORT: u16 = 514;

/// The facility local0, in the bits above the severity.
const LOCAL0: u8 = 16 << 3;

/// How severe a message is; the number is from RFC 5424.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// The board reset after a fault.
    Error = 3,
    /// A request or a client was refused, or the robot disconnected.
    Warning = 4,
    /// The board started, or the robot connected.
    Notice = 5,
}

impl Severity {
    /// Returns the severity with a code.
    #[cfg(feature = "embassy")]
    pub(crate) const fn of_code(code: u8) -> Self {
        match code {
            3 => Self::Error,
            4 => Self::Warning,
            _ => Self::Notice,
        }
    }

    pub(crate) const fn code(self) -> u8 {
        match self {
            Self::Error => 3,
            Self::Warning => 4,
            Self::Notice => 5,
        }
    }
}

/// A message.
#[derive(Clone, Copy)]
pub struct Message<'a> {
    /// How severe it is.
    pub severity: Severity,
    /// The time of the event; `None` if the board does not have the time.
    pub time: Option<Utc>,
    /// The name of the board; `None` if it has none.
    pub host: Option<&'a str>,
    /// The name of the image.
    pub app: &'a str,
    /// The kind of the message: letters, digits and hyphens.
    pub id: &'a str,
    /// The text. Characters that are not printable ASCII become `?`, because clients choose the text of their lines.
    pub text: &'a dyn fmt::Display,
}

impl fmt::Debug for Message<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Writes the datagram.
impl fmt::Display for Message<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { severity, time, host, app, id, text } = *self;
        write!(f, "<{}>1 ", LOCAL0 | severity.code())?;
        match time {
            Some(time) => time.fmt(f)?,
            None => f.write_str("-")?,
        }
        write!(f, " {} {app} - {id} - ", host.unwrap_or("-"))?;
        fmt::Write::write_fmt(&mut Printable(f), format_args!("{text}"))
    }
}

/// Replaces characters that are not printable ASCII.
struct Printable<'a, 'f>(&'a mut fmt::Formatter<'f>);

impl fmt::Write for Printable<'_, '_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let printable = |c: char| if c == ' ' || c.is_ascii_graphic() { c } else { '?' };
        text.chars().try_for_each(|c| fmt::Write::write_char(self.0, printable(c)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_message_is_that_of_rfc_5424() {
        let message = Message {
            severity: Severity::Warning,
            time: None,
            host: Some("cell-7"),
            app: "gateway",
            id: "refused",
            text: &"192.168.0.7: PUT:\u{1b}[31m\n<1>1 é: read-only",
        };
        assert_eq!(
            message.to_string(),
            "<132>1 - cell-7 gateway - refused - 192.168.0.7: PUT:?[31m?<1>1 ?: read-only",
            "a client cannot begin another message"
        );
        let start = Message { severity: Severity::Notice, host: None, id: "start", text: &"", ..message };
        assert_eq!(start.to_string(), "<133>1 - - gateway - start - ");
        let timed = Message { time: Some(Utc(1_795_707_700_500_000)), ..start };
        assert_eq!(timed.to_string(), "<133>1 2026-11-26T15:41:40.500Z - gateway - start - ");
        assert_eq!(Message { severity: Severity::Error, ..start }.to_string(), "<131>1 - - gateway - start - ");
    }
}
