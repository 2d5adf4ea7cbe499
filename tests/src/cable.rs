//! A serial cable between two pseudo-terminals, with the speed and the faults of a real line.
//!
//! A pseudo-terminal passes bytes immediately, whatever its baud rate. The cable delays them as a UART would: a byte has ten
//! bits, and bytes leave sequentially in each direction. Bytes that the receiver does not read in time are lost, as in a UART.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_testkit::network::Random;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use tempfile::TempDir;

/// The interval at which a direction checks whether its end was unplugged.
const LOOK: Duration = Duration::from_millis(5);

/// The maximum number of bytes that are passed on together. Larger blocks would arrive later than on a real line.
const BLOCK: usize = 32;

/// The speed and the faults of a cable. The default is as fast as possible and without faults.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quality {
    /// The speed in bits per second; `None` means as fast as possible.
    pub baud: Option<u32>,
    /// One byte in this many has a flipped bit; 0 disables this.
    pub corrupt_one_in: u64,
    /// One byte in this many is lost; 0 disables this.
    pub lose_one_in: u64,
    /// The seed of the faults.
    pub seed: u64,
}

/// An end of a cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The end of the controller.
    Controller,
    /// The end of the client.
    Client,
}

/// The traffic of a cable, the sum of both directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passed {
    /// The bytes that were sent.
    pub bytes: u64,
    /// The bytes that were changed.
    pub corrupted: u64,
    /// The bytes that were lost by chance.
    pub lost: u64,
}

/// A cable. Each end has a path, which stays the same when the end is unplugged and plugged in again.
#[derive(Debug)]
pub struct Cable {
    folder: TempDir,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    plugs: [Mutex<Option<Arc<Plug>>>; 2],
    stopped: AtomicBool,
    bytes: AtomicU64,
    corrupted: AtomicU64,
    lost: AtomicU64,
}

/// A pair of pseudo-terminals: the cable's side, and the device, held open so that it exists without a program too.
#[derive(Debug)]
struct Plug {
    cable: File,
    _device: File,
}

impl Cable {
    /// Creates a cable with both ends plugged in.
    ///
    /// # Panics
    ///
    /// When this machine has no temporary folder, or no more pseudo-terminals.
    #[must_use]
    pub fn new(quality: Quality) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let shared = Arc::new(Shared::default());
        let mut cable = Self { folder, shared, threads: Vec::new() };
        for end in [End::Controller, End::Client] {
            cable.plug(end);
        }
        for (from, to) in [(End::Controller, End::Client), (End::Client, End::Controller)] {
            let random = Random(quality.seed.wrapping_mul(2).wrapping_add(from as u64));
            let direction = Direction { shared: Arc::clone(&cable.shared), from, to, quality, random, free: None };
            cable.threads.push(thread::spawn(move || direction.run()));
        }
        cable
    }

    /// Returns the path of an end.
    #[must_use]
    pub fn path(&self, end: End) -> PathBuf {
        self.folder.path().join(format!("{end:?}"))
    }

    /// Returns the address of the client's end at this speed.
    #[must_use]
    pub fn address(&self, baud: u32) -> String {
        format!("serial:{}?baud={baud}", self.path(End::Client).display())
    }

    /// Unplugs an end: its device is removed.
    pub fn unplug(&self, end: End) {
        // its device is gone when the two directions have dropped it too
        let plug = self.shared.plug(end).take();
        while plug.as_ref().is_some_and(|plug| Arc::strong_count(plug) > 1) {
            thread::yield_now();
        }
        let _ = fs::remove_file(self.path(end));
    }

    /// Plugs an end in again.
    ///
    /// # Panics
    ///
    /// When this machine has no more pseudo-terminals.
    pub fn plug(&mut self, end: End) {
        let (plug, device) = Plug::new().expect("a pseudo-terminal");
        *self.shared.plug(end) = Some(Arc::new(plug));
        symlink(device, self.path(end)).expect("a link in the temporary folder");
    }

    /// Returns the traffic so far.
    #[must_use]
    pub fn passed(&self) -> Passed {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let Shared { bytes, corrupted, lost, .. } = &*self.shared;
        Passed { bytes: load(bytes), corrupted: load(corrupted), lost: load(lost) }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.shared.stopped.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            if thread.join().is_err() && !thread::panicking() {
                panic!("a direction of the cable has panicked");
            }
        }
    }
}

