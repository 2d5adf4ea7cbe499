//! Memory of an image that tools outside of it write or that a reset keeps: the block of settings, and the record of the last
//! reset's cause.
#![expect(
    unsafe_code,
    reason = "a host changes a constant after the build, and the section of a static is an unsafe attribute"
)]

#[cfg(any(target_arch = "arm", target_arch = "riscv32"))]
use core::sync::atomic::AtomicU32;

#[cfg(any(target_arch = "arm", target_arch = "riscv32"))]
use crate::record::{Memory, Record, WORDS};
use crate::{BLOCK, MAGIC};

#[used]
static SETTINGS: [u8; BLOCK] = {
    let mut block = [0; BLOCK];
    let mut i = 0;
    while i < MAGIC.len() {
        block[i] = MAGIC[i];
        i += 1;
    }
    block
};

/// The start-up code of cortex-m-rt does not change this section; neither does the code of esp-hal, except after power-on.
#[cfg(any(target_arch = "arm", target_arch = "riscv32"))]
#[cfg_attr(target_arch = "arm", unsafe(link_section = ".uninit.record"))]
#[cfg_attr(target_arch = "riscv32", unsafe(link_section = ".rtc_fast.persistent"))]
static RECORD: Memory = [const { AtomicU32::new(0) }; WORDS];

/// Returns the text of the settings in this image, up to the end of its block.
#[must_use]
pub fn image() -> &'static [u8] {
    let block: &'static [u8; BLOCK] = &SETTINGS;
    // the volatile read keeps the compiler from assuming the value of the constant
    // SAFETY: a reference is valid to read from
    let block = unsafe { core::ptr::from_ref(&block).read_volatile() };
    block.get(MAGIC.len()..).unwrap_or_default()
}

/// Returns the record of the last reset's cause, for images with cortex-m-rt or esp-hal.
#[cfg(any(target_arch = "arm", target_arch = "riscv32"))]
#[must_use]
pub const fn record() -> Record<'static> {
    Record::new(&RECORD)
}
