//! `bcap log`: the logs of the controller, one line for each entry.

use bcap_capture::LogEntry;
use bcap_capture::value::data;
use bcap_core::hresult::HResult;
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
    entries.iter().skip(skipped).try_for_each(|entry| print(entry, json))
}

fn read(session: &mut Session, is_error: bool, entries: &mut Vec<LogEntry>) -> Result<(), Failure> {
    let (count, get) = if is_error { ("GetErrorLogCount", "GetErrorLog") } else { ("GetOprLogCount", "GetOprLog") };
    let mut check = StreamCheck::default();
    let count = checked(session, &mut check, count, &())?.as_variant().as_i32().unwrap_or(0);
    for index in 0..count {
        let value = checked(session, &mut check, get, &index)?;
        let unknown = || LogEntry { is_error, text: data::format(value.as_variant()), ..LogEntry::default() };
        entries.push(LogEntry::parse(is_error, value.as_variant()).unwrap_or_else(unknown));
    }
    Ok(())
}

/// Prints an entry.
fn print(entry: &LogEntry, json: bool) -> Result<(), Failure> {
    let LogEntry { time, code, client, text, program, line, .. } = entry;
    let log = if entry.is_error { "errors" } else { "operations" };
    let object = serde_json::json!({
        "log": log, "time": time, "client": client, "code": code, "text": text, "program": program, "line": line
    });
    let what = if *code == 0 { text.clone() } else { described(HResult(*code), text) };
    let place = if program.is_empty() { String::new() } else { format!(" ({program}, line {line})") };
    Ok(print_result(json, &object, &format!("{time:23} {log:10} {client:7} {what}{place}"))?)
}
