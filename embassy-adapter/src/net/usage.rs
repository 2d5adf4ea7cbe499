//! The peak use of the buffers of sockets.

use core::sync::atomic::{AtomicUsize, Ordering};

/// The peak number of bytes in a buffer of some TCP sockets, for choosing the sizes of buffers
/// ([`Options::usage`](super::Options::usage)).
///
/// If sockets run on several executors, a maximum can be lost: the counters have no atomic read-modify-write.
#[derive(Debug, Default)]
pub struct Usage {
    received: AtomicUsize,
    sent: AtomicUsize,
}

impl Usage {
    /// Creates counters that are 0.
    #[must_use]
    pub const fn new() -> Self {
        Self { received: AtomicUsize::new(0), sent: AtomicUsize::new(0) }
    }

    /// Returns the most bytes that were in a receive buffer, and in a send buffer.
    #[must_use]
    pub fn most(&self) -> (usize, usize) {
        (self.received.load(Ordering::Relaxed), self.sent.load(Ordering::Relaxed))
    }

    pub(super) fn has_received(&self, bytes: usize) {
        raise(&self.received, bytes);
    }

    pub(super) fn has_sent(&self, bytes: usize) {
        raise(&self.sent, bytes);
    }
}

fn raise(most: &AtomicUsize, bytes: usize) {
    if bytes > most.load(Ordering::Relaxed) {
        most.store(bytes, Ordering::Relaxed);
    }
}

/// Counters are equal only to themselves.
impl PartialEq for Usage {
    fn eq(&self, other: &Self) -> bool {
        core::ptr::eq(self, other)
    }
}

impl Eq for Usage {}

#[cfg(feature = "defmt")]
impl defmt::Format for Usage {
    fn format(&self, f: defmt::Formatter<'_>) {
        let (received, sent) = self.most();
        defmt::write!(f, "at most {=usize} bytes received, {=usize} to send", received, sent);
    }
}
