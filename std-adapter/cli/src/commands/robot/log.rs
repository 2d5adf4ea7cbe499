//! `bcap log`: the logs of the controller, one line for each entry.

use std::collections::HashSet;
use std::time::Duration;

use bcap_capture::LogEntry;
use bcap_capture::duration;
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
        logs.push(LogOf::errors());
    }
    if !args.errors {
        logs.push(LogOf::operations());
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
fn new_entries(logs: &mut [LogOf], session: &mut Session) -> Result<Vec<LogEntry>, Failure> {
    let mut entries = Vec::new();
    for log in logs {
        log.read(session, &mut entries)?;
    }
    entries.sort();
    Ok(entries)
}

/// A log of the controller.
struct LogOf {
    is_error: bool,
    count: &'static str,
    get: &'static str,
    seen: HashSet<LogEntry>,
}

impl LogOf {
    fn errors() -> Self {
        Self { is_error: true, count: "GetErrorLogCount", get: "GetErrorLog", seen: HashSet::new() }
    }

    fn operations() -> Self {
        Self { is_error: false, count: "GetOprLogCount", get: "GetOprLog", seen: HashSet::new() }
    }

    /// Adds the entries that were not seen. No source says which end of a log is the latest one, so it reads from both up to a
    /// seen entry.
    fn read(&mut self, session: &mut Session, entries: &mut Vec<LogEntry>) -> Result<(), Failure> {
        let mut check = StreamCheck::default();
        let count = checked(session, &mut check, self.count, &())?.as_variant().as_i32().unwrap_or(0);
        let mut added = Vec::new();
        let mut left = 0..count;
        for from_the_end in [false, true] {
            while let Some(index) = if from_the_end { left.next_back() } else { left.next() } {
                let value = checked(session, &mut check, self.get, &index)?;
                let unknown = || LogEntry {
                    is_error: self.is_error,
                    text: data::format(value.as_variant()),
                    ..LogEntry::default()
                };
                let entry = LogEntry::parse(self.is_error, value.as_variant()).unwrap_or_else(unknown);
                if self.seen.contains(&entry) {
                    break;
                }
                added.push(entry);
            }
        }
        self.seen.extend(added.iter().cloned());
        entries.append(&mut added);
        Ok(())
    }
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
