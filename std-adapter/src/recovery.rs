//! The recovery of a robot after a lost session.

use std::fmt;

use bcap_core::procedure::{ArmOwner, Reclaimed};

/// The recovery of the robot after a lost session, over the next connection.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Recovery {
    /// Whether the robot was halted; `None` if another client uses it, or the lost session had not begun a motion.
    pub halted: Option<bool>,
    /// Whether the motor was switched off; `None` if another client uses the robot, or the lost session had not switched it on.
    pub motor_off: Option<bool>,
    /// Whether the arm was found free. Otherwise another client owns it, or the controller has not yet detected the lost
    /// connection.
    pub arm_free: bool,
}

impl Recovery {
    /// Returns whether all effects of the lost session are verified to have ended.
    pub(crate) fn is_complete(&self) -> bool {
        self.halted != Some(false) && self.motor_off != Some(false) && self.arm_free
    }

    /// Adds the results of a further attempt.
    pub(crate) fn add(&mut self, reclaimed: Reclaimed) {
        let either =
            |before: Option<bool>, now: Option<bool>| if before == Some(true) { before } else { now.or(before) };
        self.halted = either(self.halted, reclaimed.halted);
        self.motor_off = either(self.motor_off, reclaimed.motor_off);
        self.arm_free |= reclaimed.owner == ArmOwner::Free;
    }
}

/// Writes what was done, and what was not.
impl fmt::Display for Recovery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let done = |done: Option<bool>| match done {
            Some(true) => "",
            Some(false) => "NOT ",
            None => "not asked to be ",
        };
        let arm = if self.arm_free { "is free" } else { "was not seen to be free" };
        let (halted, off) = (done(self.halted), done(self.motor_off));
        write!(f, "the robot was {halted}halted, the motor was {off}switched off, and the arm {arm}")
    }
}
