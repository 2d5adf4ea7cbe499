//! Waiting for motions, and the state of motions that follow each other.

use core::time::Duration;

use super::target::{Comparison, End, JOINTS, Tolerance};
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
    /// How far each joint may be from the end of the motion, in degrees or mm. A motion shorter than this counts as arrived
    /// only after the robot has moved, or `start` has passed.
    pub tolerance: f64,
    /// How far the tool may be from a position, in mm along each axis.
    pub distance_mm: f64,
    /// How far the tool may be turned from an orientation, in degrees.
    pub angle_degrees: f64,
    /// The number of polls in a row with the robot at rest after which it counts as halted.
    pub still: u8,
}

impl MotionConfig {
    /// Returns a configuration with this time limit. It polls every 20 ms; the motion must begin within one second and end
    /// within 0.05 degrees, or 0.1 mm and 0.05 degrees of the tool, and five polls at rest elsewhere count as a halt.
    #[must_use]
    pub const fn within(limit: Duration) -> Self {
        let (start, interval) = (Duration::from_secs(1), Duration::from_millis(20));
        Self { limit, start, interval, tolerance: 0.05, distance_mm: 0.1, angle_degrees: 0.05, still: 5 }
    }
}

impl MotionConfig {
    /// Returns how far the robot may be from the end of the motion.
    pub(super) const fn at_end(&self) -> Tolerance {
        Tolerance { joint: self.tolerance, distance_mm: self.distance_mm, angle_degrees: self.angle_degrees }
    }
}

/// The outcome of a motion.
///
/// # Examples
///
/// ```
/// use bcap_core::procedure::Motion;
///
/// /// Returns whether the next step of a program may begin.
/// fn goes_on(motion: Motion) -> bool {
///     match motion {
///         Motion::Arrived => true,
///         //  a person or another client stopped the robot, for a reason that is unknown to the program
///         Motion::Halted | Motion::TimedOut => false,
///         Motion::Failed(code) => {
///             eprintln!("the controller has the error {code}");
///             false
///         }
///         // read the position first
///         _ => false,
///     }
/// }
/// # assert!(goes_on(Motion::Arrived) && !goes_on(Motion::Unknown));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[must_use]
pub enum Motion {
    /// The robot rests where the motion ends.
    Arrived,
    /// The robot rests elsewhere, and the controller has no other error: it was halted, or did not begin to move within the
    /// time for that and was halted then. The halt leaves [`E_MOTION_STOPPED`](HResult::E_MOTION_STOPPED) on a controller,
    /// which refuses the next motion until ClearError.
    Halted,
    /// The robot rests, and whether that is the end of the motion is unknown: the end cannot be compared with a reading, and
    /// the motion was too short to be seen; or the tool or the work coordinates changed during it. Read the position before the
    /// next motion.
    Unknown,
    /// The controller has an error; this is the first error.
    Failed(HResult),
    /// The time limit has passed, and the robot was halted.
    TimedOut,
}

/// How far a joint at rest may be from where the rest began, in degrees or mm.
pub(super) const AT_REST: f64 = 0.002;

/// Motions that follow each other without a stop, and their known state between two procedures.
///
/// [`run_queue`](super::run_queue) adds a motion, and waits for the last motion.
#[derive(Clone, Copy, Debug)]
#[must_use = "the robot may move until the queue has ended"]
pub struct MotionQueue {
    pub(super) config: MotionConfig,
    /// When the time limit passes.
    pub(super) until: Instant,
    /// When a robot at rest must have begun to move.
    pub(super) start_until: Instant,
    /// Where the last motion ends.
    pub(super) end: End,
    /// Whether the motions may end where they begin, so that rest there is an end only after a movement.
    pub(super) is_loop: bool,
    /// Whether the last motion was not seen to begin yet.
    pub(super) begins: bool,
    /// Where the second-to-last motion ends, until the last motion is seen to begin.
    pub(super) previous: Option<[f64; JOINTS]>,
    /// Whether DestJnt may still be the destination of an earlier motion, which is unknown.
    pub(super) is_ambiguous: bool,
    /// The destination that one poll saw during the motion, and the destination on which two polls agreed.
    pub(super) glimpsed: Option<[f64; JOINTS]>,
    pub(super) destination: Option<[f64; JOINTS]>,
    /// Whether SysState reports a motion.
    pub(super) reports_motion: bool,
    /// Where the robot was when it was first seen at rest.
    pub(super) rest: Option<[f64; JOINTS]>,
    /// Whether the robot has moved since the first motion.
    pub(super) moved: bool,
    /// Polls in a row with the robot at rest.
    pub(super) still: u8,
    pub(super) ended: Option<Motion>,
}

