//! The connections of a recording, and the events that its thread reports.

use std::net::SocketAddr;

/// The ends of a TCP connection, or of the datagrams between two ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Ends {
    /// TCP, otherwise UDP.
    pub is_tcp: bool,
    /// The client's address.
    pub client: SocketAddr,
    /// The server's address.
    pub server: SocketAddr,
}

/// An event of a recording.
#[derive(Debug)]
pub enum Recorded<'a> {
    /// A packet that begins with its IP header, at nanoseconds since 1970.
    Packet {
        /// The time.
        at: u64,
        /// The packet.
        bytes: &'a [u8],
    },
    /// The end of a connection.
    Closed(Ends),
    /// A remark on a connection.
    Note {
        /// The time, in nanoseconds since 1970.
        at: u64,
        /// The connection.
        ends: Ends,
        /// The remark, for people.
        text: &'a str,
    },
}
