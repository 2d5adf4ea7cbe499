//! One transport over any kind of socket.

use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::{fmt, io};

use bcap_core::bcap::Client;
use bcap_core::io::asynch;
use bcap_core::time::Instant;

#[cfg(feature = "serial")]
use super::SerialTransport;
use super::{Connection, TcpTransport, Transport, UdpTransport, connect_tcp, connect_udp};
use crate::address::{Address, NetworkAddress, Protocol};
use crate::connect::{ConnectError, STREAM_ROOM};
use crate::settings::Settings;

/// A TCP or UDP socket, a serial line, or a transport of the user.
pub(crate) enum Socket {
    Tcp(TcpTransport),
    Udp(UdpTransport),
    #[cfg(feature = "serial")]
    Serial(SerialTransport),
    Other(Box<dyn Transport<Error = io::Error> + Send>),
}

impl fmt::Debug for Socket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(tcp) => tcp.fmt(f),
            Self::Udp(udp) => udp.fmt(f),
            #[cfg(feature = "serial")]
            Self::Serial(line) => line.fmt(f),
            Self::Other(_) => f.write_str("Other"),
        }
    }
}

/// A [`Socket`] as a transport of the session's asynchronous functions: its futures do not wait, their polls do.
#[derive(Debug)]
pub(crate) struct Blocking {
    socket: Socket,
    /// When the socket fails.
    deadline: Option<Instant>,
}

impl Blocking {
    pub(crate) const fn new(socket: Socket) -> Self {
        Self { socket, deadline: None }
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    pub(super) const fn set_deadline(&mut self, deadline: Option<Instant>) {
        self.deadline = deadline;
    }

    /// Returns the earlier of `until` and the deadline; fails after the deadline.
    fn limited(&self, until: Instant) -> io::Result<Instant> {
        match self.deadline {
            Some(deadline) if deadline <= self.socket.now() => Err(io::ErrorKind::TimedOut.into()),
            deadline => Ok(deadline.map_or(until, |deadline| deadline.min(until))),
        }
    }
}

/// A client over a [`Blocking`] socket.
pub(super) type BlockingConnection = asynch::Connection<Blocking, Vec<u8>>;

/// Runs a function of a session over a [`Blocking`] socket: its first poll does all the work.
pub(super) fn ready<F: Future>(work: F) -> F::Output {
    let mut work = pin!(work);
    loop {
        if let Poll::Ready(output) = work.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return output;
        }
    }
}

/// Connects with the time limits of the settings.
pub(super) fn connect(address: &Address, settings: &Settings) -> Result<BlockingConnection, ConnectError> {
    let options = settings.socket_options();
    match address {
        Address::Network(NetworkAddress { protocol, host, port }) => {
            let peer = (host.as_str(), *port);
            match protocol {
                Protocol::Tcp => Ok(wrap(connect_tcp(peer, &options)?, Socket::Tcp)),
                Protocol::Udp => Ok(wrap(connect_udp(peer, &options)?, Socket::Udp)),
            }
        }
        #[cfg(feature = "serial")]
        Address::Serial(line) => Ok(wrap(super::connect_serial(line, &options)?, Socket::Serial)),
        #[cfg(not(feature = "serial"))]
        Address::Serial(line) => Err(ConnectError::NoSerial { path: line.path.clone() }),
    }
}

/// Combines a stream of the user with a client.
pub(super) fn over(
    stream: impl Transport<Error = io::Error> + Send + 'static,
    settings: &Settings,
) -> BlockingConnection {
    let client = Client::new(settings.socket_options().tcp, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM]);
    asynch::Connection::new(Blocking::new(Socket::Other(Box::new(stream))), client)
}

/// Wraps a connection over any transport.
pub(super) fn wrap_any<X>(connection: Connection<X, Vec<u8>>) -> BlockingConnection
where
    X: Transport<Error = io::Error> + Send + 'static,
{
    wrap(connection, |transport| Socket::Other(Box::new(transport)))
}

fn wrap<X: Transport>(connection: Connection<X, Vec<u8>>, socket: fn(X) -> Socket) -> BlockingConnection {
    let (transport, client): (X, Client<Vec<u8>>) = connection.into_parts();
    asynch::Connection::new(Blocking::new(socket(transport)), client)
}

impl asynch::SendTransport for Blocking {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.socket.now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let until = self.limited(until)?;
        self.socket.send(bytes, until)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let until = self.limited(until)?;
        self.socket.receive(buffer, until)
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.socket.sleep_until(at);
    }
}

impl Transport for Socket {
    type Error = io::Error;

    fn now(&self) -> Instant {
        match self {
            Self::Other(other) => other.now(),
            _ => crate::now(),
        }
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => tcp.send(bytes, until),
            Self::Udp(udp) => udp.send(bytes, until),
            #[cfg(feature = "serial")]
            Self::Serial(line) => line.send(bytes, until),
            Self::Other(other) => other.send(bytes, until),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => tcp.receive(buffer, until),
            Self::Udp(udp) => udp.receive(buffer, until),
            #[cfg(feature = "serial")]
            Self::Serial(line) => line.receive(buffer, until),
            Self::Other(other) => other.receive(buffer, until),
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        match self {
            Self::Other(other) => other.sleep_until(at),
            _ => super::sleep_until(at),
        }
    }
}
