//! The memory for large requests and replies, of which all connections together have no more than was allowed.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bcap_core::storage::Storage;

use crate::connect::STREAM_ROOM;

/// What is left for connections that need more than each has from the beginning.
#[derive(Clone, Debug)]
pub(super) struct Pool(Arc<AtomicUsize>);

impl Pool {
    pub(super) fn new(bytes: usize) -> Self {
        Self(Arc::new(AtomicUsize::new(bytes)))
    }

    /// Makes a buffer of [`STREAM_ROOM`] bytes, which cost the pool nothing.
    pub(super) fn buffer(&self) -> Buffer {
        Buffer { bytes: vec![0; STREAM_ROOM], pool: self.clone() }
    }

    fn take(&self, bytes: usize) -> bool {
        self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, |left| left.checked_sub(bytes)).is_ok()
    }

    fn give(&self, bytes: usize) {
        self.0.fetch_add(bytes, Ordering::AcqRel);
    }
}

/// A buffer that grows as long as its pool allows.
#[derive(Debug)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    pool: Pool,
}

impl Buffer {
    /// Returns how many bytes are the pool's.
    fn lent(&self) -> usize {
        self.bytes.len().saturating_sub(STREAM_ROOM)
    }
}

impl Storage for Buffer {
    fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    fn grow(&mut self, len: usize) -> bool {
        let more = len.saturating_sub(self.bytes.len());
        if more == 0 {
            return true;
        }
        if !self.pool.take(more) {
            tracing::warn!(more, "the memory of all connections is used up");
            return false;
        }
        // exactly as much as was taken, and no end of the process when the system has none
        if self.bytes.try_reserve_exact(more).is_err() {
            self.pool.give(more);
            return false;
        }
        self.bytes.resize(len, 0);
        true
    }

    fn shrink(&mut self, len: usize) {
        let lent = self.lent();
        self.bytes.shrink(len.max(STREAM_ROOM));
        self.pool.give(lent.saturating_sub(self.lent()));
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        self.pool.give(self.lent());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_has_the_others_cannot_have_until_it_is_given_back() {
        let pool = Pool::new(1000);
        let (mut first, mut second) = (pool.buffer(), pool.buffer());
        assert!(first.grow(STREAM_ROOM + 700));
        assert!(first.grow(10), "what it has already costs nothing");
        assert!(!second.grow(STREAM_ROOM + 301));
        assert_eq!(second.bytes().len(), STREAM_ROOM);
        assert!(second.grow(STREAM_ROOM + 300));
        first.shrink(0);
        assert_eq!(first.bytes().len(), STREAM_ROOM);
        assert!(second.grow(STREAM_ROOM + 1000));
        assert!(!first.grow(STREAM_ROOM + 1));
        drop(second);
        assert!(first.grow(STREAM_ROOM + 1000));
        drop(first);
        assert_eq!(pool.0.load(Ordering::Acquire), 1000);
    }
}
