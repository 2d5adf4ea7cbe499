//! The order of calls of different connections: what was answered before a call is answered before it again.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The answered calls, by the order of their recorded replies.
pub(super) struct Order {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    /// Whether each call has ended.
    ended: Vec<bool>,
    /// The number of calls at the front that have all ended.
    front: usize,
}

impl Order {
    /// The order of this many answered calls.
    pub(super) fn new(answered: usize) -> Self {
        Self { state: Mutex::new(State { ended: vec![false; answered], front: 0 }), changed: Condvar::new() }
    }

    /// Waits until the first `count` calls have ended.
    pub(super) fn wait(&self, count: usize) {
        let waits = |state: &mut State| state.front < count;
        // a thread that panicked has left the numbers in order
        drop(self.changed.wait_while(self.lock(), waits).unwrap_or_else(PoisonError::into_inner));
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

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
