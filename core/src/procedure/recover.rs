//! Recovery of a robot after an error, and the preparation of a COBOTTA.
//!
//! ```text
//!  examine ─► an obstacle: the end, for a person
//!     └─────► errors: TakeArm ─► taken ──────────────────────────────────────────────┐
//!     │                  ├─────► another client owns the arm: the end                │
//!     │                  └─────► refused because of the errors: the end,             ▼
//!     │                          unless the caller knows that no other client ─► ClearError
//!     │                          uses the robot                                      ▼
//!     └─────────────────────────────────────────────────────────────────────► TakeArm ─► (ManualReset)
//!                                                                    (MotionPreparation) ─► Motor ─► (ExtSpeed)
//! ```
//!
//! Until the arm is taken, slvGetMode precedes each call, as in an [examination](super::examine()). The order for a COBOTTA is
//! the order of a public program that was tested on one; ManualResetPreparation precedes each command that may need it, as in
//! the public ROS 2 driver.

use core::convert::identity;
use core::fmt;
use core::ops::ControlFlow;

use super::action::{Action, Procedure};
use super::examine::{ExamineSteps, Obstacle, Plan, RecoveryStep, RecoveryStepSet};
use super::failure::{Failure, StepCause, StepError};
use super::provider::Handles;
use super::reclaim::KEEP;
use super::robot::MOTOR_ON;
use super::sequence::{Argument, NextStep, Sequence, StepCall, Steps, Undo};
use crate::bcap::call::{Call, Int, Reply};
use crate::bcap::{Frame, FunctionId, StreamState};
use crate::hresult::HResult;
use crate::time::Instant;

/// Settings of a recovery.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RecoveryConfig {
    /// Whether the caller guarantees that no other client uses the robot. A controller with errors may refuse to report the
    /// owner of the arm, or whether a stream runs. Without this guarantee the recovery ends there, and the errors stay.
    pub is_alone: bool,
    /// The external speed after the recovery, in percent; `None` leaves it.
    pub speed: Option<f64>,
    /// The steps that a person confirmed after an examination; `None` if no person was asked. If the state has changed and
    /// needs another step, the recovery ends before its first step.
    pub agreed: Option<RecoveryStepSet>,
}

/// The effect of [`recover`] and [`prepare`]; the arm is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Recovered {
    /// Whether the motor was switched on. Otherwise it is as it was.
    pub motor_on: bool,
}

/// A recovery or a preparation did not complete. The arm was given back, and the motor switched off if the procedure has
/// switched it on, unless the connection is lost. Cleared errors stay cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct NotRecovered {
    /// The step that failed.
    pub step: RecoveryStep,
    /// What a person or another program must do first, if that is the reason.
    pub obstacle: Option<Obstacle>,
    /// The call that failed, or after which the procedure stopped: for the obstacle, or without one because the caller has
    /// stopped it. The cause is [`StepCause::Stopped`] then, even if the controller refused that call.
    pub error: StepError,
}

impl NotRecovered {
    /// Returns the controller's code: of the refusal, or of the error that is the obstacle.
    #[must_use]
    pub const fn code(&self) -> Option<HResult> {
        match self.obstacle {
            Some(obstacle) if obstacle.code().is_some() => obstacle.code(),
            _ => self.error.hresult(),
        }
    }
}

impl fmt::Display for NotRecovered {
    /// Writes the step, the code, and what to do.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.obstacle, self.error.cause) {
            (Some(obstacle), _) => write!(f, "before {}: {obstacle}", self.step),
            (None, StepCause::Refused(code)) => {
                write!(f, "{}: the controller refused: {code}", self.step)?;
                code.meaning().map_or(Ok(()), |meaning| write!(f, ", {}", meaning.trim_end_matches('.')))?;
                code.hint().map_or(Ok(()), |hint| write!(f, ": {hint}"))
            }
            (None, cause) => write!(f, "{}: {cause}", self.step),
        }
    }
}

