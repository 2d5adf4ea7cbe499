//! What the measured images share: an entry point, memory that the compiler knows nothing of, and the end of a panic.
//!
//! The image `empty` has this and nothing else; its size is subtracted from those of the others. `memcpy`, divisions and
//! soft floats are not part of it: what a part needs of them counts as its own.
#![no_std]

use core::hint::black_box;

/// Makes `main: fn(&mut Memory)` the program.
#[macro_export]
macro_rules! entry {
    ($main:path) => {
        #[expect(unsafe_code, reason = "the linker looks for it")]
        #[unsafe(no_mangle)]
        extern "C" fn start() -> ! {
            static MEMORY: $crate::Cell = $crate::Cell::new();
            loop {
                $main(MEMORY.get());
            }
        }
    };
}

/// Bytes that come from outside, and room for those that leave.
#[derive(Debug)]
pub struct Memory {
    /// What has come.
    pub input: [u8; 256],
    /// Where results go.
    pub output: [u8; 256],
}

/// The memory of an image.
#[derive(Debug)]
pub struct Cell(core::cell::UnsafeCell<Memory>);

#[expect(unsafe_code, reason = "an image has one thread")]
// SAFETY: there are no interrupts and no other threads
unsafe impl Sync for Cell {}

impl Cell {
    /// Makes it.
    #[must_use]
    pub const fn new() -> Self {
        Self(core::cell::UnsafeCell::new(Memory { input: [0; 256], output: [0; 256] }))
    }

    /// Returns the memory; the compiler must take everything in it for unknown.
    #[expect(unsafe_code, clippy::mut_from_ref, reason = "called once for each turn of the one loop")]
    pub fn get(&self) -> &mut Memory {
        // SAFETY: the reference before has ended with its turn
        black_box(unsafe { &mut *self.0.get() })
    }
}

impl Default for Cell {
    fn default() -> Self {
        Self::new()
    }
}

/// Copies what fits, as a link would, and returns how much that was.
pub fn copy(from: &[u8], to: &mut [u8]) -> usize {
    let count = from.len().min(to.len());
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
    black_box(count)
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
