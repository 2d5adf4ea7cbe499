//! The state of the arm in a session, and the recovery after a lost one.

/// The effects of a session on the arm that it has taken.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ArmState {
    /// Whether the motor may have been switched on here.
    pub(super) motor: bool,
    /// Whether a motion may be under way.
    pub(crate) moving: bool,
    /// Whether Slave Mode may be on.
    pub(super) streaming: bool,
}

/// The recovery of the arm of a lost session, over the next connection.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Recovery {
    /// Whether the robot was halted; `None` if the lost session had not begun a motion, and another client may own the arm.
    pub halted: Option<bool>,
    /// Whether the motor was switched off; `None` if the lost session had not switched it on.
    pub motor_off: Option<bool>,
    /// Whether no client owns the arm now. Otherwise another client owns it, or the controller has not noticed yet that the
    /// connection was lost.
    pub arm_free: bool,
}
