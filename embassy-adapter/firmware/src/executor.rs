//! An embassy executor that sleeps with WFI.
//!
//! embassy's own executor waits for events (WFE), which an emulator turns into a busy loop.
#![expect(unsafe_code, reason = "the executor is polled, and found by the name of a symbol")]

use core::sync::atomic::{AtomicBool, Ordering};

use bcap_board::stack;
use embassy_executor::{SpawnError, Spawner, raw};
use static_cell::StaticCell;

use crate::{clock, fault, uart};

static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
/// Whether a task was woken since the executor's last poll.
static WOKEN: AtomicBool = AtomicBool::new(false);

#[unsafe(export_name = "__pender")]
fn pender(_context: *mut ()) {
    WOKEN.store(true, Ordering::Release);
}

/// Starts tasks and [runs](run) them; logs it if one does not start.
///
/// `start` needs `#[inline(never)]`: otherwise the temporaries of initialisation would stay on the stack forever.
pub fn start(start: fn(Spawner) -> Result<(), SpawnError>) -> ! {
    run(|spawner| {
        if start(spawner).is_err() {
            defmt::error!("cannot start a task: its pool is full");
            fault::end()
        }
    })
}

/// Initialises the serial port, the record of faults and the clock, then runs tasks forever; there can be only one executor.
pub fn run(start: impl FnOnce(Spawner)) -> ! {
    uart::init();
    fault::init();
    if let Some(peripherals) = cortex_m::Peripherals::take() {
        clock::init(peripherals.SYST);
    }
    let executor = EXECUTOR.init_with(|| raw::Executor::new(core::ptr::null_mut()));
    start(executor.spawner());
    stack::repaint();
    loop {
        WOKEN.store(false, Ordering::Release);
        // SAFETY: `poll` is called here only, and this function never returns
        unsafe { executor.poll() };
        // an interrupt between this check and the sleep ends the sleep, although its handler runs after it
        critical_section::with(|_| {
            if !WOKEN.load(Ordering::Acquire) {
                cortex_m::asm::wfi();
            }
        });
    }
}
