//! The threads of the server, and the values that they share.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

/// Starts a thread for an order of a user. The error is for the user.
pub(crate) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), String> {
    let thread = thread::Builder::new().name(name.into()).spawn(work);
    thread.map(drop).map_err(|error| format!("a thread cannot be started: {error}; nothing was done"))
}

/// Locks values that threads share. A panic of another thread leaves values that were read or recorded, which stay valid.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
