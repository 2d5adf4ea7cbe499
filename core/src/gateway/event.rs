//! What a gateway reports: for logs, and for whoever must be told.

use core::fmt;
use core::time::Duration;

use super::link::RobotError;
use super::rules::Refusal;
use crate::handler::PeerId;
use crate::hresult::HResult;
use crate::rac::{Request, Variable, Verb};

/// What a request asks for, without its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Asked {
    /// To read, or to write.
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

/// What has happened; [`Gateway::line`](super::Gateway::line) views the line of the first three until the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Event {
    /// The robot has carried a request out.
    Served {
        /// Who asked.
        peer: PeerId,
        /// For what.
        request: Asked,
        /// What was answered: a success.
        result: HResult,
        /// How long it took, from the end of the line to the answer.
        time: Duration,
    },
    /// A request has failed: the robot refused it, did not answer, or was away.
    Failed {
        /// Who asked.
        peer: PeerId,
        /// For what.
        request: Asked,
        /// What was answered: an error.
        result: HResult,
        /// How long it took.
        time: Duration,
    },
    /// A line was refused here, and answered with the refusal's code.
    Refused {
        /// Who sent it.
        peer: PeerId,
        /// Why.
        refusal: Refusal,
    },
    /// A session with the robot has begun.
    RobotUp,
    /// There is no session with the robot any more, or none could be begun.
    RobotDown {
        /// Why.
        error: RobotError,
        /// The pause until it is tried again.
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

    /// Returns the client that it is about.
    #[must_use]
    pub const fn peer(&self) -> Option<PeerId> {
        match self {
            Self::Served { peer, .. } | Self::Failed { peer, .. } | Self::Refused { peer, .. } => Some(*peer),
            Self::RobotUp | Self::RobotDown { .. } => None,
        }
    }
}
