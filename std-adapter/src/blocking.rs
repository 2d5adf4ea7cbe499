//! Blocking clients.
//!
//! [`Controller`] is a session with a controller, and the way to read variables and to move a robot:
//!
//! ```text
//!  Controller::connect ─┬─► read, write, execute
//!                       ├─► robot ─► Robot ─► take_arm ─► Arm: motor_on, move_to, start ─► Moving: then, wait
//!                       │                                  └─► controller: read, write, execute while the arm is taken
//!                       └─► stopper ─► Stopper: halt, from any thread
//! ```
//!
//! Below it are the functions of the protocol. [`connect_tcp`], [`connect_udp`] and [`connect_rac`] take a host name or an
//! address, IPv4 or IPv6; with the feature `serial`, `connect_serial` takes a [`SerialLine`](crate::SerialLine). All but
//! `connect_rac` return a [`Connection`] of the core, whose `call` makes a typed call and waits for the reply. `connect_rac`
//! returns a [`RacConnection`], whose `get` and `put` read and write variables.

mod borrowed;
mod controller;
pub(crate) mod ending;
mod limited;
mod moving;
mod objects;
mod resolve;
mod robot;
#[cfg(feature = "serial")]
mod serial;
pub(crate) mod socket;
mod stopper;

use std::fmt::Debug;
use std::io;
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::thread;
use std::time::Duration;

pub use bcap_core::io::blocking::{Connection, RacConnection, Transport};
use bcap_core::rac;
use bcap_core::time::Instant;
use socket2::{SockRef, Socket};

pub use self::borrowed::ControllerRef;
pub use self::controller::Controller;
pub use self::moving::{KeptMotion, Moving};
pub use self::objects::{File, Scan, Task};
pub use self::resolve::resolve;
pub use self::robot::{Arm, Robot};
#[cfg(feature = "serial")]
pub use self::serial::{SerialClient, SerialTransport, connect_serial};
pub use self::stopper::Stopper;
use crate::clock::{RecentClock, until};
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
pub fn connect_tcp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<TcpClient, ConnectError> {
    let transport = TcpTransport::new(connect::tcp(peer, options)?);
    Ok(Connection::new(transport, options.tcp_client()))
}

/// Creates a client over UDP. Nothing is sent before the first call.
///
/// # Errors
///
/// A [`ConnectError`] if the name has no address or the socket cannot be created.
pub fn connect_udp<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<UdpClient, ConnectError> {
    Ok(Connection::new(UdpTransport::new(connect::udp(peer)?), options.udp_client()))
}

/// Connects a RAC client.
///
/// # Errors
///
/// A [`ConnectError`] for the last address that was tried.
pub fn connect_rac<A: ToSocketAddrs + Debug>(peer: A, options: &Options) -> Result<RacClient, ConnectError> {
    let transport = TcpTransport::new(connect::tcp(peer, options)?);
    Ok(RacConnection::new(transport, options.rac_client()))
}

/// A TCP stream as a transport; created by [`connect_tcp`], or from any connected stream.
#[derive(Debug)]
pub struct TcpTransport {
    stream: TcpStream,
    timeouts: Timeouts,
}

impl TcpTransport {
    /// Wraps a connected stream.
    #[must_use]
    pub const fn new(stream: TcpStream) -> Self {
        Self { stream, timeouts: Timeouts::new() }
    }

    /// Returns the stream.
    #[must_use]
    pub const fn stream(&self) -> &TcpStream {
        &self.stream
    }
}

/// A connected UDP socket as a transport; created by [`connect_udp`], or from any connected socket.
#[derive(Debug)]
pub struct UdpTransport {
    socket: UdpSocket,
    timeouts: Timeouts,
}

impl UdpTransport {
    /// Wraps a connected socket.
    #[must_use]
    pub const fn new(socket: UdpSocket) -> Self {
        Self { socket, timeouts: Timeouts::new() }
    }

    /// Returns the socket.
    #[must_use]
    pub const fn socket(&self) -> &UdpSocket {
        &self.socket
    }
}

/// The timeouts that are set on a socket, in microseconds; 0 if none is set.
#[derive(Debug)]
struct Timeouts {
    read: u64,
    write: u64,
    clock: RecentClock,
}

impl Timeouts {
    const fn new() -> Self {
        Self { read: 0, write: 0, clock: RecentClock::new() }
    }

    /// Sends bytes until a deadline with `write`, which waits for room.
    fn send(
        &mut self,
        socket: &Socket,
        bytes: &[u8],
        until: Instant,
        write: impl Fn(&[u8]) -> io::Result<usize>,
    ) -> io::Result<Option<usize>> {
        // the send buffer almost always has room for a request, so the common case needs no timeout
        match classified(try_send(socket, bytes)) {
            Some(Ok(Some(count))) => return Ok(Some(count)),
            // the system reports only once that it has abandoned a connection
            Some(Err(error)) if error.kind() == io::ErrorKind::TimedOut => return Err(error),
            _ => {}
        }
        loop {
            if !set_timeout(&mut self.write, self.clock.micros_until(until), |time| socket.set_write_timeout(time))? {
                return Ok(None);
            }
            if let Some(result) = classified(write(bytes)) {
                return result;
            }
        }
    }

