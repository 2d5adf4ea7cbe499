//! The state of the arm in a session, the calls that change it, and the recovery after a lost session.

use std::time::Duration;

use bcap_core::bcap::{Effect, FunctionId};
use bcap_core::procedure::{Claim, Effects, Target};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

/// The maximum time in which a controller detects that a link has become silent. Until then the lost session counts as the
/// owner of the arm.
pub(super) const UNNOTICED: Duration = Duration::from_secs(10);

/// The effects of a session on the robot.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ArmState {
    /// Whether the arm may have been taken here.
    pub(super) taken: bool,
    /// Whether it was given back without an answer, so that it may still be taken.
    pub(super) unanswered: bool,
    /// Whether the motor may have been switched on here.
    pub(super) motor: bool,
    /// Whether a motion may be in progress.
    pub(crate) moving: bool,
    /// Where that motion ends, if it is the only one since the robot was at rest.
    pub(super) destination: Option<Target>,
    /// Whether Slave Mode may be on.
    pub(super) streaming: bool,
}

/// Identifies the arm from one TakeArm of a session to the next.
#[cfg(feature = "tokio")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ArmId {
    pub(super) session: u64,
    pub(super) take: u64,
}

/// The effects that a lost session may have left on the robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Left {
    pub(super) arm: ArmState,
    /// Since when the link was silent.
    pub(super) since: Instant,
    /// Whether the controller has closed the connection, so that it has ended the session.
    pub(super) is_closed: bool,
    /// Whether the session lasts until its service is stopped, because datagrams have no connection.
    pub(super) is_datagram: bool,
}

impl Left {
    /// Returns the effects, and whether the controller still gives the arm to the lost session.
    pub(super) fn effects(&self, now: Instant) -> Effects {
        let ArmState { taken, motor, moving, streaming, destination, .. } = self.arm;
        let is_recent = now.saturating_since(self.since) < UNNOTICED;
        // a session without the arm has left the motor on only, and another client may use the robot
        let claim = match (self.is_closed || !taken, is_recent) {
            (true, _) => Claim::Unknown,
            (false, true) => Claim::Lost,
            // the service of a session over datagrams is stopped before TakeArm
            (false, false) if self.is_datagram => Claim::Unknown,
            (false, false) => Claim::Silent,
        };
        Effects { moving, destination, streaming, motor, claim }
    }
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
    /// Returns whether the end of the session has something to undo.
    pub(crate) const fn is_used(&self) -> bool {
        self.taken || self.motor
    }

    /// Returns the effects that do not end with the arm.
    pub(super) fn without_arm(self) -> Self {
        Self { motor: self.motor, ..Self::default() }
    }

    /// Records a call before it is sent, so that its effect is undone even if the call is abandoned or has no reply.
    pub(super) const fn begin(&mut self, effect: ArmEffect) {
        match effect {
            ArmEffect::Motor(true) => self.motor = true,
            ArmEffect::SlaveMode(true) => self.streaming = true,
            ArmEffect::Moves => (self.moving, self.destination) = (true, None),
            ArmEffect::Take => self.taken = true,
            ArmEffect::Give | ArmEffect::Motor(false) | ArmEffect::SlaveMode(false) => {}
        }
    }

    /// Records a call that succeeded.
    pub(super) fn succeed(&mut self, effect: ArmEffect) {
        match effect {
            ArmEffect::Motor(on) => self.motor = on,
            ArmEffect::SlaveMode(on) => self.streaming = on,
            ArmEffect::Give => *self = self.without_arm(),
            ArmEffect::Take => self.unanswered = false,
            ArmEffect::Moves => {}
        }
    }
}

/// Returns the first number of a parameter: `1`, or `1` of `[1, 0]`.
fn first_number(parameter: Variant<'_>) -> Option<i32> {
    let first = parameter.as_array().map_or(Some(parameter), |array| array.iter().next());
    first.and_then(|number| number.as_i32())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_owner_of_the_arm_follows_from_the_loss() {
        let arm = ArmState { taken: true, moving: true, ..ArmState::default() };
        let lost = |is_closed, is_datagram, seconds: u64| {
            let left = Left { arm, since: Instant::ZERO, is_closed, is_datagram };
            left.effects(Instant::from_millis(seconds * 1000)).claim
        };
        for is_datagram in [false, true] {
            assert_eq!(lost(false, is_datagram, 9), Claim::Lost);
            // the controller has ended the session
            assert_eq!((lost(true, is_datagram, 0), lost(true, is_datagram, 11)), (Claim::Unknown, Claim::Unknown));
        }
        assert_eq!((lost(false, false, 11), lost(false, true, 11)), (Claim::Silent, Claim::Unknown));
    }
}
