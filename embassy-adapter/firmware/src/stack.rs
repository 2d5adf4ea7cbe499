//! The high-water mark of the stack.
//!
//! The stack's memory is filled with a pattern before the program starts; words that differ from it have been in use.
#![expect(unsafe_code, reason = "the stack is memory that Rust has no name for")]

use core::ptr::addr_of;

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Returns the size of the stack, in bytes.
#[must_use]
pub fn size() -> usize {
    bounds().1.addr() - bounds().0.addr()
}

/// Returns the high-water mark of the stack, in bytes.
#[must_use]
pub fn high_water() -> usize {
    let (lowest, top) = bounds();
    let mut word = lowest;
    // SAFETY: the words are in the stack's memory, and no other code writes below the present end of the stack
    while word < top && unsafe { word.read_volatile() } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    top.addr() - word.addr()
}

fn bounds() -> (*const u32, *const u32) {
    (addr_of!(_stack_end), addr_of!(_stack_start))
}
