//! The state of the link to the robot, with an exponential backoff between attempts to connect.
//!
//! ```text
//!             opened              Service_Start, Controller_Connect
//!  Opening ───────────► Starting ───────────────────────────────────► Up
//!     ▲  │                 │                                           │
//!     │  │ closed          │ refused, timed out, malformed             │
//!     │  ▼                 ▼                                           │
//!    Down ◄──────────── Closing ◄──────────────────────────────────────┘
//!         closed
//! ```
//!
//! Down lasts for a pause that doubles with each attempt; a session resets it. In Closing the old connection is still open:
//! the gateway requests a new one after its caller has closed the old one.

use core::fmt;
use core::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::call::ControllerHandle;
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// The phase of the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Down { until: Instant },
    Opening,
    Starting,
    Up(ControllerHandle),
    Closing,
}

/// The state of the link to the robot, without its client.
#[derive(Debug)]
pub(super) struct LinkState {
    pub(super) phase: Phase,
    /// The pause after the next failure.
    pause: Duration,
    first_pause: Duration,
    longest_pause: Duration,
}

impl LinkState {
    pub(super) const fn new(first_pause: Duration, longest_pause: Duration) -> Self {
        Self { phase: Phase::Opening, pause: first_pause, first_pause, longest_pause }
    }

    /// Records that the session has begun.
    pub(super) const fn up(&mut self, controller: ControllerHandle) {
        self.phase = Phase::Up(controller);
        self.pause = self.first_pause;
    }

    /// Records a failure while the connection is open; the caller must close it.
    pub(super) const fn fail(&mut self) {
        self.phase = Phase::Closing;
    }

    /// Records that the connection is closed, or could not be opened.
    pub(super) fn closed(&mut self, now: Instant) {
        if !matches!(self.phase, Phase::Down { .. }) {
            self.phase = Phase::Down { until: now.saturating_add(self.pause()) };
            self.pause = self.pause().saturating_mul(2);
        }
    }

    /// Returns how long the link stays down after the next failure.
    pub(super) fn pause(&self) -> Duration {
        self.pause.min(self.longest_pause)
    }

    /// Ends the pause when it is over.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if let Phase::Down { until } = self.phase
            && now >= until
        {
            self.phase = Phase::Opening;
        }
    }

    pub(super) const fn controller(&self) -> Option<ControllerHandle> {
        match self.phase {
            Phase::Up(controller) => Some(controller),
            _ => None,
        }
    }
}

/// Why there is no session with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RobotError {
    /// The connection could not be opened, or was closed.
    Closed,
    /// The robot refused to begin a session, or the session no longer exists there.
    Refused {
        /// The refused function.
        function: FunctionId,
        /// The robot's result.
        result: HResult,
    },
    /// A call ended without a valid reply.
    Call(ClientError),
}

impl RobotError {
    /// Returns the result of the request in flight when the session failed.
    pub(super) const fn hresult(self) -> HResult {
        match self {
            Self::Call(ClientError::Timeout(Timeout::Attempt | Timeout::Deadline | Timeout::KeepAlive)) => {
                HResult::E_TIMEOUT
            }
            _ => HResult::E_NOT_CONNECTED,
        }
    }
}

impl fmt::Display for RobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => f.write_str("no connection"),
            Self::Refused { function, result } => write!(f, "{function} was refused with {result}"),
            Self::Call(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for RobotError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest_and_a_session_resets_them() {
        let ms = Duration::from_millis;
        let mut link = LinkState::new(ms(500), ms(3000));
        let mut now = Instant::from_millis(7);
        for pause in [500, 1000, 2000, 3000, 3000] {
            assert_eq!((link.phase, link.pause()), (Phase::Opening, ms(pause)));
            link.closed(now);
            let until = now + ms(pause);
            assert_eq!(link.phase, Phase::Down { until });
            link.closed(now + ms(1));
            assert_eq!(link.phase, Phase::Down { until }, "a second report counts once");
            link.handle_timeout(Instant::from_micros(until.as_micros() - 1));
            assert_eq!(link.phase, Phase::Down { until });
            link.handle_timeout(until);
            now = until;
        }
        link.up(ControllerHandle(3));
        assert_eq!(link.controller(), Some(ControllerHandle(3)));
        link.fail();
        assert_eq!(link.phase, Phase::Closing);
        link.handle_timeout(Instant::FAR_FUTURE);
        assert_eq!(link.phase, Phase::Closing, "the old connection is closed first");
        link.closed(now);
        assert_eq!(link.phase, Phase::Down { until: now + ms(500) });
    }
}
