//! A hardware counter as a microsecond clock, and embassy's time driver on it.
//!
//! The counter of the FPGA runs at 1 MHz and wraps after 71 minutes. The time is the counter's value and the number of
//! its wraps. No wrap is missed, because SysTick reads the counter each millisecond. A SysTick that is lost delays
//! alarms but does not change the time. Alarms are checked each millisecond, so they fire at most 1 ms late.

use core::cell::RefCell;
use core::task::Waker;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;
use critical_section::{CriticalSection, Mutex};
use embassy_time_queue_utils::Queue;

use crate::board::{CLOCK_HZ, FPGA_IO};

/// Registers of the FPGA's I/O.
mod register {
    /// Counts up each time the prescaler has counted down.
    pub(super) const COUNTER: usize = 0x18;
    /// The prescaler's first value.
    pub(super) const PRESCALE: usize = 0x1c;
}

/// SysTick's counts per millisecond, and the prescaler's per microsecond.
const PER_MILLI: u32 = CLOCK_HZ / 1000;
const PER_MICRO: u32 = CLOCK_HZ / 1_000_000;

struct Clock {
    state: Mutex<RefCell<State>>,
}

struct State {
    /// The counter when it was last read.
    last: u32,
    /// Number of times the counter has wrapped.
    wraps: u32,
    /// The time of the next alarm, in microseconds.
    deadline: Option<u64>,
    queue: Queue,
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock {
    state: Mutex::new(RefCell::new(State { last: 0, wraps: 0, deadline: None, queue: Queue::new() })),
});

/// Starts the clock.
pub fn init(mut timer: SYST) {
    FPGA_IO.write::<{ register::PRESCALE }>(PER_MICRO - 1);
    FPGA_IO.write::<{ register::COUNTER }>(0);
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(PER_MILLI - 1);
    timer.clear_current();
    timer.enable_counter();
    timer.enable_interrupt();
}

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.state.borrow_ref_mut(cs).now())
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut state = self.state.borrow_ref_mut(cs);
            if state.queue.schedule_wake(at, waker) {
                state.deadline = Some(state.deadline.map_or(at, |deadline| deadline.min(at)));
            }
        });
    }
}

impl State {
    /// Reads the counter.
    fn now(&mut self) -> u64 {
        let count = FPGA_IO.read::<{ register::COUNTER }>();
        if count < self.last {
            self.wraps = self.wraps.wrapping_add(1);
        }
        self.last = count;
        u64::from(self.wraps) << 32 | u64::from(count)
    }
}

impl Clock {
    fn tick(&self, cs: CriticalSection<'_>) {
        let mut state = self.state.borrow_ref_mut(cs);
        let now = state.now();
        if state.deadline.is_some_and(|deadline| now >= deadline) {
            state.deadline = Some(state.queue.next_expiration(now));
        }
    }
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| CLOCK.tick(cs));
}
