//! Reports of a gateway's driver, for a log.

use crate::Event;

/// An event of a gateway, for a log.
///
/// `A` is the address of a client, `C` the error of the link to the robot, `E` the error of the link to a client.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Report<'a, A, C, E> {
    /// A client connected and has a slot.
    Connected {
        /// The client's address.
        client: A,
    },
    /// A client was not served.
    Denied {
        /// The client's address.
        client: A,
        /// The reason.
        reason: Denial,
    },
    /// A client disconnected.
    Disconnected {
        /// The client's address.
        client: A,
        /// Why its session ended; `None` when its future was dropped.
        ended: Option<Ended<E>>,
    },
    /// A line was answered: served, failed or refused.
    Answered {
        /// The client's address.
        client: A,
        /// The line without its CR; the first 256 bytes of an over-long line. A request of Modbus becomes a line for each of
        /// its variables.
        line: &'a [u8],
        /// How the line was answered.
        event: Event,
    },
    /// The robot connected or disconnected, or could not be reached.
    Robot {
        /// [`Event::RobotUp`] or [`Event::RobotDown`].
        event: Event,
        /// The error that ended the connection or prevented it, if one did.
        cause: Option<&'a C>,
    },
}

/// Why a client was not served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Denial {
    /// The rules do not allow its address to connect. A listener that calls [`admits`](super::SharedGateway::admits) resets its
    /// connection; a serial line gets no answer.
    Address,
    /// All slots are in use, by clients that are not idle. Its first line is answered with E_MAX_CONNECT, its first request of
    /// Modbus with the exception "server device busy", and its connection is closed.
    Full,
}

/// Why the session of a client ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Ended<E> {
    /// The client closed the connection.
    Closed,
    /// A line took too long to arrive.
    RequestTooSlow,
    /// The client was idle for too long.
    Idle,
    /// The client did not read its answers.
    ReplyNotRead,
    /// The client of Modbus sent bytes that are not Modbus TCP.
    NotModbus,
    /// Another client got the slot.
    Evicted,
    /// The gateway stops.
    Stopped,
    /// The connection failed: the client or the network disappeared.
    Failed(E),
}

impl<E> Ended<E> {
    /// Converts the error of the link.
    pub fn map<F>(&self, convert: impl FnOnce(&E) -> F) -> Ended<F> {
        match self {
            Self::Failed(error) => Ended::Failed(convert(error)),
            Self::Closed => Ended::Closed,
            Self::RequestTooSlow => Ended::RequestTooSlow,
            Self::Idle => Ended::Idle,
            Self::ReplyNotRead => Ended::ReplyNotRead,
            Self::NotModbus => Ended::NotModbus,
            Self::Evicted => Ended::Evicted,
            Self::Stopped => Ended::Stopped,
        }
    }
}
