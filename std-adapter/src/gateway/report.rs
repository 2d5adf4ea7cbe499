//! The reports of a gateway to its log.

use std::io;
use std::net::SocketAddr;

use bcap_gateway::Event;

/// The event.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Report<'a> {
    /// A client has got a slot.
    Connected {
        /// The client's address.
        client: SocketAddr,
    },
    /// A client was not served.
    Denied {
        /// The client's address.
        client: SocketAddr,
        /// The reason.
        reason: Denial,
    },
    /// The connection of a client has ended.
    Disconnected {
        /// The client's address.
        client: SocketAddr,
        /// Why it ended; `None` when its task was dropped.
        ended: Option<Ended>,
    },
    /// A line was answered: served, failed or refused.
    Answered {
        /// The client's address.
        client: SocketAddr,
        /// The line, without its CR; of an over-long line the first 256 bytes. A request of Modbus becomes a line for each of its
        /// variables.
        line: &'a [u8],
        /// How it was answered.
        event: Event,
    },
    /// A session with the robot has begun or ended, or could not begin.
    Robot {
        /// Which of the two: [`Event::RobotUp`] or [`Event::RobotDown`].
        event: Event,
        /// The error of the network, when it is the reason.
        cause: Option<&'a io::Error>,
    },
}

/// Why a client was not served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Denial {
    /// The rules do not allow its address to connect. Its connection is reset.
    Address,
    /// No slot is free for it. Its first line is answered with E_MAX_CONNECT, its first request of Modbus with the exception
    /// "server device busy", and the connection is closed.
    Full,
}

/// Why the connection of a client ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Ended {
    /// The client has closed it.
    Closed,
    /// A line took too long to arrive.
    RequestTooSlow,
    /// The client was silent for too long.
    Idle,
    /// The client did not read its answers.
    ReplyNotRead,
    /// The client of Modbus sent bytes that are not Modbus TCP.
    NotModbus,
    /// Another client needed the slot.
    Evicted,
    /// The gateway stops.
    Stopped,
    /// The connection failed: the client or the network disappeared.
    Failed(io::ErrorKind),
}
