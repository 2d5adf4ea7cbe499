//! A log of events: one JSON object a line, each with its time in UTC.
//!
//! A thread writes the lines. If the reader stalls or the disk is full, lines are dropped and counted; this never delays the
//! program. An event `dropped` reports their number as soon as there is room again, or at the end. Characters that act on a
//! terminal are escaped.

use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bcap_core::variant::OleDate;
use bcap_terminal::escape;
use serde::Serialize;

/// The maximum number of lines that wait for the writer.
const BACKLOG: usize = 4096;

/// The maximum wait for the writer at the end.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// An event with its time.
#[derive(Serialize)]
struct Stamped<'a, T> {
    time: String,
    #[serde(flatten)]
    event: &'a T,
}

/// The event of lost lines.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Loss {
    Dropped { lines: u64 },
}

/// A log, for any thread.
#[derive(Debug)]
pub struct Log {
    lines: SyncSender<String>,
    /// The number of dropped lines that no event has reported yet.
    dropped: Arc<AtomicU64>,
}

/// The thread that writes a log.
#[derive(Debug)]
pub struct Writer(JoinHandle<()>);

/// Starts a log.
///
/// # Errors
///
/// When no thread can be started.
pub fn open(output: impl Write + Send + 'static) -> io::Result<(Log, Writer)> {
    let (log, lines) = Log::new(BACKLOG);
    let dropped = Arc::clone(&log.dropped);
    let writer = thread::Builder::new().name("events".into()).spawn(move || write(output, &lines, &dropped))?;
    Ok((log, Writer(writer)))
}

impl Log {
    fn new(backlog: usize) -> (Self, Receiver<String>) {
        let (lines, waiting) = sync_channel(backlog);
        (Self { lines, dropped: Arc::default() }, waiting)
    }

    /// Queues an event, or counts it if the queue is full.
    pub fn write(&self, event: &impl Serialize) {
        let lines = self.dropped.swap(0, Ordering::Relaxed);
        if lines > 0 && !self.send(&Loss::Dropped { lines }) {
            self.dropped.fetch_add(lines, Ordering::Relaxed);
        }
        if !self.send(event) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns `false` when the queue is full. After the writer has ended, no line counts as dropped.
    fn send(&self, event: &impl Serialize) -> bool {
        !matches!(self.lines.try_send(text(event)), Err(TrySendError::Full(_)))
    }
}

impl Writer {
    /// Waits until all events are written. The [`Log`] must have been dropped, or the wait lasts two seconds.
    pub fn finish(self) {
        let until = Instant::now() + CLOSE_TIMEOUT;
        while !self.0.is_finished() && Instant::now() < until {
            thread::sleep(Duration::from_millis(1));
        }
        if !self.0.is_finished() {
            warn(format_args!("the last lines of the log of events were not written in {CLOSE_TIMEOUT:?}"));
        }
    }
}

/// Writes lines until there are no more, or the pipe has no reader. `dropped` counts lines for which the queue had no room.
fn write(output: impl Write, lines: &Receiver<String>, dropped: &AtomicU64) {
    let (mut output, mut lost) = (Output { output, is_torn: false }, 0);
    loop {
        let line = lines.recv().ok();
        if line.is_none() {
            lost += dropped.swap(0, Ordering::Relaxed);
        }
        let counted = match lost {
            0 => Ok(()),
            lines => output.put(&text(&Loss::Dropped { lines })).inspect(|()| lost = 0),
        };
        match counted.and_then(|()| line.as_deref().map_or(Ok(()), |line| output.put(line))) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return,
            Err(error) => {
                if lost == 0 {
                    warn(format_args!("the log of events cannot be written: {}", escape::failure(&error)));
                }
                lost += 1;
            }
        }
        if line.is_none() {
            return;
        }
    }
}

/// The output of a log.
struct Output<W> {
    output: W,
    /// Whether the last line was truncated.
    is_torn: bool,
}

impl<W: Write> Output<W> {
    /// Writes a line in one piece, so that a rotation does not split it. After a truncated line it begins a new line.
    fn put(&mut self, line: &str) -> io::Result<()> {
        let text = format!("{}{line}\n", if self.is_torn { "\n" } else { "" });
        let mut left = text.as_bytes();
        while !left.is_empty() {
            let written = match self.output.write(left) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => written,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
                Err(error) => return Err(error),
            };
            let (done, rest) = left.split_at(written);
            self.is_torn = done.last().map_or(self.is_torn, |last| *last != b'\n');
            left = rest;
        }
        self.output.flush()
    }
}

/// Prints a warning on the standard error. `eprintln` would panic and end the thread if the standard error is full or closed.
pub(crate) fn warn(what: fmt::Arguments<'_>) {
    // if the standard error fails, that cannot be reported
    let _ = writeln!(io::stderr(), "warning: {what}");
}

