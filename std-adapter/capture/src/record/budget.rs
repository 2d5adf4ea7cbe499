//! Bounds the memory of queued entries.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The queued bytes, and their limit.
#[derive(Debug)]
pub(super) struct Budget {
    limit: usize,
    state: Mutex<BudgetState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct BudgetState {
    used: usize,
    /// Whether the thread that writes has ended.
    closed: bool,
}

impl Budget {
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Waits until `bytes` bytes are free, and reserves them. An entry above the limit waits until the queue is empty. Once the
    /// writer thread has ended, calls return immediately.
    pub(super) fn take(&self, bytes: usize) {
        let is_full =
            |state: &mut BudgetState| !state.closed && state.used > 0 && state.used.saturating_add(bytes) > self.limit;
        let state = self.changed.wait_while(self.state(), is_full);
        let mut state = state.unwrap_or_else(PoisonError::into_inner);
        state.used = state.used.saturating_add(bytes);
    }

    /// Returns the queued bytes.
    pub(super) fn used(&self) -> usize {
        self.state().used
    }

    /// Releases bytes.
    pub(super) fn release(&self, bytes: usize) {
        let mut state = self.state();
        state.used = state.used.saturating_sub(bytes);
        self.changed.notify_all();
    }

    /// Lets all entries pass when the guard is dropped: at the end of the thread that writes, even by a panic.
    pub(super) const fn close_at_end(&self) -> Closing<'_> {
        Closing(self)
    }

    fn state(&self) -> MutexGuard<'_, BudgetState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Closes a [`Budget`] when it is dropped.
pub(super) struct Closing<'r>(&'r Budget);

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.state().closed = true;
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::mpsc::channel;
    use std::thread;

    #[test]
    fn entries_wait_for_free_bytes() {
        let budget = Arc::new(Budget::new(100));
        // many small entries, and one that is larger than the limit
        (0..100).for_each(|_| budget.take(1));
        let (sender, taken) = channel();
        let other = Arc::clone(&budget);
        let waiting = thread::spawn(move || {
            for bytes in [50, 1000] {
                other.take(bytes);
                sender.send(bytes).unwrap();
            }
        });
        budget.release(49);
        assert!(taken.try_recv().is_err());
        budget.release(1);
        assert_eq!(taken.recv(), Ok(50));
        budget.release(99);
        assert!(taken.try_recv().is_err());
        budget.release(1);
        assert_eq!(taken.recv(), Ok(1000));
        waiting.join().unwrap();
        drop(budget.close_at_end());
        budget.take(1000);
    }
}
