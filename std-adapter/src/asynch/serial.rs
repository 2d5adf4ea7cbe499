//! Serial lines.

use std::io;

use bcap_core::time::Instant;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

use super::{Connection, SendTransport, has_passed, within};
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
///
/// # Panics
///
/// Outside a tokio runtime with I/O enabled.
pub fn connect_serial(line: &SerialLine, options: &Options) -> Result<SerialClient, ConnectError> {
    let failed = |error: tokio_serial::Error| ConnectError::Serial { path: line.path.clone(), source: error.into() };
    let port = SerialStream::open(&line.builder()).map_err(failed)?;
    port.clear(ClearBuffer::Input).map_err(failed)?;
    Ok(Connection::new(SerialTransport::new(port), serial_client(line.config(options.serial))))
}

/// A serial line as a transport; created by [`connect_serial`], or from any open port.
///
/// Its client needs [`Config::SERIAL`](bcap_core::bcap::client::Config::SERIAL).
#[derive(Debug)]
pub struct SerialTransport {
    port: SerialStream,
}

impl SerialTransport {
    /// Wraps an open port.
    #[must_use]
    pub const fn new(port: SerialStream) -> Self {
        Self { port }
    }

    /// Returns the port.
    #[must_use]
    pub const fn port(&self) -> &SerialStream {
        &self.port
    }

    /// Waits until the device is unplugged; drops the bytes that arrive between two calls.
    pub(super) async fn unplugged(&mut self) {
        let mut dropped = [0; 64];
        loop {
            match self.port.read(&mut dropped).await {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Ok(0) | Err(_) => return,
                Ok(_) => {}
            }
        }
    }
}

impl SendTransport for SerialTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        within(until, self.port.write(bytes)).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        if !has_passed(until) {
            return within(until, self.port.read(buffer)).await;
        }
        // directly from the port, because tokio's readiness is as old as its last wait for events
        match self.port.try_read(buffer) {
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => Ok(None),
            read => read.map(Some),
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        tokio::time::sleep(until(at)).await;
    }
}
