//! Reads little-endian fields from a slice, and writes them to a buffer.
//!
//! Neither type panics: a read past the end is `None`, a write past the end is [`EncodeError::Full`].

use crate::error::EncodeError;
use crate::num::{to_u32, to_usize};

/// The unread rest of the input.
#[derive(Clone, Copy)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    #[inline]
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    #[inline]
    pub(crate) const fn rest(&self) -> &'a [u8] {
        self.0
    }

    #[inline]
    pub(crate) const fn left(&self) -> usize {
        self.0.len()
    }

    #[inline]
    pub(crate) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    #[inline]
    pub(crate) fn slice(&mut self, len: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(head)
    }

    #[inline]
    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }
}

/// Fills a caller's buffer from the front.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::{Encode, Writer};
///
/// let mut buffer = [0; 16];
/// let mut out = Writer::new(&mut buffer);
/// 7_i32.encode(&mut out)?;
/// assert_eq!(out.as_bytes(), [3, 0, 1, 0, 0, 0, 7, 0, 0, 0]);
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
#[derive(Debug)]
pub struct Writer<'b> {
    buffer: &'b mut [u8],
    /// Never above `buffer.len()`.
    len: usize,
}

impl<'b> Writer<'b> {
    /// Starts at the front of `buffer`.
    #[must_use]
    pub const fn new(buffer: &'b mut [u8]) -> Self {
        Self { buffer, len: 0 }
    }

    /// Returns the number of bytes written.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Returns whether no byte was written.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the written bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.buffer.get(..self.len).unwrap_or_default()
    }

    /// Returns the written bytes, with the lifetime of the buffer.
    #[must_use]
    pub fn into_bytes(self) -> &'b [u8] {
        self.buffer.get(..self.len).unwrap_or_default()
    }

    /// Appends `N` bytes.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] if they do not fit; nothing is written.
    #[inline]
    pub fn put<const N: usize>(&mut self, bytes: [u8; N]) -> Result<(), EncodeError> {
        let slot = self.buffer.get_mut(self.len..).and_then(<[u8]>::first_chunk_mut::<N>).ok_or(EncodeError::Full)?;
        *slot = bytes;
        self.len = self.len.wrapping_add(N);
        Ok(())
    }

    /// Appends `bytes`.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] if they do not fit; nothing is written.
    #[cfg_attr(target_os = "none", inline(never))]
    pub fn put_slice(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        self.reserve(bytes.len())?.copy_from_slice(bytes);
        Ok(())
    }

    /// Appends `len` bytes and returns them, to be filled.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] if they do not fit; nothing is written.
    #[inline]
    pub(crate) fn reserve(&mut self, len: usize) -> Result<&mut [u8], EncodeError> {
        let slot = self.buffer.get_mut(self.len..).and_then(|rest| rest.get_mut(..len)).ok_or(EncodeError::Full)?;
        self.len = self.len.wrapping_add(len);
        Ok(slot)
    }

    /// Removes all bytes after the first `len`.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }

    /// Runs `body`, and writes the number of bytes that it appended before them, as a u32.
    // a board has one copy of this function; elsewhere a call would be slower
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(crate) fn length_prefixed(
        &mut self,
        body: &dyn Fn(&mut Self) -> Result<(), EncodeError>,
    ) -> Result<(), EncodeError> {
        let at = self.len;
        self.put([0; 4])?;
        let start = self.len;
        body(self)?;
        self.patch(at, to_u32(self.len.wrapping_sub(start)).to_le_bytes());
        Ok(())
    }

    /// Overwrites written bytes; an offset outside of them has no effect.
    #[inline]
    pub(crate) fn patch<const N: usize>(&mut self, at: usize, bytes: [u8; N]) {
        let written = self.buffer.get_mut(..self.len);
        if let Some(slot) = written.and_then(|w| w.get_mut(at..)).and_then(<[u8]>::first_chunk_mut::<N>) {
            *slot = bytes;
        }
    }
}

/// Reads a length-prefixed byte string.
#[cfg_attr(target_os = "none", inline(never))]
pub(crate) fn length_prefixed<'a>(r: &mut Reader<'a>) -> Option<&'a [u8]> {
    let len = r.u32()?;
    r.slice(to_usize(len))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_changes_nothing() {
        let mut buffer = [0xa5; 3];
        let mut out = Writer::new(&mut buffer);
        out.put([1, 2]).unwrap();
        assert_eq!(out.put([3, 4]), Err(EncodeError::Full));
        assert_eq!(out.put_slice(&[3, 4]), Err(EncodeError::Full));
        assert_eq!(out.as_bytes(), [1, 2]);
        out.patch(1, [9, 9]);
        assert_eq!(out.as_bytes(), [1, 2]);
        assert_eq!(buffer, [1, 2, 0xa5]);
    }
}
