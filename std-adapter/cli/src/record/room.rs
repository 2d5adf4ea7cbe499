//! The memory of the entries that wait for the file of a recording.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The bytes that wait, and their limit.
#[derive(Debug)]
pub(super) struct Room {
    limit: usize,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    used: usize,
    /// Whether the thread that writes has ended.
    closed: bool,
}

impl Room {
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Waits until there is room for `bytes`, and takes it. An entry above the limit waits until it is alone. Nothing
    /// waits after the end of the thread that writes.
    pub(super) fn take(&self, bytes: usize) {
        let is_full =
            |state: &mut State| !state.closed && state.used > 0 && state.used.saturating_add(bytes) > self.limit;
        let state = self.changed.wait_while(self.state(), is_full);
        let mut state = state.unwrap_or_else(PoisonError::into_inner);
        state.used = state.used.saturating_add(bytes);
    }

    /// Gives room back.
    pub(super) fn give(&self, bytes: usize) {
        let mut state = self.state();
        state.used = state.used.saturating_sub(bytes);
        self.changed.notify_all();
    }

    /// Lets all entries pass when the guard is dropped: at the end of the thread that writes, even by a panic.
    pub(super) const fn close_at_end(&self) -> Closing<'_> {
        Closing(self)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Closes a [`Room`] when it is dropped.
pub(super) struct Closing<'r>(&'r Room);

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
    fn entries_wait_for_room_in_bytes() {
        let room = Arc::new(Room::new(100));
        // many small entries, and one that is larger than the limit
        (0..100).for_each(|_| room.take(1));
        let (sender, taken) = channel();
        let other = Arc::clone(&room);
        let waiting = thread::spawn(move || {
            for bytes in [50, 1000] {
                other.take(bytes);
                sender.send(bytes).unwrap();
            }
        });
        room.give(49);
        assert!(taken.try_recv().is_err());
        room.give(1);
        assert_eq!(taken.recv(), Ok(50));
        room.give(99);
        assert!(taken.try_recv().is_err());
        room.give(1);
        assert_eq!(taken.recv(), Ok(1000));
        waiting.join().unwrap();
        drop(room.close_at_end());
        room.take(1000);
    }
}
