//! Support code of the measured images: an entry point, memory that is opaque to the compiler, and the panic handler.
//!
//! The image `empty` has only this; its size is subtracted from the sizes of the others. It has no `memcpy`, division
//! or soft float, so those that a part uses count as the part's own. The images are linked, not run.
#![no_std]

use core::cell::UnsafeCell;
use core::hint::black_box;
use core::mem::MaybeUninit;

/// Sets `main: fn(&mut Memory)` as the program.
#[macro_export]
macro_rules! entry {
    ($main:path) => {
        #[expect(unsafe_code, reason = "the linker looks for it")]
        #[unsafe(no_mangle)]
        extern "C" fn start() -> ! {
            static MEMORY: $crate::Place<$crate::Memory> = $crate::Place::new();
            loop {
                $main($crate::Memory::of(&MEMORY));
            }
        }
    };
}

/// Input bytes, and a buffer for output bytes.
#[derive(Debug)]
pub struct Memory {
    /// The input bytes.
    pub input: [u8; 256],
    /// The buffer for results.
    pub output: [u8; 256],
}

impl Memory {
    /// Returns the memory; its contents are opaque to the compiler.
    #[expect(
        unsafe_code,
        clippy::mut_from_ref,
        reason = "the reference before has ended with its turn of the one loop"
    )]
    pub fn of(place: &Place<Self>) -> &mut Self {
        // SAFETY: any bytes are a valid value, and the memory is initially zero
        black_box(unsafe { (*place.0.get()).assume_init_mut() })
    }
}

/// A static cell for a value, so that the value counts as memory of the image.
#[derive(Debug)]
pub struct Place<T>(UnsafeCell<MaybeUninit<T>>);

#[expect(unsafe_code, reason = "an image has one thread")]
// SAFETY: there are no interrupts and no other threads
unsafe impl<T> Sync for Place<T> {}

impl<T> Place<T> {
    /// Creates an empty cell.
    #[must_use]
    pub const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::zeroed()))
    }

    /// Replaces the value.
    #[expect(
        unsafe_code,
        clippy::mut_from_ref,
        reason = "the reference before has ended with its turn of the one loop"
    )]
    pub fn put(&self, value: T) -> &mut T {
        // SAFETY: each cell has one caller, whose reference from the previous iteration has ended
        black_box(unsafe { &mut *self.0.get() }).write(value)
    }
}

impl<T> Default for Place<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// Copies as many bytes as fit, as a link would, and returns their number.
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
