//! The activity of a connection, by which the listener decides whether it keeps its slot.

use std::sync::atomic::{AtomicU64, Ordering};

use bcap_core::peers::SlotState;
use bcap_core::time::Instant;
use tokio::sync::Notify;

/// The activity of a connection's task, and the signal that evicts it.
#[derive(Debug)]
pub(super) struct Activity {
    /// The time in microseconds since which it is idle; [`BUSY`] while it is not.
    idle_since: AtomicU64,
    evicted: Notify,
}

const BUSY: u64 = u64::MAX;

impl Activity {
    pub(super) fn new(now: Instant) -> Self {
        Self { idle_since: AtomicU64::new(now.as_micros()), evicted: Notify::new() }
    }

    /// Records since when the connection is idle; `None` while it is busy.
    pub(super) fn set(&self, idle_since: Option<Instant>) {
        self.idle_since.store(idle_since.map_or(BUSY, Instant::as_micros), Ordering::Release);
    }

    pub(super) fn state(&self) -> SlotState {
        match self.idle_since.load(Ordering::Acquire) {
            BUSY => SlotState::Busy,
            micros => SlotState::Idle(Instant::from_micros(micros)),
        }
    }

    /// Requests the connection's task to end.
    pub(super) fn evict(&self) {
        self.evicted.notify_one();
    }

    /// Waits until the connection is evicted.
    ///
    /// # Cancel safety
    ///
    /// Cancel safe.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }
}
