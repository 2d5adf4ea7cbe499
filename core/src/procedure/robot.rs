//! Preparing a robot for motion.

use core::convert::identity;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::sequence::{Argument, NextStep, Sequence, StepCall, Steps, Undo};
use crate::bcap::call::RobotHandle;
use crate::bcap::{Frame, FunctionId};
use crate::time::Instant;

/// Takes the arm and, if wanted, switches the motor on; the reply to that arrives when the motor is on.
///
/// `arm` is the parameter of TakeArm: the arm group and Keep, where 0 resets speed, tool and work, and 1 keeps them. On
/// a failure the arm is given back, even when the reply to TakeArm was lost, and a motor that may be on is switched off.
///
/// # Cancel safety
///
/// When a run is dropped, the arm may stay taken. Run the procedure again, and it gives the arm back; or run
/// [`give_arm`].
pub fn prepare_robot(
    robot: RobotHandle,
    arm: [i32; 2],
    motor: bool,
) -> impl Procedure<Output = (), Error = StepError> + use<> {
    Sequence::new(PrepareSteps { robot, arm, motor, step: Step::TakeArm }, identity)
}

/// Gives the arm back.
pub fn give_arm(robot: RobotHandle) -> impl Procedure<Output = (), Error = StepError> + use<> {
    Sequence::new(PrepareSteps { robot, arm: [0, 0], motor: false, step: Step::GiveArm }, identity)
}

struct PrepareSteps {
    robot: RobotHandle,
    arm: [i32; 2],
    motor: bool,
    step: Step,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    TakeArm,
    Motor,
    GiveArm,
    End,
}

/// The parameter of Motor: on, and reply when the motor is on.
pub(super) const MOTOR_ON: [i32; 2] = [1, 0];

impl Steps for PrepareSteps {
    type Output = ();
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> NextStep<'_> {
        let execute = StepCall::new(FunctionId::ROBOT_EXECUTE).with(self.robot.0);
        NextStep::Call(match self.step {
            Step::TakeArm => execute.with("TakeArm").with(Argument::Value(&self.arm)),
            Step::Motor => execute.with("Motor").with(Argument::Value(&MOTOR_ON)),
            Step::GiveArm => execute.with("GiveArm").with(Argument::Empty),
            Step::End => return NextStep::End,
        })
    }

    fn succeeded(&mut self, _reply: &Frame<'_>, _now: Instant) -> Result<(), StepCause> {
        self.step = match self.step {
            Step::TakeArm if self.motor => Step::Motor,
            _ => Step::End,
        };
        Ok(())
    }

    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        // without a reply it may have been executed
        match self.step {
            Step::TakeArm if cause.is_none_or(StepCause::may_have_run) => Some(Undo::GiveArm(self.robot.0)),
            Step::Motor if cause.is_some_and(StepCause::may_have_run) => Some(Undo::MotorOff(self.robot.0)),
            _ => None,
        }
    }

    fn output(&mut self) {}
}
