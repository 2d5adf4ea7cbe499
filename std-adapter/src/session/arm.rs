//! The state of the arm in a session, the calls that change it, and the recovery after a lost session.

use bcap_core::bcap::{Effect, FunctionId};
use bcap_core::variant::Variant;

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

/// The effect of a call on the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ArmEffect {
    Take,
    Give,
    Motor(bool),
    SlaveMode(bool),
    /// It may start a motion.
    Moves,
}

impl ArmEffect {
    /// Returns the effect of a call of the controller or the robot; `command` and `parameter` are the arguments of an
    /// Execute function.
    pub(super) fn of(function: FunctionId, command: &str, parameter: Variant<'_>) -> Option<Self> {
        match (function, &*command.to_ascii_lowercase()) {
            (FunctionId::ROBOT_EXECUTE, "takearm") => Some(Self::Take),
            (FunctionId::ROBOT_EXECUTE, "givearm") => Some(Self::Give),
            (FunctionId::ROBOT_EXECUTE | FunctionId::CONTROLLER_EXECUTE, "motor") => {
                Some(Self::Motor(first_number(parameter) != Some(0)))
            }
            (FunctionId::ROBOT_EXECUTE, "slvchangemode") => Some(Self::SlaveMode(first_number(parameter) != Some(0))),
            (FunctionId::ROBOT_EXECUTE, _) => {
                let effect = function.properties(Some(command), None).effect;
                (effect == Effect::Moves).then_some(Self::Moves)
            }
            (
                FunctionId::ROBOT_MOVE | FunctionId::ROBOT_DRIVE | FunctionId::ROBOT_ROTATE | FunctionId::ROBOT_GO_HOME,
                _,
            ) => Some(Self::Moves),
            _ => None,
        }
    }
}

impl ArmState {
    /// Records a call before it is sent, so that its effect is undone even if the call is abandoned or has no reply.
    pub(super) const fn begin(&mut self, effect: ArmEffect) {
        match effect {
            ArmEffect::Motor(true) => self.motor = true,
            ArmEffect::SlaveMode(true) => self.streaming = true,
            ArmEffect::Moves => self.moving = true,
            ArmEffect::Take | ArmEffect::Give | ArmEffect::Motor(false) | ArmEffect::SlaveMode(false) => {}
        }
    }

    /// Records a call that succeeded.
    pub(super) const fn succeed(&mut self, effect: ArmEffect) {
        match effect {
            ArmEffect::Motor(on) => self.motor = on,
            ArmEffect::SlaveMode(on) => self.streaming = on,
            ArmEffect::Take | ArmEffect::Give | ArmEffect::Moves => {}
        }
    }
}

/// Returns the first number of a parameter: `1`, or `1` of `[1, 0]`.
fn first_number(parameter: Variant<'_>) -> Option<i32> {
    let first = parameter.as_array().map_or(Some(parameter), |array| array.iter().next());
    first.and_then(|number| number.as_i32())
}
