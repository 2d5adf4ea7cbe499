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
    /// The last lines, in reverse order.
    last: Mutex<VecDeque<String>>,
}

impl Audit {
    pub(crate) fn new(line: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { line: Box::new(line), last: Mutex::default() }
    }

    /// Writes a line: when, who, at which robot, what, and the outcome. Each part is shortened separately, so that the outcome
    /// is never cut off.
    pub(crate) fn write<T>(&self, who: &str, robot: &str, what: &str, outcome: &Result<T, String>) {
        let outcome = outcome.as_ref().err().map_or("done", String::as_str);
        let time = now().map(|date| format!("{date}Z ")).unwrap_or_default();
        let [robot, who, what, outcome] = [robot, who, what, outcome].map(safe);
        let line = format!("{time}{robot}: {who}: {what}: {outcome}");
        (self.line)(&line);
        let mut last = lock(&self.last);
        last.push_front(line);
        last.truncate(KEPT);
    }

    /// Returns the last lines, in reverse order.
    pub(crate) fn last(&self) -> Vec<String> {
        lock(&self.last).iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_action_does_not_hide_its_outcome() {
        let audit = Audit::new(|_| {});
        audit.write("Anna", "press", &"x".repeat(5000), &Err::<(), _>("refused".to_owned()));
        let last = audit.last();
        assert!(last[0].ends_with("x... (4000 more characters): refused") && last[0].len() < 1200, "{last:?}");
    }
}
