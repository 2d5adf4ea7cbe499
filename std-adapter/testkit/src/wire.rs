//! The raw end of a connection: packets as they arrive, valid or not, with a time limit for every wait.
//!
//! | link                    | a packet                                                        |
//! |-------------------------|-----------------------------------------------------------------|
//! | [`Link::Tcp`]           | the bytes that the length field of a frame counts               |
//! | [`Link::Serial`]        | the same; bytes before the first byte of a frame are noise      |
//! | [`Link::Udp`]           | a datagram                                                      |
//! | RAC                     | a line with its CR                                              |
//!
//! Bytes that are not a packet are returned together, so that a judge can report them.

use std::fmt;
use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use bcap_core::limits::Limits;

use crate::frame::field;

/// The pause between two checks for a client, because a listener has no time limit.
const LOOK: Duration = Duration::from_millis(5);

/// The link of b-CAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// A TCP connection.
    Tcp,
    /// UDP datagrams.
    Udp,
    /// A serial line that a device server maps to TCP: frames have a CRC.
    Serial,
}

impl Link {
    /// Returns whether calls are sent again when no reply arrives: the reserved field has the serial of the first attempt.
    #[must_use]
    pub const fn repeats(self) -> bool {
        !matches!(self, Self::Tcp)
    }
}

/// Records the bytes of one connection, until it is dropped.
pub trait Tape: fmt::Debug + Send {
    /// Records bytes that the client (`is_request`) or the server has sent.
    fn bytes(&self, is_request: bool, bytes: &[u8]);
}

/// Records connections.
pub trait Recorder {
    /// Begins to record a connection.
    fn opened(&self, is_tcp: bool, client: SocketAddr, server: SocketAddr) -> Box<dyn Tape>;
}

/// The socket of a connection.
#[derive(Debug)]
enum Socket {
    Stream(TcpStream),
    /// A client's port, connected, so that a closed port of the server is detected.
    Datagrams(UdpSocket),
    /// A server's port, which other clients use too.
    Shared(UdpSocket, SocketAddr),
}

/// The way to find packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Framing {
    Frames(Link),
    Lines,
}

/// The received bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Received {
    /// A packet; bytes, which are empty if no more bytes arrived in time.
    Packet(Vec<u8>),
    /// The peer closed or reset the connection, or has closed its port for datagrams.
    Closed,
    /// Nothing arrived in time.
    Silence,
}

/// A connection.
#[derive(Debug)]
pub struct Wire {
    socket: Socket,
    framing: Framing,
    received: Vec<u8>,
    tape: Option<Box<dyn Tape>>,
    is_stuck: bool,
    has_received: bool,
}

impl Wire {
    /// Connects to a port of b-CAP. `limit` is also the time limit of each write.
    ///
    /// # Errors
    ///
    /// When the connection is refused.
    pub fn connect(link: Link, address: SocketAddr, limit: Duration) -> io::Result<Self> {
        let socket = match link {
            Link::Tcp | Link::Serial => Socket::Stream(stream(address, limit)?),
            Link::Udp => {
                let any: SocketAddr = if address.is_ipv4() { ([0; 4], 0).into() } else { ([0_u16; 8], 0).into() };
                let socket = UdpSocket::bind(any)?;
                socket.connect(address)?;
                Socket::Datagrams(socket)
            }
        };
        Ok(Self::new(socket, Framing::Frames(link)))
    }

    /// Connects to a port of RAC.
    ///
    /// # Errors
    ///
    /// When the connection is refused.
    pub fn connect_rac(address: SocketAddr, limit: Duration) -> io::Result<Self> {
        Ok(Self::new(Socket::Stream(stream(address, limit)?), Framing::Lines))
    }

    /// Takes a connected stream.
    ///
    /// # Errors
    ///
    /// When the stream has ended.
    pub fn of_stream(stream: TcpStream, limit: Duration) -> io::Result<Self> {
        set_up(&stream, limit)?;
        Ok(Self::new(Socket::Stream(stream), Framing::Frames(Link::Tcp)))
    }

    /// Returns the stream, if the link has one.
    #[must_use]
    pub const fn stream(&self) -> Option<&TcpStream> {
        match &self.socket {
            Socket::Stream(stream) => Some(stream),
            Socket::Datagrams(_) | Socket::Shared(..) => None,
        }
    }

    fn new(socket: Socket, framing: Framing) -> Self {
        Self { socket, framing, received: Vec::new(), tape: None, is_stuck: false, has_received: false }
    }

