//! Records all connections of an access to a file, while a recording runs.
//!
//! A recording never delays a call: if the disk is full or too slow, the recording ends.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bcap_capture::Role;
use bcap_capture::record::{Ends, Recorded, Recording};

/// The maximum number of bytes that wait for the disk.
const QUEUE: usize = 16 << 20;

/// The size of a packet in the file without its bytes.
const BLOCK: u64 = 32;

/// Records the connections of an [`Access`](crate::link::Access); clones share the recording.
#[derive(Clone, Debug, Default)]
pub struct Tap(Arc<Mutex<TapState>>);

#[derive(Debug, Default)]
struct TapState {
    running: Option<Running>,
    last: Option<Outcome>,
    /// The number of recordings that were started.
    count: u64,
}

#[derive(Debug)]
struct Running {
    recording: Recording,
    file: PathBuf,
    since: Instant,
    size: Arc<AtomicU64>,
    limit: u64,
}

/// The end of a recording: its file, and why it ended early.
pub type Outcome = (PathBuf, Result<(), String>);

/// The state of a tap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Status {
    /// Nothing was recorded.
    Off,
    /// A recording runs.
    Runs {
        /// The file.
        file: PathBuf,
        /// Its size, in bytes.
        size: u64,
        /// The time since its start.
        length: Duration,
    },
    /// The last recording has ended.
    Ended(Outcome),
}

impl Tap {
    fn lock(&self) -> MutexGuard<'_, TapState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a recording to a new file, of about `limit` bytes at most. It waits for the disk. Of several simultaneous calls
    /// only one starts a recording.
    ///
    /// # Errors
    ///
    /// A text: a recording runs, or the file exists or cannot be written.
    pub fn start(&self, file: &Path, limit: u64) -> Result<(), String> {
        let cannot = |error: &dyn std::fmt::Display| format!("cannot record to {}: {error}", file.display());
        let runs = || Err("a recording runs; end it first".into());
        if self.lock().running.is_some() {
            return runs();
        }
        drop(File::create_new(file).map_err(|error| cannot(&error))?);
        let size = Arc::new(AtomicU64::new(0));
        let written = Arc::clone(&size);
        let count = move |recorded: Recorded<'_>| {
            if let Recorded::Packet { bytes, .. } = recorded {
                written.fetch_add(BLOCK + bytes.len() as u64, Ordering::Relaxed);
            }
        };
        let recording = Recording::start(Some(file), count).map_err(|error| error.to_string())?;
        let mut state = self.lock();
        if state.running.is_some() {
            // not under the lock, which the calls wait for
            drop(state);
            let _ = recording.finish();
            let _ = std::fs::remove_file(file);
            return runs();
        }
        state.count += 1;
        state.running = Some(Running { recording, file: file.to_owned(), since: Instant::now(), size, limit });
        Ok(())
    }

    /// Ends the recording, if one runs. It waits for the disk.
    pub fn stop(&self) -> Option<Outcome> {
        let Running { recording, file, .. } = self.lock().running.take()?;
        let outcome = (file, recording.finish().map_err(|error| error.to_string()));
        self.lock().last = Some(outcome.clone());
        Some(outcome)
    }

    /// Returns the number of recordings that were started. A recording lacks the beginning of a session that was opened before it.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.lock().count
    }

    /// Returns the state.
    #[must_use]
    pub fn status(&self) -> Status {
        let mut state = self.lock();
        state.check();
        match &*state {
            TapState { running: Some(Running { file, since, size, .. }), .. } => {
                Status::Runs { file: file.clone(), size: size.load(Ordering::Relaxed), length: since.elapsed() }
            }
            TapState { last: Some(outcome), .. } => Status::Ended(outcome.clone()),
            _ => Status::Off,
        }
    }

    /// Returns the line of a connection.
    pub(crate) const fn line(self, ends: Ends) -> TappedLink {
        TappedLink { tap: self, ends }
    }
}

impl TapState {
    /// Ends a recording that cannot continue.
    fn check(&mut self) {
        let Some(running) = &self.running else { return };
        let size = running.size.load(Ordering::Relaxed);
        let failed = running.recording.has_failed();
        let why = if failed {
            "the disk cannot be written".into()
        } else if running.recording.recorder().queued() > QUEUE {
            "the disk is too slow".into()
        } else if size >= running.limit {
            format!("it has {} MB, the limit of a recording", size / 1_000_000)
        } else {
            return;
        };
        let Some(Running { recording, file, .. }) = self.running.take() else { return };
        // `finish` blocks, except after a failure of the thread; a running thread writes the rest of its queue in the
        // background
        let written = if failed { recording.finish().map_err(|error| error.to_string()) } else { Ok(()) };
        self.last = Some((file, written.and(Err(why))));
    }
}

/// A connection. Its drop records its end.
#[derive(Debug)]
pub(crate) struct TappedLink {
    tap: Tap,
    ends: Ends,
}

