//! The boot loader of the image `gateway` with updates: swaps an update in, and back if it was not confirmed, then starts the
//! image.
//!
//! It arms the watchdog. So an image that hangs before it arms the watchdog is reset, and rolled back if it is on trial.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use bcap_board::{memory, stack};
use bcap_firmware::{update, watchdog};
use cortex_m::peripheral::SCB;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    memory::record().write_panic(info);
    SCB::sys_reset()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    watchdog::arm();
    stack::run(program)
}

extern "C" fn program() -> ! {
    if update::prepare().is_err() {
        SCB::sys_reset()
    }
    watchdog::arm();
    update::start()
}