    /// Records the connection from now on.
    #[must_use]
    pub fn recorded(mut self, recorder: Option<&dyn Recorder>) -> Self {
        let ends = match &self.socket {
            Socket::Stream(stream) => stream.local_addr().and_then(|client| Ok((client, stream.peer_addr()?))),
            Socket::Datagrams(socket) => socket.local_addr().and_then(|client| Ok((client, socket.peer_addr()?))),
            Socket::Shared(socket, peer) => socket.local_addr().map(|server| (*peer, server)),
        };
        // the peer may have closed the connection already
        self.tape = recorder.zip(ends.ok()).map(|(recorder, (client, server))| {
            recorder.opened(matches!(self.socket, Socket::Stream(_)), client, server)
        });
        self
    }

    /// Sends bytes. After a time limit [`is_stuck`](Self::is_stuck) returns true.
    ///
    /// # Errors
    ///
    /// When the peer takes no bytes, or a datagram is too long for IP.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let sent = match &mut self.socket {
            Socket::Stream(stream) => stream.write_all(bytes),
            Socket::Datagrams(socket) => socket.send(bytes).map(drop),
            Socket::Shared(socket, peer) => socket.send_to(bytes, *peer).map(drop),
        };
        let is_stream = matches!(self.socket, Socket::Stream(_));
        self.is_stuck |= is_stream && sent.as_ref().is_err_and(is_timeout);
        if let Some(tape) = self.tape.as_ref().filter(|_| is_stream || sent.is_ok()) {
            tape.bytes(!matches!(self.socket, Socket::Shared(..)), bytes);
        }
        sent
    }

    /// Sends a datagram to the client from another port of this machine.
    ///
    /// # Errors
    ///
    /// When there is no port for it.
    pub fn send_from_elsewhere(&self, bytes: &[u8]) -> io::Result<()> {
        let Socket::Shared(socket, peer) = &self.socket else { return Ok(()) };
        let other = UdpSocket::bind(SocketAddr::new(socket.local_addr()?.ip(), 0))?;
        other.send_to(bytes, *peer).map(drop)
    }

    /// Shuts down the sending direction of a stream, and keeps the other direction.
    ///
    /// # Errors
    ///
    /// When the connection has ended.
    pub fn finish(&self) -> io::Result<()> {
        self.stream().map_or(Ok(()), |stream| stream.shutdown(Shutdown::Write))
    }

    /// Returns whether the peer stopped accepting bytes for longer than the time limit.
    #[must_use]
    pub const fn is_stuck(&self) -> bool {
        self.is_stuck
    }

    /// Returns whether the peer has sent anything.
    #[must_use]
    pub const fn has_received(&self) -> bool {
        self.has_received
    }

    /// Receives a packet within `limit`.
    pub fn receive(&mut self, limit: Duration) -> Received {
        let until = Instant::now() + limit;
        let mut buffer = Vec::new();
        loop {
            if let Some(length) = self.packet_length() {
                let rest = self.received.split_off(length);
                return Received::Packet(std::mem::replace(&mut self.received, rest));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || self.is_stuck {
                return self.end(Received::Silence);
            }
            buffer.resize(1 << 16, 0);
            match self.read(&mut buffer, left) {
                Ok(Some(count)) if self.framing == Framing::Frames(Link::Udp) => {
                    self.record(&buffer[..count]);
                    return Received::Packet(buffer[..count].to_vec());
                }
                Ok(Some(0)) => return self.end(Received::Closed),
                Ok(Some(count)) => {
                    self.record(&buffer[..count]);
                    self.received.extend_from_slice(&buffer[..count]);
                }
                Ok(None) => {}
                Err(error) if is_timeout(&error) => {}
                Err(_) => return self.end(Received::Closed),
            }
        }
    }

    /// Reads once; `None` for a datagram of another client.
    fn read(&mut self, buffer: &mut [u8], limit: Duration) -> io::Result<Option<usize>> {
        match &mut self.socket {
            Socket::Stream(stream) => {
                stream.set_read_timeout(Some(limit))?;
                stream.read(buffer).map(Some)
            }
            Socket::Datagrams(socket) => {
                socket.set_read_timeout(Some(limit))?;
                socket.recv(buffer).map(Some)
            }
            Socket::Shared(socket, peer) => {
                socket.set_read_timeout(Some(limit))?;
                // another client is served later, if it tries again
                socket.recv_from(buffer).map(|(count, from)| (from == *peer).then_some(count))
            }
        }
    }

    /// Returns the bytes that are not a packet, or the reason for the end.
    fn end(&mut self, reason: Received) -> Received {
        if self.received.is_empty() { reason } else { Received::Packet(std::mem::take(&mut self.received)) }
    }

    /// Returns the length of the packet at the front; of bytes that cannot be one, the length of all bytes.
    fn packet_length(&mut self) -> Option<usize> {
        match self.framing {
            Framing::Lines => return self.received.iter().position(|byte| *byte == b'\r').map(|at| at + 1),
            Framing::Frames(Link::Udp) => return Some(self.received.len()).filter(|length| *length > 0),
            Framing::Frames(Link::Serial) => {
                let noise = self.received.iter().take_while(|byte| **byte != 1).count();
                self.received.drain(..noise);
            }
            Framing::Frames(Link::Tcp) => {}
        }
        let first = self.received.first()?;
        if *first != 1 {
            return Some(self.received.len());
        }
        let length = field::length(&self.received)?;
        if !(16..=Limits::STREAM.frame).contains(&length) {
            return Some(self.received.len());
        }
        usize::try_from(length).ok().filter(|length| *length <= self.received.len())
    }

    /// Closes the connection, and waits until the peer has closed it too: a small device then has room for the next one.
    pub fn close(mut self, limit: Duration) {
        // a connection that the peer has closed already is not an error
        if self.stream().is_none() || self.finish().is_err() {
            return;
        }
        let until = Instant::now() + limit;
        while let Received::Packet(_) = self.receive(until.saturating_duration_since(Instant::now())) {}
    }

    fn record(&mut self, bytes: &[u8]) {
        self.has_received = true;
        if let Some(tape) = &self.tape {
            tape.bytes(matches!(self.socket, Socket::Shared(..)), bytes);
        }
    }
}

