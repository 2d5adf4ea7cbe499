//! The threads of sessions.
//!
//! ```text
//!  bcap.aio, stoppers   Home::shared    one thread of tokio, which all of them share
//!  bcap                 Home::driven    the thread that makes a call runs the session; between calls a keeper thread does
//! ```
//!
//! A blocking call so needs no other thread. While a stream of Slave Mode runs, the keeper runs the session: it waits for poses.

use std::mem;
use std::pin::Pin;
use std::process;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::sync::Notify;

/// The shared runtime, and the process that started it.
static SHARED: Mutex<Option<(u32, Runtime)>> = Mutex::new(None);

/// The other runtimes, for the end of the interpreter.
static DRIVERS: Mutex<Vec<(u32, Weak<Driver>)>> = Mutex::new(Vec::new());

/// Maximum time that Python's signals wait.
pub(crate) const SIGNALS: Duration = Duration::from_millis(20);

/// Time after the last call until the keeper takes over.
const IDLE: Duration = Duration::from_millis(10);

/// Locks a mutex; no code that holds one leaves its value half changed.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The refusal of an object in a forked process.
pub(crate) const FORKED: &str = "this object belongs to the process that this one was forked from, and so do its connections; open a \
     new one here";

/// The runtime of one session, or of all of `bcap.aio`.
pub(crate) struct Home {
    handle: Handle,
    process: u32,
    /// `None` for the shared runtime, whose thread runs all tasks.
    driver: Option<Arc<Driver>>,
}

impl Home {
    /// Returns the shared runtime; starts it first if necessary, even in a forked process.
    pub(crate) fn shared() -> PyResult<Arc<Self>> {
        let process = process::id();
        let mut shared = lock(&SHARED);
        let handle = match &*shared {
            Some((starter, runtime)) if *starter == process => runtime.handle().clone(),
            _ => {
                let started = Builder::new_multi_thread().worker_threads(1).thread_name("bcap").enable_all().build()?;
                let handle = started.handle().clone();
                // the thread and the sockets of the parent are not this process's
                mem::forget(shared.replace((process, started)));
                handle
            }
        };
        Ok(Arc::new(Self { handle, process, driver: None }))
    }

    /// Starts the runtime of a session whose callers run its tasks.
    pub(crate) fn driven() -> PyResult<Arc<Self>> {
        let (driver, handle) = Driver::start()?;
        Ok(Arc::new(Self { handle, process: process::id(), driver: Some(driver) }))
    }

    /// Returns the runtime, to start tasks.
    ///
    /// # Errors
    ///
    /// `RuntimeError` in a forked process.
    pub(crate) fn handle(&self) -> PyResult<&Handle> {
        if self.process == process::id() { Ok(&self.handle) } else { Err(PyRuntimeError::new_err(FORKED)) }
    }

    /// Lets the keeper run the session until the value is dropped, because a task of it blocks.
    pub(crate) fn streams(&self) -> Option<Streaming> {
        let driver = Arc::clone(self.driver.as_ref()?);
        driver.change(|turn| turn.streams += 1);
        Some(Streaming(driver))
    }

    /// Runs a future on this thread, without the GIL.
    ///
    /// # Errors
    ///
    /// The exception that a signal handler of Python raises, such as `KeyboardInterrupt`; the future is dropped then.
    pub(crate) fn wait<T: Send>(&self, py: Python<'_>, mut future: Work<T>) -> PyResult<T> {
        let handle = self.handle()?;
        loop {
            let polled = py.detach(|| match self.driver.as_ref().and_then(|driver| driver.call()) {
                Some(call) => call.run_for(SIGNALS, future.as_mut()),
                None => {
                    let _context = handle.enter();
                    poll_for(SIGNALS, future.as_mut())
                }
            });
            match polled {
                Poll::Ready(output) => return Ok(output),
                Poll::Pending => py.check_signals()?,
            }
        }
    }
}

impl Drop for Home {
    fn drop(&mut self) {
        if let Some(driver) = &self.driver
            && self.process == process::id()
        {
            driver.change(|turn| turn.is_abandoned = true);
        }
    }
}

/// The future of a call.
pub(crate) type Work<T> = Pin<Box<dyn Future<Output = T> + Send>>;

/// A runtime without threads. At each time one caller or the keeper runs its tasks.
struct Driver {
    /// `None` after the end.
    runtime: Mutex<Option<Arc<Runtime>>>,
    turn: Mutex<Turn>,
    changed: Condvar,
    /// Ends the turn of the keeper.
    wanted: Notify,
}

/// Determines which thread runs the tasks.
#[derive(Default)]
struct Turn {
    /// The calls that run, and the number of calls so far.
    running: usize,
    calls: usize,
    /// The streams, whose tasks block.
    streams: usize,
    /// Whether the keeper runs the tasks.
    is_kept: bool,
    /// Whether no object of Python uses the runtime. Its tasks end their sessions.
    is_abandoned: bool,
    /// Whether the interpreter ends.
    is_ended: bool,
    /// Whether the keeper has ended.
    is_left: bool,
}

