//! The order of calls of different connections: a call is sent only after every call that was answered before it in the
//! capture.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The answered calls, by the order of their recorded replies.
pub(super) struct Order {
    state: Mutex<OrderState>,
    changed: Condvar,
}

struct OrderState {
    /// Whether each call has ended.
    ended: Vec<bool>,
    /// The number of calls at the front that have all ended.
    front: usize,
    is_stopped: bool,
}

impl Order {
    /// The order of this many answered calls.
    pub(super) fn new(answered: usize) -> Self {
        let state = OrderState { ended: vec![false; answered], front: 0, is_stopped: false };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Waits until the first `count` calls have ended and no time is `left`. Returns false if the replay has stopped.
    pub(super) fn wait(&self, count: usize, left: impl Fn() -> Duration) -> bool {
        let mut state = self.lock();
        // the numbers are consistent even after a panic of a thread
        while !state.is_stopped {
            let left = left();
            if !left.is_zero() {
                state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
            } else if state.front < count {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            } else {
                return true;
            }
        }
        false
    }

    /// Stops the replay: no more calls are made.
    pub(super) fn stop(&self) {
        self.lock().is_stopped = true;
        self.changed.notify_all();
    }

    /// Records that a call has ended, with a reply or without.
    pub(super) fn end(&self, rank: usize) {
        let state = &mut *self.lock();
        if let Some(ended) = state.ended.get_mut(rank) {
            *ended = true;
        }
        while state.ended.get(state.front).copied().unwrap_or(false) {
            state.front += 1;
        }
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, OrderState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
