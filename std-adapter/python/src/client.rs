//! The client of `bcap.compat`: any function, over a connection that a signal of Python interrupts.

use std::io;
use std::mem;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use bcap_std::blocking::{self, Connection, Controller, TcpTransport, Transport};
use bcap_std::core::bcap::FunctionId;
use bcap_std::core::bcap::client::Timing;
use bcap_std::core::hresult::HResult;
use bcap_std::core::time::Instant;
use bcap_std::core::variant::OwnedVariant;
use bcap_std::{Address, CallError, Error, Model, NetworkAddress, Options, Protocol, Settings};
use pyo3::exceptions::{PyOSError, PyRuntimeError};
use pyo3::prelude::*;

use crate::error::{self, seconds};
use crate::runtime::{FORKED, SIGNALS, lock};
use crate::value::{Value, value_of};

/// A connection over which any function can be called. One thread at a time makes a call.
#[pyclass(frozen)]
pub(crate) struct Client {
    state: Mutex<State>,
    /// A call has ended.
    free: Condvar,
    interrupt: Arc<Interrupt>,
    process: u32,
}

/// The session, which a call takes out, so that the mutex is locked for moments only: a thread with the GIL may lock it.
struct State {
    /// `None` during a call, and after the end of the session.
    controller: Option<Box<Controller>>,
    is_called: bool,
    timing: Timing,
}

/// How a signal ends the call that runs.
#[derive(Default)]
struct Interrupt {
    /// The exception of a signal handler, which has run during the call.
    raised: Mutex<Option<PyErr>>,
    /// Whether another thread ends the session.
    is_ended: AtomicBool,
}

#[pymethods]
impl Client {
    #[new]
    fn new(py: Python<'_>, host: String, port: u16, timeout: f64) -> PyResult<Self> {
        let (attempt_timeout, interrupt) = (seconds(timeout)?, Arc::<Interrupt>::default());
        let options = Options::default().connect_timeout(attempt_timeout);
        let connected = py.detach(|| blocking::connect_tcp((&*host, port), &options));
        let connected = connected.map_err(|error| PyOSError::new_err(error.to_string()))?;
        let (transport, client) = connected.into_parts();
        let transport = Interruptible { transport, interrupt: Arc::clone(&interrupt) };
        let address = Address::Network(NetworkAddress { protocol: Protocol::Tcp, host, port });
        let controller = Controller::unopened(Connection::new(transport, client));
        let controller = controller.recover_at(address, Settings::new(Model::Rc8).options(options));
        let state = State { controller: Some(Box::new(controller)), is_called: false, timing: timing(attempt_timeout) };
        Ok(Self { state: Mutex::new(state), free: Condvar::new(), interrupt, process: process::id() })
    }

    /// Sets how long a call waits for a reply or a keep-alive, in seconds, from the next call on.
    fn set_timeout(&self, timeout: f64) -> PyResult<()> {
        lock(&self.state).timing = timing(seconds(timeout)?);
        Ok(())
    }

    /// Calls a function, and returns its value; `failed` makes the exception for a code.
    fn call(
        &self,
        py: Python<'_>,
        function: i32,
        arguments: Vec<Bound<'_, PyAny>>,
        failed: &Bound<'_, PyAny>,
    ) -> PyResult<Value> {
        if self.process != process::id() {
            return Err(PyRuntimeError::new_err(FORKED));
        }
        let arguments = arguments.iter().map(|argument| value_of(argument, false)).collect::<PyResult<Vec<_>>>()?;
        match py.detach(|| self.begin()?.call(FunctionId(function), &arguments))? {
            Ok((_, value)) => Ok(Value(value.unwrap_or_default())),
            Err(failure) => Err(code(&failure).map_or_else(
                || error::raise(py, &failure),
                |code| failed.call1((code.0,)).map_or_else(|error| error, PyErr::from_value),
            )),
        }
    }

    /// Halts the robot, gives the arm back and ends the session. The call of another thread is interrupted.
    fn close(&self, py: Python<'_>) {
        if self.process != process::id() {
            // another process has opened the connection
            return mem::forget(lock(&self.state).controller.take());
        }
        self.interrupt.is_ended.store(true, Relaxed);
        py.detach(|| self.next().end());
    }
}

