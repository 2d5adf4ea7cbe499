//! Ending the effects of a session on a robot whose arm it does not own: of a lost session, or one that never took the arm.
//!
//! ```text
//!  slvGetMode ─► off ─► TakeArm ─► taken ──────────────► Robot_Halt ──► (Motor 0) ─► GiveArm
//!      │          │        ├─────► refused ────────────► (Robot_Halt) ─► (Motor 0)
//!      │          │        └─────► another owner: nothing, unless it may be the lost session
//!      │          │                └─► (DestJnt) ─► elsewhere: nothing
//!      │          │                        └──────► Robot_Halt ──► (Motor 0)
//!      │          └─► the lost session owns the arm ───► (Robot_Halt) ─► (Motor 0)
//!      ├─► a stream runs: nothing, unless it is the lost session's ─► slvChangeMode 0 ─► Robot_Halt ─► (Motor 0)
//!      └─► refused: a stream may run ──────────────────► (Robot_Halt)
//! ```
//!
//! The calls in brackets are made only if the session may have caused what they end.
//!
//! A TakeArm that is answered with E_TIMEOUT may still be executed, so GiveArm follows it. Calls are repeated while the
//! controller is busy with a call of the lost session.
//!
//! Only TakeArm reveals whether another client owns the arm; TakeArmState only reports whether the calling client does. A
//! refused TakeArm may leave an error on the controller, so it is not called while the lost session is known to own the arm.
//!
//! If the lost session may own the arm, and has begun a motion whose end is not known, then the robot is halted unless it heads
//! for another destination than that motion: if it is unclear which client moves the robot, the robot must not move.

use core::convert::identity;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::motion::joints;
use super::sequence::{Argument, MOTOR_OFF, NextStep, Sequence, StepCall, Steps, Undo};
use super::target::{Comparison, JOINTS, Target, Tolerance};
use crate::bcap::call::{Int, Reply, RobotHandle};
use crate::bcap::{Frame, FunctionId, Properties, StreamState};
use crate::hresult::HResult;
use crate::time::Instant;

/// The possible effects of a session on a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Effects {
    /// A motion may be running.
    pub moving: bool,
    /// Where that motion ends, if it is the only motion. Only joints distinguish it from another client's motion.
    pub destination: Option<Target>,
    /// A stream of Slave Mode may run.
    pub streaming: bool,
    /// The motor may have been switched on.
    pub motor: bool,
    /// The owner of the arm, as far as it is known.
    pub claim: Claim,
}

/// The owner of the arm before [`reclaim`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Claim {
    /// Unknown. If TakeArm is refused for another reason than another owner, no other client is known to use the robot.
    #[default]
    Unknown,
    /// The lost session: the controller has not detected the loss.
    Lost,
    /// The lost session, if the controller has not detected the loss, or another client since.
    Silent,
    /// Another client, according to an earlier TakeArm. Nothing is done unless the arm can be taken now.
    Other,
}

/// The effect of [`reclaim`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Reclaimed {
    /// The owner of the arm afterwards.
    pub owner: ArmOwner,
    /// Whether the robot was halted; `None` if no halt was tried.
    pub halted: Option<bool>,
    /// Whether the motor was switched off; `None` if that was not tried.
    pub motor_off: Option<bool>,
}

/// The owner of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ArmOwner {
    /// No client: the arm was taken and given back.
    Free,
    /// Another client or a task; nothing was changed.
    Other,
    /// Unknown: the lost session may still own it, or the controller did not say.
    Unknown,
}

/// Ends the effects of a session on a robot, as far as no other client uses the robot.
///
/// # Errors
///
/// Refusals are in the output. An error means that a call has no reply: the robot may still move.
///
/// # Cancel safety
///
/// When a run is dropped, the arm may stay taken. Run the procedure again, and it gives the arm back.
pub fn reclaim(robot: RobotHandle, effects: Effects) -> impl Procedure<Output = Reclaimed, Error = StepError> + use<> {
    let output = Reclaimed { owner: ArmOwner::Unknown, halted: None, motor_off: None };
    Sequence::new(ReclaimSteps { robot, effects, step: Step::Mode, taken: false, unsure: false, output }, identity)
}

struct ReclaimSteps {
    robot: RobotHandle,
    effects: Effects,
    step: Step,
    taken: bool,
    /// Whether the controller abandoned TakeArm, so that it may still take the arm.
    unsure: bool,
    output: Reclaimed,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Mode,
    Leave,
    TakeArm,
    Destination,
    Halt,
    MotorOff,
    GiveArm,
    End,
}

/// The answer to TakeArm while a task of the controller owns the arm.
const ARM_OF_TASK: HResult = HResult::from_u32(0x8350_0079);

/// The parameters of TakeArm: group 0, and the speed, the tool and the work stay.
pub(super) const KEEP: [i32; 2] = [0, 1];

impl ReclaimSteps {
    fn update_mode(&mut self, state: StreamState) {
        let Effects { streaming, claim, .. } = self.effects;
        self.step = match state {
            _ if state.allows(Properties::UNKNOWN) && claim == Claim::Lost => self.halt(),
            _ if state.allows(Properties::UNKNOWN) => Step::TakeArm,
            _ if streaming && claim == Claim::Lost => Step::Leave,
            // a stream ends some cycles after its last pose, so it is not the silent session's
            StreamState::Runs => self.end(ArmOwner::Other),
            _ if claim == Claim::Other => Step::End,
            _ => {
                // the other calls might end a stream
                self.effects.motor = false;
                self.halt()
            }
        };
    }

