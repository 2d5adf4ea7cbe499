//! A stream of Slave Mode as a procedure: an engine with the trajectory that supplies its poses.

use core::fmt;

use super::call::Step;
use super::engine::{Engine, EngineAction};
use super::fault::Cause;
use super::limits::PoseError;
use super::trajectory::{Next, Trajectory};
use super::{Cycle, MOVE_FRAME};
use crate::bcap::call::Call;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link};
use crate::hresult::HResult;
use crate::procedure::{self, Failure, Procedure};
use crate::time::Instant;

/// One run of an [`Engine`], made by [`Engine::stream`]: starts Slave Mode, streams a trajectory, leaves Slave Mode, switches
/// the motor off, and gives the arm back.
///
/// It ends in one of four ways. In all but the last the robot stops within the limits:
///
/// * The trajectory returns [`Next::Finish`]: the engine repeats the last pose until the robot is at rest, leaves Slave
///   Mode, and releases the motor and the arm.
/// * The trajectory returns [`Next::Stop`]: the same after a ramp along the current direction.
/// * The trajectory returns a pose that is invalid or exceeds the limits: the same ramp, then [`StreamError::Pose`].
/// * A call fails: the engine has left Slave Mode, if it could, and has read the first error from the controller.
///   [`StreamError::Fault`] names the call; [`Engine::fault`] returns the details, and whether Slave Mode is off. The arm is
///   still taken: call [`Engine::recover`] and run a new stream, or run [`give_up`](Engine::give_up).
///
/// # Cancel safety
///
/// When the future that runs a stream is dropped, no more poses are sent, and an error of the controller stops a robot in
/// motion. If the stream is run again, it diagnoses the controller and ends with a fault. To end a stream early, return
/// [`Next::Stop`] from the trajectory.
#[derive(Debug)]
pub struct Stream<'e, T: ?Sized, const N: usize = MOVE_FRAME> {
    engine: &'e mut Engine<N>,
    /// Without one, the stream stops.
    trajectory: Option<&'e mut T>,
    /// The number of poses that the trajectory has supplied.
    supplied: u32,
    refused: Option<StreamError>,
}

/// Why a stream failed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StreamError {
    /// A call failed; [`Engine::fault`] returns the details.
    Fault {
        /// The call.
        step: Step,
        /// Why it failed.
        cause: Cause,
        /// The controller's first error, or the code with which it refused the call.
        code: Option<HResult>,
    },
    /// The trajectory returned an invalid pose, or one that exceeds the limits; the robot was stopped in an orderly way, and
    /// the arm was given back.
    Pose {
        /// The number of the pose, counted from 0.
        number: u32,
        /// Why it was refused.
        error: PoseError,
    },
}

impl fmt::Display for StreamError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fault { step, cause, code } => {
                write!(f, "{}: {cause}", step.name())?;
                match (cause, code) {
                    (Cause::Refused(refused), Some(code)) if refused == code => Ok(()),
                    (_, Some(code)) => write!(f, "; the controller's first error is {code}"),
                    (_, None) => Ok(()),
                }
            }
            Self::Pose { number, error } => write!(f, "pose {number}: {error}"),
        }
    }
}

impl core::error::Error for StreamError {}

impl<const N: usize> Engine<N> {
    /// Creates a [`Procedure`] that streams a trajectory, for the loops of [`io`](crate::io).
    pub const fn stream<'e, T: Trajectory + ?Sized>(&'e mut self, trajectory: &'e mut T) -> Stream<'e, T, N> {
        Stream { engine: self, trajectory: Some(trajectory), supplied: 0, refused: None }
    }

    /// Creates a [`Procedure`] that ends the effects of the stream after a fault: Slave Mode, a motion, the motor and the arm.
    ///
    /// It fails with the fault again if a call of the end fails; [`effects`](Engine::effects) returns the remaining ones.
    pub fn give_up(&mut self) -> Stream<'_, fn(&Cycle<'_>) -> Next, N> {
        self.stop();
        Stream { engine: self, trajectory: None, supplied: 0, refused: None }
    }
}

impl<T: Trajectory + ?Sized, const N: usize> Stream<'_, T, N> {
    /// Passes the next pose of the trajectory to the engine.
    fn supply(&mut self, deadline: Instant, now: Instant) {
        let Some(trajectory) = &mut self.trajectory else { return self.engine.stop() };
        match self.engine.supply(*trajectory, self.supplied, deadline, now) {
            Ok(()) => self.supplied = self.supplied.saturating_add(1),
            Err(error) => self.refused = Some(StreamError::Pose { number: self.supplied, error }),
        }
    }
}

impl<T: Trajectory + ?Sized, const N: usize> Procedure for Stream<'_, T, N> {
    type Output = ();
    type Error = StreamError;

    fn poll(&mut self, now: Instant) -> procedure::Action<Result<(), StreamError>> {
        loop {
            return match self.engine.poll(now) {
                EngineAction::Call(_, channel) => procedure::Action::Call(channel),
                EngineAction::Wait(at) => procedure::Action::Wait(at),
                EngineAction::Finished => procedure::Action::Done(self.refused.take().map_or(Ok(()), Err)),
                EngineAction::Faulted => procedure::Action::Done(self.engine.fault().map_or(Ok(()), |fault| {
                    Err(StreamError::Fault { step: fault.step, cause: fault.cause, code: fault.code() })
                })),
                EngineAction::Pose { deadline } => {
                    self.supply(deadline, now);
                    continue;
                }
            };
        }
    }

    fn request(&self) -> Option<impl Call> {
        self.engine.request()
    }

    /// Returns short timeouts for slvMove on lossy links, as [`Engine::timing`] does.
    fn timing(&self, link: Link, usual: Timing) -> Timing {
        self.engine.timing(link, usual)
    }

    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant) {
        if let Some(moved) = self.engine.handle_reply(reply, now)
            && let Some(trajectory) = &mut self.trajectory
        {
            trajectory.moved(&moved, now);
        }
    }

    fn handle_failure(&mut self, failure: Failure, now: Instant) {
        self.engine.handle_failure(failure, now);
    }
}
