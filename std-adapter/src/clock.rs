//! The monotonic clock of this process. It starts at zero on first use.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::time::{Instant, micros};

/// The monotonic time of the first use; 0 before it.
static ORIGIN: AtomicU64 = AtomicU64::new(0);

/// Returns the current time on the clock that all clients and servers of this crate share.
#[must_use]
pub fn now() -> Instant {
    let now = monotonic();
    let origin = match ORIGIN.load(Ordering::Relaxed) {
        0 => begin(now),
        origin => origin,
    };
    Instant::from_micros(now.saturating_sub(origin))
}

/// Begins the clock, unless another thread has begun it.
#[cold]
fn begin(now: u64) -> u64 {
    match ORIGIN.compare_exchange(0, now, Ordering::Relaxed, Ordering::Relaxed) {
        Ok(_) => now,
        Err(origin) => origin,
    }
}

/// Returns microseconds since any origin, in a third of the instructions of `std::time::Instant::elapsed`: a call reads the clock three
/// times.
#[cfg(target_os = "linux")]
fn monotonic() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    let (seconds, nanoseconds) = (time.tv_sec.cast_unsigned(), time.tv_nsec.cast_unsigned());
    seconds.saturating_mul(1_000_000).saturating_add(nanoseconds / 1000)
}

/// Returns microseconds since the first call.
#[cfg(not(target_os = "linux"))]
fn monotonic() -> u64 {
    static ORIGIN: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    bcap_core::time::micros(ORIGIN.get_or_init(std::time::Instant::now).elapsed())
}

/// The clock of a transport. It keeps its last reading for the next wait, so a call reads the clock only once, at its start.
#[derive(Debug)]
pub(crate) struct RecentClock {
    /// The last reading in microseconds; 0 without one.
    recent: AtomicU64,
}

impl RecentClock {
    pub(crate) const fn new() -> Self {
        Self { recent: AtomicU64::new(0) }
    }

    /// Reads the clock, and stores the time.
    pub(crate) fn now(&self) -> Instant {
        let now = now();
        self.recent.store(now.as_micros(), Ordering::Relaxed);
        now
    }

    /// Returns the microseconds until `at`, counted from the stored time, and clears that time, because the caller waits next.
    /// Without a stored time it reads the clock.
    pub(crate) fn micros_until(&mut self, at: Instant) -> u64 {
        match std::mem::take(self.recent.get_mut()) {
            0 => micros(until(at)),
            recent => at.as_micros().saturating_sub(recent),
        }
    }
}

/// Returns the duration until `at`; zero if `at` has passed. It does not read the clock for [`Instant::ZERO`].
pub(crate) fn until(at: Instant) -> Duration {
    if at == Instant::ZERO { Duration::ZERO } else { at.saturating_since(now()) }
}
