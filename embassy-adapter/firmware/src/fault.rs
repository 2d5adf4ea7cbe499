//! Reports a panic or a fault and resets the board.
//!
//! With the feature `semihosting` the emulator exits with an error instead, so that a test detects it.

use core::fmt::Write as _;
use core::panic::PanicInfo;

use cortex_m_rt::ExceptionFrame;

use crate::uart::{self, Text};

/// Reports a panic over defmt; for the panic handler of an image with a log.
pub fn panic_logged(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    match info.location() {
        Some(at) => {
            defmt::error!("panic at {=str}:{=u32}: {}", at.file(), at.line(), defmt::Display2Format(&info.message()))
        }
        None => defmt::error!("panic: {}", defmt::Display2Format(&info.message())),
    }
    end()
}

/// Reports a panic as text; for the panic handler of an image without a log.
pub fn panic_text(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    let _ = writeln!(Text, "{info}");
    end()
}

pub(crate) fn hard_fault(frame: &ExceptionFrame) -> ! {
    // as text even in an image with defmt, so that a fault inside the logger is reported too
    let _ = writeln!(Text, "\nhard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr());
    end()
}

pub(crate) fn hung() -> ! {
    let _ = writeln!(Text, "\nwatchdog: stalled tasks {:#b}", crate::watchdog::stalled());
    end()
}

pub(crate) fn unexpected(number: i16) -> ! {
    let _ = writeln!(Text, "\nunexpected exception or interrupt {number}");
    end()
}

/// Ends the program with success: the emulator exits with 0, a board resets.
pub fn succeed() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_SUCCESS);
    cortex_m::peripheral::SCB::sys_reset()
}

/// Ends the program after a failure: the emulator exits with an error, a board resets.
pub fn end() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    cortex_m::peripheral::SCB::sys_reset()
}
