//! `bcap log`: the logs of the controller, one line for each entry.

use bcap_capture::value::data;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use clap::Args;

use crate::commands::robot::errors::{checked, described};
use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;

/// Lists the logs of errors and operations of the controller, the latest entry last
///
/// A line has the time on the controller's clock, the client that caused the entry, the code with its meaning, and the program
/// with its line. Each entry is a call, so a long log takes seconds. An entry of an unknown layout is printed as it is, first.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap log
  bcap log --errors --last 10
  bcap log --operations --json")]
pub(crate) struct Log {
    /// Only the log of errors
    #[arg(long, conflicts_with = "operations")]
    pub(crate) errors: bool,

    /// Only the log of operations
    #[arg(long)]
    pub(crate) operations: bool,

    /// Only the latest N lines
    #[arg(long, value_name = "N")]
    pub(crate) last: Option<usize>,
}

/// The clients, from -1 on (RC8 provider guide, sections 5.2.11.10 and 5.2.11.12).
const CLIENTS: [&str; 9] = ["unknown", "system", "pendant", "IO", "PC", "task", "COM2", "COM3", "COM4"];

/// An entry; the fields are in the order in which entries are sorted.
#[derive(Default, PartialEq, Eq, PartialOrd, Ord)]
struct Entry {
    time: String,
    tick: i32,
    is_error: bool,
    code: i32,
    client: &'static str,
    text: String,
    program: String,
    line: i32,
}

/// Runs `bcap log`.
pub(crate) fn log(args: &Log, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut entries = Vec::new();
    if !args.operations {
        read(session, true, &mut entries)?;
    }
    if !args.errors {
        read(session, false, &mut entries)?;
    }
    // no source says which end of a log is the latest one
    entries.sort();
    let skipped = entries.len().saturating_sub(args.last.unwrap_or(usize::MAX));
    entries.iter().skip(skipped).try_for_each(|entry| entry.print(json))
}

fn read(session: &mut Session, is_error: bool, entries: &mut Vec<Entry>) -> Result<(), Failure> {
    let (count, get) = if is_error { ("GetErrorLogCount", "GetErrorLog") } else { ("GetOprLogCount", "GetOprLog") };
    let mut check = StreamCheck::default();
    let count = checked(session, &mut check, count, &())?.as_variant().as_i32().unwrap_or(0);
    for index in 0..count {
        let value = checked(session, &mut check, get, &index)?;
        let unknown = || Entry { is_error, text: data::format(value.as_variant()), ..Entry::default() };
        entries.push(Entry::parse(is_error, value.as_variant()).unwrap_or_else(unknown));
    }
    Ok(())
}

impl Entry {
    /// Reads an entry; `None` if it has another layout than that of the guide.
    fn parse(is_error: bool, entry: Variant<'_>) -> Option<Self> {
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

    fn print(&self, json: bool) -> Result<(), Failure> {
        let Self { time, code, client, text, program, line, .. } = self;
        let log = if self.is_error { "errors" } else { "operations" };
        let object = serde_json::json!({
            "log": log, "time": time, "client": client, "code": code, "text": text, "program": program, "line": line
        });
        let what = if *code == 0 { text.clone() } else { described(HResult(*code), text) };
        let place = if program.is_empty() { String::new() } else { format!(" ({program}, line {line})") };
        Ok(print_result(json, &object, &format!("{time:23} {log:10} {client:7} {what}{place}"))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::values::Value;

    #[test]
    fn an_entry_has_its_time_client_and_place() {
        let value = |text: &str| Value::parse_text(text.as_bytes()).unwrap();
        let at = "(3,2026),(3,2),(3,5),(3,27),(3,9),(3,5),(3,7),(3,42),(3,100)";
        let error = value(&format!("8204,(3,-2092953560),{at},(8,Pro1),(3,3),(8,stopped),(3,-2092953560),(3,4)"));
        let entry = Entry::parse(true, error.as_variant()).unwrap();
        assert_eq!((entry.time.as_str(), entry.client, entry.tick), ("2026-02-27 09:05:07.042", "task", 100));
        assert_eq!((entry.program.as_str(), entry.line, entry.text.as_str()), ("Pro1", 3, "stopped"));
        let operation = value(&format!("8204,(3,0),{at},(3,-1),(8,motor on)"));
        let entry = Entry::parse(false, operation.as_variant()).unwrap();
        assert_eq!((entry.client, entry.text.as_str()), ("unknown", "motor on"));
        // each layout only in its own log
        assert!(
            Entry::parse(true, operation.as_variant()).is_none() && Entry::parse(false, error.as_variant()).is_none()
        );
    }
}
