//! The audit log: one JSON object a line for everything that a client asked, and for what became of the robot.
//!
//! | `event`                            | further fields                                             |
//! |------------------------------------|------------------------------------------------------------|
//! | `connected` `disconnected` `turned_away` | `client`                                             |
//! | `served` `failed`                  | `client` `line` `result` `name` `us`: the time it took     |
//! | `refused`                          | `client` `line` `result` `name` `reason`                   |
//! | `robot_up`                         | `robot`                                                    |
//! | `robot_down`                       | `robot` `reason` `retry_ms`                                |
//! | `dropped`                          | `lines`: so many could not be written in time              |
//! | `end`                              | `served` `failed` `refused` `sessions` and the times in us |
//!
//! Every object has `time`, in UTC. Lines are written by a thread: a reader that does not read costs lines, which are
//! counted, and never holds the gateway up.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bcap_core::gateway::{Counters, Tally};
use bcap_core::hresult::HResult;
use bcap_core::time::micros;
use bcap_core::variant::OleDate;
use serde::Serialize;

use crate::error::Failure;
use crate::times::Times;

/// Lines that wait for the writer at most.
const BACKLOG: usize = 4096;

/// How long the end waits for the writer.
const PATIENCE: Duration = Duration::from_secs(2);

/// What is written.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(super) enum Record {
    Connected { client: String },
    Disconnected { client: String },
    TurnedAway { client: String },
    Served(Answer),
    Failed(Answer),
    Refused(Answer),
    RobotUp { robot: String },
    RobotDown { robot: String, reason: String, retry_ms: u64 },
    Dropped { lines: u64 },
    End(Totals),
}

/// A line of a client, and what was answered.
#[derive(Debug, Serialize)]
pub(super) struct Answer {
    client: String,
    line: String,
    result: i32,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    us: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl Answer {
    /// Describes a line by its bytes, as they came.
    pub(super) fn new(client: String, line: &[u8], result: HResult) -> Self {
        let line = String::from_utf8_lossy(line).into_owned();
        Self { client, line, result: result.0, name: result.name(), us: None, reason: None }
    }

    pub(super) fn took(self, time: Duration) -> Self {
        Self { us: Some(micros(time)), ..self }
    }

    pub(super) fn because(self, reason: String) -> Self {
        Self { reason: Some(reason), ..self }
    }
}

/// What was done in all.
#[derive(Debug, Serialize)]
pub(super) struct Totals {
    served: TimesOf,
    failed: TimesOf,
    refused: u32,
    sessions: u32,
}

/// The times of all requests of one outcome, in microseconds.
#[derive(Debug, Serialize)]
struct TimesOf {
    count: u32,
    mean_us: u64,
    p50_us: u64,
    p99_us: u64,
    max_us: u64,
}

impl TimesOf {
    fn new(tally: &Tally, times: &Times) -> Self {
        Self {
            count: tally.count(),
            mean_us: micros(tally.mean()),
            p50_us: times.quantile(0.5),
            p99_us: times.quantile(0.99),
            max_us: micros(tally.max()),
        }
    }
}

/// A line of the log.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    #[serde(flatten)]
    record: &'a Record,
}

/// An audit log.
#[derive(Debug)]
pub(super) struct Audit {
    lines: SyncSender<String>,
    dropped: u64,
    writer: JoinHandle<()>,
    served: Times,
    failed: Times,
}

