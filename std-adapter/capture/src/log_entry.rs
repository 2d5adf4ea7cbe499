//! An entry of the logs of a controller (RC8 provider guide, sections 5.2.11.10 and 5.2.11.12).

use bcap_core::variant::Variant;

/// The clients, from -1 on (RC8 provider guide, sections 5.2.11.10 and 5.2.11.12).
const CLIENTS: [&str; 9] = ["unknown", "system", "pendant", "IO", "PC", "task", "COM2", "COM3", "COM4"];

/// An entry of a log of the controller. The fields are in the order in which entries are sorted.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LogEntry {
    /// The time on the controller's clock, such as `2026-02-27 09:05:07.042`.
    pub time: String,
    /// The controller's counter of milliseconds.
    pub tick: i32,
    /// Whether it is in the error log.
    pub is_error: bool,
    /// The result code; 0 for an operation without one.
    pub code: i32,
    /// The client that caused it.
    pub client: &'static str,
    /// The controller's text.
    pub text: String,
    /// The program; empty for an operation.
    pub program: String,
    /// The line of the program.
    pub line: i32,
}

impl LogEntry {
    /// Reads an entry; `None` if its layout differs from the guide.
    #[must_use]
    pub fn parse(is_error: bool, entry: Variant<'_>) -> Option<Self> {
        let elements: Vec<Variant<'_>> = entry.as_array()?.iter().collect();
        let number = |at: usize| match elements.get(at)? {
            Variant::Error(code) => Some(code.0),
            other => other.as_i32(),
        };
        let text = |at: usize| Some(elements.get(at)?.as_bstr()?.to_string());
        let (length, client, message) = if is_error { (15, 14, 12) } else { (12, 10, 11) };
        if elements.len() != length {
            return None;
        }
        // 3 is the day of the week
        let date = format!("{:04}-{:02}-{:02}", number(1)?, number(2)?, number(4)?);
        let time = format!("{date} {:02}:{:02}:{:02}.{:03}", number(5)?, number(6)?, number(7)?, number(8)?);
        let client = usize::try_from(number(client)?.checked_add(1)?).ok().and_then(|at| CLIENTS.get(at));
        let (program, line) = if is_error { (text(10)?, number(11)?) } else { (String::new(), 0) };
        let (code, tick) = (number(0)?, number(9)?);
        Some(Self {
            time,
            tick,
            is_error,
            code,
            client: client.unwrap_or(&"unknown"),
            text: text(message)?,
            program,
            line,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::OwnedVariant as Value;

    #[test]
    fn an_entry_has_its_time_client_and_place() {
        let value = |text: &str| Value::parse_text(text.as_bytes()).unwrap();
        let at = "(3,2026),(3,2),(3,5),(3,27),(3,9),(3,5),(3,7),(3,42),(3,100)";
        let error = value(&format!("8204,(3,-2092953560),{at},(8,Pro1),(3,3),(8,stopped),(3,-2092953560),(3,4)"));
        let entry = LogEntry::parse(true, error.as_variant()).unwrap();
        assert_eq!((entry.time.as_str(), entry.client, entry.tick), ("2026-02-27 09:05:07.042", "task", 100));
        assert_eq!((entry.program.as_str(), entry.line, entry.text.as_str()), ("Pro1", 3, "stopped"));
        let operation = value(&format!("8204,(3,0),{at},(3,-1),(8,motor on)"));
        let entry = LogEntry::parse(false, operation.as_variant()).unwrap();
        assert_eq!((entry.client, entry.text.as_str()), ("unknown", "motor on"));
        // each layout only in its own log
        assert!(
            LogEntry::parse(true, operation.as_variant()).is_none()
                && LogEntry::parse(false, error.as_variant()).is_none()
        );
    }
}
