//! The state of a robot and its controller, read without an effect, and the plan of a recovery.
//!
//! ```text
//!  slvGetMode ─► a stream runs, or may run: the end
//!      └───────► SysState ─► StoState ─► TakeArmState ─► GetRobotTypeName ─► (GetMotionPreparationState)
//!                   └─► error: GetCurErrorCount ─► GetCurErrorInfo, the first cause first
//! ```
//!
//! A call that Slave Mode may refuse ends a stream, even another client's stream. So slvGetMode is sent before each of them. A
//! refused call leaves its part of the state unknown. Only TakeArm reveals whether another client owns the arm, and it has an
//! effect.

use core::convert::identity;
use core::fmt;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::motion::code;
use super::provider::Handles;
use super::sequence::{Argument, NextStep, Sequence, StepCall, Steps};
use crate::bcap::call::{Any, Int, Reply, Text};
use crate::bcap::{Frame, FunctionId, StreamState};
use crate::hresult::HResult;
use crate::time::Instant;

/// Maximum number of errors in an [`Examination`]; of a longer list it has the oldest.
const ERRORS_MAX: usize = 8;
/// The start of the type names of a COBOTTA, such as `CVR038A1`; those of a COBOTTA PRO start with `CVRB`.
const COBOTTA: &str = "CVR0";

/// The bits of SysState.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SysState(
    /// The value of the reply.
    pub i32,
);

macro_rules! bits {
    ($($bit:literal $name:ident $meaning:literal;)*) => {
        impl SysState {$(
            #[doc = concat!("Tells whether ", $meaning, ": bit ", stringify!($bit), ".")]
            #[must_use]
            pub const fn $name(self) -> bool {
                self.0 & (1 << $bit) != 0
            }
        )*}
    };
}

bits! {
    1 has_error "an error is present";
    2 motor_is_on "the motor is on";
    4 is_auto "the mode is Auto";
    5 has_outside_token "the teach pendant does not have the executable token";
    10 is_emergency_stopped "the emergency stop is pressed";
    11 is_auto_enabled "the enable input permits Auto mode";
    12 is_protectively_stopped "the protective stop is active";
    20 is_moving "the robot moves, by its commands";
}

/// The state of a robot and its controller.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Examination {
    /// Whether a stream of Slave Mode runs. If so, or if that is unknown, nothing else was read.
    pub stream: StreamState,
    /// The state of the controller; `None` if it is unknown.
    pub state: Option<SysState>,
    /// The number of current errors.
    pub error_count: usize,
    errors: heapless::Vec<HResult, ERRORS_MAX>,
    /// Whether this session owns the arm.
    pub owns_arm: bool,
    /// Whether the torque is still off after an emergency stop; `None` on an RC8, which does not report it.
    pub torque_off: Option<bool>,
    /// Whether the robot is a COBOTTA, which needs a preparation before its motor can be switched on.
    pub is_cobotta: bool,
    /// Whether the motion of a COBOTTA is prepared; `None` if that is unknown, and for other models.
    pub prepared: Option<bool>,
}

/// The reason why a recovery must not continue: what a person or another program must do first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Obstacle {
    /// A client streams in Slave Mode.
    Stream,
    /// Whether a client streams is unknown: slvGetMode was refused with this code.
    StreamUnknown(HResult),
    /// SysState was refused.
    StateUnknown,
    /// The robot moves, and this session does not own the arm.
    Moves,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The protective stop is active.
    ProtectiveStop,
    /// The mode is not Auto.
    Mode,
    /// The teach pendant has the executable token.
    Token,
    /// ClearError does not end this error, or must not: a preparation needs a controller without errors.
    Error(HResult),
    /// The controller does not report the owner of the arm while it has errors, and the caller has not excluded other clients.
    OwnerUnknown,
    /// The state has changed: this step is needed, and is not among the steps that a person confirmed.
    NotAgreed(RecoveryStep),
}

/// A step of a recovery or a preparation, in the order of a recovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RecoveryStep {
    /// Reads the state.
    Examine,
    /// Permits a COBOTTA the next command that concerns safety.
    ManualResetPreparation,
    /// Clears the errors.
    ClearError,
    /// Takes the arm, which keeps its speed, tool and work.
    TakeArm,
    /// Ends the safe torque off.
    ManualReset,
    /// Prepares the motion of a COBOTTA. **The arm can move.**
    MotionPreparation,
    /// Switches the motor on.
    Motor,
    /// Sets the external speed.
    ExtSpeed,
}