impl core::error::Error for NotRecovered {}

/// Recovers a robot: clears its errors, takes the arm, resets the safe torque off, prepares the motion of a COBOTTA, and
/// switches the motor on. It makes the [steps](super::Examination::steps) that the state needs.
///
/// **The arm of a COBOTTA can move**, and an arm can sag when the motor is switched on. A person must look at the robot before
/// this call.
///
/// `observe` gets each step with its result: `Err` for a step that the controller does not support, and that is left out. The
/// procedure ends when it returns [`ControlFlow::Break`].
///
/// # Errors
///
/// [`NotRecovered`], with the step and what to do.
///
/// # Cancel safety
///
/// When a run is dropped, the arm may stay taken and the motor may stay on. Run the procedure again, and it undoes them.
pub fn recover<F>(
    handles: Handles,
    config: RecoveryConfig,
    observe: F,
) -> impl Procedure<Output = Recovered, Error = NotRecovered> + use<F>
where
    F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>,
{
    Recovery::new(handles, Goal::Recovered(config), observe)
}

/// Prepares the motion of a COBOTTA, so that its motor can be switched on, and takes the arm. For other models, or if the
/// motion is already prepared, it only takes the arm.
///
/// **The arm can move.** It changes nothing while the controller has errors.
///
/// # Errors
///
/// [`NotRecovered`], with the step and what to do.
///
/// # Cancel safety
///
/// Same as [`recover`].
pub fn prepare<F>(handles: Handles, observe: F) -> impl Procedure<Output = Recovered, Error = NotRecovered> + use<F>
where
    F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>,
{
    Recovery::new(handles, Goal::Prepared, observe)
}

#[derive(Clone, Copy, Debug)]
enum Goal {
    Recovered(RecoveryConfig),
    Prepared,
}

/// The sequence with its own error.
struct Recovery<F>(Sequence<RecoverySteps<F>, fn(Recovered) -> Recovered>);

impl<F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>> Recovery<F> {
    fn new(handles: Handles, goal: Goal, observe: F) -> Self {
        let is_alone = matches!(goal, Goal::Recovered(RecoveryConfig { is_alone: true, .. }));
        let steps = RecoverySteps {
            handles,
            goal,
            is_alone,
            observe,
            examine: ExamineSteps::new(handles, is_alone),
            examined: false,
            stopped: false,
            plan: Plan::new(),
            at: 0,
            has_arm: false,
            asked: false,
            asks_owner: false,
            obstacle: None,
            done: Recovered::default(),
        };
        Self(Sequence::new(steps, identity))
    }
}

impl<F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>> Procedure for Recovery<F> {
    type Output = Recovered;
    type Error = NotRecovered;

    fn poll(&mut self, now: Instant) -> Action<Result<Recovered, NotRecovered>> {
        match self.0.poll(now) {
            Action::Done(Err(error)) => {
                let steps = self.0.steps();
                let is_stopped = steps.stopped || steps.obstacle.is_some();
                let error = if is_stopped { StepError { cause: StepCause::Stopped, ..error } } else { error };
                Action::Done(Err(NotRecovered { step: steps.step(), obstacle: steps.obstacle, error }))
            }
            Action::Done(Ok(done)) => Action::Done(Ok(done)),
            Action::Call(channel) => Action::Call(channel),
            Action::Wait(until) => Action::Wait(until),
        }
    }

    fn request(&self) -> Option<impl Call> {
        self.0.request()
    }

    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant) {
        self.0.handle_reply(reply, now);
    }

    fn handle_failure(&mut self, failure: Failure, now: Instant) {
        self.0.handle_failure(failure, now);
    }
}

