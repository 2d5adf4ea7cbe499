//! Records the bytes of connections as packets in a pcapng file, and hands the packets to the program.
//!
//! ```text
//!  Recorder ─► a queue ─► a thread: packets with headers ─► the file
//!                                                        └► a function of the program, such as the lines of a proxy
//! ```
//!
//! The headers of IP, TCP and UDP are synthetic, because the operating system does not expose the headers of connections.
//! Addresses, ports, times and the order of bytes are real.
//!
//! # Examples
//!
//! ```no_run
//! use bcap_capture::record::{Recording, Taped};
//! use bcap_std::blocking::{Connection, Controller, connect_tcp};
//! use bcap_std::Options;
//!
//! let recording = Recording::start(Some("session.pcapng".as_ref()), |_| {})?;
//! let connection = connect_tcp("192.168.0.1:5007", &Options::default())?;
//! let mut robot = Controller::unopened(Taped::connection(connection, Some(recording.recorder())));
//! // calls of `robot` are recorded
//! drop(robot);
//! recording.finish()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod budget;
mod ends;
mod packets;
mod pcapng;
mod tape;
mod transport;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::{self, JoinHandle};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use self::budget::Budget;
pub use self::ends::{Ends, Recorded};
use self::pcapng::Writer;
use self::tape::Tape;
pub use self::transport::{HasEnds, Taped};
use crate::error::Error;
use crate::role::Role;

/// The maximum number of bytes that wait for the file. Then [`Recorder::bytes`] waits, because a recording must not lack bytes.
const QUEUE: usize = 64 << 20;

/// An entry of the queue.
enum QueueEntry {
    Opened { at: u64, ends: Ends },
    Bytes { at: u64, ends: Ends, sender: Role, bytes: Vec<u8>, note: Option<String> },
    Note { at: u64, ends: Ends, text: String },
    Closed { at: u64, ends: Ends },
    End,
}

impl QueueEntry {
    /// Returns the memory that the entry takes, in bytes.
    fn size(&self) -> usize {
        let more = match self {
            Self::Bytes { bytes, note, .. } => bytes.len() + note.as_ref().map_or(0, String::len),
            Self::Note { text, .. } => text.len(),
            Self::Opened { .. } | Self::Closed { .. } | Self::End => 0,
        };
        size_of::<Self>() + more
    }
}

/// Records bytes; clones record to the same file.
#[derive(Clone, Debug)]
pub struct Recorder {
    queue: Sender<QueueEntry>,
    budget: Arc<Budget>,
    clock: Clock,
}

/// The time since 1970. It advances steadily even if the clock of the machine is set during the recording.
#[derive(Clone, Copy, Debug)]
struct Clock {
    start: Instant,
    since_1970: u64,
}

impl Clock {
    fn new() -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { start: Instant::now(), since_1970: u64::try_from(since_1970.as_nanos()).unwrap_or(0) }
    }

    fn now(&self) -> u64 {
        let elapsed = u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.since_1970.saturating_add(elapsed)
    }
}

impl Recorder {
    /// Returns the time, in nanoseconds since 1970.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.clock.now()
    }

    /// Returns how many bytes wait for the file, for a program that ends its recording instead of waiting for a slow disk.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.budget.used()
    }

    /// Records that a connection was opened.
    pub fn opened(&self, ends: Ends) {
        self.put(QueueEntry::Opened { at: self.now(), ends });
    }

    /// Records bytes that arrived or left at this time.
    pub fn bytes(&self, at: u64, ends: Ends, sender: Role, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.put(QueueEntry::Bytes { at, ends, sender, bytes: bytes.to_vec(), note: None });
        }
    }

    /// Records bytes with a remark, which becomes the comment of their packet.
    pub fn bytes_with(&self, at: u64, ends: Ends, sender: Role, bytes: &[u8], note: String) {
        self.put(QueueEntry::Bytes { at, ends, sender, bytes: bytes.to_vec(), note: Some(note) });
    }

    /// Hands a remark to the program; the file does not get it.
    pub fn note(&self, ends: Ends, text: String) {
        self.put(QueueEntry::Note { at: self.now(), ends, text });
    }

    /// Records the end of a connection.
    pub fn closed(&self, ends: Ends) {
        self.put(QueueEntry::Closed { at: self.now(), ends });
    }

    fn put(&self, entry: QueueEntry) {
        self.budget.take(entry.size());
        // the thread ends early only if the file cannot be written; `Recording::finish` reports that
        let _ = self.queue.send(entry);
    }
}