/// A set of steps, such as those that a person has agreed to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RecoveryStepSet(u8);

impl RecoveryStepSet {
    /// Returns whether the set has a step.
    #[must_use]
    pub const fn contains(self, step: RecoveryStep) -> bool {
        self.0 & step.bit() != 0
    }
}

impl FromIterator<RecoveryStep> for RecoveryStepSet {
    fn from_iter<I: IntoIterator<Item = RecoveryStep>>(steps: I) -> Self {
        Self(steps.into_iter().fold(0, |bits, step| bits | step.bit()))
    }
}

/// The steps of a recovery or a preparation.
pub(super) type Plan = heapless::Vec<RecoveryStep, 9>;

impl RecoveryStep {
    /// Returns the name of the command.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Examine => "the examination",
            Self::ManualResetPreparation => "ManualResetPreparation",
            Self::ClearError => "ClearError",
            Self::TakeArm => "TakeArm",
            Self::ManualReset => "ManualReset",
            Self::MotionPreparation => "MotionPreparation",
            Self::Motor => "Motor",
            Self::ExtSpeed => "ExtSpeed",
        }
    }

    const fn bit(self) -> u8 {
        match self {
            Self::Examine => 1,
            Self::ManualResetPreparation => 1 << 1,
            Self::ClearError => 1 << 2,
            Self::TakeArm => 1 << 3,
            Self::ManualReset => 1 << 4,
            Self::MotionPreparation => 1 << 5,
            Self::Motor => 1 << 6,
            Self::ExtSpeed => 1 << 7,
        }
    }
}

impl fmt::Display for RecoveryStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Examination {
    const UNKNOWN: Self = Self {
        stream: StreamState::Off,
        state: None,
        error_count: 0,
        errors: heapless::Vec::new(),
        owns_arm: false,
        torque_off: None,
        is_cobotta: false,
        prepared: None,
    };

    /// Returns the current errors, the first cause first, at most eight. [`HResult::cause`] and [`HResult::hint`] say what to
    /// do.
    #[must_use]
    pub fn errors(&self) -> &[HResult] {
        &self.errors
    }

    /// Iterates over what a person or another program must do before a recovery.
    pub fn obstacles(&self) -> impl Iterator<Item = Obstacle> + '_ {
        let stream = match self.stream {
            StreamState::Runs => Some(Obstacle::Stream),
            StreamState::Unknown(code) => Some(Obstacle::StreamUnknown(code)),
            StreamState::Off | StreamState::Absent => None,
        };
        let unknown = (stream.is_none() && self.state.is_none()).then_some(Obstacle::StateUnknown);
        let bits = self.state.into_iter().flat_map(|state| {
            [
                (state.is_moving() && !self.owns_arm).then_some(Obstacle::Moves),
                state.is_emergency_stopped().then_some(Obstacle::EmergencyStop),
                state.is_protectively_stopped().then_some(Obstacle::ProtectiveStop),
                (!state.is_auto()).then_some(Obstacle::Mode),
                (!state.has_outside_token()).then_some(Obstacle::Token),
            ]
        });
        let faults = self.errors.iter().filter(|code| !is_clearable(**code)).map(|code| Obstacle::Error(*code));
        stream.into_iter().chain(unknown).chain(bits.flatten()).chain(faults)
    }

    /// Returns whether the robot needs no recovery: the controller has no error, and the motor is on.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.obstacles().next().is_none() && self.plan(true, false).iter().all(|step| *step == RecoveryStep::TakeArm)
    }

    /// Iterates over the steps of a recovery from this state. `sets_speed`: whether it sets the external speed.
    ///
    /// A COBOTTA gets ManualResetPreparation, ClearError, TakeArm, ManualReset, MotionPreparation, Motor and ExtSpeed, and
    /// ManualResetPreparation before each command that may need one; other models ClearError and Motor. Steps that this
    /// state does not need are left out. While the controller has errors, TakeArm is sent once before ClearError, in case the
    /// controller reports the owner of the arm.
    pub fn steps(&self, sets_speed: bool) -> impl Iterator<Item = RecoveryStep> + use<> {
        self.plan(true, sets_speed).into_iter()
    }

    /// Returns the steps of a recovery, or those of a preparation: TakeArm and what precedes the motor of a COBOTTA.
    pub(super) fn plan(&self, recovers: bool, sets_speed: bool) -> Plan {
        let clears = recovers && self.has_error();
        // an RC8 does not report its torque; on a COBOTTA an unreported torque may be off
        let resets = recovers && self.torque_off.unwrap_or(self.is_cobotta);
        let prepares = self.is_cobotta && self.prepared != Some(true);
        let motor_is_on = self.state.is_some_and(SysState::motor_is_on);
        let plan = [
            (clears && self.is_cobotta, RecoveryStep::ManualResetPreparation),
            (clears, RecoveryStep::ClearError),
            (!self.owns_arm, RecoveryStep::TakeArm),
            (resets && self.is_cobotta, RecoveryStep::ManualResetPreparation),
            (resets, RecoveryStep::ManualReset),
            (prepares, RecoveryStep::ManualResetPreparation),
            (prepares, RecoveryStep::MotionPreparation),
            (recovers && !motor_is_on, RecoveryStep::Motor),
            (sets_speed, RecoveryStep::ExtSpeed),
        ];
        plan.into_iter().filter_map(|(is_needed, step)| is_needed.then_some(step)).collect()
    }

    pub(super) fn has_error(&self) -> bool {
        self.error_count > 0 || self.state.is_some_and(SysState::has_error)
    }
}

