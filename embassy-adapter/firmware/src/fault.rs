//! Reports a panic or a fault, keeps a record of it and resets the board.
//!
//! The record is in memory that a reset does not clear, so the board can tell after the restart why it was reset. With the
//! feature `semihosting` the emulator exits with an error instead, so that a test detects it.

use core::fmt::{self, Write as _};
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;

use crate::board::SYSTEM_CONTROL;
use crate::record::{self, Cause};
use crate::uart::{self, Text};
use crate::{lan9118, stack};

/// Registers of the system control block.
mod register {
    pub(super) const ICSR: usize = 0x04;
    pub(super) const CFSR: usize = 0x28;
    pub(super) const HFSR: usize = 0x2c;
    pub(super) const MMFAR: usize = 0x34;
    pub(super) const BFAR: usize = 0x38;
}

/// Bits of CFSR: the addresses of MMFAR and BFAR are valid; the stack pointer went below its limit.
const MMFAR_VALID: u32 = 1 << 7;
const BFAR_VALID: u32 = 1 << 15;
const STACK_LIMIT: u32 = 1 << 20;
/// Bit of ICSR: no other exception is active, so the fault interrupted the program.
const RETURNS_TO_PROGRAM: u32 = 1 << 11;

/// Reports a panic over defmt; for the panic handler of an image with a log.
pub fn panic_logged(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    match info.location() {
        Some(at) => {
            record::write(Cause::panic(at.file(), at.line()));
            defmt::error!("panic at {=str}:{=u32}: {}", at.file(), at.line(), defmt::Display2Format(&info.message()))
        }
        None => defmt::error!("panic: {}", defmt::Display2Format(&info.message())),
    }
    end()
}

/// Reports a panic as text; for the panic handler of an image without a log.
pub fn panic_text(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    if let Some(at) = info.location() {
        record::write(Cause::panic(at.file(), at.line()));
    }
    let _ = writeln!(Text, "{info}");
    end()
}

/// Handles a fault of the program or of a handler.
pub(crate) fn hard_fault() -> ! {
    let status = SYSTEM_CONTROL.read::<{ register::CFSR }>();
    let address = match status {
        status if status & BFAR_VALID != 0 => SYSTEM_CONTROL.read::<{ register::BFAR }>(),
        status if status & MMFAR_VALID != 0 => SYSTEM_CONTROL.read::<{ register::MMFAR }>(),
        _ => 0,
    };
    let hard = SYSTEM_CONTROL.read::<{ register::HFSR }>();
    let in_program = SYSTEM_CONTROL.read::<{ register::ICSR }>() & RETURNS_TO_PROGRAM != 0;
    let cause = match stack::saved() {
        None => Cause::StackOverflow { status, address },
        Some(_) if status & STACK_LIMIT != 0 => Cause::StackOverflow { status, address },
        Some(saved) if in_program => Cause::Fault { pc: saved.pc, lr: saved.lr, status, hard, address },
        // the frame of a handler is on its own stack, whose depth is not known here
        Some(_) => Cause::Fault { pc: 0, lr: 0, status, hard, address },
    };
    stop(cause)
}

/// Handles the watchdog's NMI.
pub(crate) fn hung() -> ! {
    match crate::watchdog::stalled() {
        0 if lan9118::is_dead() => stop(Cause::Network),
        tasks => stop(Cause::Watchdog { tasks }),
    }
}

pub(crate) fn unexpected(number: i16) -> ! {
    stop(Cause::Unexpected { number: i32::from(number).cast_unsigned() })
}

/// Records a cause, reports it and ends the program.
fn stop(cause: Cause) -> ! {
    record::write(cause);
    // as text even in an image with defmt, so that a fault inside the logger is reported too
    let _ = writeln!(Text, "\n{cause}");
    end()
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PowerOn => f.write_str("power-on"),
            Self::Unrecorded => f.write_str("the watchdog or the reset input, without a record"),
            Self::Panic { file, line } => {
                let start = file.iter().position(|byte| *byte != 0).unwrap_or(file.len());
                write!(f, "panic at ..{}:{line}", file.get(start..).unwrap_or_default().escape_ascii())
            }
            Self::Fault { pc, lr, status, hard, address } => write!(
                f,
                "hard fault at {pc:#010x}, called from {lr:#010x}: CFSR {status:#010x}, HFSR {hard:#010x}, address \
                 {address:#010x}"
            ),
            Self::StackOverflow { status, address } => {
                write!(f, "stack overflow: CFSR {status:#010x}, address {address:#010x}")
            }
            Self::Watchdog { tasks: 0 } => f.write_str("watchdog: no task runs, or the gateway overruns its deadline"),
            Self::Watchdog { tasks } => write!(f, "watchdog: stalled tasks {tasks:#b}"),
            Self::Network => f.write_str("watchdog: the Ethernet controller does not respond"),
            Self::Unexpected { number } => write!(f, "unexpected exception or interrupt {}", number.cast_signed()),
        }
    }
}

/// Returns why the board was last reset; call it once at the start.
pub fn last_reset() -> Cause {
    record::take()
}

/// Ends the program with success: the emulator exits with 0, a board resets.
pub fn succeed() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_SUCCESS);
    SCB::sys_reset()
}

/// Ends the program after a failure: the emulator exits with an error, a board resets.
pub fn end() -> ! {
    uart::flush();
    #[cfg(feature = "semihosting")]
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    SCB::sys_reset()
}