impl Client {
    /// Waits for the end of the call of another thread, and begins one.
    ///
    /// # Errors
    ///
    /// The exception of a signal handler that ran during the wait. The session has ended, as after a signal during the call.
    fn begin(&self) -> PyResult<CallPermit<'_>> {
        loop {
            if let Some(permit) = self.next_within(SIGNALS) {
                return Ok(permit);
            }
            if let Some(Err(raised)) = Python::try_attach(|py| py.check_signals()) {
                self.interrupt.is_ended.store(true, Relaxed);
                self.next().end();
                return Err(raised);
            }
        }
    }

    fn next(&self) -> CallPermit<'_> {
        loop {
            if let Some(permit) = self.next_within(SIGNALS) {
                return permit;
            }
        }
    }

    fn next_within(&self, time: Duration) -> Option<CallPermit<'_>> {
        let waited = self.free.wait_timeout_while(lock(&self.state), time, |state| state.is_called);
        let (mut state, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
        if timeout.timed_out() {
            return None;
        }
        state.is_called = true;
        Some(CallPermit { client: self, controller: state.controller.take(), timing: state.timing })
    }
}

/// The right to make a call.
struct CallPermit<'a> {
    client: &'a Client,
    controller: Option<Box<Controller>>,
    timing: Timing,
}

type Called = Result<(HResult, Option<OwnedVariant>), Error>;

impl CallPermit<'_> {
    /// Calls a function. A signal, and another thread that ends the session, interrupt the call and end the session.
    ///
    /// # Errors
    ///
    /// The exception of a signal handler, which has run during the call.
    fn call(mut self, function: FunctionId, arguments: &[OwnedVariant]) -> PyResult<Called> {
        let interrupt = &self.client.interrupt;
        let Some(controller) = self.controller.as_mut().filter(|_| !interrupt.is_ended.load(Relaxed)) else {
            self.end();
            return Ok(Err(Error::Closed));
        };
        controller.set_timing(self.timing);
        let called = controller.call_any("the controller", function, arguments);
        let raised = lock(&interrupt.raised).take();
        if raised.is_some() || interrupt.is_ended.load(Relaxed) {
            self.end();
        }
        raised.map_or(Ok(called), Err)
    }

    /// Ends the session: halts the robot, and gives the arm back, after an interrupted call over a new connection.
    fn end(mut self) {
        self.client.interrupt.is_ended.store(false, Relaxed);
        drop(self.controller.take());
    }
}

impl Drop for CallPermit<'_> {
    fn drop(&mut self) {
        let mut state = lock(&self.client.state);
        state.controller = self.controller.take();
        state.is_called = false;
        drop(state);
        self.client.free.notify_one();
    }
}

/// Returns the timing of calls that end after a time without a reply or a keep-alive.
const fn timing(attempt_timeout: Duration) -> Timing {
    Timing { attempt_timeout, deadline: FOREVER, keep_alive: FOREVER, attempts: 1 }
}

/// Longer than any call.
const FOREVER: Duration = Duration::from_secs(1 << 32);

/// Returns the code of a failed call, as the maker's client has it.
fn code(error: &Error) -> Option<HResult> {
    match error {
        Error::NoReply { source: CallError::Client(_), .. } => Some(HResult::E_TIMEOUT),
        error => error.code(),
    }
}

/// A transport whose waits end when a signal handler of Python raises, or another thread ends the session.
struct Interruptible {
    transport: TcpTransport,
    interrupt: Arc<Interrupt>,
}

impl Transport for Interruptible {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.transport.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        self.transport.send(bytes, until)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        loop {
            let slice = (self.now() + SIGNALS).min(until);
            let received = self.transport.receive(buffer, slice)?;
            if received.is_some() || slice == until {
                return Ok(received);
            }
            let raised = Python::try_attach(|py| py.check_signals()).and_then(PyResult::err);
            if raised.is_some() || self.interrupt.is_ended.load(Relaxed) {
                *lock(&self.interrupt.raised) = raised;
                // not a kind that means that the controller has closed the connection: its session continues until the drop
                return Err(io::Error::other("a signal has interrupted the call"));
            }
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(at);
    }
}