/// Returns whether ClearError ends an error: it is one of the controller, of a level below a fault, and needs no restart.
fn is_clearable(code: HResult) -> bool {
    let restarts = code.hint().is_some_and(|hint| hint.needs_restart());
    matches!(code.level(), Some(0..=4)) && !restarts
}

impl Obstacle {
    /// Returns the code of the error or the refusal.
    #[must_use]
    pub const fn code(self) -> Option<HResult> {
        match self {
            Self::Error(code) | Self::StreamUnknown(code) => Some(code),
            _ => None,
        }
    }
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stream => f.write_str("a client streams in Slave Mode: end its stream"),
            Self::StreamUnknown(code) => {
                write!(f, "slvGetMode was refused with {code}, so a client may stream: make sure that none does")
            }
            Self::StateUnknown => f.write_str("SysState was refused: check that the controller has finished starting"),
            Self::Moves => f.write_str("the robot moves for another client or a task: wait for its end, or halt it"),
            Self::EmergencyStop => {
                f.write_str("the emergency stop is pressed: make sure that the robot endangers no person, and release it")
            }
            Self::ProtectiveStop => {
                f.write_str("the protective stop is active: make sure that no person is near the robot, and release it")
            }
            Self::Mode => f.write_str("the mode is Manual or teach check: switch the controller to Auto"),
            Self::Token => f.write_str(
                "the teach pendant has the executable token: set it to Ethernet with the address of this machine, or to Any",
            ),
            Self::Error(code) => {
                write!(f, "the error {code}")?;
                code.meaning().map_or(Ok(()), |meaning| write!(f, ", {}", meaning.trim_end_matches('.')))?;
                match code.hint() {
                    Some(hint) => write!(f, ": {hint}"),
                    None => f.write_str(": look it up in the manual of the controller"),
                }
            }
            Self::OwnerUnknown => f.write_str(
                "the controller does not say who owns the arm while it has errors: make sure that no other program uses the \
                 robot",
            ),
            Self::NotAgreed(step) => {
                write!(f, "the state has changed, and {step} is needed, too: look at the robot, and begin again")
            }
        }
    }
}

/// Reads the state of a robot and its controller. It changes nothing and interrupts no stream.
///
/// # Errors
///
/// A refusal leaves a part of the state unknown. An error means that a call has no reply.
///
/// # Cancel safety
///
/// When a run is dropped, run the procedure again.
pub fn examine(handles: Handles) -> impl Procedure<Output = Examination, Error = StepError> + use<> {
    Sequence::new(ExamineSteps::new(handles, false), identity)
}

/// The steps of an examination, which a recovery begins with.
#[derive(Debug)]
pub(super) struct ExamineSteps {
    handles: Handles,
    /// Whether the caller guarantees that no other client uses the robot: a refused slvGetMode then means that no client
    /// streams.
    is_alone: bool,
    step: Step,
    /// Whether slvGetMode has answered since the last call that may end a stream.
    asked: bool,
    /// The number of errors that are not read yet.
    left: i32,
    pub(super) result: Examination,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    State,
    Torque,
    Arm,
    Type,
    Prepared,
    Count,
    Info,
    End,
}

impl ExamineSteps {
    pub(super) const fn new(handles: Handles, is_alone: bool) -> Self {
        Self { handles, is_alone, step: Step::State, asked: false, left: 0, result: Examination::UNKNOWN }
    }

