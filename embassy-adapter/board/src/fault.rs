//! The handler of faults on a Cortex-M: it records the cause and resets the board.
//!
//! [`on_stop`] sets what happens between the two, such as a report on a serial port. The linker finds the handler by name.
#![expect(
    unsafe_code,
    reason = "the handler of a fault is an unsafe function, and reads registers through their addresses"
)]

use core::cell::Cell;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use critical_section::Mutex;

use crate::memory;
use crate::record::Cause;
use crate::stack;

/// Bits of CFSR: the addresses of MMFAR and BFAR are valid; the stack pointer went below its limit.
const MMFAR_VALID: u32 = 1 << 7;
const BFAR_VALID: u32 = 1 << 15;
const STACK_LIMIT: u32 = 1 << 20;
/// Bit of ICSR: no other exception is active, so the fault interrupted the program. ARMv6-M does not have it.
const RETURNS_TO_PROGRAM: u32 = 1 << 11;

static STOP: Mutex<Cell<StopHook>> = Mutex::new(Cell::new(None));

/// The function that ends the program after a fault.
type StopHook = Option<fn(&Cause) -> !>;

/// Sets what ends the program after a fault. Without it the board is reset.
pub fn on_stop(end: fn(&Cause) -> !) {
    critical_section::with(|cs| STOP.borrow(cs).set(Some(end)));
}

/// Records a cause and ends the program.
pub fn stop(cause: Cause) -> ! {
    memory::record().write(cause);
    match critical_section::with(|cs| STOP.borrow(cs).get()) {
        Some(end) => end(&cause),
        None => SCB::sys_reset(),
    }
}

/// Records a panic, logs it and resets the board; for the panic handler of an image with a log.
pub fn panicked(info: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    memory::record().write_panic(info);
    defmt::error!("panic: {}", defmt::Display2Format(info));
    SCB::sys_reset()
}

// without the trampoline, which passes a reference to a frame that does not exist after a stack overflow
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    hard_fault()
}

/// Handles a fault of the program or of a handler.
fn hard_fault() -> ! {
    let FaultRegisters { status, hard, address } = FaultRegisters::read();
    let cause = match stack::saved() {
        None => Cause::StackOverflow { status, address },
        Some(_) if status & STACK_LIMIT != 0 => Cause::StackOverflow { status, address },
        Some(saved) if is_in_program() => Cause::Fault { pc: saved.pc, lr: saved.lr, status, hard, address },
        // the frame of a handler is on its own stack, whose depth is not known here
        Some(_) => Cause::Fault { pc: 0, lr: 0, status, hard, address },
    };
    stop(cause)
}

fn is_in_program() -> bool {
    // SAFETY: reading the register has no effect
    let state = unsafe { (*SCB::PTR).icsr.read() };
    cfg!(armv6m) || state & RETURNS_TO_PROGRAM != 0
}

/// The registers that describe a fault.
struct FaultRegisters {
    status: u32,
    hard: u32,
    address: u32,
}

impl FaultRegisters {
    #[cfg(not(armv6m))]
    fn read() -> Self {
        // SAFETY: reading the registers has no effect
        let (status, hard, memory, bus) = unsafe {
            let scb = &*SCB::PTR;
            (scb.cfsr.read(), scb.hfsr.read(), scb.mmfar.read(), scb.bfar.read())
        };
        let address = match status {
            status if status & BFAR_VALID != 0 => bus,
            status if status & MMFAR_VALID != 0 => memory,
            _ => 0,
        };
        Self { status, hard, address }
    }

    /// ARMv6-M has none of them.
    #[cfg(armv6m)]
    fn read() -> Self {
        let _ = (BFAR_VALID, MMFAR_VALID);
        Self { status: 0, hard: 0, address: 0 }
    }
}
