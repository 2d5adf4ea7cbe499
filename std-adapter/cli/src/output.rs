//! The standard output. Every line is escaped, because part of its text may be untrusted.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_terminal::escape;
use serde::Serialize;

/// Prints one line for people.
pub(crate) fn print_line(line: &str) -> io::Result<()> {
    print_raw(&escape::line(line))
}

/// Prints lines of the command's own layout.
pub(crate) fn print_block(lines: &str) -> io::Result<()> {
    print_raw(&escape::block(lines))
}

/// Prints one line of JSON, or several.
pub(crate) fn print_json(lines: &str) -> io::Result<()> {
    print_raw(&escape::json(lines))
}

/// Prints one line, of JSON if `json`.
pub(crate) fn print(line: &str, json: bool) -> io::Result<()> {
    if json { print_json(line) } else { print_line(line) }
}

/// Prints a result: the object with `--json`, otherwise the line.
pub(crate) fn print_result(json: bool, object: &impl Serialize, line: &str) -> io::Result<()> {
    // serializing strings and numbers cannot fail
    if json { print_json(&serde_json::to_string(object).unwrap_or_default()) } else { print_line(line) }
}

/// Prints text as it is, with an end of line. It must not contain untrusted text.
pub(crate) fn print_raw(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.write_all(b"\n")?;
    out.flush()
}

/// The maximum number of lines that wait for the output.
const WAITING: usize = 4096;

/// Maximum time for the last lines.
const FINISH: Duration = Duration::from_secs(2);

/// A thread that prints lines, for a server that must not wait for a terminal that does not read.
pub(crate) struct Printer {
    queue: PrintQueue,
    thread: JoinHandle<()>,
}

/// The way to a [`Printer`]. Lines that find no room are left out, and counted.
#[derive(Clone)]
pub(crate) struct PrintQueue {
    /// `None` is the end.
    lines: SyncSender<Option<String>>,
    left_out: Arc<AtomicU64>,
    json: bool,
}

impl Printer {
    pub(crate) fn start(json: bool) -> io::Result<Self> {
        let (lines, waiting) = sync_channel(WAITING);
        // a closed output does not end the server
        let work = move || waiting.iter().map_while(|line| line).for_each(|line: String| drop(print(&line, json)));
        let thread = thread::Builder::new().name("lines".into()).spawn(work)?;
        Ok(Self { queue: PrintQueue { lines, left_out: Arc::default(), json }, thread })
    }

    pub(crate) fn queue(&self) -> PrintQueue {
        self.queue.clone()
    }

    /// Prints the rest, if the output takes it.
    pub(crate) fn finish(self) {
        let (until, mut is_sent) = (Instant::now() + FINISH, false);
        while !self.thread.is_finished() && Instant::now() < until {
            is_sent = is_sent || self.queue.lines.try_send(None).is_ok();
            thread::sleep(Duration::from_millis(1));
        }
    }
}

impl PrintQueue {
    /// Queues a line, preceded by the number of lines that were left out.
    pub(crate) fn put(&self, line: String) {
        let count = self.left_out.swap(0, Ordering::Relaxed);
        let loss = if self.json {
            format!("{{\"event\":\"dropped\",\"lines\":{count}}}")
        } else {
            format!("({count} lines were left out, because the output took none)")
        };
        let lost = if count > 0 && self.lines.try_send(Some(loss)).is_err() { count } else { 0 };
        let lost = lost + u64::from(self.lines.try_send(Some(line)).is_err());
        self.left_out.fetch_add(lost, Ordering::Relaxed);
    }
}

/// Prints a note on the standard error.
pub(crate) fn note(text: &str) {
    // an error of the standard error cannot be reported
    let _ = writeln!(io::stderr().lock(), " note: {}", escape::line(text));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_without_room_are_counted() {
        let (lines, waiting) = sync_channel(2);
        let queue = PrintQueue { lines, left_out: Arc::default(), json: false };
        (0..5).for_each(|n| queue.put(n.to_string()));
        assert_eq!(waiting.try_iter().flatten().collect::<Vec<_>>(), ["0", "1"]);
        queue.put("5".into());
        let left_out = "(3 lines were left out, because the output took none)";
        assert_eq!(waiting.try_iter().flatten().collect::<Vec<_>>(), [left_out, "5"]);
    }
}
