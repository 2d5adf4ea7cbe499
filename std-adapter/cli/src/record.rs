//! Records what a command sends and receives as packets in a pcapng file, and hands the packets to the command.
//!
//! ```text
//!  Recorder ─► a queue ─► a thread: packets with headers ─► the file
//!                                                        └► the command's own reader, such as the lines of `bcap proxy`
//! ```
//!
//! The headers of IP, TCP and UDP are synthetic, because the operating system does not show the real ones. Addresses,
//! ports, times and the order of bytes are real.

mod ends;
mod packets;
mod pcapng;
mod room;
mod tape;
mod transport;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

pub(crate) use self::ends::{Ends, Recorded};
use self::pcapng::Writer;
use self::room::Room;
use self::tape::Tape;
pub(crate) use self::transport::{TapedRac, TapedTcp, taped, taped_rac};
use crate::error::Failure;
use crate::frame::Role;

/// The most bytes that wait for the file. Then [`Recorder::bytes`] waits, because a recording must not lack bytes.
const QUEUE: usize = 64 << 20;

/// An entry of the queue.
enum Entry {
    Opened { at: u64, ends: Ends },
    Bytes { at: u64, ends: Ends, sender: Role, bytes: Vec<u8>, note: Option<String> },
    Note { at: u64, ends: Ends, text: String },
    Closed { at: u64, ends: Ends },
    End,
}

impl Entry {
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
pub(crate) struct Recorder {
    queue: Sender<Entry>,
    room: Arc<Room>,
    clock: Clock,
}

/// The time since 1970, which runs on evenly if the clock of the machine is set meanwhile.
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
    /// Returns nanoseconds since 1970.
    pub(crate) fn now(&self) -> u64 {
        self.clock.now()
    }

    /// Records that a connection was opened.
    pub(crate) fn opened(&self, ends: Ends) {
        self.put(Entry::Opened { at: self.now(), ends });
    }

    /// Records bytes that arrived or left at this time.
    pub(crate) fn bytes(&self, at: u64, ends: Ends, sender: Role, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.put(Entry::Bytes { at, ends, sender, bytes: bytes.to_vec(), note: None });
        }
    }

    /// Records bytes with a remark, which becomes the comment of their packet.
    pub(crate) fn bytes_with(&self, at: u64, ends: Ends, sender: Role, bytes: &[u8], note: String) {
        self.put(Entry::Bytes { at, ends, sender, bytes: bytes.to_vec(), note: Some(note) });
    }

    /// Hands a remark to the command; the file does not get it.
    pub(crate) fn note(&self, ends: Ends, text: String) {
        self.put(Entry::Note { at: self.now(), ends, text });
    }

    /// Records the end of a connection.
    pub(crate) fn closed(&self, ends: Ends) {
        self.put(Entry::Closed { at: self.now(), ends });
    }

    fn put(&self, entry: Entry) {
        self.room.take(entry.size());
        // the thread ends early only if the file cannot be written; `Recording::finish` reports that
        let _ = self.queue.send(entry);
    }
}

/// A running recording.
#[derive(Debug)]
pub(crate) struct Recording {
    recorder: Recorder,
    file: Option<PathBuf>,
    thread: JoinHandle<io::Result<()>>,
}

/// The recording of this command, if the user wants one.
static CURRENT: OnceLock<Recorder> = OnceLock::new();

/// Returns the recorder of this command, if it was called with `--write`.
pub(crate) fn current() -> Option<&'static Recorder> {
    CURRENT.get()
}

impl Recording {
    /// Starts the recording of this command, which [`current`] returns.
    pub(crate) fn of_command(file: &Path) -> Result<Self, Failure> {
        let recording = Self::start(Some(file), |_| {})?;
        // a command has one recording
        let _ = CURRENT.set(recording.recorder.clone());
        Ok(recording)
    }

    /// Starts a recording to a file, or only for `each`.
    pub(crate) fn start(file: Option<&Path>, each: impl FnMut(Recorded<'_>) + Send + 'static) -> Result<Self, Failure> {
        let writer = file.map(|path| Writer::create(path).map_err(|error| not_written(path, &error))).transpose()?;
        let (queue, entries) = channel();
        let room = Arc::new(Room::new(QUEUE));
        let recorder = Recorder { queue, room: Arc::clone(&room), clock: Clock::new() };
        let thread = thread::Builder::new().name("record".into()).spawn(move || {
            let _closing = room.close_at_end();
            run(&entries, &room, Tape::new(writer, each))
        })?;
        Ok(Self { recorder, file: file.map(Path::to_owned), thread })
    }

    /// Returns the file; `None` for a recording only for the command.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    pub(crate) fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Returns whether the file can no longer be written.
    pub(crate) fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes the entries so far, and closes the file.
    pub(crate) fn finish(self) -> Result<(), Failure> {
        self.recorder.put(Entry::End);
        let written = self.thread.join().unwrap_or_else(|_| Err(io::Error::other("the thread that writes panicked")));
        match (&self.file, written) {
            (Some(path), Err(error)) => Err(not_written(path, &error)),
            (None, Err(error)) => Err(error.into()),
            (_, Ok(())) => Ok(()),
        }
    }
}

fn not_written(path: &Path, error: &io::Error) -> Failure {
    Failure::Input(format!("cannot write {}: {error}", path.display()))
}

/// Turns entries into packets until the end.
fn run(entries: &Receiver<Entry>, room: &Room, mut tape: Tape<impl FnMut(Recorded<'_>)>) -> io::Result<()> {
    loop {
        let entry = match entries.try_recv() {
            Ok(entry) => entry,
            Err(TryRecvError::Empty) => {
                // the file is complete whenever nothing happens
                tape.flush()?;
                entries.recv().unwrap_or(Entry::End)
            }
            Err(TryRecvError::Disconnected) => Entry::End,
        };
        // it takes memory until it is written, but never more than one at a time
        room.give(entry.size());
        match entry {
            Entry::Opened { at, ends } => tape.open(at, ends)?,
            Entry::Bytes { at, ends, sender, bytes, note } => tape.bytes(at, ends, sender, &bytes, note.as_deref())?,
            Entry::Note { at, ends, text } => tape.note(at, ends, &text),
            Entry::Closed { at, ends } => tape.close(at, ends)?,
            Entry::End => return tape.flush(),
        }
    }
}
