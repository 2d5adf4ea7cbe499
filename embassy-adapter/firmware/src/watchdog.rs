//! The watchdog of the board (CMSDK): a reset when the tasks make no progress.
//!
//! ```text
//!  fed ── 4 s without food ──► NMI: reported, reset ── 4 s more ──► reset by the watchdog itself
//! ```
//!
//! It is fed when every task that was promised has gone on since it was fed last: [`watched`] wakes its task each second,
//! so that one that does not get its turn, or never gives the processor back, is missed. What a task waits for may take
//! as long as it likes.

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
/// Seconds without food until the NMI comes.
const PATIENCE: u32 = 4;
/// How often a task shows that it is alive, and how often that is looked at.
const PULSE: Duration = Duration::from_secs(1);

/// A bit for each task that has gone on since the watchdog was fed last, and for each that was promised.
static ALIVE: AtomicU32 = AtomicU32::new(0);
static PROMISED: AtomicU32 = AtomicU32::new(0);

/// A task of the image, by its number, which is below 32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task(u32);

impl Task {
    /// Names a task.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self(1_u32.wrapping_shl(number))
    }
}

/// Works, and shows that the task is alive.
pub async fn watched<F: Future>(task: Task, work: F) -> F::Output {
    PROMISED.fetch_or(task.0, Ordering::Relaxed);
    let mut work = pin!(work);
    loop {
        ALIVE.fetch_or(task.0, Ordering::Relaxed);
        if let Ok(done) = with_timeout(PULSE, work.as_mut()).await {
            // a task that has ended is not missed
            PROMISED.fetch_and(!task.0, Ordering::Relaxed);
            return done;
        }
    }
}

/// Starts the watchdog, and feeds it for as long as all tasks go on and `is_well` says so.
pub async fn run(is_well: impl Fn() -> bool) -> ! {
    WATCHDOG.write::<{ register::LOCK }>(UNLOCK);
    WATCHDOG.write::<{ register::LOAD }>(CLOCK_HZ * PATIENCE);
    WATCHDOG.write::<{ register::CONTROL }>(INTERRUPT_AND_RESET);
    loop {
        Timer::after(PULSE).await;
        if late() == 0 && is_well() {
            ALIVE.store(0, Ordering::Relaxed);
            WATCHDOG.write::<{ register::INT_CLEAR }>(1);
        }
    }
}

/// Returns a bit for each task that has not gone on.
pub(crate) fn late() -> u32 {
    PROMISED.load(Ordering::Relaxed) & !ALIVE.load(Ordering::Relaxed)
}
