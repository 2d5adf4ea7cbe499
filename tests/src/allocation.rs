//! A global allocator that counts allocations, for tests that code does not allocate.
//!
//! The count is kept per thread, so that the test harness and other tests do not disturb it.
//!
//! # Examples
//!
//! ```
//! use bcap_tests::allocation::{Counting, allocations};
//!
//! #[global_allocator]
//! static ALLOCATOR: Counting = Counting;
//!
//! assert_eq!(allocations(|| 1 + 1), (2, 0));
//! assert_eq!(allocations(|| vec![1_u8].len()), (1, 1));
//! ```
#![expect(unsafe_code, reason = "GlobalAlloc is an unsafe trait")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Allocations of this thread; const and without a destructor, so that reading it does not allocate.
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator with a counter of allocations.
#[derive(Debug)]
pub struct Counting;

// SAFETY: every method passes its arguments on unchanged to the system's allocator, which meets the contract.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promises are passed on, and `pointer` was allocated by the same allocator.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on, and `pointer` was allocated by the same allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Runs `body` and returns its result with the number of allocations, enlargements included, that this thread made.
///
/// It is always 0 unless [`Counting`] is the program's global allocator.
pub fn allocations<T>(body: impl FnOnce() -> T) -> (T, u64) {
    let before = COUNT.get();
    let result = body();
    (result, COUNT.get() - before)
}
