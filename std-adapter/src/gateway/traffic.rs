//! The bytes of a gateway, for a recording.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes that were moved on a connection of a gateway, or its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Traffic<'a> {
    /// Whether it is a TCP connection; otherwise the bytes are a datagram.
    pub is_tcp: bool,
    /// The address of the client: a PLC, or this gateway as the client of the robot.
    pub client: SocketAddr,
    /// The address of the server: this gateway, or the robot.
    pub server: SocketAddr,
    /// The event.
    pub moved: Moved<'a>,
}

/// An event on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Moved<'a> {
    /// The client has sent bytes.
    Request(&'a [u8]),
    /// The server has sent bytes.
    Reply(&'a [u8]),
    /// The connection has ended.
    Closed,
}

/// The ends of a connection: whether it is TCP, the client, the server.
pub(super) type Ends = (bool, SocketAddr, SocketAddr);

/// A function of the user.
type Show = Box<dyn FnMut(&Traffic<'_>) + Send>;

/// Receives all traffic, if the user of the driver wants it.
#[derive(Clone, Default)]
pub(super) struct TrafficTap(Option<Arc<Mutex<Show>>>);

impl TrafficTap {
    pub(super) fn new(show: impl FnMut(&Traffic<'_>) + Send + 'static) -> Self {
        Self(Some(Arc::new(Mutex::new(Box::new(show)))))
    }

    /// Shows an event on a connection; a socket without addresses has ended and shows nothing.
    pub(super) fn show(&self, ends: impl FnOnce() -> io::Result<Ends>, moved: Moved<'_>) {
        if let Some(tap) = &self.0
            && let Ok((is_tcp, client, server)) = ends()
        {
            let mut show = tap.lock().unwrap_or_else(PoisonError::into_inner);
            show(&Traffic { is_tcp, client, server, moved });
        }
    }
}

impl fmt::Debug for TrafficTap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Tap" } else { "no tap" })
    }
}
