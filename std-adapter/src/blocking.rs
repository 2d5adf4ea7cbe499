//! Clients that block.
//!
//! [`connect_tcp`], [`connect_udp`] and [`connect_rac`] take a name or an address, IPv4 or IPv6. What they return is a
//! [`Connection`] of the core, whose `call` makes a typed call and waits for the reply, or a [`RacConnection`], whose
//! `get` and `put` do the same for variables.

use std::fmt::Debug;
use std::io;
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::thread;
use std::time::Duration;

use bcap_core::bcap::Client;
pub use bcap_core::io::blocking::{Connection, RacConnection, Transport};
use bcap_core::rac;
use bcap_core::time::Instant;
use socket2::{SockRef, Socket};

use crate::clock::{now, until};
use crate::connect::{self, ConnectError, DATAGRAM_ROOM, Options, STREAM_ROOM};

/// A client over TCP.
pub type TcpClient = Connection<TcpTransport, Vec<u8>>;
/// A client over UDP.
pub type UdpClient = Connection<UdpTransport, Vec<u8>>;

/// A client of RAC.
pub type RacClient = RacConnection<TcpTransport, [u8; rac::MAX_VALUE]>;

/// Connects a client over TCP.
///
/// # Errors
///
/// A [`ConnectError`] for the last address that was tried.
pub fn connect_tcp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<TcpClient, ConnectError> {
    let transport = TcpTransport::new(connect::tcp(peer, options)?);
    let client = Client::new(options.tcp, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM]);
    Ok(Connection::new(transport, client))
}

/// Makes a client over UDP; nothing is sent before the first call.
///
/// # Errors
///
/// A [`ConnectError`] when the name has no address or there is no socket to be had.
pub fn connect_udp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<UdpClient, ConnectError> {
    let transport = UdpTransport::new(connect::udp(peer)?);
    let mut client = Client::new(options.udp, vec![0; DATAGRAM_ROOM], vec![0; DATAGRAM_ROOM]);
    client.set_next_serial(connect::random_serial());
    Ok(Connection::new(transport, client))
}

/// Connects a client of RAC.
///
/// # Errors
///
/// A [`ConnectError`] for the last address that was tried.
pub fn connect_rac<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<RacClient, ConnectError> {
    let transport = TcpTransport::new(connect::tcp(peer, options)?);
    Ok(RacConnection::new(transport, rac::client::Client::new(options.rac, [0; rac::MAX_VALUE])))
}

/// A TCP stream as a transport; made by [`connect_tcp`], or of any connected stream.
#[derive(Debug)]
pub struct TcpTransport {
    stream: TcpStream,
    limits: Limits,
}

impl TcpTransport {
    /// Takes a connected stream.
    #[must_use]
    pub const fn new(stream: TcpStream) -> Self {
        Self { stream, limits: Limits { read: None, write: None } }
    }

    /// Returns the stream.
    #[must_use]
    pub const fn stream(&self) -> &TcpStream {
        &self.stream
    }
}

/// A UDP socket with one peer as a transport; made by [`connect_udp`], or of any connected socket.
#[derive(Debug)]
pub struct UdpTransport {
    socket: UdpSocket,
    limits: Limits,
}

impl UdpTransport {
    /// Takes a connected socket.
    #[must_use]
    pub const fn new(socket: UdpSocket) -> Self {
        Self { socket, limits: Limits { read: None, write: None } }
    }

    /// Returns the socket.
    #[must_use]
    pub const fn socket(&self) -> &UdpSocket {
        &self.socket
    }
}

/// The time limits that a socket has now.
#[derive(Debug)]
struct Limits {
    read: Option<Duration>,
    write: Option<Duration>,
}

/// Brings a limit near `at`, and returns `false` when it is over.
///
/// A limit that is a little too long is left as it is, so that a call after a call of the same timeout costs no system
/// call for it; it can be overstepped by an eighth.
fn limit(
    current: &mut Option<Duration>,
    at: Instant,
    set: impl FnOnce(Option<Duration>) -> io::Result<()>,
) -> io::Result<bool> {
    let wanted = until(at);
    if wanted.is_zero() {
        return Ok(false);
    }
    let near = current.is_some_and(|current| wanted <= current && current <= wanted + wanted / 8);
    if !near {
        // a socket's limit cannot be zero, and is cut to microseconds
        let wanted = wanted.max(Duration::from_micros(100));
        set(Some(wanted))?;
        *current = Some(wanted);
    }
    Ok(true)
}

/// Receives what has arrived, without waiting.
fn receive_at_once(socket: &Socket, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    loop {
        if let Some(end) = ended(try_receive(socket, buffer)) {
            return end;
        }
    }
}

#[cfg(target_os = "linux")]
fn try_receive(socket: &Socket, buffer: &mut [u8]) -> io::Result<usize> {
    use rustix::net::{RecvFlags, recv};
    Ok(recv(socket, buffer, RecvFlags::DONTWAIT)?.0)
}

#[cfg(not(target_os = "linux"))]
fn try_receive(mut socket: &Socket, buffer: &mut [u8]) -> io::Result<usize> {
    socket.set_nonblocking(true)?;
    let received = io::Read::read(&mut socket, buffer);
    socket.set_nonblocking(false)?;
    received
}

/// Sorts the ways in which a system call ends: done, too late, interrupted, failed.
fn ended(result: io::Result<usize>) -> Option<io::Result<Option<usize>>> {
    match result {
        Ok(count) => Some(Ok(Some(count))),
        Err(error) => match error.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => Some(Ok(None)),
            io::ErrorKind::Interrupted => None,
            _ => Some(Err(error)),
        },
    }
}

impl Transport for TcpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { stream, limits } = self;
        loop {
            if !limit(&mut limits.write, until, |time| stream.set_write_timeout(time))? {
                return Ok(None);
            }
            if let Some(end) = ended(io::Write::write(stream, bytes)) {
                return end;
            }
        }
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { stream, limits } = self;
        loop {
            if !limit(&mut limits.read, until, |time| stream.set_read_timeout(time))? {
                return receive_at_once(&SockRef::from(&*stream), buffer);
            }
            if let Some(end) = ended(io::Read::read(stream, buffer)) {
                return end;
            }
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        sleep_until(at);
    }
}

impl Transport for UdpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { socket, limits } = self;
        loop {
            if !limit(&mut limits.write, until, |time| socket.set_write_timeout(time))? {
                return Ok(None);
            }
            if let Some(end) = ended(socket.send(bytes)) {
                return end;
            }
        }
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { socket, limits } = self;
        loop {
            if !limit(&mut limits.read, until, |time| socket.set_read_timeout(time))? {
                return receive_at_once(&SockRef::from(&*socket), buffer);
            }
            if let Some(end) = ended(socket.recv(buffer)) {
                return end;
            }
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        sleep_until(at);
    }
}

fn sleep_until(at: Instant) {
    loop {
        let rest = until(at);
        if rest.is_zero() {
            return;
        }
        thread::sleep(rest);
    }
}