fn text(event: &impl Serialize) -> String {
    // strings and numbers cannot fail
    escape::json(&serde_json::to_string(&Stamped { time: utc(), event }).unwrap_or_default())
}

/// Returns the time of day in UTC, as `2026-11-21T08:05:00.000Z`.
#[must_use]
pub fn utc() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let civil = i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil);
    civil.map(|civil| format!("{civil}Z")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk that accepts a number of bytes, and then refuses some writes.
    struct Disk {
        written: Vec<u8>,
        free: usize,
        full_for: u32,
    }

    impl Write for &mut Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.free == 0 && self.full_for > 0 {
                self.full_for -= 1;
                return Err(io::ErrorKind::StorageFull.into());
            }
            let count = if self.full_for > 0 { bytes.len().min(self.free) } else { bytes.len() };
            self.free -= count.min(self.free);
            self.written.extend(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Writes three lines to a disk; returns all lines on it.
    fn written(mut disk: Disk, dropped: u64) -> Vec<String> {
        let (sender, lines) = sync_channel(10);
        ["one", "two", "three"].iter().for_each(|line| sender.send((*line).to_owned()).unwrap());
        drop(sender);
        write(&mut disk, &lines, &AtomicU64::new(dropped));
        String::from_utf8(disk.written).unwrap().lines().map(str::to_owned).collect()
    }

    #[test]
    fn lines_that_a_full_disk_refuses_are_counted() {
        let lines = written(Disk { written: Vec::new(), free: 0, full_for: 2 }, 0);
        assert!(
            matches!(&lines[..], [dropped, three] if dropped.contains("\"lines\":2}") && three == "three"),
            "{lines:?}"
        );
        // a truncated line does not corrupt the next line
        let lines = written(Disk { written: Vec::new(), free: 5, full_for: 1 }, 0);
        let expected = |lines: &[String]| {
            matches!(lines, [one, t, dropped, three]
                if one == "one" && t == "t" && dropped.contains("\"lines\":1}") && three == "three")
        };
        assert!(expected(&lines), "{lines:?}");
    }

    /// The test runs itself again with a standard error that has no reader.
    #[test]
    fn a_warning_that_cannot_be_printed_does_not_end_the_log() {
        const AGAIN: &str = "BCAP_TEST_UNREAD";
        if std::env::var_os(AGAIN).is_some() {
            let lines = written(Disk { written: Vec::new(), free: 0, full_for: 1 }, 0);
            assert!(matches!(&lines[..], [dropped, _, _] if dropped.contains("\"lines\":1}")), "{lines:?}");
            return;
        }
        let (reader, writer) = io::pipe().unwrap();
        drop(reader);
        let name = "events::tests::a_warning_that_cannot_be_printed_does_not_end_the_log";
        let mut again = std::process::Command::new(std::env::current_exe().unwrap());
        // the test does not capture its output
        again.args(["--exact", name, "--nocapture"]).env(AGAIN, "1").stderr(writer);
        let output = again.output().unwrap();
        let out = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && out.contains("1 passed"), "{out}");
    }

    #[test]
    fn lines_that_are_lost_at_the_end_are_counted() {
        let lines = written(Disk { written: Vec::new(), free: 8, full_for: 1 }, 3);
        assert!(
            matches!(&lines[..], [_, two, dropped] if two == "two" && dropped.contains("\"lines\":4}")),
            "{lines:?}"
        );
    }

    #[test]
    fn lines_without_room_in_the_queue_are_counted() {
        let (log, waiting) = Log::new(2);
        let up = serde_json::json!({"event": "robot_up"});
        (0..5).for_each(|_| log.write(&up));
        assert_eq!(log.dropped.load(Ordering::Relaxed), 3);
        assert_eq!(waiting.try_iter().count(), 2);
        log.write(&up);
        let lines: Vec<String> = waiting.try_iter().collect();
        assert!(lines[0].contains(r#""event":"dropped","lines":3"#), "{lines:?}");
        assert_eq!((lines.len(), log.dropped.load(Ordering::Relaxed)), (2, 0));
        drop(waiting);
        log.write(&up);
        assert_eq!(log.dropped.load(Ordering::Relaxed), 0, "without a reader no line is missing");
    }

    #[test]
    fn a_line_begins_with_its_time_and_is_escaped() {
        let line = text(&serde_json::json!({"reason": "\u{1b}[2J\u{9b}31m\u{202e}\u{2028}\u{7f}Grün"}));
        assert!(!line.chars().any(escape::acts), "{line}");
        let (time, rest) = line.split_at(r#"{"time":"2026-11-21T08:05:00.000Z","#.len());
        assert!(time.starts_with(r#"{"time":"20"#) && time.ends_with(r#"Z","#), "{line}");
        assert_eq!(rest, r#""reason":"\u001b[2J\u009b31m\u202e\u2028\u007fGrün"}"#);
    }
}
