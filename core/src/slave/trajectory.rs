//! Where the poses of a stream come from.

use core::time::Duration;

use super::engine::Engine;
use super::limits::PoseError;
use super::pose::Pose;
use super::reply::MoveReply;
use super::stats::Stats;
use crate::time::Instant;

/// What a trajectory wants next.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Next {
    /// The robot shall be here one cycle after the last pose.
    Pose(Pose),
    /// The last pose is the end: the robot stands there, then the stream ends.
    Finish,
    /// The robot slows down along its present direction and stands, then the stream ends.
    Stop,
}

/// The cycle for which a pose is wanted.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Cycle<'a> {
    /// Poses that were given before, so 0 is the first.
    pub number: u32,
    /// When it is sent; a pose that is found later makes the cycle late.
    pub due: Instant,
    /// Where the stream began.
    pub start: &'a Pose,
    /// The last pose that was given; before the first one the start.
    pub last: &'a Pose,
    /// How long the controller's buffer lasts, by this side's reckoning; `None` in mode 1.
    pub margin: Option<Duration>,
    /// The figures so far.
    pub stats: &'a Stats,
}

/// Where the poses of a stream come from.
///
/// It is asked once a cycle and shall answer at once: no files, no locks that others hold for long. A closure that takes
/// a [`Cycle`] and returns a [`Next`] is one.
pub trait Trajectory {
    /// Gives the next pose, or ends the stream.
    fn next(&mut self, cycle: &Cycle<'_>) -> Next;

    /// Sees what the controller has answered to a pose.
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
    /// Answers [`Action::Pose`](super::Action::Pose) with what a trajectory wants: a pose, the end, or a stop. `number` counts
    /// the poses that were given before.
    ///
    /// # Errors
    ///
    /// When the pose may not be sent; the stream then [stops](Self::stop).
    pub fn supply(
        &mut self,
        trajectory: &mut (impl Trajectory + ?Sized),
        number: u32,
        due: Instant,
        now: Instant,
    ) -> Result<(), PoseError> {
        let last = self.last_pose();
        let start = self.start_pose().unwrap_or(last);
        let cycle = Cycle { number, due, start, last, margin: self.margin(now), stats: self.stats() };
        match trajectory.next(&cycle) {
            Next::Finish => self.finish(),
            Next::Stop => self.stop(),
            Next::Pose(pose) => return self.push(&pose).inspect_err(|_| self.stop()),
        }
        Ok(())
    }
}
