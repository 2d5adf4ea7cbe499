//! Clients over a serial line: any `embedded_io_async` device, such as a buffered UART.
//!
//! Frames on a serial line carry a CRC. The client skips bytes that are not part of a frame, and retries a call that is
//! not answered as often as [`Config::serial`] says, which derives the times from the rate of the line. Errors of the line,
//! such as framing errors and overruns, are lost bytes: they cost an attempt at most, and do not end the call.
//!
//! Do not use devices whose `read` is not cancel-safe. Buffered drivers (a `BufferedUart`, a DMA ring buffer) are.

use bcap_core::bcap::Client;
pub use bcap_core::bcap::client::Config;
pub use bcap_core::io::asynch::{Connection, Timed};
use bcap_core::storage::Storage;
use embassy_time::Timer;
use embedded_io_async::{ErrorType, Read, Write};

use crate::clock::EmbassyClock;

/// A serial device as a transport.
pub type SerialTransport<D> = Timed<Line<D>, EmbassyClock>;
/// A client over a serial line.
pub type SerialClient<D, T, R = T> = Connection<SerialTransport<D>, T, R>;

/// Creates a client on a device; `tx` and `rx` hold one frame each, at most 503 bytes.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call;
/// use bcap_embassy::serial::{self, Config};
/// use embedded_io_async::{Read, Write};
///
/// async fn read<U: Read + Write>(uart: U) -> Result<i32, bcap_core::io::CallError<U::Error>> {
///     let mut robot = serial::client(uart, Config::serial(115_200), [0; 503], [0; 503]);
///     robot.call(call::service_start("")).await?;
///     let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")).await?;
///     let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
///     Ok(robot.call(call::variable_get_value(variable)).await?.as_i32().unwrap_or(0))
/// }
/// ```
pub fn client<D, T: Storage, R: Storage>(device: D, config: Config, tx: T, rx: R) -> SerialClient<D, T, R>
where
    D: Read + Write,
{
    Connection::new(transport(device), Client::new(config, tx, rx))
}

/// Creates a transport over a device, whose errors are lost bytes.
pub const fn transport<D>(device: D) -> SerialTransport<D> {
    Timed::new(Line(device), EmbassyClock)
}

/// The pause after an error of the line, so that a device that only fails does not keep its task running.
const PAUSE_MS: u64 = 1;

/// A serial device whose reads do not fail: errors of the line are lost bytes.
#[derive(Debug)]
pub struct Line<D>(D);

impl<D: ErrorType> ErrorType for Line<D> {
    type Error = D::Error;
}

impl<D: Read> Read for Line<D> {
    /// # Cancel safety
    ///
    /// As that of the device.
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, D::Error> {
        loop {
            match self.0.read(buffer).await {
                Ok(count) => return Ok(count),
                // the frame's CRC finds the loss; a device that fails for good ends the call at its timeouts
                Err(_) => Timer::after_millis(PAUSE_MS).await,
            }
        }
    }
}

impl<D: Write> Write for Line<D> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, D::Error> {
        self.0.write(bytes).await
    }

    async fn flush(&mut self) -> Result<(), D::Error> {
        self.0.flush().await
    }
}