    fn end(&mut self, owner: ArmOwner) -> Step {
        self.output.owner = owner;
        Step::End
    }

    /// Returns the step after a TakeArm that was refused because the arm has an owner.
    fn refused_arm(&mut self) -> Step {
        let Effects { moving, destination, claim, .. } = self.effects;
        match (claim, destination) {
            (Claim::Silent, Some(target)) if moving && target.joints_end().is_some() => Step::Destination,
            (Claim::Silent, _) if moving => self.halt_only(),
            _ => self.end(ArmOwner::Other),
        }
    }

    /// Returns the step that halts a robot whose owner is unknown. Its motor stays on.
    const fn halt_only(&mut self) -> Step {
        self.effects.motor = false;
        Step::Halt
    }

    /// Compares the destination of the robot with the lost session's.
    fn update_destination(&mut self, destination: &[f64; JOINTS]) {
        let end = self.effects.destination.and_then(|target| target.joints_end());
        let is_same = end.and_then(|end| end.compare_joints(destination, &Tolerance::DESTINATION));
        self.step = match is_same {
            Some(Comparison::There) => Step::Halt,
            Some(_) => self.end(ArmOwner::Other),
            None => self.halt_only(),
        };
    }

    /// Returns the step that halts the robot, if the session may have moved it, or owns the arm now, so that no other client
    /// moves it.
    fn halt(&self) -> Step {
        let Effects { moving, streaming, .. } = self.effects;
        if self.taken || moving || streaming { Step::Halt } else { self.switch_off() }
    }

    fn switch_off(&self) -> Step {
        if self.effects.motor { Step::MotorOff } else { self.give() }
    }

    const fn give(&self) -> Step {
        if self.taken || self.unsure { Step::GiveArm } else { Step::End }
    }

    /// Takes the answer to the current call: `None`, or the code of a refusal.
    fn answered(&mut self, refusal: Option<HResult>) {
        let done = Some(refusal.is_none());
        self.step = match (self.step, refusal) {
            (Step::TakeArm, Some(HResult::E_ARM_NOT_TAKEN)) => self.refused_arm(),
            // the lost session does not own it
            (Step::TakeArm, Some(ARM_OF_TASK)) => self.end(ArmOwner::Other),
            (Step::Destination, _) => self.halt_only(),
            (Step::TakeArm, refusal) => {
                self.taken = refusal.is_none();
                self.unsure = refusal == Some(HResult::E_TIMEOUT);
                if self.effects.claim == Claim::Other && !self.taken { self.give() } else { self.halt() }
            }
            (Step::Leave, _) => self.halt(),
            (Step::Halt, _) => {
                self.output.halted = done;
                self.switch_off()
            }
            (Step::MotorOff, _) => {
                self.output.motor_off = done;
                self.give()
            }
            (Step::GiveArm, None) => self.end(ArmOwner::Free),
            _ => Step::End,
        };
    }
}

impl Steps for ReclaimSteps {
    type Output = Reclaimed;
    const KEEPS_OBJECTS: bool = true;
    const REPEATS: bool = true;

    fn next(&self) -> NextStep<'_> {
        let robot = self.robot.0;
        let of_robot = |command| StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot).with(command);
        NextStep::Call(match self.step {
            Step::Mode => of_robot(StreamState::COMMAND).with(Argument::Empty),
            Step::Leave => of_robot("slvChangeMode").with(0),
            Step::TakeArm => of_robot("TakeArm").with(Argument::Value(&KEEP)),
            Step::Destination => of_robot("DestJnt").with(Argument::Empty),
            Step::Halt => StepCall::new(FunctionId::ROBOT_HALT).with(robot).with(""),
            Step::MotorOff => of_robot("Motor").with(Argument::Value(&MOTOR_OFF)),
            Step::GiveArm => of_robot("GiveArm").with(Argument::Empty),
            Step::End => return NextStep::End,
        })
    }

    fn succeeded(&mut self, reply: &Frame<'_>, _now: Instant) -> Result<(), StepCause> {
        match self.step {
            Step::Mode => self.update_mode(StreamState::from_reply(reply.hresult(), Int::read(reply.args).ok())),
            Step::Destination => match joints(reply) {
                Ok(destination) => self.update_destination(&destination),
                Err(_) => self.answered(None),
            },
            _ => self.answered(None),
        }
        Ok(())
    }

    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        let takes = match self.step {
            // without a reply the arm may have been taken
            Step::TakeArm => cause.is_none_or(StepCause::may_have_run),
            // an abandoned TakeArm has no entry
            _ => self.unsure && cause.is_some(),
        };
        takes.then_some(Undo::GiveArm(self.robot.0))
    }

    fn has_effect(&self) -> bool {
        self.output.halted.is_some() || self.output.motor_off.is_some()
    }

    fn recovered(&mut self, cause: &StepCause) -> bool {
        let StepCause::Refused(code) = *cause else { return false };
        match self.step {
            Step::Mode => self.update_mode(StreamState::from_reply(code, None)),
            _ => self.answered(Some(code)),
        }
        true
    }

    fn output(&mut self) -> Reclaimed {
        self.output
    }
}
