//! What a gateway reports to its driver and for logs.

use core::fmt;
use core::time::Duration;

use super::link::RobotError;
use super::rules::Refusal;
use crate::handler::PeerId;
use crate::hresult::HResult;
use crate::rac::{Request, Variable, Verb};

/// A request without its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

/// What has happened. [`Gateway::line`](super::Gateway::line) views the line of the first three until the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Event {
    /// The robot has carried a request out.
    Served {
        /// The client.
        peer: PeerId,
        /// The request.
        request: Asked,
        /// The answer: a success.
        result: HResult,
        /// How long it took, from the end of the line to the answer.
        time: Duration,
    },
    /// A request has failed: the robot refused it, did not answer, or was disconnected.
    Failed {
        /// The client.
        peer: PeerId,
        /// The request.
        request: Asked,
        /// The answer: an error.
        result: HResult,
        /// How long it took.
        time: Duration,
    },
    /// The gateway refused a line, and answered with the code of the refusal.
    Refused {
        /// The client.
        peer: PeerId,
        /// The reason.
        refusal: Refusal,
    },
    /// A session with the robot has begun.
    RobotUp,
    /// The session with the robot has ended or could not begin.
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

    /// Returns the client of the event.
    #[must_use]
    pub const fn peer(&self) -> Option<PeerId> {
        match self {
            Self::Served { peer, .. } | Self::Failed { peer, .. } | Self::Refused { peer, .. } => Some(*peer),
            Self::RobotUp | Self::RobotDown { .. } => None,
        }
    }
}