impl Shared {
    fn plug(&self, end: End) -> std::sync::MutexGuard<'_, Option<Arc<Plug>>> {
        self.plugs[end as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Plug {
    /// Creates a pair of pseudo-terminals without echo and line editing; also returns the path of the device.
    fn new() -> io::Result<(Self, PathBuf)> {
        // processes that the test starts must not inherit it, or it would stay open after it was unplugged
        let cable = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&cable)?;
        unlockpt(&cable)?;
        let path = PathBuf::from(ptsname(&cable, Vec::new())?.into_string().map_err(io::Error::other)?);
        let flags = i32::try_from(OFlags::NOCTTY.bits()).map_err(io::Error::other)?;
        let device = OpenOptions::new().read(true).write(true).custom_flags(flags).open(&path)?;
        let mut settings = tcgetattr(&device)?;
        settings.make_raw();
        tcsetattr(&device, OptionalActions::Now, &settings)?;
        Ok((Self { cable: File::from(cable), _device: device }, path))
    }

    /// Waits until one of these events is possible; `false` if that takes longer than `wait`.
    fn is_ready(&self, flags: PollFlags, wait: Duration) -> bool {
        let wait = Timespec { tv_sec: 0, tv_nsec: wait.subsec_nanos().into() };
        let mut polled = [PollFd::new(&self.cable, flags)];
        poll(&mut polled, Some(&wait)).is_ok_and(|count| count > 0)
    }
}

/// One direction of a cable.
struct Direction {
    shared: Arc<Shared>,
    from: End,
    to: End,
    quality: Quality,
    random: Random,
    /// When the line has sent all bytes so far.
    free: Option<Instant>,
}

impl Direction {
    fn run(mut self) {
        while !self.shared.stopped.load(Ordering::Acquire) {
            let Some(from) = self.shared.plug(self.from).clone() else {
                thread::sleep(LOOK);
                continue;
            };
            let is_busy = from.is_ready(PollFlags::IN, Duration::ZERO);
            if !is_busy && !from.is_ready(PollFlags::IN, LOOK) {
                continue;
            }
            let mut bytes = [0; BLOCK];
            let Ok(count) = (&from.cable).read(&mut bytes) else { continue };
            drop(from);
            self.pace(count, is_busy);
            let bytes = self.spoilt(&bytes[..count]);
            if let Some(to) = self.shared.plug(self.to).clone()
                && to.is_ready(PollFlags::OUT, Duration::ZERO)
            {
                // what does not fit is lost
                let _ = (&to.cable).write(&bytes);
            }
        }
    }

    /// Waits until a UART would have sent these bytes; a busy one began with them when it had sent the bytes before them.
    fn pace(&mut self, count: usize, is_busy: bool) {
        let Some(baud) = self.quality.baud else { return };
        let now = Instant::now();
        let begin = self.free.filter(|_| is_busy).unwrap_or(now);
        let bits = u32::try_from(count).unwrap_or(u32::MAX).saturating_mul(10);
        let free = begin + Duration::from_secs(1) * bits / baud;
        self.free = Some(free);
        thread::sleep(free.saturating_duration_since(now));
    }

    /// Returns the bytes that arrive.
    fn spoilt(&mut self, bytes: &[u8]) -> Vec<u8> {
        let Shared { bytes: passed, corrupted, lost, .. } = &*self.shared;
        passed.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let (random, quality) = (&mut self.random, self.quality);
        let mut happens = |one_in: u64| one_in > 0 && random.below(one_in) == 0;
        let mut arrived = Vec::with_capacity(bytes.len());
        for byte in bytes {
            if happens(quality.lose_one_in) {
                lost.fetch_add(1, Ordering::Relaxed);
            } else if happens(quality.corrupt_one_in) {
                corrupted.fetch_add(1, Ordering::Relaxed);
                arrived.push(byte ^ 0x10);
            } else {
                arrived.push(*byte);
            }
        }
        arrived
    }
}
