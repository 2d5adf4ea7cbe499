//! Memory of the caller: the checks of pointers, and all access through them.

use core::ffi::{CStr, c_char};
use core::slice;

use bcap_core::storage::Storage;

use crate::status::{BCAP_E_POINTER, BCAP_E_SHORT, BCAP_E_TEXT, Status};

/// The largest object that C can have.
const MAX: usize = isize::MAX.unsigned_abs();

/// Refuses a pointer that is null or misaligned.
pub(crate) fn check<T>(pointer: *const T) -> Result<(), Status> {
    if pointer.is_null() || !pointer.is_aligned() { Err(BCAP_E_POINTER) } else { Ok(()) }
}

/// Stores a result.
///
/// # Safety
///
/// `to` is null, or valid for a write.
pub(crate) unsafe fn put<T>(to: *mut T, value: T) -> Result<(), Status> {
    check(to)?;
    // SAFETY: it is not null and aligned; the caller promises the rest
    unsafe { to.write(value) };
    Ok(())
}

/// Reads a structure.
///
/// # Safety
///
/// `from` is null, or points to an initialised `T`.
pub(crate) unsafe fn get<T: Copy>(from: *const T) -> Result<T, Status> {
    check(from)?;
    // SAFETY: it is not null and aligned; the caller promises the rest
    Ok(unsafe { from.read() })
}

/// Views an array; null is an empty one if `count` is 0.
///
/// # Safety
///
/// `from` is null, or points to `count` initialised elements, which do not change during `'a`.
pub(crate) unsafe fn slice<'a, T>(from: *const T, count: usize) -> Result<&'a [T], Status> {
    if count == 0 {
        return Ok(&[]);
    }
    check(from)?;
    if count.checked_mul(size_of::<T>()).is_none_or(|size| size > MAX) {
        return Err(BCAP_E_POINTER);
    }
    // SAFETY: it is not null, aligned and not too large; the caller promises the rest
    Ok(unsafe { slice::from_raw_parts(from, count) })
}

/// Views a string that ends with NUL.
///
/// # Safety
///
/// `from` is null, or points to a string that does not change during `'a`.
pub(crate) unsafe fn read_text<'a>(from: *const c_char) -> Result<&'a str, Status> {
    check(from)?;
    // SAFETY: it is not null; the caller promises the rest
    unsafe { CStr::from_ptr(from) }.to_str().map_err(|_| BCAP_E_TEXT)
}

/// Copies an array to the caller.
///
/// # Safety
///
/// `to` is null, or valid for writes of `capacity` elements.
pub(crate) unsafe fn copy<T: Copy>(from: &[T], to: *mut T, capacity: usize) -> Result<(), Status> {
    if from.len() > capacity {
        return Err(BCAP_E_SHORT);
    }
    if from.is_empty() {
        return Ok(());
    }
    check(to)?;
    // SAFETY: `to` is not null, aligned, and has room; the elements are `Copy`, and a caller's buffer is not memory of this
    // library
    unsafe { to.copy_from(from.as_ptr(), from.len()) };
    Ok(())
}

/// A string that is written to a buffer of the caller, and ends with NUL there. It counts what does not fit.
pub(crate) struct TextBuffer {
    to: *mut c_char,
    size: usize,
    /// The length of the text, and of its beginning that was written.
    len: usize,
    written: usize,
}

impl TextBuffer {
    /// # Safety
    ///
    /// `to` is null, or valid for writes of `size` bytes during the life of the buffer.
    pub(crate) unsafe fn new(to: *mut c_char, size: usize) -> Self {
        Self { to, size: if to.is_null() { 0 } else { size }, len: 0, written: 0 }
    }

    /// Appends text as far as there is room for whole characters and NUL.
    pub(crate) fn push(&mut self, text: &str) {
        for character in text.chars() {
            let start = self.len;
            self.len = start.saturating_add(character.len_utf8());
            if self.len < self.size {
                let mut bytes = [0; 4];
                (start..)
                    .zip(character.encode_utf8(&mut bytes).bytes())
                    .for_each(|(index, byte)| self.set(index, byte));
                self.written = self.len;
            }
        }
    }

    fn set(&self, index: usize, byte: u8) {
        if index < self.size {
            // SAFETY: `new` has the promise of the caller for all indices below `size`
            unsafe { self.to.cast::<u8>().add(index).write(byte) };
        }
    }

    /// Ends the text with NUL; fails if it was cut.
    pub(crate) fn finish_whole(self) -> Result<(), Status> {
        let size = self.size;
        if self.finish() < size { Ok(()) } else { Err(BCAP_E_SHORT) }
    }

    /// Ends the text with NUL, and returns its whole length without NUL, as `snprintf` does.
    pub(crate) fn finish(self) -> usize {
        self.set(self.written, 0);
        self.len
    }
}

/// A buffer of the caller, which a client uses between calls.
#[derive(Debug)]
pub(crate) struct Memory {
    start: *mut u8,
    len: usize,
}

impl Memory {
    /// # Safety
    ///
    /// `start` is null, or valid for reads and writes of `len` bytes as long as this value is used.
    pub(crate) unsafe fn new(start: *mut u8, len: usize) -> Result<Self, Status> {
        if start.is_null() || len > MAX {
            return Err(BCAP_E_POINTER);
        }
        // C need not initialise its buffers, and Rust must not view uninitialised bytes
        // SAFETY: the caller promises that these bytes can be written
        unsafe { start.write_bytes(0, len) };
        Ok(Self { start, len })
    }
}

impl Storage for Memory {
    fn bytes(&self) -> &[u8] {
        // SAFETY: `new` has the promise of the caller, and initialised the bytes
        unsafe { slice::from_raw_parts(self.start, self.len) }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above; the buffers of a client do not overlap, and it has the only reference to this one
        unsafe { slice::from_raw_parts_mut(self.start, self.len) }
    }
}

/// Calls an unsafe function of this crate with a promise that the caller of a function of the header makes.
macro_rules! caller {
    ($($function:ident)::+ ($($argument:expr),* $(,)?)) => {
        // SAFETY: the head of the header states this promise for the pointers of all functions
        unsafe { $($function)::+ ($($argument),*) }
    };
}
pub(crate) use caller;
