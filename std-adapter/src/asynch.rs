//! Objects and clients for tokio.
//!
//! [`Controller`] is a handle of a task that owns a session with a controller:
//!
//! ```text
//!  Controller::connect ─┬─► read, write, execute ─┐
//!                       ├─► subscribe             ├─► the task ─► the session, opened again when it is lost
//!                       ├─► robot ─► Robot ─► Arm ┘
//!                       └─► stopper ─► Stopper ─────► a separate task and session
//! ```
//!
//! Below it are the functions of the protocol, as in [`blocking`](crate::blocking): [`connect_tcp`], [`connect_udp`] and
//! [`connect_rac`] return a [`Connection`] of the core over tokio's sockets. Its calls are cancel safe: the future of a call
//! may be dropped at any point, and the connection stays usable.

mod actor;
mod controller;
mod ending;
mod handle;
mod moving;
mod objects;
mod robot;
#[cfg(feature = "serial")]
mod serial;
pub(crate) mod socket;
mod state;
mod subscription;

use std::fmt::Debug;
use std::io;
use std::net::SocketAddr;

pub use bcap_core::io::asynch::{Connection, RacConnection, SendTransport, Transport};
use bcap_core::rac;
use bcap_core::time::Instant;
use socket2::{SockRef, Socket};
use tokio::net::{TcpStream, ToSocketAddrs, UdpSocket, lookup_host};
use tokio::time::timeout;

pub use self::controller::Controller;
pub use self::moving::Moving;
pub use self::objects::{File, Task};
pub use self::robot::{Arm, Robot, Stopper};
#[cfg(feature = "serial")]
pub use self::serial::{SerialClient, SerialTransport, connect_serial};
pub use self::state::{Recoveries, State, States, Statistics};
pub use self::subscription::{Reading, Subscription};
use crate::clock::{now, until};
use crate::connect::{self, ConnectError, Options};
pub use crate::session::Halted;

/// A client over TCP.
pub type TcpClient = Connection<TcpTransport, Vec<u8>>;
/// A client over UDP.
pub type UdpClient = Connection<UdpTransport, Vec<u8>>;

/// A RAC client.
pub type RacClient = RacConnection<TcpTransport, [u8; rac::MAX_VALUE]>;

/// Connects a client over TCP.
///
/// # Errors
///
/// A [`ConnectError`] for the last address that was tried.
///
/// # Cancel safety
///
/// Dropping the future closes the connection.
pub async fn connect_tcp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<TcpClient, ConnectError> {
    let transport = TcpTransport::new(connect_stream(peer, options).await?);
    Ok(Connection::new(transport, options.tcp_client()))
}

/// Connects a RAC client.
///
/// # Errors
///
/// A [`ConnectError`] for the last address that was tried.
///
/// # Cancel safety
///
/// Dropping the future closes the connection.
pub async fn connect_rac<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<RacClient, ConnectError> {
    let transport = TcpTransport::new(connect_stream(peer, options).await?);
    Ok(RacConnection::new(transport, options.rac_client()))
}

/// Connects a TCP stream and configures it for short messages.
pub(crate) async fn connect_stream<A: ToSocketAddrs + Debug>(
    peer: A,
    options: &Options,
) -> Result<TcpStream, ConnectError> {
    let addresses = addresses(peer).await?;
    let mut failed = None;
    for address in addresses {
        let connecting = timeout(options.connect_timeout, TcpStream::connect(address));
        let source = match connecting.await {
            Ok(Ok(stream)) => {
                connect::set_up_tcp(SockRef::from(&stream), options.keep_alive).map_err(ConnectError::Setup)?;
                return Ok(stream);
            }
            Ok(Err(source)) => source,
            Err(_) => io::ErrorKind::TimedOut.into(),
        };
        failed = Some(ConnectError::Connect { address, source });
    }
    // `addresses` returns at least one, so `failed` is set
    Err(failed.unwrap_or_else(|| ConnectError::Setup(connect::no_address())))
}

