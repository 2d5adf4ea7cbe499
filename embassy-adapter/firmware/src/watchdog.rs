//! The watchdog of the board (CMSDK): a reset when a task makes no progress.
//!
//! ```text
//!  arm, first in `main` ─► fed ── 4 s without feeding ──► NMI: reported, reset ── 4 s more ──► reset by the watchdog itself
//! ```
//!
//! It is fed when every registered task has run since the last feeding. [`watched`] wakes its task each second, so the
//! watchdog detects a task that starves or that never yields. A task may still wait for an event for any time.

use core::pin::pin;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::{Duration, Timer, with_timeout};

use crate::board::{CLOCK_HZ, WATCHDOG};

/// Registers of the watchdog.
mod register {
    pub(super) const LOAD: usize = 0x000;
    pub(super) const CONTROL: usize = 0x008;
    pub(super) const INT_CLEAR: usize = 0x00c;
    pub(super) const LOCK: usize = 0xc00;
}

const UNLOCK: u32 = 0x1acc_e551;
const INTERRUPT_AND_RESET: u32 = 0b11;
/// Seconds without feeding until the NMI.
const TIMEOUT_SECONDS: u32 = 4;
/// The interval at which tasks report progress and at which the reports are checked.
const PULSE: Duration = Duration::from_secs(1);

/// A bit for each task that has run since the last feeding, and a bit for each registered task.
static ALIVE: AtomicU32 = AtomicU32::new(0);
static PROMISED: AtomicU32 = AtomicU32::new(0);

/// A task of the image, identified by a number below 32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task(u32);

impl Task {
    /// Creates the identifier of a task.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self(1_u32.wrapping_shl(number))
    }
}

/// Runs `work` and reports the task's progress.
pub async fn watched<F: Future>(task: Task, work: F) -> F::Output {
    PROMISED.fetch_or(task.0, Ordering::Relaxed);
    let mut work = pin!(work);
    loop {
        ALIVE.fetch_or(task.0, Ordering::Relaxed);
        if let Ok(done) = with_timeout(PULSE, work.as_mut()).await {
            // a task that has ended is no longer registered
            PROMISED.fetch_and(!task.0, Ordering::Relaxed);
            return done;
        }
    }
}

/// Starts the watchdog; call it first in `main`, so that a start that hangs is reset, too.
pub fn arm() {
    WATCHDOG.write::<{ register::LOCK }>(UNLOCK);
    WATCHDOG.write::<{ register::LOAD }>(CLOCK_HZ * TIMEOUT_SECONDS);
    WATCHDOG.write::<{ register::CONTROL }>(INTERRUPT_AND_RESET);
}

/// Feeds the watchdog while all registered tasks run and `is_healthy` returns true.
pub async fn run(is_healthy: impl Fn() -> bool) -> ! {
    loop {
        Timer::after(PULSE).await;
        if stalled() == 0 && is_healthy() {
            ALIVE.store(0, Ordering::Relaxed);
            WATCHDOG.write::<{ register::INT_CLEAR }>(1);
        }
    }
}

/// Returns a bit for each registered task that has not run since the last feeding.
pub(crate) fn stalled() -> u32 {
    PROMISED.load(Ordering::Relaxed) & !ALIVE.load(Ordering::Relaxed)
}
