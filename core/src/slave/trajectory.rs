//! Trajectories, which supply the poses of a stream.

use core::time::Duration;

use super::command::Outputs;
use super::engine::Engine;
use super::limits::PoseError;
use super::pose::Pose;
use super::reply::MoveReply;
use super::stats::Stats;
use crate::time::Instant;

/// The next element of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Next {
    /// The position of the robot one cycle after the last pose.
    Pose(Pose),
    /// The end: the robot rests at the last pose, then the stream ends.
    Finish,
    /// An early end: the robot slows down along its current direction, then the stream ends.
    Stop,
}

/// The cycle for which the engine needs a pose.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Cycle<'a> {
    /// The number of the pose, counted from 0.
    pub number: u32,
    /// The deadline of the pose; a later pose makes the cycle late.
    pub deadline: Instant,
    /// The start of the stream.
    pub start: &'a Pose,
    /// The last pose; for the first cycle, the start.
    pub last: &'a Pose,
    /// An estimate of how long the controller's buffer lasts; `None` in mode 1.
    pub margin: Option<Duration>,
    /// The statistics so far.
    pub stats: &'a Stats,
}

/// A source of poses for a stream.
///
/// It is called once per cycle and must return quickly: no file access, no lock that other threads hold for long. Closures
/// from [`Cycle`] to [`Next`] implement it.
pub trait Trajectory {
    /// Returns the next pose, or ends the stream.
    fn next(&mut self, cycle: &Cycle<'_>) -> Next;

    /// Returns the outputs that are sent with the pose that [`next`](Self::next) has just returned, and with those after it;
    /// `None` leaves them as they are. Those that the format does not send are ignored.
    fn outputs(&mut self) -> Option<Outputs<'_>> {
        None
    }

    /// Called with the controller's reply to a pose.
    fn moved(&mut self, reply: &MoveReply<'_>, now: Instant) {
        let _ = (reply, now);
    }
}

impl<F: FnMut(&Cycle<'_>) -> Next> Trajectory for F {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        self(cycle)
    }
}

impl<const N: usize> Engine<N> {
    /// Handles [`EngineAction::Pose`](super::EngineAction::Pose) with the next element of a trajectory: pushes a pose with its
    /// outputs, or ends the stream. `number` is the number of poses before it.
    ///
    /// # Errors
    ///
    /// When the pose is invalid or exceeds the limits, or the user IO has another length than the format's; the stream then
    /// [stops](Self::stop).
    pub fn supply(
        &mut self,
        trajectory: &mut (impl Trajectory + ?Sized),
        number: u32,
        deadline: Instant,
        now: Instant,
    ) -> Result<(), PoseError> {
        let last = self.last_pose();
        let start = self.start_pose().unwrap_or(last);
        let cycle = Cycle { number, deadline, start, last, margin: self.margin(now), stats: self.stats() };
        match trajectory.next(&cycle) {
            Next::Finish => self.finish(),
            Next::Stop => self.stop(),
            Next::Pose(pose) => return self.supply_pose(trajectory, &pose).inspect_err(|_| self.stop()),
        }
        Ok(())
    }

    fn supply_pose(&mut self, trajectory: &mut (impl Trajectory + ?Sized), pose: &Pose) -> Result<(), PoseError> {
        self.push(pose)?;
        if let Some(outputs) = trajectory.outputs() {
            self.set_outputs(outputs)?;
        }
        Ok(())
    }
}
