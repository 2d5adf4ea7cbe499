//! The runtime of all sessions: one thread of tokio, from the first call to the end of the interpreter.

use std::pin::Pin;
use std::process;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tokio::runtime::{Builder, Handle, Runtime};

/// The runtime, and the process that started it.
static RUNTIME: Mutex<Option<(u32, Runtime)>> = Mutex::new(None);

/// How long Python's signals wait at most.
pub(crate) const SIGNALS: Duration = Duration::from_millis(20);

/// Locks a mutex; no code that holds one leaves its value half changed.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the runtime, which is started first.
///
/// # Errors
///
/// `RuntimeError` in a process that was forked after the start: it has neither the thread nor the sessions.
pub(crate) fn runtime() -> PyResult<Handle> {
    let mut runtime = lock(&RUNTIME);
    match &*runtime {
        Some((process, runtime)) if *process == process::id() => Ok(runtime.handle().clone()),
        Some(_) => Err(PyRuntimeError::new_err(FORKED)),
        None => {
            let started = Builder::new_multi_thread().worker_threads(1).thread_name("bcap").enable_all().build()?;
            let handle = started.handle().clone();
            *runtime = Some((process::id(), started));
            Ok(handle)
        }
    }
}

/// The refusal in a forked process.
pub(crate) const FORKED: &str = "this process was forked from one that uses bcap, and has none of its connections; start it with \
     multiprocessing.get_context(\"spawn\"), or import bcap after the fork";

/// Ends all sessions at the end of the interpreter: robots are halted, motors switched off and arms given back.
#[pyfunction]
pub(crate) fn end(py: Python<'_>) {
    let runtime = lock(&RUNTIME).take();
    match runtime {
        Some((process, runtime)) if process == process::id() => py.detach(|| drop(runtime)),
        // the threads and sockets are those of another process
        forked => std::mem::forget(forked),
    }
}

/// Runs a future on this thread, without the GIL.
///
/// # Errors
///
/// The exception that a signal handler of Python raises, such as `KeyboardInterrupt`; the future is dropped then.
pub(crate) fn wait<T: Send>(py: Python<'_>, mut future: Pin<Box<dyn Future<Output = T> + Send>>) -> PyResult<T> {
    let runtime = runtime()?;
    let waker = Waker::from(Arc::new(Unpark(thread::current())));
    loop {
        let polled = py.detach(|| {
            let _context = runtime.enter();
            poll_for(SIGNALS, future.as_mut(), &waker)
        });
        match polled {
            Poll::Ready(output) => return Ok(output),
            Poll::Pending => py.check_signals()?,
        }
    }
}

/// Polls a future for a time.
fn poll_for<T>(time: Duration, mut future: Pin<&mut (dyn Future<Output = T> + Send)>, waker: &Waker) -> Poll<T> {
    let end = Instant::now() + time;
    loop {
        let polled = future.as_mut().poll(&mut Context::from_waker(waker));
        let rest = end.saturating_duration_since(Instant::now());
        if polled.is_ready() || rest.is_zero() {
            return polled;
        }
        thread::park_timeout(rest);
    }
}

/// Wakes a parked thread.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}
