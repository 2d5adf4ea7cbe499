//! What the measured images share: an entry point, memory that the compiler knows nothing of, and the end of a panic.
//!
//! The image `empty` has this and nothing else; its size is subtracted from those of the others. `memcpy`, divisions and
//! soft floats are not in it: what a part needs of them counts as its own. The images are linked, not run.
#![no_std]

use core::cell::UnsafeCell;
use core::hint::black_box;
use core::mem::MaybeUninit;

/// Makes `main: fn(&mut Memory)` the program.
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

/// Bytes that come from outside, and room for those that leave.
#[derive(Debug)]
pub struct Memory {
    /// What has come.
    pub input: [u8; 256],
    /// Where results go.
    pub output: [u8; 256],
}

impl Memory {
    /// Views the memory; what is in it the compiler cannot know.
    #[expect(
        unsafe_code,
        clippy::mut_from_ref,
        reason = "the reference before has ended with its turn of the one loop"
    )]
    pub fn of(place: &Place<Self>) -> &mut Self {
        // SAFETY: any bytes are a value, and the place was zero at first
        black_box(unsafe { (*place.0.get()).assume_init_mut() })
    }
}

/// A place for a value in the image's memory, so that the value is counted there.
#[derive(Debug)]
pub struct Place<T>(UnsafeCell<MaybeUninit<T>>);

#[expect(unsafe_code, reason = "an image has one thread")]
// SAFETY: there are no interrupts and no other threads
unsafe impl<T> Sync for Place<T> {}

impl<T> Place<T> {
    /// Makes it.
    #[must_use]
    pub const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::zeroed()))
    }

    /// Puts a value there, instead of the one before.
    #[expect(
        unsafe_code,
        clippy::mut_from_ref,
        reason = "the reference before has ended with its turn of the one loop"
    )]
    pub fn put(&self, value: T) -> &mut T {
        // SAFETY: there is one caller for each place, whose reference of the turn before has ended
        black_box(unsafe { &mut *self.0.get() }).write(value)
    }
}

impl<T> Default for Place<T> {
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