impl Driver {
    fn start() -> PyResult<(Arc<Self>, Handle)> {
        let runtime = Arc::new(Builder::new_current_thread().enable_all().build()?);
        let handle = runtime.handle().clone();
        let driver = Arc::new(Self {
            runtime: Mutex::new(Some(Arc::clone(&runtime))),
            turn: Mutex::default(),
            changed: Condvar::new(),
            wanted: Notify::new(),
        });
        let keeper = Arc::clone(&driver);
        thread::Builder::new().name("bcap".to_owned()).spawn(move || {
            keeper.keep(&runtime);
            drop(runtime);
            keeper.change(|turn| turn.is_left = true);
        })?;
        let mut drivers = lock(&DRIVERS);
        drivers.retain(|(_, driver)| driver.strong_count() > 0);
        drivers.push((process::id(), Arc::downgrade(&driver)));
        Ok((driver, handle))
    }

    /// Changes the turn, and wakes the thread that waits for it.
    fn change(&self, change: impl FnOnce(&mut Turn)) {
        change(&mut lock(&self.turn));
        self.changed.notify_all();
        self.wanted.notify_one();
    }

    /// Runs the tasks while no caller does, until the last task or the interpreter ends.
    fn keep(&self, runtime: &Runtime) {
        while let Some(is_abandoned) = self.next_turn(runtime) {
            runtime.block_on(async {
                if is_abandoned {
                    tokio::time::sleep(IDLE).await;
                } else {
                    self.wanted.notified().await;
                }
            });
            lock(&self.turn).is_kept = false;
        }
    }

    /// Waits for the turn of the keeper; `None` at the end. Returns whether the runtime is abandoned.
    fn next_turn(&self, runtime: &Runtime) -> Option<bool> {
        let mut turn = lock(&self.turn);
        let mut calls = None;
        loop {
            if turn.is_ended || (turn.is_abandoned && runtime.metrics().num_alive_tasks() == 0) {
                return None;
            }
            let is_idle = turn.running == 0 && (calls == Some(turn.calls) || turn.is_abandoned);
            if turn.streams > 0 || is_idle {
                turn.is_kept = true;
                return Some(turn.is_abandoned);
            }
            calls = Some(turn.calls);
            turn = self.changed.wait_timeout(turn, IDLE).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Begins a call that runs the tasks; `None` while a stream runs, and at the end of the interpreter.
    fn call(&self) -> Option<Running<'_>> {
        let mut turn = lock(&self.turn);
        if turn.streams > 0 || turn.is_ended {
            return None;
        }
        let runtime = lock(&self.runtime).clone()?;
        turn.running += 1;
        turn.calls = turn.calls.wrapping_add(1);
        if turn.is_kept {
            self.wanted.notify_one();
        }
        Some(Running { driver: self, runtime: Some(runtime) })
    }

    /// Ends the sessions once their calls and the keeper have ended: dropping the tasks halts robots.
    fn end(&self) {
        self.change(|turn| turn.is_ended = true);
        let mut turn = lock(&self.turn);
        while turn.running > 0 || !turn.is_left {
            turn = self.changed.wait(turn).unwrap_or_else(PoisonError::into_inner);
        }
        drop(turn);
        let runtime = lock(&self.runtime).take();
        drop(runtime);
    }
}

/// A call that runs the tasks of its session.
struct Running<'a> {
    driver: &'a Driver,
    runtime: Option<Arc<Runtime>>,
}

impl Running<'_> {
    fn run_for<T>(&self, time: Duration, future: Pin<&mut (dyn Future<Output = T> + Send)>) -> Poll<T> {
        let Some(runtime) = &self.runtime else { return Poll::Pending };
        runtime.block_on(async {
            match tokio::time::timeout(time, future).await {
                Ok(output) => Poll::Ready(output),
                Err(_) => Poll::Pending,
            }
        })
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        // before `end` counts the users
        self.runtime = None;
        let mut turn = lock(&self.driver.turn);
        turn.running -= 1;
        if turn.is_ended {
            self.driver.changed.notify_all();
        }
    }
}

/// A stream, whose task blocks.
pub(crate) struct Streaming(Arc<Driver>);

impl Drop for Streaming {
    fn drop(&mut self) {
        lock(&self.0.turn).streams -= 1;
    }
}

/// Ends all sessions at the end of the interpreter: robots are halted, motors switched off and arms given back.
#[pyfunction]
pub(crate) fn end(py: Python<'_>) {
    let process = process::id();
    let (shared, drivers) = (lock(&SHARED).take(), mem::take(&mut *lock(&DRIVERS)));
    py.detach(|| {
        // drivers of another process have its threads and sockets
        let own = drivers.into_iter().filter(|(starter, _)| *starter == process);
        own.filter_map(|(_, driver)| driver.upgrade()).for_each(|driver| driver.end());
        match shared {
            Some((starter, runtime)) if starter == process => drop(runtime),
            forked => mem::forget(forked),
        }
    });
}

/// Polls a future for a time.
fn poll_for<T>(time: Duration, mut future: Pin<&mut (dyn Future<Output = T> + Send)>) -> Poll<T> {
    let (end, waker) = (Instant::now() + time, Waker::from(Arc::new(Unpark(thread::current()))));
    loop {
        let polled = future.as_mut().poll(&mut Context::from_waker(&waker));
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
