//! The events of a gateway, for logs and alarms.

use core::fmt;
use core::time::Duration;

use super::link::RobotError;
use super::rules::Refusal;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request, Variable, Verb};

/// The verb and the variable of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Asked {
    /// Read or write.
    pub verb: Verb,
    /// The variable.
    pub variable: Variable,
}

impl Asked {
    pub(super) const fn of(request: &Request<'_>) -> Self {
        Self { verb: request.verb(), variable: request.variable() }
    }
}

/// Writes `GET I[10]`.
impl fmt::Display for Asked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.verb, self.variable)
    }
}

/// An event of a gateway; [`Gateway::line`](crate::Gateway::line) views the line of the first three until the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
#[non_exhaustive]
pub enum Event {
    /// The robot executed a request.
    Served {
        /// The client.
        peer: PeerId,
        /// The request.
        request: Asked,
        /// The result in the reply: a success.
        result: HResult,
        /// The time from the end of the line to the reply.
        time: Duration,
    },
    /// A request failed: the robot refused it, did not reply, or was disconnected.
    Failed {
        /// The client.
        peer: PeerId,
        /// The request.
        request: Asked,
        /// The result in the reply: an error.
        result: HResult,
        /// The time from the end of the line to the reply.
        time: Duration,
    },
    /// The gateway refused a line, and replied with the refusal's code.
    Refused {
        /// The client.
        peer: PeerId,
        /// The reason.
        refusal: Refusal,
    },
    /// A session with the robot has begun.
    RobotUp,
    /// The session with the robot ended, or could not begin.
    RobotDown {
        /// The reason.
        error: RobotError,
        /// The pause before the next attempt.
        pause: Duration,
    },
}

impl Event {
    pub(super) const fn answered(peer: PeerId, request: Asked, result: HResult, time: Duration) -> Self {
        match result.is_ok() {
            true => Self::Served { peer, request, result, time },
            false => Self::Failed { peer, request, result, time },
        }
    }

    /// Returns the client that the event concerns.
    #[must_use]
    pub const fn peer(&self) -> Option<PeerId> {
        match self {
            Self::Served { peer, .. } | Self::Failed { peer, .. } | Self::Refused { peer, .. } => Some(*peer),
            Self::RobotUp | Self::RobotDown { .. } => None,
        }
    }
}
