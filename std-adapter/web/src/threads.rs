//! The values that threads of the server share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks values that threads share. A panic of another thread leaves values that were read or recorded, which stay valid.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