/// Maximum time limit: it distinguishes a queue with motions from a new queue, even with `Duration::MAX`.
pub(super) const LATEST: Instant = Instant::from_micros(u64::MAX - 1);

impl MotionQueue {
    /// Returns a queue without motions. One time limit covers all motions; it starts with the first.
    pub const fn new(config: MotionConfig) -> Self {
        Self {
            config,
            until: Instant::FAR_FUTURE,
            start_until: Instant::FAR_FUTURE,
            end: End::Unknown,
            is_loop: false,
            begins: false,
            previous: None,
            is_ambiguous: false,
            glimpsed: None,
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

    /// Returns whether there was no motion yet. The time limit begins with the first motion.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.until == Instant::FAR_FUTURE
    }

    /// Compares a position with the place where the robot was first seen at rest.
    pub(super) fn update_rest(&mut self, joints: &[f64; JOINTS], now: Instant) {
        // measured from the start of the rest, not from the last poll, so that a slow motion adds up
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

    /// Records the destination of the running motion, which two polls must agree on. DestJnt counts only while the robot moves
    /// and is elsewhere: after a halt it may be the place where the robot rests.
    pub(super) fn update_destination(&mut self, seen: [f64; JOINTS], joints: &[f64; JOINTS]) {
        let is_new = self.previous.is_none_or(|previous| !within(&seen, &previous, AT_REST));
        if !is_new || !self.reports_motion || within(joints, &seen, self.config.tolerance) {
            return;
        }
        if self.glimpsed.is_some_and(|before| within(&seen, &before, AT_REST)) {
            (self.destination, self.begins) = (Some(seen), false);
        }
        self.glimpsed = Some(seen);
    }

    /// Returns how far the robot may be from the end of the motion. Until it has moved, or its time to begin has passed, it
    /// must be exactly there: a motion that is shorter than the tolerance may begin late.
    pub(super) fn tolerance(&self, now: Instant) -> Tolerance {
        let Tolerance { joint, distance_mm, angle_degrees } = self.config.at_end();
        let most = if self.moved || now >= self.start_until { f64::INFINITY } else { AT_REST };
        Tolerance { joint: joint.min(most), distance_mm: distance_mm.min(most), angle_degrees: angle_degrees.min(most) }
    }

    /// Returns whether DestJnt is needed.
    pub(super) fn needs_destination(&self) -> bool {
        self.destination.is_none() && (self.begins || !matches!(self.end, End::Joints(..)))
    }

    /// Returns whether enough polls saw the robot at rest, whatever SysState reports.
    pub(super) fn is_still(&self, begins: bool) -> bool {
        // with shorter pauses, as many more polls
        self.still >= self.config.still.max(1).saturating_mul(if begins { 4 } else { 1 })
    }

    /// Returns whether the robot counts as stopped, wherever it is.
    pub(super) fn is_stopped(&self, begins: bool) -> bool {
        self.is_still(begins) && !self.reports_motion
    }

    /// Returns whether these joints are the destination that was seen during the motion; `None` if none was seen.
    pub(super) fn is_at_destination(&self, joints: &[f64; JOINTS]) -> Option<bool> {
        let destination = self.destination.filter(|_| !self.is_ambiguous)?;
        Some(within(joints, &destination, self.config.tolerance))
    }

    /// Returns the outcome for a robot that has moved and rests somewhere else than its end.
    pub(super) fn outcome_elsewhere(&self, joints: &[f64; JOINTS], comparison: Comparison) -> Motion {
        match (self.end, self.is_at_destination(joints)) {
            (End::Joints(..), _) => Motion::Halted,
            // the controller carried the motion out, but the reading means something else now
            (End::Position(..) | End::Transform(_), Some(true)) => Motion::Unknown,
            (End::Position(..) | End::Transform(_), _) if comparison == Comparison::Turned => Motion::Unknown,
            (End::Unknown, None) => Motion::Unknown,
            _ => Motion::Halted,
        }
    }
}

/// Returns whether no joint is further away than this.
pub(super) fn within(joints: &[f64; JOINTS], other: &[f64; JOINTS], distance: f64) -> bool {
    joints.iter().zip(other).all(|(joint, other)| (joint - other).abs() <= distance)
}
