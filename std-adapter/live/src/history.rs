//! The logs of errors and operations of a controller.

use std::collections::HashSet;

use bcap_capture::LogEntry;
use bcap_capture::value::data;

use crate::calls::Calls;
use crate::errors::checked;
use crate::stream::StreamCheck;

/// A log of the controller, and the entries that were read.
#[derive(Debug)]
pub struct Log {
    is_error: bool,
    count: &'static str,
    get: &'static str,
    seen: HashSet<LogEntry>,
}

impl Log {
    /// The log of errors.
    #[must_use]
    pub fn errors() -> Self {
        Self { is_error: true, count: "GetErrorLogCount", get: "GetErrorLog", seen: HashSet::new() }
    }

    /// The log of operations.
    #[must_use]
    pub fn operations() -> Self {
        Self { is_error: false, count: "GetOprLogCount", get: "GetOprLog", seen: HashSet::new() }
    }

    /// Adds the new entries, at most `most` from each end. No source says which end of a log is the most recent, so both ends
    /// are read up to a known entry.
    ///
    /// # Errors
    ///
    /// The error of a call; [`Failure::skipped`](crate::calls::Failure::skipped) while a stream runs.
    pub fn read<C: Calls>(&mut self, calls: &mut C, most: usize, entries: &mut Vec<LogEntry>) -> Result<(), C::Error> {
        let mut check = StreamCheck::default();
        let count = checked(calls, &mut check, self.count, &())?.as_variant().as_i32().unwrap_or(0);
        let mut added = Vec::new();
        let mut left = 0..count;
        for from_the_end in [false, true] {
            for _ in 0..most {
                let Some(index) = (if from_the_end { left.next_back() } else { left.next() }) else { break };
                calls.restart_limit();
                let value = checked(calls, &mut check, self.get, &index)?;
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
