//! A line for each action of a user.

use std::collections::VecDeque;
use std::sync::Mutex;

use crate::text::{now, safe};
use crate::threads::lock;

/// The lines that a page shows.
const KEPT: usize = 100;

/// Takes the lines.
pub(crate) struct Audit {
    line: Box<dyn Fn(&str) + Send + Sync>,
    /// The last lines, the latest first.
    last: Mutex<VecDeque<String>>,
}

impl Audit {
    pub(crate) fn new(line: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { line: Box::new(line), last: Mutex::default() }
    }

    /// Writes a line: when, who, at which robot, what, and the outcome.
    pub(crate) fn write<T>(&self, who: &str, robot: &str, what: &str, outcome: &Result<T, String>) {
        let outcome = outcome.as_ref().err().map_or("done", String::as_str);
        let time = now().map(|date| format!("{date}Z ")).unwrap_or_default();
        let line = safe(&format!("{time}{robot}: {who}: {what}: {outcome}"));
        (self.line)(&line);
        let mut last = lock(&self.last);
        last.push_front(line);
        last.truncate(KEPT);
    }

    /// Returns the last lines, the latest first.
    pub(crate) fn last(&self) -> Vec<String> {
        lock(&self.last).iter().cloned().collect()
    }
}
