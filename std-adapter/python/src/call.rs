//! Calls, which Python runs or awaits.

use std::sync::{Arc, Mutex};

use bcap_std::Error;
use bcap_stream::steps::StepError;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tokio::sync::oneshot;

use crate::error;
use crate::runtime::{Home, Work, lock};

/// The value of a call, which becomes an object of Python under the GIL.
type Value = Box<dyn FnOnce(Python<'_>) -> PyResult<Py<PyAny>> + Send>;

type Result = std::result::Result<Value, StepError>;

type Pending = Work<Result>;

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
    /// Makes a call of a future. Dropping the future cancels it.
    pub(crate) fn new<T>(
        home: &Arc<Home>,
        future: impl Future<Output = std::result::Result<T, Error>> + Send + 'static,
    ) -> Self
    where
        T: for<'py> IntoPyObject<'py> + Send + 'static,
    {
        Self::of_stream(home, async { Ok(future.await?) })
    }

    /// Makes a call of a future, which may also fail as a stream does.
    pub(crate) fn of_stream<T>(
        home: &Arc<Home>,
        future: impl Future<Output = std::result::Result<T, StepError>> + Send + 'static,
    ) -> Self
    where
        T: for<'py> IntoPyObject<'py> + Send + 'static,
    {
        let pending: Pending = Box::pin(async {
            let value = future.await?;
            Ok(Box::new(move |py: Python<'_>| value.into_py_any(py)) as Value)
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

    /// Runs the call in the background, then calls `done(value, None)` or `done(None, exception)`.
    fn start(&self, done: Py<PyAny>) -> PyResult<Started> {
        let pending = self.take()?;
        let (wanted, unwanted) = oneshot::channel::<()>();
        self.home.handle()?.spawn(async move {
            let result = tokio::select! {
                biased;
                _ = unwanted => return,
                result = pending => result,
            };
            // without an interpreter there is no caller
            let _ = Python::try_attach(|py| {
                let (value, error) = match finish(py, result) {
                    Ok(value) => (Some(value), None),
                    Err(error) => (None, Some(error)),
                };
                // the event loop has ended
                let _ = done.call1(py, (value, error));
            });
        });
        Ok(Started { wanted: Mutex::new(Some(wanted)) })
    }
}

#[pymethods]
impl Started {
    /// Cancels the call unless it has ended.
    fn cancel(&self) {
        lock(&self.wanted).take();
    }
}

fn finish(py: Python<'_>, result: Result) -> PyResult<Py<PyAny>> {
    match result {
        Ok(convert) => convert(py),
        Err(StepError::Failed(failure)) => Err(error::raise(py, &failure)),
        Err(other) => Err(error::exception(py, "StreamError", other.to_string(), None)),
    }
}
