//! `bcap log`: the logs of the controller, one line for each entry.

use std::time::Duration;

use bcap_capture::LogEntry;
use bcap_capture::duration;
use bcap_core::hresult::HResult;
use bcap_live::history;
use clap::Args;

use crate::commands::robot::errors::described;
use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;

/// Lists the logs of errors and operations of the controller, the latest entry last
///
/// A line has the time on the controller's clock, the client that caused the entry, the code with its meaning, and the program
/// with its line. Each entry is a call, so a long log takes seconds. An entry of an unknown layout is printed as it is, first.
/// --follow reads the ends of the logs each second, and prints the entries that are new.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap log
  bcap log --errors --last 10
  bcap log --operations --json
  bcap log --last 5 --follow --for 1s")]
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

    /// Goes on with the entries that are added; Ctrl-C ends that
    #[arg(long)]
    pub(crate) follow: bool,

    /// Ends --follow after this time
    #[arg(long = "for", value_name = "TIME", value_parser = duration::parse, requires = "follow")]
    pub(crate) time: Option<Duration>,
}

/// Runs `bcap log`.
pub(crate) fn log(args: &Log, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut logs = Vec::new();
    if !args.operations {
        logs.push(history::Log::errors());
    }
    if !args.errors {
        logs.push(history::Log::operations());
    }
    let entries = new_entries(&mut logs, session)?;
    let skipped = entries.len().saturating_sub(args.last.unwrap_or(usize::MAX));
    entries.iter().skip(skipped).try_for_each(|entry| print(entry, json))?;
    if !args.follow {
        return Ok(());
    }
    let interval = Duration::from_secs(1);
    session.repeat(interval, args.time, |session| {
        new_entries(&mut logs, session)?.iter().try_for_each(|entry| print(entry, json))
    })
}

/// Returns the entries that were not seen, the latest one last.
fn new_entries(logs: &mut [history::Log], session: &mut Session) -> Result<Vec<LogEntry>, Failure> {
    let mut entries = Vec::new();
    for log in logs {
        log.read(session, usize::MAX, &mut entries)?;
    }
    entries.sort();
    Ok(entries)
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
