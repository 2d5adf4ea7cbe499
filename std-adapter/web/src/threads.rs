//! The threads of the server, and the values that they share.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use tokio::sync::{Semaphore, oneshot};
use tokio::time::timeout;

/// Maximum time that an order waits for the disk.
const DISK: Duration = Duration::from_secs(5);

/// Limits the threads that wait for a disk that hangs.
static SLOTS: Semaphore = Semaphore::const_new(16);

/// Starts a thread for an order of a user. The error is for the user.
pub(crate) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), String> {
    let thread = thread::Builder::new().name(name.into()).spawn(work);
    thread.map(drop).map_err(|error| format!("a thread cannot be started: {error}; nothing was done"))
}

const BUSY: &str = "other orders wait for the disk; nothing was done";

/// Does work that waits for the disk. A disk that hangs must delay neither a halt nor the end of the process, so a separate
/// thread does it; nor the next orders of the page, so there is a time limit.
pub(crate) async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Result<T, String> {
    let order = async {
        let slot = timeout(DISK / 2, SLOTS.acquire()).await.map_err(|_| BUSY)?;
        let (sender, done) = oneshot::channel();
        spawn("disk", move || drop((sender.send(work()), slot)))?;
        done.await.unwrap_or_else(|_| Err("the work on the disk panicked".into()))
    };
    let late = |_| Err(format!("the disk has not answered for {} s; it may still do this later", DISK.as_secs()));
    timeout(DISK, order).await.unwrap_or_else(late)
}

/// Locks values that threads share. A panic of another thread leaves values that were read or recorded, which stay valid.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
