//! How motions are waited for, and what is known of those that follow each other.

use core::time::Duration;

use crate::hresult::HResult;
use crate::time::Instant;

/// How [`move_and_wait`](super::move_and_wait) waits for a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotionConfig {
    /// The time limit, from the start of the motion; after it the robot is halted.
    pub limit: Duration,
    /// How long the robot may take to begin the motion. If it still rests after that, it is halted, so that it does not
    /// begin later.
    pub start: Duration,
    /// The pause between two polls of the robot.
    pub interval: Duration,
    /// How far each joint may be from the destination, in degrees or mm.
    pub tolerance: f64,
    /// The number of polls in a row with the robot at rest after which it counts as halted.
    pub still: u8,
}

impl MotionConfig {
    /// Returns a configuration with this time limit. It polls every 20 ms; the motion must begin within one second and end
    /// within 0.05 degrees of its destination, and five polls at rest count as a halt.
    #[must_use]
    pub const fn within(limit: Duration) -> Self {
        Self { limit, start: Duration::from_secs(1), interval: Duration::from_millis(20), tolerance: 0.05, still: 5 }
    }
}

/// How a motion has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[must_use]
pub enum Motion {
    /// The robot rests at its destination.
    Arrived,
    /// The robot rests, and the controller has no error, but it was not seen to reach its destination: another client
    /// halted it, or it did not begin to move.
    Halted,
    /// The controller has an error; this is the first one.
    Failed(HResult),
    /// The time limit has passed, and the robot was halted.
    TimedOut,
}

/// The joints of CurJnt and DestJnt.
pub(super) const JOINTS: usize = 8;
/// How far a joint at rest may be from where the rest began, in degrees or mm.
pub(super) const AT_REST: f64 = 0.002;

/// Motions that follow each other without a stop: what is known of them between two procedures.
///
/// [`run_queue`](super::run_queue) adds a motion, and waits for the last one.
#[derive(Clone, Copy, Debug)]
#[must_use = "the robot may move until the queue has ended"]
pub struct MotionQueue {
    pub(super) config: MotionConfig,
    /// When the time limit passes.
    pub(super) until: Instant,
    /// When a robot at rest must have begun to move.
    pub(super) start_until: Instant,
    /// Where the motion under way ends; `None` before the first one.
    pub(super) destination: Option<[f64; JOINTS]>,
    /// Whether SysState reports a motion.
    pub(super) reports_motion: bool,
    /// Where the robot was when it was first seen at rest.
    pub(super) rest: Option<[f64; JOINTS]>,
    /// Whether the robot has moved since the first poll.
    pub(super) moved: bool,
    /// Polls in a row with the robot at rest.
    pub(super) still: u8,
    pub(super) ended: Option<Motion>,
}

impl MotionQueue {
    /// Returns a queue without motions. The time limit begins with the first motion, and is that of all motions.
    pub const fn new(config: MotionConfig) -> Self {
        Self {
            config,
            until: Instant::FAR_FUTURE,
            start_until: Instant::FAR_FUTURE,
            destination: None,
            reports_motion: false,
            rest: None,
            moved: false,
            still: 0,
            ended: None,
        }
    }

    /// Returns how the motions have ended, after [`Until::Ended`](super::Until::Ended), or when the robot was stopped before.
    #[must_use]
    pub const fn ended(&self) -> Option<Motion> {
        self.ended
    }

    /// Tells whether there was no motion yet.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.until == Instant::FAR_FUTURE
    }

    /// Compares a position with the place where the robot was first seen at rest.
    pub(super) fn update_rest(&mut self, joints: &[f64; JOINTS], now: Instant) {
        // from where the rest began, not from the last poll, so that a slow motion adds up
        let rests = self.rest.map(|rest| within(joints, &rest, AT_REST));
        if rests == Some(true) {
            self.still = self.still.saturating_add(1);
            return;
        }
        (self.still, self.rest) = (0, Some(*joints));
        if rests == Some(false) {
            self.moved = true;
            self.start_until = now.saturating_add(self.config.start);
        }
    }

    /// Tells whether the robot counts as stopped, wherever it is.
    pub(super) fn is_stopped(&self, begins: bool) -> bool {
        // with shorter pauses, as many more polls
        let polls = self.config.still.max(1).saturating_mul(if begins { 4 } else { 1 });
        self.still >= polls && !self.reports_motion
    }

    /// Tells whether the robot is at the destination of the motion under way.
    pub(super) fn is_at_destination(&self, joints: &[f64; JOINTS]) -> bool {
        self.destination.is_some_and(|destination| within(joints, &destination, self.config.tolerance))
    }

    /// Begins to follow a motion to this destination.
    pub(super) const fn aim(&mut self, destination: [f64; JOINTS]) {
        (self.destination, self.rest, self.still) = (Some(destination), None, 0);
    }
}

/// Tells whether no joint is further away than this.
pub(super) fn within(joints: &[f64; JOINTS], other: &[f64; JOINTS], distance: f64) -> bool {
    joints.iter().zip(other).all(|(joint, other)| (joint - other).abs() <= distance)
}
