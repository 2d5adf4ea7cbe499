//! What happens after a panic or a fault: it is reported, and the board starts again.
//!
//! With the feature `semihosting` the emulator ends with an error instead, so that a test sees it.

use core::fmt::Write as _;
use core::panic::PanicInfo;

use cortex_m_rt::ExceptionFrame;

use crate::uart::Text;

/// Reports a panic over defmt; what an image with a log calls in its panic handler.
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

/// Reports a panic as text; what an image without a log calls in its panic handler.
pub fn panic_text(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    let _ = writeln!(Text, "{info}");
    end()
}

pub(crate) fn hard_fault(frame: &ExceptionFrame) -> ! {
    // as text even in an image with defmt: a fault inside of the logger must be told too
    let _ = writeln!(Text, "\nhard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr());
    end()
}

pub(crate) fn hung() -> ! {
    let _ = writeln!(Text, "\nwatchdog: no progress of the tasks {:#b}", crate::watchdog::late());
    end()
}

pub(crate) fn unexpected(number: i16) -> ! {
    let _ = writeln!(Text, "\nunexpected exception or interrupt {number}");
    end()
}

/// Ends the program well: the emulator exits with success, a board starts again.
pub fn succeed() -> ! {
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_SUCCESS);
    cortex_m::peripheral::SCB::sys_reset()
}

/// Ends the program after a failure: the emulator exits with an error, a board starts again.
pub fn end() -> ! {
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    cortex_m::peripheral::SCB::sys_reset()
}
