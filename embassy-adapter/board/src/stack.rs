//! The stacks of a Cortex-M, and the high-water mark of the program's.
//!
//! ```text
//!  lowest address ─► guard │ program's stack │ stack of the exception handlers │ data
//! ```
//!
//! An overflow of the program's stack faults: at the guard, which the MPU forbids to access, or at the processor's limit of
//! the stack pointer (ARMv8-M). A frame that jumps over the guard leaves the memory, which faults as well. The fault's
//! handler runs on the other stack, so it can report the overflow. The program's stack is filled with a pattern; words that
//! differ from it have been in use.
//!
//! The linker script of the image defines the places. `_program_stack_end` must be a multiple of 256, and must be the lowest
//! address of the memory:
//!
//! ```text
//!  _program_stack_end = ORIGIN(STACK);       _program_stack_start = ORIGIN(STACK) + LENGTH(STACK);
//!  _stack_end = ORIGIN(HANDLERS);            _stack_start = ORIGIN(HANDLERS) + LENGTH(HANDLERS);
//! ```
#![expect(unsafe_code, reason = "the stack is memory that Rust has no name for")]

use core::arch::asm;
use core::ops::Range;
use core::ptr::addr_of_mut;

use cortex_m::register::psp;

const PATTERN: u32 = 0xcccc_cccc;
/// Words below the stack pointer that are not painted: the painting function's own frame.
const MARGIN: usize = 64;
/// Bytes of the guard: a power of two, at which the stack's lowest address is aligned.
const GUARD: usize = 256;

unsafe extern "C" {
    static mut _program_stack_start: u32;
    static mut _program_stack_end: u32;
}

/// Runs a program on its own stack; the exception handlers keep the stack that the processor started with. Call it first in
/// `main`.
pub fn run(program: extern "C" fn() -> !) -> ! {
    let Range { start, end } = bounds();
    paint(start, end);
    #[cfg(not(armv8m))]
    guard();
    #[cfg(armv8m)]
    // SAFETY: the limit is the end of the program's stack
    unsafe {
        asm!("msr psplim, {}", in(reg) start, options(nomem, nostack));
    }
    // SAFETY: `end` is the top of memory that only this stack uses, and no code runs on the old stack in thread mode again
    unsafe {
        asm!(
            "msr psp, {top}",
            "msr control, {program_stack}",
            "isb",
            "bx {program}",
            top = in(reg) end,
            program_stack = in(reg) 2,
            program = in(reg) program,
            options(noreturn)
        )
    }
}

/// Forbids every access to the guard, except to the handlers of a hard fault and of the NMI.
#[cfg(not(armv8m))]
fn guard() {
    use cortex_m::peripheral::MPU;

    const ENABLE: u32 = 1;
    const DEFAULT_ELSEWHERE: u32 = 1 << 2;
    const NUMBER_IS_VALID: u32 = 1 << 4;
    const NEVER_EXECUTE: u32 = 1 << 28;
    const SIZE: u32 = (GUARD.ilog2() - 1) << 1;
    let base = u32::try_from(addr_of_mut!(_program_stack_end).addr()).unwrap_or_default();
    // SAFETY: no code has a reason to access the guard, and no other code uses this region of the MPU
    unsafe {
        let mpu = &*MPU::PTR;
        mpu.rbar.write(base | NUMBER_IS_VALID);
        mpu.rasr.write(NEVER_EXECUTE | SIZE | ENABLE);
        mpu.ctrl.write(DEFAULT_ELSEWHERE | ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Paints the unused part of the stack again, so that [`high_water`] no longer includes the start of the program.
#[inline(never)]
pub fn repaint() {
    let start = bounds().start;
    let words = (to_usize(psp::read()) - start.addr()) / size_of::<u32>();
    paint(start, start.wrapping_add(words.saturating_sub(MARGIN)));
}

/// Returns the size of the stack, in bytes.
#[must_use]
pub fn size() -> usize {
    bounds().end.addr() - bounds().start.addr()
}

/// Returns the high-water mark of the stack, in bytes.
#[must_use]
pub fn high_water() -> usize {
    let Range { start, end } = bounds();
    let mut word = start;
    // SAFETY: the words are in the stack's memory, and no other code writes below the current end of the stack
    while word < end && unsafe { word.read_volatile() } == PATTERN {
        word = word.wrapping_add(1);
    }
    end.addr() - word.addr()
}

/// The program's place and its caller, as an exception saved them on the program's stack.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Saved {
    pub(crate) pc: u32,
    pub(crate) lr: u32,
}

/// Returns the frame that an exception saved; `None` if the stack has overflowed, because nothing was saved then.
pub(crate) fn saved() -> Option<Saved> {
    /// The words of a frame, and the places in it.
    const FRAME: usize = 8;
    const LR: usize = 5;
    const PC: usize = 6;
    let Range { start, end } = bounds();
    let frame = core::ptr::with_exposed_provenance::<u32>(to_usize(psp::read()));
    let is_inside = frame >= start.cast_const() && frame.wrapping_add(FRAME) <= end.cast_const();
    // SAFETY: the words are in the stack's memory
    let word = |at: usize| unsafe { frame.wrapping_add(at).read_volatile() };
    is_inside.then(|| Saved { pc: word(PC), lr: word(LR) })
}

fn paint(start: *mut u32, end: *mut u32) {
    let mut word = start;
    while word < end {
        // SAFETY: the words are in the stack's memory, and the callers pass an unused part of it
        unsafe { word.write_volatile(PATTERN) };
        word = word.wrapping_add(1);
    }
}

/// Returns the lowest word of the stack above the guard, and the end above it.
fn bounds() -> Range<*mut u32> {
    addr_of_mut!(_program_stack_end).wrapping_byte_add(GUARD)..addr_of_mut!(_program_stack_start)
}

/// Converts an address without loss, because `usize` has 32 bits on the board.
const fn to_usize(n: u32) -> usize {
    n as usize
}
