//! The connection of a gateway to its robot, over TCP or UDP.

use std::io;

use bcap_core::bcap;
use bcap_core::io::asynch::SendTransport;
use bcap_core::time::Instant;
use bcap_gateway::driver::RobotLink;

use super::clients::reset;
use super::traffic::{Moved, TrafficTap};
use crate::asynch::socket::Socket;
use crate::asynch::{TcpTransport, UdpTransport, connect_datagrams, connect_stream};
use crate::clock::{now, until};
use crate::connect::Options;

/// The host and the port of a robot.
pub(super) type HostPort = (String, u16);

/// A connection to a robot, whose bytes are shown to the tap.
pub(super) struct RobotSocket {
    pub(super) robot: HostPort,
    pub(super) kind: bcap::Link,
    pub(super) options: Options,
    pub(super) tap: TrafficTap,
    pub(super) socket: Option<Socket>,
}

impl RobotSocket {
    fn show(&self, moved: Moved<'_>) {
        let ends = || match &self.socket {
            Some(Socket::Tcp(tcp)) => Ok((true, tcp.stream().local_addr()?, tcp.stream().peer_addr()?)),
            Some(Socket::Udp(udp)) => Ok((false, udp.socket().local_addr()?, udp.socket().peer_addr()?)),
            _ => Err(io::ErrorKind::NotConnected.into()),
        };
        self.tap.show(ends, moved);
    }

    fn open_socket(&mut self) -> io::Result<&mut Socket> {
        self.socket.as_mut().ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

impl SendTransport for RobotSocket {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = SendTransport::send(self.open_socket()?, bytes, until).await?;
        if let Some(count) = sent {
            self.show(Moved::Request(bytes.get(..count).unwrap_or(bytes)));
        }
        Ok(sent)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = SendTransport::receive(self.open_socket()?, buffer, until).await?;
        if let Some(count) = received
            && (count > 0 || self.kind == bcap::Link::Datagram)
        {
            self.show(Moved::Reply(buffer.get(..count).unwrap_or_default()));
        }
        Ok(received)
    }

    async fn sleep_until(&mut self, at: Instant) {
        tokio::time::sleep(until(at)).await;
    }
}

impl RobotLink for RobotSocket {
    type Transport = Self;
    type Cause = io::Error;

    fn transport(&mut self) -> &mut Self {
        self
    }

    async fn open(&mut self) -> io::Result<()> {
        let peer = (self.robot.0.as_str(), self.robot.1);
        self.socket = Some(match self.kind {
            bcap::Link::Datagram => Socket::Udp(UdpTransport::new(connect_datagrams(peer).await?)),
            _ => Socket::Tcp(TcpTransport::new(connect_stream(peer, &self.options).await?)),
        });
        Ok(())
    }

    fn close(&mut self) {
        self.show(Moved::Closed);
        if let Some(Socket::Tcp(tcp)) = &self.socket {
            // otherwise the operating system still sends a PUT that timed out, which may arrive after a newer one
            reset(tcp.stream());
        }
        self.socket = None;
    }

    fn cause(error: Option<io::Error>) -> io::Error {
        error.unwrap_or_else(|| io::Error::new(io::ErrorKind::UnexpectedEof, "the robot has closed the connection"))
    }
}
