//! One transport over any kind of blocking socket.

use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::{fmt, io};

use bcap_core::io::asynch;
use bcap_core::time::Instant;

use super::{Connection, Transport, connect_tcp, connect_udp};
use crate::address::{Address, NetworkAddress, Protocol};
use crate::connect::ConnectError;
use crate::settings::Settings;

/// A blocking transport for the session's asynchronous functions: its futures do not wait, their polls do.
pub(crate) struct Blocking {
    socket: Box<dyn Transport<Error = io::Error> + Send>,
    /// When the socket fails.
    deadline: Option<Instant>,
}

impl fmt::Debug for Blocking {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Blocking").field("deadline", &self.deadline).finish_non_exhaustive()
    }
}

impl Blocking {
    pub(crate) fn new(socket: impl Transport<Error = io::Error> + Send + 'static) -> Self {
        Self { socket: Box::new(socket), deadline: None }
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

/// A client over a [`Blocking`] transport.
pub(super) type BlockingConnection = asynch::Connection<Blocking, Vec<u8>>;

/// Runs a function of a session over a [`Blocking`] transport: its first poll does all the work.
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
                Protocol::Tcp => Ok(wrap(connect_tcp(peer, &options)?)),
                Protocol::Udp => Ok(wrap(connect_udp(peer, &options)?)),
            }
        }
        #[cfg(feature = "serial")]
        Address::Serial(line) => Ok(wrap(super::connect_serial(line, &options)?)),
        #[cfg(not(feature = "serial"))]
        Address::Serial(line) => Err(ConnectError::NoSerial { path: line.path.clone() }),
    }
}

/// Combines a stream of the user with a client.
pub(super) fn over(
    stream: impl Transport<Error = io::Error> + Send + 'static,
    settings: &Settings,
) -> BlockingConnection {
    wrap(Connection::new(stream, settings.socket_options().tcp_client()))
}

/// Wraps a connection over any transport.
pub(super) fn wrap<X>(connection: Connection<X, Vec<u8>>) -> BlockingConnection
where
    X: Transport<Error = io::Error> + Send + 'static,
{
    let (transport, client) = connection.into_parts();
    asynch::Connection::new(Blocking::new(transport), client)
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
