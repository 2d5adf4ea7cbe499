//! Errors of links to a peer.

use core::fmt;

/// Why a connection cannot be opened or can no longer be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum NetError {
    /// The board has no link or no address.
    Down,
    /// There is no route to the peer.
    NoRoute,
    /// The peer refused or closed the connection.
    Reset,
    /// The peer did not answer in time.
    Timeout,
    /// The datagram is larger than the socket's buffer.
    TooLarge,
    /// A serial line or another device failed.
    Line,
}

impl fmt::Display for NetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Down => "the network is down",
            Self::NoRoute => "there is no route to the peer",
            Self::Reset => "the peer refused or closed the connection",
            Self::Timeout => "the peer did not answer in time",
            Self::Line => "the serial line failed",
            Self::TooLarge => "the datagram does not fit into the socket's buffer",
        })
    }
}

impl core::error::Error for NetError {}
