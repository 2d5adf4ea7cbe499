//! The progress of a command: a line on the standard error, if that is a terminal.

use std::fmt;
use std::io::{self, IsTerminal as _, Write as _};
use std::time::{Duration, Instant};

/// The minimum time between two drawings.
const INTERVAL: Duration = Duration::from_millis(50);

/// The maximum length of the line, in characters: a wrapped line could not be removed.
const WIDTH: usize = 79;

/// The characters of a bar.
const BAR: u64 = 30;

/// A line that shows the progress; dropping this removes it.
#[derive(Debug)]
pub struct Progress {
    is_terminal: bool,
    began: Instant,
    /// The last drawing; `None` while nothing is shown.
    drawn: Option<Instant>,
}

impl Default for Progress {
    fn default() -> Self {
        Self { is_terminal: io::stderr().is_terminal(), began: Instant::now(), drawn: None }
    }
}

impl Progress {
    /// Shows a line, unless the previous line was drawn too recently. `line` gets the time since the start.
    pub fn show(&mut self, line: impl FnOnce(Elapsed) -> String) {
        if self.is_terminal && self.drawn.is_none_or(|drawn| drawn.elapsed() >= INTERVAL) {
            let line: String = line(Elapsed(self.began.elapsed())).chars().take(WIDTH).collect();
            self.draw(&line);
            self.drawn = Some(Instant::now());
        }
    }

    /// Prints a line that stays, above the progress.
    pub fn print(&mut self, line: &str) {
        self.clear();
        // if the standard error fails, that cannot be reported
        let _ = writeln!(io::stderr().lock(), "{line}");
    }

    /// Removes the line.
    pub fn clear(&mut self) {
        if self.drawn.take().is_some() {
            self.draw("");
        }
    }

    fn draw(&self, line: &str) {
        let mut err = io::stderr().lock();
        // back to the first column, and erase the line
        let _ = write!(err, "\r\x1b[2K{line}").and_then(|()| err.flush());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.clear();
    }
}

/// A time as `12s` or `3m05s`.
#[derive(Clone, Copy, Debug)]
pub struct Elapsed(Duration);

impl fmt::Display for Elapsed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.as_secs() {
            seconds @ 0..60 => write!(f, "{seconds}s"),
            seconds => write!(f, "{}m{:02}s", seconds / 60, seconds % 60),
        }
    }
}

/// Returns a bar of 30 characters: `####------`.
#[must_use]
pub fn bar(done: u64, total: u64) -> String {
    let full = done.min(total).saturating_mul(BAR).checked_div(total).unwrap_or(0);
    (0..BAR).map(|n| if n < full { '#' } else { '-' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_full_at_the_end() {
        assert_eq!(bar(0, 0), "-".repeat(30));
        assert_eq!(bar(5, 10), ["#".repeat(15), "-".repeat(15)].concat());
        assert_eq!([bar(10, 10), bar(11, 10)], ["#".repeat(30), "#".repeat(30)]);
    }

    #[test]
    fn minutes_are_shown_from_one_minute_on() {
        assert_eq!([59, 60, 125].map(|s| Elapsed(Duration::from_secs(s)).to_string()), ["59s", "1m00s", "2m05s"]);
    }
}
