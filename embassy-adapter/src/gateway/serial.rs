//! A robot at the other end of a serial line.

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
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

impl<D: Read + Write> Transport for SerialRobot<D> {
    type Error = D::Error;

    fn now(&self) -> Instant {
        self.transport.now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, D::Error> {
        self.transport.send(bytes, until).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, D::Error> {
        self.transport.receive(buffer, until).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(at).await;
    }
}

impl<D: Read + Write> RobotLink for SerialRobot<D> {
    type Cause = NetError;

    async fn open(&mut self) -> Result<(), D::Error> {
        Ok(())
    }

    fn close(&mut self) {}

    fn cause(_: Option<D::Error>) -> NetError {
        NetError::Line
    }
}
