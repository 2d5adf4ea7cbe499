//! The connections of a recording, and the messages of the thread to the command.

use std::net::SocketAddr;

/// The ends of a TCP connection, or of the datagrams between two ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Ends {
    pub(crate) is_tcp: bool,
    pub(crate) client: SocketAddr,
    pub(crate) server: SocketAddr,
}

/// A message of the thread to the command.
#[derive(Debug)]
pub(crate) enum Recorded<'a> {
    /// A packet that begins with its IP header, at nanoseconds since 1970.
    Packet { at: u64, bytes: &'a [u8] },
    /// The end of a connection.
    Closed(Ends),
    /// A remark on a connection.
    Note { at: u64, ends: Ends, text: &'a str },
}
