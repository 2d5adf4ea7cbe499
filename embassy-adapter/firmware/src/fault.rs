//! Reports a panic or a fault, keeps a record of it and resets the board.
//!
//! The record is in memory that a reset does not clear, so the board can report after the restart why it was reset. With the
//! feature `semihosting` the emulator exits with an error instead, so that a test detects it.

use core::fmt::Write as _;
use core::panic::PanicInfo;

use bcap_board::record::Cause;
use bcap_board::{memory, network, watchdog};
use cortex_m::peripheral::SCB;

use crate::lan9118;
use crate::uart::{self, Text};

/// Reports faults on the serial port before the board is reset.
pub fn init() {
    bcap_board::fault::on_stop(report);
}

/// Reports a panic over defmt; for the panic handler of an image with a log.
pub fn panic_logged(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    memory::record().write_panic(info);
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
    memory::record().write_panic(info);
    let _ = writeln!(Text, "{info}");
    end()
}

/// Handles the watchdog's NMI.
pub(crate) fn hung() -> ! {
    bcap_board::fault::stop(match watchdog::stalled() {
        0 if network::is_dead(lan9118::SILENCE) => Cause::Network,
        tasks => Cause::Watchdog { tasks },
    })
}

pub(crate) fn unexpected(number: i16) -> ! {
    bcap_board::fault::stop(Cause::Unexpected { number: i32::from(number).cast_unsigned() })
}

/// Reports a cause and ends the program.
fn report(cause: &Cause) -> ! {
    // as text even in an image with defmt, so that a fault inside the logger is reported too
    let _ = writeln!(Text, "\n{cause}");
    end()
}

/// Returns why the board was last reset; call it once at the start.
pub fn last_reset() -> Cause {
    memory::record().take()
}

/// Ends the program with success: the emulator exits with 0, a board stops.
pub fn succeed() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_SUCCESS);
    stop()
}

/// Ends the program after a failure, for a program that must not run again: the emulator exits with an error, a board stops.
pub fn fail() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    stop()
}

fn stop() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}

/// Ends the program after a failure: the emulator exits with an error, a board resets.
pub fn end() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    SCB::sys_reset()
}
