//! Text of a controller for a page, and the time.

use std::fmt::Display;
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::variant::{CivilTime, OleDate};
use bcap_terminal::escape;

/// Cuts a text, such as one of the controller, and escapes characters that act on the text around them.
pub(crate) fn safe(text: &(impl Display + ?Sized)) -> String {
    escape::line(&escape::cut(&text))
}

/// Returns the time of this computer, in UTC.
pub(crate) fn now() -> Option<CivilTime> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil)
}
