//! The feeding of a hardware watchdog: only while all tasks run.
//!
//! ```text
//!  armed first in `main` ─► fed each second while all registered tasks run ── not fed ──► reset
//! ```
//!
//! [`watched`] registers a task, and [`run`] wakes all registered tasks each second, so a task that starves or that never yields
//! is detected. A task may still wait for an event for any time. The image arms its watchdog with a timeout of some seconds and
//! passes [`run`] a closure that feeds it.
//!
//! The tasks' wakers are in a table, because a timer for each task would be set again each time the task runs.

use core::cell::Cell;
use core::future::poll_fn;
use core::pin::Pin;
use core::task::Waker;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Timer};

use crate::record::Cause;

/// The interval at which tasks are woken to report progress and at which the reports are checked.
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

/// The wakers of the registered tasks, by the tasks' numbers.
static WAKERS: Mutex<CriticalSectionRawMutex, [Cell<Option<Waker>>; u32::BITS as usize]> =
    Mutex::new([const { Cell::new(None) }; u32::BITS as usize]);

/// A task of the image, identified by a number below 32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task(u32);

impl Task {
    /// Creates the identifier of a task.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self(1_u32.wrapping_shl(number))
    }

    /// Reports progress, and stores the waker of the task. Not inlined, because there are many tasks.
    #[inline(never)]
    fn report(self, waker: &Waker) {
        update(|reports| reports.alive |= self.0);
        WAKERS.lock(|wakers| {
            if let Some(cell) = wakers.get(self.0.trailing_zeros() as usize) {
                let old = cell.take().filter(|old| old.will_wake(waker));
                cell.set(Some(old.unwrap_or_else(|| waker.clone())));
            }
        });
    }
}

/// Runs `work` and reports the task's progress.
///
/// The caller pins it, because an async function has a second copy of each argument.
pub async fn watched<F: Future>(task: Task, mut work: Pin<&mut F>) -> F::Output {
    update(|reports| reports.registered |= task.0);
    let done = poll_fn(|cx| {
        task.report(cx.waker());
        work.as_mut().poll(cx)
    })
    .await;
    // a task that has ended is no longer registered
    update(|reports| reports.registered &= !task.0);
    done
}

/// Wakes all registered tasks, which report progress then.
fn wake_all() {
    WAKERS.lock(|wakers| {
        for cell in wakers {
            let waker = cell.take();
            waker.iter().for_each(Waker::wake_by_ref);
            cell.set(waker);
        }
    });
}

/// Calls `feed` each second while all registered tasks run and `fault` returns none. Otherwise it records [`Cause::Watchdog`],
/// or the fault, in case the watchdog resets the board.
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
        wake_all();
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