struct RecoverySteps<F> {
    handles: Handles,
    goal: Goal,
    is_alone: bool,
    observe: F,
    examine: ExamineSteps,
    examined: bool,
    /// Whether the caller has stopped the procedure.
    stopped: bool,
    plan: Plan,
    /// The index of the current step of the plan.
    at: usize,
    /// Whether this session owns the arm.
    has_arm: bool,
    /// Whether slvGetMode has answered since the last call that may end a stream.
    asked: bool,
    /// Whether the current TakeArm only queries the owner of the arm while the controller has errors.
    asks_owner: bool,
    obstacle: Option<Obstacle>,
    done: Recovered,
}

impl<F> RecoverySteps<F> {
    fn step(&self) -> RecoveryStep {
        match self.plan.get(self.at) {
            _ if !self.examined => RecoveryStep::Examine,
            _ if self.asks_owner => RecoveryStep::TakeArm,
            Some(step) => *step,
            None => RecoveryStep::Examine,
        }
    }

    /// Returns whether slvGetMode precedes the current step.
    fn asks_mode(&self) -> bool {
        !self.has_arm && !self.asked && self.examine.result.stream != StreamState::Absent
    }

    fn stop(&mut self, obstacle: Obstacle) -> Result<(), StepCause> {
        self.obstacle = Some(obstacle);
        Err(StepCause::Stopped)
    }

    /// Plans the steps after the examination.
    fn begin(&mut self) -> Result<(), StepCause> {
        let (state, is_alone) = (&self.examine.result, self.is_alone);
        let (recovers, speed, agreed) = match self.goal {
            Goal::Recovered(config) => (true, config.speed, config.agreed),
            Goal::Prepared => (false, None, None),
        };
        let first = state.errors().first().copied().unwrap_or(HResult::E_ERROR_PRESENT);
        let error = (!recovers && state.has_error()).then_some(Obstacle::Error(first));
        let is_known = |obstacle: &Obstacle| is_alone && matches!(obstacle, Obstacle::StreamUnknown(_));
        let obstacle = state.obstacles().find(|obstacle| !is_known(obstacle)).or(error);
        self.plan = state.plan(recovers, speed.is_some());
        self.has_arm = state.owns_arm;
        self.asks_owner = state.has_error() && !state.owns_arm;
        let other = agreed.and_then(|agreed| self.plan.iter().copied().find(|step| !agreed.contains(*step)));
        if let Some(obstacle) = obstacle.or(other.map(Obstacle::NotAgreed)) {
            return self.stop(obstacle);
        }
        self.examined = true;
        Ok(())
    }

    /// Takes the answer to slvGetMode.
    fn update_mode(&mut self, stream: StreamState) -> Result<(), StepCause> {
        (self.asked, self.examine.result.stream) = (true, stream);
        match stream {
            StreamState::Runs => self.stop(Obstacle::Stream),
            StreamState::Unknown(code) if !self.is_alone => self.stop(Obstacle::StreamUnknown(code)),
            _ => Ok(()),
        }
    }
}

impl<F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>> RecoverySteps<F> {
    /// Reports a step with its result, and moves to the next step.
    fn end_step(&mut self, result: Result<(), HResult>) -> Result<(), StepCause> {
        let step = self.step();
        let flow = (self.observe)(step, result);
        self.has_arm |= step == RecoveryStep::TakeArm;
        self.done.motor_on |= step == RecoveryStep::Motor;
        if flow.is_break() {
            self.stopped = true;
            return Err(StepCause::Stopped);
        }
        if !core::mem::take(&mut self.asks_owner) {
            self.at = self.at.saturating_add(1);
        }
        if self.has_arm && self.plan.get(self.at) == Some(&RecoveryStep::TakeArm) {
            self.at = self.at.saturating_add(1);
        }
        self.asked = false;
        Ok(())
    }
}

/// Returns whether a controller does not support a command.
const fn is_unknown(code: HResult) -> bool {
    matches!(code, HResult::E_INVALID_CMD_NAME | HResult::E_INVALIDCOMMAND | HResult::E_NOTIMPL)
}