/// A port at which clients are served sequentially.
#[derive(Debug)]
pub enum Listener {
    /// A port for TCP.
    Tcp(TcpListener),
    /// A port for UDP.
    Udp(UdpSocket),
}

impl Listener {
    /// Listens over TCP or UDP; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When listening on the address fails.
    pub fn bind(link: Link, address: SocketAddr) -> io::Result<Self> {
        Ok(match link {
            Link::Tcp | Link::Serial => Self::Tcp(TcpListener::bind(address)?),
            Link::Udp => Self::Udp(UdpSocket::bind(address)?),
        })
    }

    /// Returns the address.
    ///
    /// # Errors
    ///
    /// If the operating system does not return the address.
    pub fn address(&self) -> io::Result<SocketAddr> {
        match self {
            Self::Tcp(listener) => listener.local_addr(),
            Self::Udp(socket) => socket.local_addr(),
        }
    }

    /// Waits for the next client; `None` at the time limit.
    ///
    /// # Errors
    ///
    /// When the socket fails.
    pub fn accept(&self, limit: Duration) -> io::Result<Option<Wire>> {
        let until = Instant::now() + limit;
        let listener = match self {
            Self::Tcp(listener) => listener,
            Self::Udp(socket) => return accept_datagrams(socket, limit),
        };
        listener.set_nonblocking(true)?;
        loop {
            match listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(false)?;
                    return Wire::of_stream(stream, limit).map(Some);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock && Instant::now() < until => {
                    std::thread::sleep(LOOK);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                Err(error) => return Err(error),
            }
        }
    }
}

/// Waits for the first datagram of a client.
fn accept_datagrams(socket: &UdpSocket, limit: Duration) -> io::Result<Option<Wire>> {
    socket.set_read_timeout(Some(limit))?;
    let mut buffer = vec![0; 1 << 16];
    let Ok((count, peer)) = socket.recv_from(&mut buffer) else { return Ok(None) };
    let mut wire = Wire::new(Socket::Shared(socket.try_clone()?, peer), Framing::Frames(Link::Udp));
    wire.received.extend_from_slice(&buffer[..count]);
    Ok(Some(wire))
}

fn stream(address: SocketAddr, limit: Duration) -> io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&address, limit)?;
    set_up(&stream, limit)?;
    Ok(stream)
}

fn set_up(stream: &TcpStream, limit: Duration) -> io::Result<()> {
    stream.set_write_timeout(Some(limit))?;
    stream.set_nodelay(true)
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}