impl Audit {
    /// Opens the log: `-` is the standard output, a file is appended to.
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let output: Box<dyn Write + Send> = if path == Path::new("-") {
            Box::new(io::stdout())
        } else {
            let file = OpenOptions::new().append(true).create(true).open(path);
            Box::new(file.map_err(|error| Failure::Input(format!("cannot write to {}: {error}", path.display())))?)
        };
        let (lines, waiting) = sync_channel(BACKLOG);
        let writer = thread::Builder::new().name("audit".into()).spawn(move || write(output, &waiting))?;
        Ok(Self::new(lines, writer))
    }

    fn new(lines: SyncSender<String>, writer: JoinHandle<()>) -> Self {
        Self { lines, dropped: 0, writer, served: Times::new(), failed: Times::new() }
    }

    /// Writes a record.
    pub(super) fn write(&mut self, record: &Record) {
        match record {
            Record::Served(Answer { us: Some(us), .. }) => self.served.record(*us),
            Record::Failed(Answer { us: Some(us), .. }) => self.failed.record(*us),
            _ => {}
        }
        if self.dropped > 0 && self.send(&Record::Dropped { lines: self.dropped }) {
            self.dropped = 0;
        }
        if !self.send(record) {
            self.dropped += 1;
        }
    }

    /// Tells whether the record was taken; without a reader it is of no use to anybody, so it counts as taken.
    fn send(&self, record: &Record) -> bool {
        !matches!(self.lines.try_send(text(record)), Err(TrySendError::Full(_)))
    }

    /// Writes the totals and the waiting lines, as long as a reader takes them.
    pub(super) fn end(mut self, counters: &Counters) {
        let totals = Totals {
            served: TimesOf::new(&counters.served, &self.served),
            failed: TimesOf::new(&counters.failed, &self.failed),
            refused: counters.refused,
            sessions: counters.connected,
        };
        self.write(&Record::End(totals));
        drop(self.lines);
        let until = Instant::now() + PATIENCE;
        while !self.writer.is_finished() && Instant::now() < until {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Writes lines until there are no more, or nobody reads them. What a full disk does not take is counted, and the count is
/// written as soon as it takes something again.
fn write(mut output: impl Write, lines: &Receiver<String>) {
    let mut put = |line: &str| writeln!(output, "{line}").and_then(|()| output.flush());
    let mut lost = 0;
    while let Ok(line) = lines.recv() {
        let told = match lost {
            0 => Ok(()),
            lines => put(&text(&Record::Dropped { lines })).inspect(|()| lost = 0),
        };
        match told.and_then(|()| put(&line)) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return,
            Err(error) => {
                if lost == 0 {
                    eprintln!("warning: the audit log cannot be written: {error}");
                }
                lost += 1;
            }
        }
    }
}

fn text(record: &Record) -> String {
    // strings and numbers have no way to fail
    serde_json::to_string(&Line { time: time(), record }).unwrap_or_default()
}

/// Returns the time of day in UTC, as `2026-11-21T08:05:00.000Z`.
fn time() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let civil = i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil);
    civil.map(|civil| format!("{civil}Z")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk that is full for some writes.
    struct Disk {
        written: Vec<u8>,
        full_for: u32,
    }

    impl Write for &mut Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.full_for > 0 {
                self.full_for -= 1;
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.written.extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn what_a_full_disk_does_not_take_is_counted() {
        let mut disk = Disk { written: Vec::new(), full_for: 2 };
        let (sender, lines) = sync_channel(10);
        ["one", "two", "three"].iter().for_each(|line| sender.send((*line).to_owned()).unwrap());
        drop(sender);
        write(&mut disk, &lines);
        let written = String::from_utf8(disk.written).unwrap();
        let [dropped, three] = written.lines().collect::<Vec<_>>()[..] else { panic!("{written}") };
        assert!(dropped.contains("\"lines\":2"), "{dropped}");
        assert_eq!(three, "three");
    }

    #[test]
    fn a_line_says_when_who_what_and_how_it_ended() {
        let answer = Answer::new("10.0.0.2:40000".into(), b"GET:RC8:1:I:\xff", HResult::E_ACCESSDENIED);
        let record = Record::Refused(answer.because("not today".into()));
        let line = serde_json::to_string(&Line { time: time(), record: &record }).unwrap();
        let (time, rest) = line.split_at(r#"{"time":"2026-11-21T08:05:00.000Z","#.len());
        assert!(time.starts_with(r#"{"time":"20"#) && time.ends_with(r#"Z","#), "{line}");
        let expected = "\"event\":\"refused\",\"client\":\"10.0.0.2:40000\",\"line\":\"GET:RC8:1:I:\u{fffd}\",\
                        \"result\":-2147024891,\"name\":\"E_ACCESSDENIED\",\"reason\":\"not today\"}";
        assert_eq!(rest, expected);
    }

    #[test]
    fn a_reader_that_does_not_read_costs_lines_and_they_are_counted() {
        let (lines, waiting) = sync_channel(2);
        let mut audit = Audit::new(lines, thread::spawn(|| {}));
        let up = Record::RobotUp { robot: "tcp:10.0.0.1:5007".into() };
        for _ in 0..5 {
            audit.write(&up);
        }
        assert_eq!(audit.dropped, 3);
        assert_eq!(waiting.try_iter().count(), 2);
        audit.write(&up);
        let lines: Vec<String> = waiting.try_iter().collect();
        assert!(lines[0].contains(r#""event":"dropped","lines":3"#), "{lines:?}");
        assert_eq!((lines.len(), audit.dropped), (2, 0));
        drop(waiting);
        audit.write(&up);
        assert_eq!(audit.dropped, 0, "nobody is there to miss it");
        audit.end(&Counters::default());
    }

    #[test]
    fn the_totals_have_quantiles_with_three_digits() {
        let (lines, waiting) = sync_channel(1000);
        let mut audit = Audit::new(lines, thread::spawn(|| {}));
        for us in 900..1000 {
            let answer = Answer::new("10.0.0.2:40000".into(), b"GET:RC8:1:I:", HResult::S_OK);
            audit.write(&Record::Served(answer.took(Duration::from_micros(us))));
        }
        audit.end(&Counters::default());
        let end = waiting.try_iter().last().unwrap_or_default();
        assert!(end.contains(r#""p50_us":949,"p99_us":998"#), "{end}");
    }
}