/// A running recording.
#[derive(Debug)]
pub struct Recording {
    recorder: Recorder,
    file: Option<PathBuf>,
    thread: JoinHandle<io::Result<()>>,
}

impl Recording {
    /// Starts a recording to a file, or only for `each`, which runs on the thread of the recording.
    ///
    /// # Errors
    ///
    /// When the file or the thread cannot be created.
    pub fn start(file: Option<&Path>, each: impl FnMut(Recorded<'_>) + Send + 'static) -> Result<Self, Error> {
        let writer = file.map(|path| Writer::create(path).map_err(|error| not_written(path, error))).transpose()?;
        let (queue, entries) = channel();
        let budget = Arc::new(Budget::new(QUEUE));
        let recorder = Recorder { queue, budget: Arc::clone(&budget), clock: Clock::new() };
        let thread = thread::Builder::new().name("record".into()).spawn(move || {
            let _closing = budget.close_at_end();
            run(&entries, &budget, Tape::new(writer, each))
        })?;
        Ok(Self { recorder, file: file.map(Path::to_owned), thread })
    }

    /// Returns the file; `None` for a recording without one.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Returns the recorder of the recording.
    #[must_use]
    pub const fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Returns whether the file can no longer be written.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes the recorded bytes, and closes the file.
    ///
    /// # Errors
    ///
    /// When the file could not be written.
    pub fn finish(self) -> Result<(), Error> {
        self.recorder.put(QueueEntry::End);
        let written = self.thread.join().unwrap_or_else(|_| Err(io::Error::other("the thread that writes panicked")));
        match (&self.file, written) {
            (Some(path), Err(error)) => Err(not_written(path, error)),
            (None, Err(error)) => Err(error.into()),
            (_, Ok(())) => Ok(()),
        }
    }
}

fn not_written(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.to_owned(), source }
}

/// Writes the bytes of one connection as a pcapng file: the times in nanoseconds since 1970, and the senders.
///
/// # Errors
///
/// When `out` does not accept them.
pub fn write<'a>(
    out: impl io::Write,
    ends: Ends,
    sent: impl IntoIterator<Item = (u64, Role, &'a [u8])>,
) -> io::Result<()> {
    let mut tape = Tape::new(Some(Writer::new(out)?), |_| {});
    for (at, sender, bytes) in sent {
        tape.bytes(at, ends, sender, bytes, None)?;
    }
    tape.flush()
}

/// Turns entries into packets until the end.
fn run(
    entries: &Receiver<QueueEntry>,
    budget: &Budget,
    mut tape: Tape<impl io::Write, impl FnMut(Recorded<'_>)>,
) -> io::Result<()> {
    loop {
        let entry = match entries.try_recv() {
            Ok(entry) => entry,
            Err(TryRecvError::Empty) => {
                // the file is complete whenever nothing happens
                tape.flush()?;
                entries.recv().unwrap_or(QueueEntry::End)
            }
            Err(TryRecvError::Disconnected) => QueueEntry::End,
        };
        // it uses memory until it is written, but only one entry at a time
        budget.release(entry.size());
        match entry {
            QueueEntry::Opened { at, ends } => tape.open(at, ends)?,
            QueueEntry::Bytes { at, ends, sender, bytes, note } => {
                tape.bytes(at, ends, sender, &bytes, note.as_deref())?;
            }
            QueueEntry::Note { at, ends, text } => tape.note(at, ends, &text),
            QueueEntry::Closed { at, ends } => tape.close(at, ends)?,
            QueueEntry::End => return tape.flush(),
        }
    }
}
