//! A memory pool for large requests and replies, which bounds the memory of all connections together.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bcap_core::storage::Storage;

use crate::connect::STREAM_ROOM;

/// The bytes that are left for connections that outgrow their initial buffers.
#[derive(Clone, Debug)]
pub(super) struct Pool(Arc<AtomicUsize>);

impl Pool {
    pub(super) fn new(bytes: usize) -> Self {
        Self(Arc::new(AtomicUsize::new(bytes)))
    }

    /// Creates a buffer of [`STREAM_ROOM`] bytes, which do not count against the pool.
    pub(super) fn buffer(&self) -> Buffer {
        Buffer { bytes: vec![0; STREAM_ROOM], pool: self.clone() }
    }

    fn take(&self, bytes: usize) -> bool {
        self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, |left| left.checked_sub(bytes)).is_ok()
    }

    fn give_back(&self, bytes: usize) {
        self.0.fetch_add(bytes, Ordering::AcqRel);
    }
}

/// A buffer that grows as far as its pool allows.
#[derive(Debug)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    pool: Pool,
}

impl Buffer {
    /// Returns how many bytes were taken from the pool.
    fn borrowed(&self) -> usize {
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
            tracing::warn!(more, "the memory pool of all connections is exhausted");
            return false;
        }
        // reserves exactly the bytes taken, and does not abort the process if the allocation fails
        if self.bytes.try_reserve_exact(more).is_err() {
            self.pool.give_back(more);
            return false;
        }
        self.bytes.resize(len, 0);
        true
    }

    fn shrink(&mut self, len: usize) {
        let before = self.borrowed();
        self.bytes.shrink(len.max(STREAM_ROOM));
        self.pool.give_back(before.saturating_sub(self.borrowed()));
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        self.pool.give_back(self.borrowed());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_share_the_pool_and_return_its_memory() {
        let pool = Pool::new(1000);
        let (mut first, mut second) = (pool.buffer(), pool.buffer());
        assert!(first.grow(STREAM_ROOM + 700));
        assert!(first.grow(10), "it has these bytes already");
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
