//! Streams of Slave Mode over sockets: the core's [`Engine`] with a clock, connections and a trajectory.
//!
//! ```text
//!   Trajectory ──pose──► Engine ──call──► motion connection ─────────────────────────► controller
//!       ▲                  │  └──call──► watch connection: what the controller says after an error
//!       └──where, answer───┘ waits for times, not for durations: a late cycle does not shift the next
//! ```
//!
//! [`blocking::Stream`] blocks its thread, `asynch::Stream` (feature `tokio`) is awaited; both do the same. A stream ends in
//! one of four ways, and in all but the last the robot slows down before it stands:
//!
//! * the trajectory says [`Next::Finish`]: the last pose is repeated until the robot stands, Slave Mode is left, the arm
//!   given back;
//! * it says [`Next::Stop`]: the same after a ramp along the present direction, within the limits;
//! * it gives a pose that may not be sent: the same ramp, then [`StreamError::Pose`];
//! * a call fails: Slave Mode is off, the controller was asked for its first error over the watch connection, and
//!   [`StreamError::Fault`] tells. Nothing moves again before [`recover`](blocking::Stream::recover), which refuses after
//!   an emergency stop.
//!
//! How well it ran is in [`Stats`](bcap_core::bcap::slave::Stats): counters and two histograms in fixed memory. [`Realtime`] asks Linux for what a
//! stream needs on a busy machine.

#[cfg(feature = "tokio")]
pub mod asynch;
pub mod blocking;
mod realtime;

pub use bcap_core::bcap::slave::{Cycle, Next, Trajectory};
use bcap_core::bcap::slave::{Engine, Fault, PoseError};
use bcap_core::time::Instant;

pub use self::realtime::{Realtime, RealtimeError};

/// The option of Service_Start: a sign of life every 400 ms of a call that takes long, as the vendor's samples have it.
const SERVICE: &str = "WDT=400";
/// The machine of Controller_Connect: the controller itself.
const MACHINE: &str = "localhost";
/// The name of the robot: controllers take any, the vendor's samples use this.
const ROBOT: &str = "Arm0";

/// Why a stream has not gone to its end.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// A call has failed; Slave Mode was left if that was possible.
    #[error(transparent)]
    Fault(Box<Fault>),
    /// The trajectory gave a pose that may not be sent; the robot was stopped in an orderly way and the arm given back.
    #[error("pose {number}: {error}")]
    Pose {
        /// Poses that were given before it.
        number: u32,
        /// What is wrong with it.
        error: PoseError,
    },
}

impl StreamError {
    /// Returns the fault of the controller or the connection, if that is the reason.
    #[must_use]
    pub fn fault(&self) -> Option<&Fault> {
        match self {
            Self::Fault(fault) => Some(fault),
            Self::Pose { .. } => None,
        }
    }
}

/// A run of a trajectory: what has been given so far, and what was wrong with it.
#[derive(Debug, Default)]
struct Run {
    given: u32,
    refused: Option<StreamError>,
}

impl Run {
    /// Asks the trajectory for the next pose and gives it to the engine.
    fn pose<const N: usize>(
        &mut self,
        engine: &mut Engine<N>,
        trajectory: &mut impl Trajectory,
        due: Instant,
        now: Instant,
    ) {
        match engine.supply(trajectory, self.given, due, now) {
            Ok(()) => self.given = self.given.saturating_add(1),
            Err(error) => {
                tracing::warn!(number = self.given, %error, "a pose is refused, the stream stops");
                self.refused = Some(StreamError::Pose { number: self.given, error });
            }
        }
    }

    fn finished(self) -> Result<(), StreamError> {
        self.refused.map_or(Ok(()), Err)
    }
}

/// Returns why an engine is faulted.
fn fault<const N: usize>(engine: &Engine<N>) -> Result<(), StreamError> {
    // a faulted engine has a fault
    engine.fault().cloned().map_or(Ok(()), |fault| Err(StreamError::Fault(Box::new(fault))))
}