    /// Receives bytes until a deadline with `read`, which waits for them.
    fn receive(
        &mut self,
        socket: &Socket,
        buffer: &mut [u8],
        until: Instant,
        read: impl Fn(&mut [u8]) -> io::Result<usize>,
    ) -> io::Result<Option<usize>> {
        if until == Instant::ZERO {
            return receive_now(socket, buffer);
        }
        loop {
            if !set_timeout(&mut self.read, self.clock.micros_until(until), |time| socket.set_read_timeout(time))? {
                return receive_now(socket, buffer);
            }
            if let Some(result) = classified(read(buffer)) {
                return result;
            }
        }
    }
}

/// Sets a socket's timeout so that an operation ends after `wanted` microseconds; returns `false` if no time is left.
///
/// A timeout that is at most an eighth too long is not changed, so repeated calls with equal timeouts need no system call
/// for it. An operation may therefore end that much after its deadline.
fn set_timeout(
    current: &mut u64,
    wanted: u64,
    set: impl FnOnce(Option<Duration>) -> io::Result<()>,
) -> io::Result<bool> {
    if wanted == 0 {
        return Ok(false);
    }
    let near = wanted <= *current && *current - wanted <= wanted / 8;
    if !near {
        // a socket's timeout must not be zero
        let wanted = wanted.max(100);
        set(Some(Duration::from_micros(wanted)))?;
        *current = wanted;
    }
    Ok(true)
}

/// Receives bytes that have arrived, without waiting.
fn receive_now(socket: &Socket, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    loop {
        if let Some(result) = try_receive(socket, buffer) {
            return result;
        }
    }
}

/// Receives bytes, classified. Before each call nothing has arrived, which therefore makes no `io::Error`.
#[cfg(target_os = "linux")]
fn try_receive(socket: &Socket, buffer: &mut [u8]) -> Option<io::Result<Option<usize>>> {
    use rustix::io::Errno;
    use rustix::net::{RecvFlags, recv};
    match recv(socket, buffer, RecvFlags::DONTWAIT) {
        Ok((count, _)) => Some(Ok(Some(count))),
        Err(Errno::AGAIN) => Some(Ok(None)),
        Err(error) => classified(Err(error.into())),
    }
}

#[cfg(not(target_os = "linux"))]
fn try_receive(mut socket: &Socket, buffer: &mut [u8]) -> Option<io::Result<Option<usize>>> {
    let received = socket.set_nonblocking(true).and_then(|()| {
        let received = io::Read::read(&mut socket, buffer);
        socket.set_nonblocking(false)?;
        received
    });
    classified(received)
}

/// Sends bytes without waiting.
#[cfg(target_os = "linux")]
fn try_send(socket: &Socket, bytes: &[u8]) -> io::Result<usize> {
    use rustix::net::{SendFlags, send};
    Ok(send(socket, bytes, SendFlags::DONTWAIT | SendFlags::NOSIGNAL)?)
}

/// Sends nothing: on this platform each attempt would cost two more system calls.
#[cfg(not(target_os = "linux"))]
fn try_send(_: &Socket, _: &[u8]) -> io::Result<usize> {
    Err(io::ErrorKind::WouldBlock.into())
}

/// Classifies the result of a system call: a count, `Ok(None)` after a timeout, an error, or `None` to try again.
fn classified(result: io::Result<usize>) -> Option<io::Result<Option<usize>>> {
    match result {
        Ok(count) => Some(Ok(Some(count))),
        Err(error) => match error.kind() {
            io::ErrorKind::WouldBlock => Some(Ok(None)),
            // the timeout of a socket of Windows and of a serial line; on Unix the system reports an abandoned connection with
            // this error
            io::ErrorKind::TimedOut if cfg!(windows) || error.raw_os_error().is_none() => Some(Ok(None)),
            io::ErrorKind::Interrupted => None,
            _ => Some(Err(error)),
        },
    }
}

impl Transport for TcpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.timeouts.clock.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { stream, timeouts } = self;
        timeouts.send(&SockRef::from(&*stream), bytes, until, |bytes| io::Write::write(&mut &*stream, bytes))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { stream, timeouts } = self;
        timeouts.receive(&SockRef::from(&*stream), buffer, until, |buffer| io::Read::read(&mut &*stream, buffer))
    }

    fn sleep_until(&mut self, at: Instant) {
        sleep_until(at);
    }
}

impl Transport for UdpTransport {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.timeouts.clock.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { socket, timeouts } = self;
        timeouts.send(&SockRef::from(&*socket), bytes, until, |bytes| socket.send(bytes))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let Self { socket, timeouts } = self;
        timeouts.receive(&SockRef::from(&*socket), buffer, until, |buffer| socket.recv(buffer))
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

#[cfg(all(test, not(feature = "serial")))]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn a_build_without_serial_lines_names_the_feature() {
        let error = Controller::connect("serial:/dev/ttyUSB0", &Settings::rc8()).unwrap_err();
        let text = "cannot open the serial line /dev/ttyUSB0: enable the feature `serial` of bcap-std";
        assert_eq!(error.to_string(), text);
    }
}
