//! Links to a robot over embassy-net.

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_net::{IpEndpoint, Stack};

use super::RobotLink;
use crate::clock::now;
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

impl Transport for TcpRobot<'_> {
    type Error = NetError;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, NetError> {
        self.transport.send(bytes, until).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, NetError> {
        self.transport.receive(buffer, until).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(at).await;
    }
}

impl RobotLink for TcpRobot<'_> {
    type Cause = NetError;

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
    type Cause = NetError;

    async fn open(&mut self) -> Result<(), NetError> {
        Ok(())
    }

    fn close(&mut self) {}

    fn cause(error: Option<NetError>) -> NetError {
        error.unwrap_or(NetError::Reset)
    }
}
