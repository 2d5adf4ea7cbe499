//! The buffers of state machines, provided by the caller.

/// Memory for frames: `[u8; N]`, `&mut [u8]`, or, with the feature `alloc`, a `Vec<u8>` that grows as data arrive.
///
/// # Examples
///
/// ```
/// use bcap_core::storage::Storage;
///
/// let mut board = [0_u8; 512];
/// assert!(!board.grow(1024));
/// assert_eq!(board.bytes_mut().len(), 512);
/// ```
pub trait Storage {
    /// Views the memory.
    fn bytes(&self) -> &[u8];

    /// Views the memory for changes.
    fn bytes_mut(&mut self) -> &mut [u8];

    /// Extends the memory to `len` bytes if it can, and keeps the contents.
    fn grow(&mut self, len: usize) -> bool {
        self.bytes().len() >= len
    }

    /// Releases memory above `len` bytes if it can, with its contents.
    fn shrink(&mut self, len: usize) {
        let _ = len;
    }
}

impl<const N: usize> Storage for [u8; N] {
    fn bytes(&self) -> &[u8] {
        self
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        self
    }
}

impl Storage for &mut [u8] {
    fn bytes(&self) -> &[u8] {
        self
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        self
    }
}

#[cfg(feature = "alloc")]
impl Storage for alloc::vec::Vec<u8> {
    fn bytes(&self) -> &[u8] {
        self
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        self
    }

    fn grow(&mut self, len: usize) -> bool {
        if self.len() < len {
            self.resize(len, 0);
        }
        true
    }

    fn shrink(&mut self, len: usize) {
        self.truncate(len);
        self.shrink_to(len);
    }
}

/// Moves the bytes from `by` on to the front of `buffer`.
///
/// `copy_within` does the same, but its range check would leave a panic in the image.
pub fn shift_down(buffer: &mut [u8], by: usize) {
    let cells = core::cell::Cell::from_mut(buffer).as_slice_of_cells();
    for (to, from) in cells.iter().zip(cells.get(by..).unwrap_or_default()) {
        to.set(from.get());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_moves_to_the_front() {
        let mut buffer = [1, 2, 3, 4, 5];
        shift_down(&mut buffer, 3);
        assert_eq!(buffer[..2], [4, 5]);
        shift_down(&mut buffer, 6);
        shift_down(&mut buffer, 0);
        assert_eq!(buffer[..2], [4, 5]);
    }
}
