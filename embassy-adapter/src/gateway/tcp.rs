//! Links to a robot over embassy-net.

use embassy_net::{IpEndpoint, Stack};

use super::RobotLink;
use crate::net::{NetError, Options, TcpTransport, UdpTransport};

/// A link to the robot over TCP.
#[derive(Debug)]
pub struct TcpRobot<'s> {
    transport: TcpTransport<'s>,
    peer: IpEndpoint,
}

impl<'s> TcpRobot<'s> {
    /// Creates a link that is not open; `rx` and `tx` are the socket's buffers.
    #[must_use]
    pub fn new(
        stack: Stack<'s>,
        rx: &'s mut [u8],
        tx: &'s mut [u8],
        options: Options,
        peer: impl Into<IpEndpoint>,
    ) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), peer: peer.into() }
    }
}

impl<'s> RobotLink for TcpRobot<'s> {
    type Transport = TcpTransport<'s>;
    type Cause = NetError;

    fn transport(&mut self) -> &mut TcpTransport<'s> {
        &mut self.transport
    }

    async fn open(&mut self) -> Result<(), NetError> {
        self.transport.connect(self.peer).await
    }

    fn close(&mut self) {
        self.transport.socket().abort();
    }

    fn cause(error: Option<NetError>) -> NetError {
        error.unwrap_or(NetError::Reset)
    }
}

/// A link to the robot over UDP; the gateway's configuration must have [`Link::Datagram`](bcap_core::bcap::Link::Datagram) too.
///
/// UDP has no connection, so opening it succeeds even without a robot; only an answer shows that the robot is connected.
impl RobotLink for UdpTransport<'_> {
    type Transport = Self;
    type Cause = NetError;

    fn transport(&mut self) -> &mut Self {
        self
    }

    async fn open(&mut self) -> Result<(), NetError> {
        Ok(())
    }

    fn close(&mut self) {
        self.discard();
    }

    fn cause(error: Option<NetError>) -> NetError {
        error.unwrap_or(NetError::Reset)
    }
}
