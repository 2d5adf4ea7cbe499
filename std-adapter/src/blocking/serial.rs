//! Serial lines.

use std::time::Duration;
use std::{fmt, io};

use bcap_core::time::Instant;
use serialport::{ClearBuffer, SerialPort};

use super::{Connection, Transport, classified};
use crate::clock::{now, until};
use crate::connect::{ConnectError, Options, serial_client};
use crate::line::SerialLine;

/// A client over a serial line.
pub type SerialClient = Connection<SerialTransport, Vec<u8>>;

/// Opens a serial line for this process alone, and drops bytes that it received before. Nothing is sent before the
/// first call.
///
/// # Errors
///
/// A [`ConnectError::Serial`] if the device does not exist, is in use, or does not have these settings.
pub fn connect_serial(line: &SerialLine, options: &Options) -> Result<SerialClient, ConnectError> {
    let failed = |error: serialport::Error| ConnectError::Serial { path: line.path.clone(), source: error.into() };
    let port = line.builder().open().map_err(failed)?;
    port.clear(ClearBuffer::Input).map_err(failed)?;
    Ok(Connection::new(SerialTransport::new(port), serial_client(line.config(options.serial))))
}

/// A serial line as a transport; created by [`connect_serial`], or from any open port.
///
/// Its client needs [`Config::SERIAL`](bcap_core::bcap::client::Config::SERIAL). A device that stops taking bytes can delay a
/// send beyond its time limit.
pub struct SerialTransport {
    port: Box<dyn SerialPort>,
}

impl SerialTransport {
    /// Wraps an open port. The transport changes the port's timeout.
    #[must_use]
    pub fn new(port: Box<dyn SerialPort>) -> Self {
        Self { port }
    }

    /// Returns the port.
    #[must_use]
    pub fn port(&self) -> &dyn SerialPort {
        &*self.port
    }

    /// Repeats an interrupted operation until `deadline`.
    fn within(
        &mut self,
        deadline: Instant,
        mut operation: impl FnMut(&mut dyn SerialPort) -> io::Result<usize>,
    ) -> io::Result<Option<usize>> {
        loop {
            // a timeout of zero moves only bytes that need no waiting; Windows rounds a shorter one down to zero
            let timeout = match until(deadline) {
                Duration::ZERO => Duration::ZERO,
                left => left.max(Duration::from_millis(1)),
            };
            self.port.set_timeout(timeout)?;
            if let Some(result) = classified(operation(&mut *self.port)) {
                return result;
            }
        }
    }
}

impl fmt::Debug for SerialTransport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SerialTransport").field("port", &self.port.name()).finish()
    }
}

impl Transport for SerialTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        self.within(until, |port| port.write(bytes))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        self.within(until, |port| port.read(buffer))
    }

    fn sleep_until(&mut self, at: Instant) {
        super::sleep_until(at);
    }
}
