//! The connection of a gateway to its robot, over TCP or UDP.

use std::io;

use bcap_core::bcap;
use bcap_core::io::asynch::SendTransport;
use bcap_core::time::Instant;
use bcap_gateway::driver::RobotLink;

use super::traffic::{Moved, Tap};
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
    pub(super) tap: Tap,
    pub(super) socket: Option<Socket>,
}

pub(super) enum Socket {
    Stream(TcpTransport),
    Datagrams(UdpTransport),
}

impl RobotSocket {
    fn show(&self, moved: Moved<'_>) {
        let ends = || match &self.socket {
            Some(Socket::Stream(tcp)) => Ok((true, tcp.stream().local_addr()?, tcp.stream().peer_addr()?)),
            Some(Socket::Datagrams(udp)) => Ok((false, udp.socket().local_addr()?, udp.socket().peer_addr()?)),
            None => Err(io::ErrorKind::NotConnected.into()),
        };
        self.tap.show(ends, moved);
    }
}

impl SendTransport for RobotSocket {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = match &mut self.socket {
            Some(Socket::Stream(tcp)) => SendTransport::send(tcp, bytes, until).await?,
            Some(Socket::Datagrams(udp)) => SendTransport::send(udp, bytes, until).await?,
            None => return Err(io::ErrorKind::NotConnected.into()),
        };
        if let Some(count) = sent {
            self.show(Moved::Request(bytes.get(..count).unwrap_or(bytes)));
        }
        Ok(sent)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = match &mut self.socket {
            Some(Socket::Stream(tcp)) => SendTransport::receive(tcp, buffer, until).await?,
            Some(Socket::Datagrams(udp)) => SendTransport::receive(udp, buffer, until).await?,
            None => return Err(io::ErrorKind::NotConnected.into()),
        };
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
    type Cause = io::Error;

    async fn open(&mut self) -> io::Result<()> {
        let peer = (self.robot.0.as_str(), self.robot.1);
        self.socket = Some(match self.kind {
            bcap::Link::Datagram => Socket::Datagrams(UdpTransport::new(connect_datagrams(peer).await?)),
            _ => Socket::Stream(TcpTransport::new(connect_stream(peer, &self.options).await?)),
        });
        Ok(())
    }

    fn close(&mut self) {
        self.show(Moved::Closed);
        self.socket = None;
    }

    fn cause(error: Option<io::Error>) -> io::Error {
        error.unwrap_or_else(|| io::Error::new(io::ErrorKind::UnexpectedEof, "the robot has closed the connection"))
    }
}
