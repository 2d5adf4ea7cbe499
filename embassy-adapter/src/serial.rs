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
use embedded_io_async::{Read, Write};

use crate::clock::EmbassyClock;

/// A serial device as a transport.
pub type SerialTransport<D> = Timed<D, EmbassyClock>;
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
///     robot.call(call::service_start("WDT=400")).await?;
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

/// Creates a transport over a device.
pub const fn transport<D>(device: D) -> SerialTransport<D> {
    Timed::new(device, EmbassyClock)
}
