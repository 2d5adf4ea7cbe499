//! The socket of the judge: frames of one client.

use std::io::{self, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use bcap_core::bcap::{Decoder, Progress};

use crate::wire::read_until;

/// Where clients connect to.
#[derive(Debug)]
pub(super) enum Listener {
    Tcp(TcpListener),
    Udp(UdpSocket),
}

/// The connection of one client.
#[derive(Debug)]
pub(super) enum Socket {
    Tcp { stream: TcpStream, received: Vec<u8> },
    Udp { socket: UdpSocket, peer: SocketAddr, first: Option<Vec<u8>> },
}

/// What came from the client.
#[derive(Debug)]
pub(super) enum Incoming {
    /// The bytes of a valid frame.
    Frame(Vec<u8>),
    Invalid(String),
    Closed,
    Nothing,
}

impl Listener {
    /// Waits for the next client; `None` at the time limit.
    pub(super) fn accept(&self, limit: Duration) -> io::Result<Option<Socket>> {
        let until = Instant::now() + limit;
        match self {
            Self::Tcp(listener) => {
                listener.set_nonblocking(true)?;
                while Instant::now() < until {
                    match listener.accept() {
                        Ok((stream, _)) => {
                            stream.set_nonblocking(false)?;
                            stream.set_nodelay(true)?;
                            stream.set_write_timeout(Some(limit))?;
                            return Ok(Some(Socket::Tcp { stream, received: Vec::new() }));
                        }
                        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                            // a listener has no time limit of its own
                            std::thread::sleep(Duration::from_millis(5));
                        }
                        Err(error) => return Err(error),
                    }
                }
                Ok(None)
            }
            Self::Udp(socket) => {
                socket.set_read_timeout(Some(limit))?;
                let mut buffer = [0; 65536];
                match socket.recv_from(&mut buffer) {
                    Ok((count, peer)) => {
                        let first = Some(buffer[..count].to_vec());
                        Ok(Some(Socket::Udp { socket: socket.try_clone()?, peer, first }))
                    }
                    Err(_) => Ok(None),
                }
            }
        }
    }
}

impl Socket {
    pub(super) fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp { stream, .. } => stream.write_all(bytes),
            Self::Udp { socket, peer, .. } => socket.send_to(bytes, *peer).map(drop),
        }
    }

    /// Sends a datagram from another port of this machine.
    pub(super) fn send_from_elsewhere(&self, bytes: &[u8]) -> io::Result<()> {
        let Self::Udp { socket, peer, .. } = self else { return Ok(()) };
        let other = UdpSocket::bind(SocketAddr::new(socket.local_addr()?.ip(), 0))?;
        other.send_to(bytes, *peer).map(drop)
    }

    /// Receives the next frame within `limit`.
    pub(super) fn receive(&mut self, limit: Duration) -> Incoming {
        let until = Instant::now() + limit;
        match self {
            Self::Tcp { stream, received } => loop {
                match Decoder::TCP.decode(received) {
                    Ok(Progress::Complete(_, used)) => return Incoming::Frame(received.drain(..used).collect()),
                    Ok(Progress::NeedMore(_)) => {}
                    Err(error) => return Incoming::Invalid(error.to_string()),
                }
                let mut buffer = [0; 4096];
                match read_until(stream, &mut buffer, until) {
                    Ok(Some(0)) | Err(_) => return Incoming::Closed,
                    Ok(Some(count)) => received.extend_from_slice(&buffer[..count]),
                    Ok(None) => return Incoming::Nothing,
                }
            },
            Self::Udp { socket, peer, first } => loop {
                let bytes = match first.take() {
                    Some(bytes) => bytes,
                    None => {
                        let left = until.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
                        let mut buffer = [0; 65536];
                        let received = socket.set_read_timeout(Some(left)).and_then(|()| socket.recv_from(&mut buffer));
                        match received {
                            Ok((count, from)) if from == *peer => buffer[..count].to_vec(),
                            // another client; it is served later, if it tries again
                            Ok(_) if Instant::now() < until => continue,
                            _ => return Incoming::Nothing,
                        }
                    }
                };
                return match Decoder::UDP.decode_datagram(&bytes) {
                    Ok(_) => Incoming::Frame(bytes),
                    Err(error) => Incoming::Invalid(error.to_string()),
                };
            },
        }
    }
}
