//! The client of `bcap.compat`: any function, over a connection that a signal of Python interrupts.

use std::io;
use std::mem;
use std::process;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_std::blocking::{self, Connection, Controller, TcpTransport, Transport};
use bcap_std::core::bcap::FunctionId;
use bcap_std::core::bcap::client::Timing;
use bcap_std::core::hresult::HResult;
use bcap_std::core::time::Instant;
use bcap_std::{Address, CallError, Error, Model, NetworkAddress, Options, Protocol, Settings};
use pyo3::exceptions::{PyOSError, PyRuntimeError};
use pyo3::prelude::*;

use crate::controller::seconds;
use crate::error;
use crate::runtime::{FORKED, SIGNALS, lock};
use crate::value::{Value, value_of};

/// A connection over which any function can be called.
#[pyclass(frozen)]
pub(crate) struct Client {
    /// `None` after the end.
    controller: Mutex<Option<Controller>>,
    /// The exception that has interrupted a call.
    raised: Raised,
    process: u32,
}

type Raised = Arc<Mutex<Option<PyErr>>>;

#[pymethods]
impl Client {
    #[new]
    fn new(py: Python<'_>, host: String, port: u16, timeout: f64) -> PyResult<Self> {
        let (options, raised) = (Options::default().connect_timeout(seconds(timeout)?), Raised::default());
        let connected = py.detach(|| blocking::connect_tcp((&*host, port), &options));
        let connected = connected.map_err(|error| PyOSError::new_err(error.to_string()))?;
        let (transport, client) = connected.into_parts();
        let transport = Interruptible { transport, raised: Arc::clone(&raised) };
        let address = Address::Network(NetworkAddress { protocol: Protocol::Tcp, host, port });
        let controller = Controller::unopened(Connection::new(transport, client));
        let controller = controller.recover_at(address, Settings::new(Model::Rc8).options(options));
        let client = Self { controller: Mutex::new(Some(controller)), raised, process: process::id() };
        client.set_timeout(timeout)?;
        Ok(client)
    }

    /// Sets how long a call waits for a reply or a keep-alive, in seconds.
    fn set_timeout(&self, timeout: f64) -> PyResult<()> {
        let attempt_timeout = seconds(timeout)?;
        if let Some(controller) = &mut *lock(&self.controller) {
            controller.set_timing(Timing { attempt_timeout, deadline: FOREVER, keep_alive: FOREVER, attempts: 1 });
        }
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
        let called = py.detach(|| {
            let mut controller = lock(&self.controller);
            let called = controller.as_mut()?.call_any("the controller", FunctionId(function), &arguments);
            if lock(&self.raised).is_some() {
                // halts the robot, and gives the arm back, over a new connection
                drop(controller.take());
            }
            Some(called)
        });
        if let Some(raised) = lock(&self.raised).take() {
            return Err(raised);
        }
        match called.unwrap_or(Err(Error::Closed)) {
            Ok((_, value)) => Ok(Value(value.unwrap_or_default())),
            Err(failure) => Err(code(&failure).map_or_else(
                || error::raise(py, &failure),
                |code| failed.call1((code.0,)).map_or_else(|error| error, PyErr::from_value),
            )),
        }
    }

    /// Halts the robot, gives the arm back and ends the session.
    fn close(&self, py: Python<'_>) {
        let controller = py.detach(|| lock(&self.controller).take());
        if self.process == process::id() {
            py.detach(|| drop(controller));
        } else {
            // another process has opened the connection
            mem::forget(controller);
        }
    }
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

/// A transport whose waits end when a signal handler of Python raises.
struct Interruptible {
    transport: TcpTransport,
    raised: Raised,
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
            if let Some(Err(raised)) = Python::try_attach(|py| py.check_signals()) {
                *lock(&self.raised) = Some(raised);
                // not a kind that says that the controller has closed the connection: its session goes on until the drop
                return Err(io::Error::other("a signal has interrupted the call"));
            }
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(at);
    }
}
