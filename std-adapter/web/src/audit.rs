//! A line for each action of a user.

use std::fmt;
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::variant::OleDate;
use bcap_terminal::escape;

/// Takes the lines.
pub(crate) struct Audit(Box<dyn Fn(&str) + Send + Sync>);

impl fmt::Debug for Audit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Audit")
    }
}

impl Audit {
    pub(crate) fn new(line: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self(Box::new(line))
    }

    /// Writes a line: when, who, at which robot, what, and the outcome.
    pub(crate) fn write<T>(&self, who: &str, robot: &str, what: &str, outcome: &Result<T, String>) {
        let outcome = outcome.as_ref().err().map_or("done", String::as_str);
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let date =
            i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil);
        let time = date.map(|date| format!("{date}Z ")).unwrap_or_default();
        (self.0)(&escape::line(&escape::cut(&format!("{time}{robot}: {who}: {what}: {outcome}"))));
    }
}
