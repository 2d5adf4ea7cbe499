//! The robot's side of a gateway: one connection, opened and closed as the gateway wants it.

use std::convert::Infallible;
use std::io;
use std::sync::Arc;

use bcap_core::bcap;
use bcap_core::time::Instant;
use tokio::net::{TcpStream, UdpSocket};
use tokio::task::coop::consume_budget;
use tokio::time::sleep;

use super::front::must_wait;
use super::shared::GatewayState;
use super::traffic::{Ends, Moved};
use crate::asynch::{connect_datagrams, connect_stream};
use crate::clock::{now, until};
use crate::connect::{ConnectError, Options};

/// The host and the port of a robot.
pub(super) type HostPort = (String, u16);

/// Keeps the connection to the robot and the gateway's time.
pub(super) async fn run(shared: Arc<GatewayState>, robot: HostPort, options: Options) -> Infallible {
    let mut link = None;
    loop {
        // a robot that sends without a pause must not keep the thread
        consume_budget().await;
        shared.step();
        let wanted = shared.lock().gateway.robot_wanted();
        link = match link.take() {
            None if wanted => open(&shared, &robot, &options).await,
            Some(link) if !wanted => {
                let inner = &mut *shared.lock();
                inner.tap.show(|| link.ends(), Moved::Closed);
                // dropping the link closes it
                inner.gateway.robot_closed(now());
                None
            }
            link => wait(&shared, link).await,
        };
    }
}

/// A connection to a robot.
#[derive(Debug)]
enum RobotSocket {
    Stream(TcpStream),
    Datagrams(UdpSocket),
}

impl RobotSocket {
    async fn open(kind: bcap::Link, (host, port): &HostPort, options: &Options) -> Result<Self, ConnectError> {
        match kind {
            bcap::Link::Datagram => connect_datagrams((host.as_str(), *port)).await.map(Self::Datagrams),
            _ => connect_stream((host.as_str(), *port), options).await.map(Self::Stream),
        }
    }

    fn ends(&self) -> io::Result<Ends> {
        match self {
            Self::Stream(stream) => Ok((true, stream.local_addr()?, stream.peer_addr()?)),
            Self::Datagrams(socket) => Ok((false, socket.local_addr()?, socket.peer_addr()?)),
        }
    }

    async fn writable(&self) -> io::Result<()> {
        match self {
            Self::Stream(stream) => stream.writable().await,
            Self::Datagrams(socket) => socket.writable().await,
        }
    }

    async fn readable(&self) -> io::Result<()> {
        match self {
            Self::Stream(stream) => stream.readable().await,
            Self::Datagrams(socket) => socket.readable().await,
        }
    }

    fn try_send(&self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Stream(stream) => stream.try_write(bytes),
            Self::Datagrams(socket) => socket.try_send(bytes),
        }
    }

    /// Receives bytes of a stream, or a datagram, which may be empty.
    fn try_receive(&self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Stream(stream) => match stream.try_read(buffer)? {
                0 => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the robot has closed the connection")),
                count => Ok(count),
            },
            Self::Datagrams(socket) => socket.try_recv(buffer),
        }
    }
}

/// Opens the connection, and tells the gateway the outcome.
async fn open(shared: &GatewayState, robot: &HostPort, options: &Options) -> Option<RobotSocket> {
    let kind = shared.lock().gateway.config().client.link;
    let opened = RobotSocket::open(kind, robot, options).await;
    let inner = &mut *shared.lock();
    match opened {
        Ok(link) => {
            inner.gateway.robot_opened(now());
            Some(link)
        }
        Err(error) => {
            inner.robot_lost(error.into());
            None
        }
    }
}

/// Waits until something can be done, and moves the bytes that can be moved.
async fn wait(shared: &GatewayState, link: Option<RobotSocket>) -> Option<RobotSocket> {
    let (deadline, sends) = {
        let gateway = &shared.lock().gateway;
        (gateway.poll_timeout(), !gateway.robot_transmit().is_empty())
    };
    let moved = tokio::select! {
        moved = transfer(shared, link.as_ref(), sends) => moved,
        () = sleep(until(deadline.unwrap_or(Instant::ZERO))), if deadline.is_some() => Ok(()),
        () = shared.robot.notified() => Ok(()),
    };
    match moved {
        Ok(()) => link,
        Err(cause) => {
            let inner = &mut *shared.lock();
            if let Some(link) = &link {
                inner.tap.show(|| link.ends(), Moved::Closed);
            }
            inner.robot_lost(cause);
            None
        }
    }
}

/// Moves bytes as soon as some can be moved; an error is the end of the connection. Waits for ever without a connection.
async fn transfer(shared: &GatewayState, link: Option<&RobotSocket>, sends: bool) -> io::Result<()> {
    let Some(link) = link else { return std::future::pending().await };
    loop {
        tokio::select! {
            ready = link.writable(), if sends => {
                ready?;
                let inner = &mut *shared.lock();
                let bytes = inner.gateway.robot_transmit();
                let sent = link.try_send(bytes);
                if !must_wait(&sent) {
                    let count = sent?;
                    inner.tap.show(|| link.ends(), Moved::Request(bytes.get(..count).unwrap_or(bytes)));
                    inner.gateway.robot_transmitted(count);
                    return Ok(());
                }
            }
            ready = link.readable() => {
                ready?;
                let inner = &mut *shared.lock();
                let room = inner.gateway.robot_receive_buffer();
                let received = link.try_receive(room);
                if !must_wait(&received) {
                    let count = received?;
                    inner.tap.show(|| link.ends(), Moved::Reply(room.get(..count).unwrap_or_default()));
                    inner.gateway.robot_received(count);
                    return Ok(());
                }
            }
        }
    }
}
