//! The feeding of a hardware watchdog: only while all tasks run.
//!
//! ```text
//!  armed first in `main` ─► fed each second while all registered tasks run ── not fed ──► reset
//! ```
//!
//! [`watched`] registers a task and wakes it each second, so a task that starves or that never yields is detected. A task may
//! still wait for an event for any time. The image arms its watchdog with a timeout of some seconds and passes [`run`] a
//! closure that feeds it.

use core::cell::Cell;
use core::pin::Pin;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Timer, with_timeout};

use crate::record::Cause;

/// The interval at which tasks report progress and at which the reports are checked.
const PULSE: Duration = Duration::from_secs(1);

/// A bit for each registered task, and a bit for each task that has run since the last feeding.
#[derive(Clone, Copy)]
struct Reports {
    registered: u32,
    alive: u32,
}

// not atomic integers, because some processors have no atomic addition
static REPORTS: Mutex<CriticalSectionRawMutex, Cell<Reports>> =
    Mutex::new(Cell::new(Reports { registered: 0, alive: 0 }));

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
///
/// The caller pins it, because an async function has a second copy of each argument.
pub async fn watched<F: Future>(task: Task, mut work: Pin<&mut F>) -> F::Output {
    update(|reports| reports.registered |= task.0);
    loop {
        update(|reports| reports.alive |= task.0);
        if let Ok(done) = with_timeout(PULSE, work.as_mut()).await {
            // a task that has ended is no longer registered
            update(|reports| reports.registered &= !task.0);
            return done;
        }
    }
}

/// Calls `feed` each second while all registered tasks run and `fault` returns none. Otherwise it records [`Cause::Watchdog`], or the
/// fault, in case that the watchdog resets the board.
pub async fn run(fault: impl Fn() -> Option<Cause>, mut feed: impl FnMut()) -> ! {
    let mut was_fed = true;
    loop {
        Timer::after(PULSE).await;
        let cause = match stalled() {
            0 => fault(),
            tasks => Some(Cause::Watchdog { tasks }),
        };
        let is_fed = cause.is_none();
        if is_fed != was_fed {
            record(cause.unwrap_or(Cause::Unrecorded));
        }
        was_fed = is_fed;
        if is_fed {
            update(|reports| reports.alive = 0);
            feed();
        }
    }
}

/// Writes the cause of the reset that may follow.
pub(crate) fn record(cause: Cause) {
    #[cfg(any(target_arch = "arm", target_arch = "riscv32"))]
    crate::memory::record().write(cause);
    // a host has no such memory
    #[cfg(not(any(target_arch = "arm", target_arch = "riscv32")))]
    let _ = cause;
}

/// Returns a bit for each registered task that has not run since the last feeding.
#[must_use]
pub fn stalled() -> u32 {
    REPORTS.lock(|reports| reports.get().registered & !reports.get().alive)
}

fn update(change: impl FnOnce(&mut Reports)) {
    REPORTS.lock(|cell| {
        let mut reports = cell.get();
        change(&mut reports);
        cell.set(reports);
    });
}
