//! The panels of a log of calls: one call a line, `#4 I4(1) = Variable_GetValue(variable: I4(3))`.
//!
//! The reply is at the front, because a narrow terminal cuts off the end.

use std::time::Duration;

use bcap_live::log::{CallLog, CallStats, Entry};
use bcap_terminal::escape;
use bcap_terminal::screen::{KeyCode, Line, Mark, Panel, Part};

/// Returns each function and object once, with the count, the rate, the time since the last call, and its reply.
pub(crate) fn calls_panel(log: &CallLog, now: Duration) -> Panel {
    let line = |(name, call): (&str, &CallStats)| {
        let age = now.saturating_sub(call.last).as_secs_f64();
        let is_marked = call.changed.is_some_and(|at| now < at + bcap_live::log::MARKED);
        let text = format!(
            "{:6} {:6.1}/s {age:5.1} s  {} = {}",
            call.count,
            call.rate(),
            name.trim_end(),
            escape::cut(&call.reply)
        );
        Line { mark: if is_marked { Mark::Changed } else { Mark::Plain }, ..Line::new(text) }
    };
    Panel::new("calls: count, rate, time since the last one, reply", log.calls().map(line).collect())
}

/// Returns the lines as a panel.
pub(crate) fn log_panel(log: &CallLog, what: &str) -> Panel {
    let which = match (log.is_paused, log.shows_all) {
        (true, _) => "paused",
        (false, true) => "all",
        (false, false) => "changes only",
    };
    Panel::new(format!("{what}, {which}"), log.entries().map(line).collect()).showing(Part::Last)
}

fn line(entry: &Entry) -> Line {
    let Entry { at, number, call, reply } = entry;
    Line::new(format!("{:8.2} {number} {reply} = {call}", at.as_secs_f64()))
}

/// Handles the keys of a log.
pub(crate) fn log_key(log: &mut CallLog, key: KeyCode) {
    match key {
        KeyCode::Char('a') => log.shows_all = !log.shows_all,
        KeyCode::Char('p') => log.is_paused = !log.is_paused,
        _ => {}
    }
}