    /// Returns whether slvGetMode precedes the next step.
    fn asks(&self) -> bool {
        let is_allowed = matches!(self.step, Step::Torque | Step::End);
        !self.asked && !is_allowed && self.result.stream != StreamState::Absent
    }

    fn update_stream(&mut self, stream: StreamState) {
        (self.result.stream, self.asked) = (stream, true);
        let may_run = match stream {
            StreamState::Off | StreamState::Absent => false,
            StreamState::Runs => true,
            StreamState::Unknown(_) => !self.is_alone,
        };
        if may_run {
            // what was read before the stream began is old
            self.result = Examination { stream, ..Examination::UNKNOWN };
            self.step = Step::End;
        }
    }

    /// Moves to the next step, whether the current step was answered or refused.
    fn go_on(&mut self) {
        // StoState is allowed, so it does not use up the answer of slvGetMode
        self.asked &= self.step == Step::Torque;
        self.step = match self.step {
            Step::State => Step::Torque,
            Step::Torque => Step::Arm,
            Step::Arm => Step::Type,
            Step::Type if self.result.is_cobotta => Step::Prepared,
            Step::Type | Step::Prepared if self.result.has_error() => Step::Count,
            Step::Count | Step::Info if self.left > 0 && !self.result.errors.is_full() => Step::Info,
            _ => Step::End,
        };
    }

    fn update_errors(&mut self, reply: &Frame<'_>) {
        // the last error is the oldest, so the first cause
        self.left = self.left.saturating_sub(1);
        let info = Any::read(reply.args).ok();
        let first = info.as_ref().and_then(|info| info.as_array()).and_then(|elements| elements.iter().next());
        // the loop ends before the list is full
        let _ = self.result.errors.push(first.as_ref().and_then(code).unwrap_or(HResult::E_FAIL));
    }
}

impl Steps for ExamineSteps {
    type Output = Examination;
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> NextStep<'_> {
        let Handles { controller, robot } = self.handles;
        let of_robot = |command| StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot.0).with(command);
        let of_controller = |command| StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(controller.0).with(command);
        NextStep::Call(match self.step {
            _ if self.asks() => of_robot(StreamState::COMMAND).with(Argument::Empty),
            Step::State => of_controller("SysState").with(Argument::Empty),
            Step::Torque => of_controller("StoState").with(Argument::Empty),
            Step::Arm => of_robot("TakeArmState").with(-1),
            Step::Type => of_robot("GetRobotTypeName").with(Argument::Empty),
            Step::Prepared => of_robot("GetMotionPreparationState").with(Argument::Empty),
            Step::Count => of_controller("GetCurErrorCount").with(Argument::Empty),
            Step::Info => of_controller("GetCurErrorInfo").with(self.left.saturating_sub(1)),
            Step::End => return NextStep::End,
        })
    }

    fn succeeded(&mut self, reply: &Frame<'_>, _now: Instant) -> Result<(), StepCause> {
        if self.asks() {
            self.update_stream(StreamState::from_reply(reply.hresult(), Int::read(reply.args).ok()));
            return Ok(());
        }
        let number = Int::read(reply.args).ok();
        let yes = Any::read(reply.args).ok().and_then(|value| value.as_bool());
        match self.step {
            Step::State => self.result.state = number.map(SysState),
            Step::Torque => self.result.torque_off = yes,
            Step::Arm => self.result.owns_arm = number == Some(1),
            Step::Type => {
                let mut name = Text::read(reply.args).ok().into_iter().flat_map(|name| name.chars());
                self.result.is_cobotta = COBOTTA.chars().all(|letter| name.next() == Some(Ok(letter)));
            }
            Step::Prepared => self.result.prepared = yes,
            Step::Count => {
                self.left = number.unwrap_or(0).max(0);
                self.result.error_count = usize::try_from(self.left).unwrap_or(0);
            }
            Step::Info => self.update_errors(reply),
            Step::End => {}
        }
        self.go_on();
        Ok(())
    }

    fn recovered(&mut self, cause: &StepCause) -> bool {
        let StepCause::Refused(code) = *cause else { return false };
        if self.asks() {
            self.update_stream(StreamState::from_reply(code, None));
        } else {
            self.left = 0;
            self.go_on();
        }
        true
    }

    fn output(&mut self) -> Examination {
        core::mem::replace(&mut self.result, Examination::UNKNOWN)
    }
}
