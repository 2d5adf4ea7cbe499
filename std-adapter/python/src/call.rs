//! Calls, which Python runs or awaits.

use std::io::{self, PipeReader, PipeWriter, Read, Write};
use std::mem;
use std::os::fd::{AsRawFd, RawFd};
use std::sync::{Arc, Mutex};

use bcap_std::Error;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tokio::sync::oneshot;

use crate::error::Failure;
use crate::runtime::{Home, Work, lock};

/// The value of a call, which becomes an object of Python under the GIL.
type Converter = Box<dyn FnOnce(Python<'_>) -> PyResult<Py<PyAny>> + Send>;

type CallResult = Result<Converter, Failure>;

type Pending = Work<CallResult>;

/// A call that has not begun. It runs once.
#[pyclass(frozen)]
pub(crate) struct Call {
    home: Arc<Home>,
    pending: Mutex<Option<Pending>>,
}

/// A call that runs in the background. Its end cancels it.
#[pyclass(frozen)]
pub(crate) struct Started {
    wanted: Mutex<Option<oneshot::Sender<()>>>,
}

impl Call {
    /// Creates a call from a future. Dropping the future cancels it.
    pub(crate) fn new<T>(home: &Arc<Home>, future: impl Future<Output = Result<T, Error>> + Send + 'static) -> Self
    where
        T: for<'py> IntoPyObject<'py> + Send + 'static,
    {
        Self::fallible(home, async { Ok(future.await?) })
    }

    /// Creates a call from a future, which may also fail without an error of the session.
    pub(crate) fn fallible<T>(
        home: &Arc<Home>,
        future: impl Future<Output = Result<T, Failure>> + Send + 'static,
    ) -> Self
    where
        T: for<'py> IntoPyObject<'py> + Send + 'static,
    {
        let pending: Pending = Box::pin(async {
            let value = future.await?;
            Ok(Box::new(move |py: Python<'_>| value.into_py_any(py)) as Converter)
        });
        Self { home: Arc::clone(home), pending: Mutex::new(Some(pending)) }
    }

    fn take(&self) -> PyResult<Pending> {
        lock(&self.pending).take().ok_or_else(|| PyRuntimeError::new_err("this call was made already"))
    }
}

#[pymethods]
impl Call {
    /// Runs the call on this thread, and returns its result. A signal whose handler raises cancels it.
    fn wait(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        finish(py, self.home.wait(py, self.take()?)?)
    }

    /// Runs the call in the background. Then the inbox has its result for the future.
    fn start(&self, inbox: &Inbox, future: Py<PyAny>) -> PyResult<Started> {
        let (pending, queue) = (self.take()?, Arc::clone(&inbox.queue));
        let (wanted, unwanted) = oneshot::channel::<()>();
        self.home.handle()?.spawn(async move {
            tokio::select! {
                biased;
                _ = unwanted => {}
                result = pending => queue.push(future, result),
            }
        });
        Ok(Started { wanted: Mutex::new(Some(wanted)) })
    }
}

/// The results for the futures of an event loop. A byte in its pipe wakes the loop, so that the thread of tokio needs no GIL.
#[pyclass(frozen)]
pub(crate) struct Inbox {
    queue: Arc<Queue>,
    woken: PipeReader,
}

/// A future, and its value or exception.
type Settled = (Py<PyAny>, Option<Py<PyAny>>, Option<PyErr>);

struct Queue {
    ended: Mutex<Vec<(Py<PyAny>, CallResult)>>,
    wake: PipeWriter,
}

impl Queue {
    fn push(&self, future: Py<PyAny>, result: CallResult) {
        let mut ended = lock(&self.ended);
        ended.push((future, result));
        if ended.len() == 1 {
            // there is room: the loop takes the byte before it empties the queue. Without a reader the loop has ended.
            let _ = (&self.wake).write(&[0]);
        }
    }
}

#[pymethods]
impl Inbox {
    #[new]
    fn new() -> PyResult<Self> {
        let (woken, wake) = io::pipe()?;
        Ok(Self { queue: Arc::new(Queue { ended: Mutex::default(), wake }), woken })
    }

    /// Returns the descriptor that can be read when there are results.
    fn fileno(&self) -> RawFd {
        self.woken.as_raw_fd()
    }

    /// Takes the results: futures with a value, or with an exception.
    fn take(&self, py: Python<'_>) -> Vec<Settled> {
        // the pipe does not block, and may be empty
        let _ = (&self.woken).read(&mut [0; 16]);
        let ended = mem::take(&mut *lock(&self.queue.ended));
        let settled = ended.into_iter().map(|(future, result)| match finish(py, result) {
            Ok(value) => (future, Some(value), None),
            Err(error) => (future, None, Some(error)),
        });
        settled.collect()
    }
}

#[pymethods]
impl Started {
    /// Cancels the call unless it has ended.
    fn cancel(&self) {
        lock(&self.wanted).take();
    }
}

fn finish(py: Python<'_>, result: CallResult) -> PyResult<Py<PyAny>> {
    match result {
        Ok(convert) => convert(py),
        Err(failure) => Err(failure.raise(py)),
    }
}