impl TappedLink {
    pub(crate) fn packet(&self, role: Role, bytes: &[u8]) {
        let mut state = self.tap.lock();
        state.check();
        if let Some(running) = &state.running {
            let recorder = running.recording.recorder();
            recorder.bytes(recorder.now(), self.ends, role, bytes);
        }
    }
}

impl Drop for TappedLink {
    fn drop(&mut self) {
        let mut state = self.tap.lock();
        state.check();
        if let Some(running) = &state.running {
            running.recording.recorder().closed(self.ends);
        }
    }
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    use std::io::Read as _;
    use std::net::SocketAddr;

    use super::*;

    fn line(tap: &Tap) -> TappedLink {
        let end = |port| SocketAddr::from(([127, 0, 0, 1], port));
        tap.clone().line(Ends { is_tcp: true, client: end(1), server: end(2) })
    }

    /// Sends packets until the recording has ended, and returns why.
    fn why(tap: &Tap) -> String {
        let (line, since) = (line(tap), Instant::now());
        loop {
            let is_written = |running: &Running| running.recording.recorder().queued() == 0;
            if tap.lock().running.as_ref().is_some_and(is_written) {
                line.packet(Role::Request, &[0; 100_000]);
            }
            if let Status::Ended((_, outcome)) = tap.status() {
                return outcome.unwrap_err();
            }
            assert!(since.elapsed() < Duration::from_secs(20), "it does not end");
        }
    }

    #[test]
    fn a_recording_ends_at_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let (tap, file) = (Tap::default(), folder.path().join("a.pcapng"));
        tap.start(&file, 5_000_000).unwrap();
        assert_eq!(tap.start(&folder.path().join("b"), 1), Err("a recording runs; end it first".into()));
        assert_eq!(why(&tap), "it has 5 MB, the limit of a recording");
        let taken = tap.start(&file, 1).unwrap_err();
        assert!(taken.starts_with(&format!("cannot record to {}: ", file.display())), "{taken}");
        assert_eq!((tap.count(), tap.stop()), (1, None));
    }

    #[test]
    fn one_of_two_starts_at_the_same_time_succeeds() {
        let folder = tempfile::tempdir().unwrap();
        for round in 0..50 {
            let (tap, both) = (Tap::default(), std::sync::Barrier::new(2));
            let start = |name: &str| {
                let file = folder.path().join(format!("{round}-{name}"));
                both.wait();
                (tap.start(&file, 1).is_ok(), file.exists())
            };
            let (a, b) = std::thread::scope(|scope| {
                let other = scope.spawn(|| start("b"));
                (start("a"), other.join().unwrap())
            });
            // the other file is removed
            assert_eq!((a.0 ^ b.0, a, b), (true, (a.0, a.0), (b.0, b.0)));
            assert!(tap.count() == 1 && tap.stop().is_some_and(|(_, outcome)| outcome.is_ok()));
        }
    }

    /// Starts a recording to a FIFO, whose reader closes it at the end of `reads`.
    #[cfg(unix)]
    fn to_fifo(folder: &Path, reads: impl FnOnce(File) + Send + 'static) -> (Tap, std::thread::JoinHandle<()>) {
        let fifo = folder.join("fifo");
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let path = fifo.clone();
        let reader = std::thread::spawn(move || reads(File::open(path).unwrap()));
        let recording = Recording::start(Some(&fifo), |_| {}).unwrap();
        let (tap, size) = (Tap::default(), Arc::default());
        let running = Running { recording, file: fifo, since: Instant::now(), size, limit: u64::MAX };
        tap.lock().running = Some(running);
        (tap, reader)
    }

    #[cfg(unix)]
    #[test]
    fn a_disk_that_fails_ends_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let nowhere = folder.path().join("no/such/folder/a.pcapng");
        let refused = Tap::default().start(&nowhere, 1).unwrap_err();
        assert_eq!(refused, format!("cannot record to {}: No such file or directory (os error 2)", nowhere.display()));
        // the head of the file is still written
        let (tap, reader) = to_fifo(folder.path(), |mut file| assert!(file.read(&mut [0; 4096]).unwrap() > 0));
        reader.join().unwrap();
        let why = why(&tap);
        assert!(why.contains("fifo") && why.contains("Broken pipe"), "{why}");
    }

    /// No call waits for the disk: a halt must not.
    #[cfg(unix)]
    #[test]
    fn a_disk_that_hangs_ends_the_recording() {
        let (folder, (hang, hung)) = (tempfile::tempdir().unwrap(), std::sync::mpsc::channel::<()>());
        let (tap, reader) = to_fifo(folder.path(), move |file| {
            let _ = hung.recv();
            drop(file);
        });
        let line = line(&tap);
        while matches!(tap.status(), Status::Runs { .. }) {
            line.packet(Role::Request, &[0; 1 << 20]);
        }
        assert_eq!(tap.status(), Status::Ended((folder.path().join("fifo"), Err("the disk is too slow".into()))));
        drop(hang);
        reader.join().unwrap();
    }
}