/// Creates a client over UDP. Nothing is sent before the first call.
///
/// # Errors
///
/// A [`ConnectError`] if the name has no address or the socket cannot be created.
pub async fn connect_udp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<UdpClient, ConnectError> {
    Ok(Connection::new(UdpTransport::new(connect_datagrams(peer).await?), options.udp_client()))
}

/// Creates a UDP socket that receives datagrams of one peer only.
pub(crate) async fn connect_datagrams<A: ToSocketAddrs + Debug>(peer: A) -> Result<UdpSocket, ConnectError> {
    let socket = connect::udp(&addresses(peer).await?[..])?;
    socket.set_nonblocking(true).map_err(ConnectError::Setup)?;
    UdpSocket::from_std(socket).map_err(ConnectError::Setup)
}

/// Resolves a name to one or more addresses.
async fn addresses<A: ToSocketAddrs + Debug>(peer: A) -> Result<Vec<SocketAddr>, ConnectError> {
    let name = connect::host_and_port(&peer);
    let found = match lookup_host(peer).await {
        Ok(found) => found.collect::<Vec<_>>(),
        Err(source) => return Err(ConnectError::Resolve { name, source }),
    };
    if found.is_empty() {
        return Err(ConnectError::Resolve { name, source: connect::no_address() });
    }
    Ok(found)
}

/// A TCP stream as a transport; created by [`connect_tcp`], or from any connected stream.
#[derive(Debug)]
pub struct TcpTransport {
    stream: TcpStream,
}

impl TcpTransport {
    /// Wraps a connected stream.
    #[must_use]
    pub const fn new(stream: TcpStream) -> Self {
        Self { stream }
    }

    /// Returns the stream.
    #[must_use]
    pub const fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Returns the stream, to use it otherwise.
    #[cfg(feature = "gateway")]
    pub(crate) fn into_stream(self) -> TcpStream {
        self.stream
    }
}

/// A connected UDP socket as a transport; created by [`connect_udp`], or from any connected socket.
#[derive(Debug)]
pub struct UdpTransport {
    socket: UdpSocket,
}

impl UdpTransport {
    /// Wraps a connected socket.
    #[must_use]
    pub const fn new(socket: UdpSocket) -> Self {
        Self { socket }
    }

    /// Returns the socket.
    #[must_use]
    pub const fn socket(&self) -> &UdpSocket {
        &self.socket
    }
}

/// Waits for `operation` until `deadline`; `None` if the deadline passes first.
async fn within(deadline: Instant, operation: impl Future<Output = io::Result<usize>>) -> io::Result<Option<usize>> {
    match timeout(until(deadline), operation).await {
        Ok(result) => result.map(Some),
        Err(_) => Ok(None),
    }
}

/// Returns whether `deadline` has passed, so that a receive must not wait.
fn has_passed(deadline: Instant) -> bool {
    until(deadline).is_zero()
}

/// Receives bytes that have arrived, without waiting. It reads from the socket directly, because tokio's readiness is as old
/// as its last wait for events.
fn receive_now(mut socket: &Socket, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    loop {
        match io::Read::read(&mut socket, buffer) {
            Ok(count) => return Ok(Some(count)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

impl SendTransport for TcpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        // the send buffer almost always has room for a request, so the common case needs no timer
        match self.stream.try_write(bytes) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            done => return done.map(Some),
        }
        within(until, tokio::io::AsyncWriteExt::write(&mut self.stream, bytes)).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        if has_passed(until) {
            return receive_now(&SockRef::from(&self.stream), buffer);
        }
        within(until, tokio::io::AsyncReadExt::read(&mut self.stream, buffer)).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        tokio::time::sleep(until(at)).await;
    }
}

impl SendTransport for UdpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        within(until, self.socket.send(bytes)).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        if has_passed(until) {
            return receive_now(&SockRef::from(&self.socket), buffer);
        }
        within(until, self.socket.recv(buffer)).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        tokio::time::sleep(until(at)).await;
    }
}
