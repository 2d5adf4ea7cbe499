//! SysTick as a microsecond clock, and embassy's time driver on it.
//!
//! The timer reloads each millisecond. The time is the number of elapsed milliseconds plus the timer's count within the
//! current one. Alarms are checked each millisecond, so they fire at most 1 ms late.

use core::cell::RefCell;
use core::task::Waker;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use critical_section::{CriticalSection, Mutex};
use embassy_time_queue_utils::Queue;

use crate::board::CLOCK_HZ;

/// Timer counts per millisecond and per microsecond.
const PER_MILLI: u32 = CLOCK_HZ / 1000;
const PER_MICRO: u32 = CLOCK_HZ / 1_000_000;

struct Clock {
    state: Mutex<RefCell<State>>,
}

struct State {
    /// Elapsed milliseconds.
    millis: u64,
    /// The time of the next alarm, in microseconds.
    due: Option<u64>,
    queue: Queue,
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock {
    state: Mutex::new(RefCell::new(State { millis: 0, due: None, queue: Queue::new() })),
});

/// Starts the clock.
pub fn init(mut timer: SYST) {
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(PER_MILLI - 1);
    timer.clear_current();
    timer.enable_counter();
    // the count is 0, the end of a millisecond, until the timer loads its first value
    while SYST::get_current() == 0 {}
    timer.enable_interrupt();
}

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|cs| {
            let before = SYST::get_current();
            // the timer may have wrapped while its interrupt is masked
            let pending = SCB::is_pendst_pending();
            let count = if pending { SYST::get_current() } else { before };
            let passed = PER_MILLI.saturating_sub(1).saturating_sub(count) / PER_MICRO;
            let millis = self.state.borrow_ref(cs).millis + u64::from(pending);
            millis * 1000 + u64::from(passed)
        })
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut state = self.state.borrow_ref_mut(cs);
            if state.queue.schedule_wake(at, waker) {
                state.due = Some(state.due.map_or(at, |due| due.min(at)));
            }
        });
    }
}

impl Clock {
    fn tick(&self, cs: CriticalSection<'_>) {
        let mut state = self.state.borrow_ref_mut(cs);
        state.millis += 1;
        let now = state.millis * 1000;
        if state.due.is_some_and(|due| now >= due) {
            state.due = Some(state.queue.next_expiration(now));
        }
    }
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| CLOCK.tick(cs));
}
