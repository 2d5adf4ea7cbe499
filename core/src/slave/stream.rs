//! A stream of Slave Mode as a procedure: an engine and the trajectory that its poses come from.

use core::fmt;

use super::engine::{Action, Engine};
use super::fault::Cause;
use super::limits::PoseError;
use super::request::Step;
use super::trajectory::{Next, Trajectory};
use super::{Cycle, MOVE_FRAME};
use crate::bcap::call::Call;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link};
use crate::hresult::HResult;
use crate::procedure::{self, Failure, Procedure};
use crate::time::Instant;

/// One run of an [`Engine`]: it starts Slave Mode, streams a trajectory, and leaves, until the robot stands and the arm is
/// given back.
///
/// Made by [`Engine::stream`]. It ends in one of four ways, and in all but the last the robot slows down before it stands:
///
/// * the trajectory returns [`Next::Finish`]: the last pose is repeated until the robot stands, Slave Mode is left, the
///   arm given back;
/// * it returns [`Next::Stop`]: the same after a ramp along the present direction, within the limits;
/// * it returns a pose that may not be sent: the same ramp, then [`StreamError::Pose`];
/// * a call fails: Slave Mode is off, the controller was asked for its first error, and [`StreamError::Fault`] says which
///   call failed; [`Engine::fault`] has the details. The arm is still taken: [`Engine::recover`] and run again, or
///   [`give_up`](Engine::give_up).
///
/// # Cancel safety
///
/// Dropping the future that runs a stream ends its poses, and a robot in motion stops by an error of the controller. A
/// stream that is run after that asks the controller what has happened and ends with a fault. To end early, let the
/// trajectory return [`Next::Stop`].
#[derive(Debug)]
pub struct Stream<'e, T: ?Sized, const N: usize = MOVE_FRAME> {
    engine: &'e mut Engine<N>,
    /// Without one, the stream stops.
    trajectory: Option<&'e mut T>,
    /// Poses that were given.
    given: u32,
    refused: Option<StreamError>,
}

/// Why a stream has not gone to its end.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StreamError {
    /// A call has failed; [`Engine::fault`] has all that is known.
    Fault {
        /// The call.
        step: Step,
        /// Why it failed.
        cause: Cause,
        /// The controller's first error, or the code with which it refused the call.
        code: Option<HResult>,
    },
    /// The trajectory gave a pose that may not be sent; the robot was stopped in an orderly way and the arm given back.
    Pose {
        /// Poses that were given before it.
        number: u32,
        /// What is wrong with it.
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
    /// Makes a run of this engine with a trajectory: a [`Procedure`] for the loops of [`io`](crate::io).
    pub const fn stream<'e, T: Trajectory + ?Sized>(&'e mut self, trajectory: &'e mut T) -> Stream<'e, T, N> {
        Stream { engine: self, trajectory: Some(trajectory), given: 0, refused: None }
    }

    /// Makes a run that gives the arm back after a fault, and does nothing else.
    pub fn give_up(&mut self) -> Stream<'_, fn(&Cycle<'_>) -> Next, N> {
        self.stop();
        Stream { engine: self, trajectory: None, given: 0, refused: None }
    }
}

impl<T: Trajectory + ?Sized, const N: usize> Stream<'_, T, N> {
    /// Gives the engine the next pose of the trajectory.
    fn supply(&mut self, due: Instant, now: Instant) {
        let Some(trajectory) = &mut self.trajectory else { return self.engine.stop() };
        match self.engine.supply(*trajectory, self.given, due, now) {
            Ok(()) => self.given = self.given.saturating_add(1),
            Err(error) => self.refused = Some(StreamError::Pose { number: self.given, error }),
        }
    }
}

impl<T: Trajectory + ?Sized, const N: usize> Procedure for Stream<'_, T, N> {
    type Output = ();
    type Error = StreamError;

    fn poll(&mut self, now: Instant) -> procedure::Action<Result<(), StreamError>> {
        loop {
            return match self.engine.poll(now) {
                Action::Call(_, channel) => procedure::Action::Call(channel),
                Action::Wait(at) => procedure::Action::Wait(at),
                Action::Finished => procedure::Action::Done(self.refused.take().map_or(Ok(()), Err)),
                Action::Faulted => procedure::Action::Done(self.engine.fault().map_or(Ok(()), |fault| {
                    Err(StreamError::Fault { step: fault.step, cause: fault.cause, code: fault.code() })
                })),
                Action::Pose { due } => {
                    self.supply(due, now);
                    continue;
                }
            };
        }
    }

    fn request(&self) -> Option<impl Call> {
        self.engine.request()
    }

    /// On links that lose frames, a slvMove is repeated soon: after two cycles in mode 2, whose answer may be withheld,
    /// and after one in the other modes.
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