/// Returns whether a COBOTTA has no ManualResetPreparation. Before version 2.8 it answers as if an argument were wrong, and
/// does not need the command (DENSORobot/denso_robot_ros, issue 44).
const fn needs_no_reset(code: HResult) -> bool {
    is_unknown(code) || matches!(code, HResult::E_INVALIDARG)
}

impl<F: FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>> Steps for RecoverySteps<F> {
    type Output = Recovered;
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> NextStep<'_> {
        if !self.examined {
            return self.examine.next();
        }
        let Handles { controller, robot } = self.handles;
        let of_robot = |command| StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot.0).with(command);
        let of_controller = |command| StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(controller.0).with(command);
        if self.plan.get(self.at).is_none() {
            return NextStep::End;
        }
        NextStep::Call(match self.step() {
            _ if self.asks_mode() => of_robot(StreamState::COMMAND).with(Argument::Empty),
            step @ (RecoveryStep::ClearError | RecoveryStep::ManualReset) => {
                of_controller(step.name()).with(Argument::Empty)
            }
            step @ (RecoveryStep::ManualResetPreparation | RecoveryStep::MotionPreparation) => {
                of_robot(step.name()).with(Argument::Empty)
            }
            RecoveryStep::TakeArm => of_robot("TakeArm").with(Argument::Value(&KEEP)),
            RecoveryStep::Motor => of_robot("Motor").with(Argument::Value(&MOTOR_ON)),
            RecoveryStep::ExtSpeed => match &self.goal {
                Goal::Recovered(RecoveryConfig { speed: Some(speed), .. }) => {
                    of_robot("ExtSpeed").with(Argument::Value(speed))
                }
                _ => return NextStep::End,
            },
            RecoveryStep::Examine => return NextStep::End,
        })
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        if !self.examined {
            self.examine.succeeded(reply, now)?;
            return if matches!(self.examine.next(), NextStep::End) { self.begin() } else { Ok(()) };
        }
        if self.asks_mode() {
            return self.update_mode(StreamState::from_reply(reply.hresult(), Int::read(reply.args).ok()));
        }
        self.end_step(Ok(()))
    }

    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        // after `Stopped` the call has succeeded, so its undo entry exists already
        if !self.examined || self.asks_mode() || cause == Some(&StepCause::Stopped) {
            return None;
        }
        let robot = self.handles.robot.0;
        let ran = cause.is_none_or(StepCause::may_have_run);
        match self.step() {
            RecoveryStep::TakeArm => ran.then_some(Undo::GiveArm(robot)),
            RecoveryStep::MotionPreparation => (ran && cause.is_some()).then_some(Undo::Halt(robot)),
            RecoveryStep::Motor => ran.then_some(Undo::MotorOff(robot)),
            _ => None,
        }
    }

    fn has_effect(&self) -> bool {
        self.at > 0
    }

    fn recovered(&mut self, cause: &StepCause) -> bool {
        let StepCause::Refused(code) = *cause else { return false };
        if !self.examined {
            let is_ended = self.examine.recovered(cause) && matches!(self.examine.next(), NextStep::End);
            return !is_ended || self.begin().is_ok();
        }
        if self.asks_mode() {
            return self.update_mode(StreamState::from_reply(code, None)).is_ok();
        }
        match self.step() {
            RecoveryStep::TakeArm if self.asks_owner && code == HResult::E_ERROR_PRESENT => {
                if !self.is_alone {
                    self.obstacle = Some(Obstacle::OwnerUnknown);
                    return false;
                }
                (self.asks_owner, self.asked) = (false, false);
                true
            }
            RecoveryStep::ManualResetPreparation if needs_no_reset(code) => self.end_step(Err(code)).is_ok(),
            RecoveryStep::ManualReset if is_unknown(code) => self.end_step(Err(code)).is_ok(),
            _ => false,
        }
    }

    fn output(&mut self) -> Recovered {
        self.done
    }
}
