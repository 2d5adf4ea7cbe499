//! A line for each action of a user.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Mutex, PoisonError};

use bcap_terminal::escape;

use crate::text::now;

/// The lines that a page shows.
const KEPT: usize = 100;

/// Takes the lines.
pub(crate) struct Audit {
    line: Box<dyn Fn(&str) + Send + Sync>,
    /// The last lines, the latest last.
    last: Mutex<VecDeque<String>>,
}

impl fmt::Debug for Audit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Audit")
    }
}

impl Audit {
    pub(crate) fn new(line: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { line: Box::new(line), last: Mutex::default() }
    }

    /// Writes a line: when, who, at which robot, what, and the outcome.
    pub(crate) fn write<T>(&self, who: &str, robot: &str, what: &str, outcome: &Result<T, String>) {
        let outcome = outcome.as_ref().err().map_or("done", String::as_str);
        let time = now().map(|date| format!("{date}Z ")).unwrap_or_default();
        let line = escape::line(&escape::cut(&format!("{time}{robot}: {who}: {what}: {outcome}")));
        (self.line)(&line);
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.len() >= KEPT {
            last.pop_front();
        }
        last.push_back(line);
    }

    /// Returns the last lines, the latest first.
    pub(crate) fn last(&self) -> Vec<String> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).iter().rev().cloned().collect()
    }
}
