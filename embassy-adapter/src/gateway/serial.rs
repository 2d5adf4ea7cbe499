//! A robot at the other end of a serial line.

use embedded_io_async::{Read, Write};

use super::RobotLink;
use crate::error::NetError;
use crate::serial::{SerialTransport, transport};

/// A link to the robot over RS-232; the gateway's configuration must have
/// [`Config::serial`](bcap_core::bcap::client::Config::serial) with the rate of the line.
///
/// A line has no connection, so opening it succeeds even without a robot; only an answer shows that the robot is connected.
/// Errors of the line are lost bytes, as in [`serial`](crate::serial).
#[derive(Debug)]
pub struct SerialRobot<D> {
    transport: SerialTransport<D>,
}

impl<D: Read + Write> SerialRobot<D> {
    /// Creates a link over a device, whose `read` must be cancel-safe.
    #[must_use]
    pub const fn new(device: D) -> Self {
        Self { transport: transport(device) }
    }
}

impl<D: Read + Write> RobotLink for SerialRobot<D> {
    type Transport = SerialTransport<D>;
    type Cause = NetError;

    fn transport(&mut self) -> &mut SerialTransport<D> {
        &mut self.transport
    }

    async fn open(&mut self) -> Result<(), D::Error> {
        Ok(())
    }

    fn close(&mut self) {}

    fn cause(_: Option<D::Error>) -> NetError {
        NetError::Line
    }
}
