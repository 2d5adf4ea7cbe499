//! Starting a motion and waiting for its end.
//!
//! ```text
//!  Robot_Move NEXT ─► DestJnt ─► (pause ─► SysState ─► CurJnt)* ─► Arrived
//!                                             │            └────► Halted: at rest, and not at the destination
//!                                             └─► GetCurErrorCount ─► GetCurErrorInfo ─► Failed
//! ```
//!
//! Arrival is decided by position: the robot has arrived when its joints rest where DestJnt said that the motion ends. That
//! SysState reports no motion is not enough, because it reports none after a halt either.
//!
//! A robot that rests elsewhere has been halted, unless SysState reports a motion (a slow start, a motion on hold) or the
//! robot has not begun to move yet.

use core::convert::identity;
use core::time::Duration;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::provider::Handles;
use super::sequence::{Argument, Next, Sequence, StepCall, Steps, Undo};
use crate::bcap::call::{Any, Int, Reply, ReplyError};
use crate::bcap::{Frame, FunctionId};
use crate::hresult::HResult;
use crate::time::Instant;
use crate::variant::{Encode, Variant};

/// The call that starts a motion. Its options contain `NEXT`: otherwise the reply comes when the motion has ended.
#[derive(Clone, Copy, Debug)]
pub enum MotionStart<D, O> {
    /// Robot_Move.
    Move {
        /// 1 point to point, 2 line, 3 circle, 4 free curve.
        interpolation: i32,
        /// The destination: `"@E P1"`, or an array of numbers, type and pass.
        pose: D,
        /// The options.
        option: O,
    },
    /// A command of Robot_Execute, such as `DriveEx`.
    Execute {
        /// The command.
        command: &'static str,
        /// Its parameter, with the options as an element.
        parameter: D,
    },
    /// Robot_Rotate.
    Rotate {
        /// `XY`, `YZ` or `ZX`.
        plane: &'static str,
        /// The angle.
        degrees: f32,
        /// The centre, such as `V(400, 0, 300)` in mm.
        centre: O,
        /// The options.
        option: O,
    },
}

/// How [`move_and_wait`] waits for a motion.
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
    /// The robot rests elsewhere, and the controller has no error: another client halted it, or it did not begin to move.
    Halted,
    /// The controller has an error; this is the first one.
    Failed(HResult),
    /// The time limit has passed, and the robot was halted.
    TimedOut,
}

/// Starts a motion and waits for its end.
///
/// The arm must be taken and the motor on. When a call fails after the motion may have started, the robot is halted,
/// because its state is unknown. A motion on hold counts as a motion until the time limit passes.
///
/// # Cancel safety
///
/// When a run is dropped, the robot continues to move. Run the procedure again: if a call was in flight, the procedure
/// fails and halts the robot, otherwise it continues to wait.
pub fn move_and_wait<D: Encode, O: AsRef<str>>(
    handles: Handles,
    motion: MotionStart<D, O>,
    config: MotionConfig,
) -> impl Procedure<Output = Motion, Error = StepError> {
    let steps = MoveSteps {
        handles,
        motion,
        config,
        step: Step::Move,
        until: Instant::FAR_FUTURE,
        start_until: Instant::FAR_FUTURE,
        destination: [0.0; JOINTS],
        reports_motion: false,
        rest: None,
        moved: false,
        still: 0,
        error: 0,
        outcome: Motion::Halted,
    };
    Sequence::new(steps, identity)
}

/// The joints of CurJnt and DestJnt.
const JOINTS: usize = 8;
/// How far a joint at rest may be from where the rest began, in degrees or mm.
const AT_REST: f64 = 0.002;
/// The bits of SysState for an error, for the emergency stop, and for a motion.
const ERROR: i32 = 1 << 1;
const EMERGENCY_STOP: i32 = 1 << 10;
const MOVING: i32 = 0b11 << 20;

struct MoveSteps<D, O> {
    handles: Handles,
    motion: MotionStart<D, O>,
    config: MotionConfig,
    step: Step,
    /// When the time limit passes.
    until: Instant,
    /// When the motion must have begun.
    start_until: Instant,
    destination: [f64; JOINTS],
    /// Whether SysState reports a motion.
    reports_motion: bool,
    /// Where the robot was when it was first seen at rest.
    rest: Option<[f64; JOINTS]>,
    /// Whether the robot has moved since the first poll.
    moved: bool,
    /// Polls in a row with the robot at rest.
    still: u8,
    /// The index of the error to ask for.
    error: i32,
    outcome: Motion,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Move,
    Destination,
    Pause(Instant),
    State,
    Position,
    ErrorCount,
    ErrorInfo,
    Halt,
    End,
}

impl<D, O> MoveSteps<D, O> {
    fn of_robot(&self, command: &'static str) -> Next<'_> {
        let execute = StepCall::new(FunctionId::ROBOT_EXECUTE).with(self.handles.robot.0);
        Next::Call(execute.with(command).with(Argument::Empty))
    }

    fn of_controller<'a>(&'a self, command: &'static str, parameter: Argument<'a>) -> Next<'a> {
        let execute = StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(self.handles.controller.0);
        Next::Call(execute.with(command).with(parameter))
    }

    fn end(&mut self, outcome: Motion) {
        self.outcome = outcome;
        self.step = Step::End;
    }

    /// Compares the robot's position with its destination and with earlier positions.
    fn update_position(&mut self, joints: [f64; JOINTS], now: Instant) {
        // from where the rest began, not from the last poll, so that a slow motion adds up
        let rests = self.rest.map(|rest| within(&joints, &rest, AT_REST));
        match rests {
            Some(true) => self.still = self.still.saturating_add(1),
            _ => (self.still, self.rest) = (0, Some(joints)),
        }
        self.moved |= rests == Some(false);
        // a motion may end where it began, so rest there does not count as arrival while SysState reports a motion
        let at_end = within(&joints, &self.destination, self.config.tolerance) && (self.moved || !self.reports_motion);
        let stopped = self.still >= self.config.still.max(1) && !self.reports_motion;
        if self.still >= 1 && at_end {
            self.end(Motion::Arrived);
        } else if stopped && self.moved {
            self.end(Motion::Halted);
        } else if stopped && now >= self.start_until {
            self.halt(Motion::Halted);
        } else if now >= self.until {
            self.halt(Motion::TimedOut);
        } else {
            self.step = Step::Pause(now.saturating_add(self.config.interval).min(self.until));
        }
    }

    fn halt(&mut self, outcome: Motion) {
        self.outcome = outcome;
        self.step = Step::Halt;
    }
}

/// Tells whether no joint is further away than this.
fn within(joints: &[f64; JOINTS], other: &[f64; JOINTS], distance: f64) -> bool {
    joints.iter().zip(other).all(|(joint, other)| (joint - other).abs() <= distance)
}

impl<D: Encode, O: AsRef<str>> MoveSteps<D, O> {
    /// Returns the call that starts the motion.
    fn start(&self) -> StepCall<'_> {
        let robot = self.handles.robot.0;
        match &self.motion {
            MotionStart::Move { interpolation, pose, option } => {
                let pose: &dyn Encode = pose;
                let call = StepCall::new(FunctionId::ROBOT_MOVE).with(robot).with(*interpolation);
                call.with(pose).with(option.as_ref())
            }
            MotionStart::Execute { command, parameter } => {
                let parameter: &dyn Encode = parameter;
                StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot).with(*command).with(parameter)
            }
            MotionStart::Rotate { plane, degrees, centre, option } => {
                let degrees: &dyn Encode = degrees;
                let call = StepCall::new(FunctionId::ROBOT_ROTATE).with(robot).with(*plane).with(degrees);
                call.with(centre.as_ref()).with(option.as_ref())
            }
        }
    }
}

impl<D: Encode, O: AsRef<str>> Steps for MoveSteps<D, O> {
    type Output = Motion;
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> Next<'_> {
        match self.step {
            Step::Move => Next::Call(self.start()),
            Step::Destination => self.of_robot("DestJnt"),
            Step::Pause(until) => Next::Wait(until),
            Step::State => self.of_controller("SysState", Argument::Empty),
            Step::Position => self.of_robot("CurJnt"),
            Step::ErrorCount => self.of_controller("GetCurErrorCount", Argument::Empty),
            Step::ErrorInfo => self.of_controller("GetCurErrorInfo", Argument::Int(self.error)),
            Step::Halt => Next::Call(StepCall::new(FunctionId::ROBOT_HALT).with(self.handles.robot.0).with("")),
            Step::End => Next::End,
        }
    }

    fn waited(&mut self) {
        self.step = Step::State;
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        match self.step {
            Step::Move => {
                self.until = now.saturating_add(self.config.limit);
                self.start_until = now.saturating_add(self.config.start);
                self.step = Step::Destination;
            }
            Step::Destination => {
                self.destination = joints(reply)?;
                self.step = Step::State;
            }
            Step::State => {
                let bits = Int::read(reply.args).map_err(StepCause::Reply)?;
                self.reports_motion = bits & MOVING != 0;
                self.step = if bits & (ERROR | EMERGENCY_STOP) == 0 { Step::Position } else { Step::ErrorCount };
            }
            Step::Position => self.update_position(joints(reply)?, now),
            Step::ErrorCount => {
                // the last error of the list is the oldest, so the first cause
                self.error = Int::read(reply.args).map_err(StepCause::Reply)?.saturating_sub(1);
                if self.error >= 0 {
                    self.step = Step::ErrorInfo;
                } else {
                    self.end(Motion::Failed(HResult::E_FAIL));
                }
            }
            Step::ErrorInfo => {
                let value = Any::read(reply.args).map_err(StepCause::Reply)?;
                let code = value.as_array().and_then(|array| array.iter().next()).as_ref().and_then(code);
                self.end(Motion::Failed(code.unwrap_or(HResult::E_FAIL)));
            }
            Step::Halt | Step::Pause(_) | Step::End => self.step = Step::End,
        }
        Ok(())
    }

    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        let cause = cause?;
        let moves = self.step != Step::Move || cause.may_have_run();
        moves.then_some(Undo::Halt(self.handles.robot.0))
    }

    fn output(&mut self) -> Motion {
        self.outcome
    }
}

/// Reads a position of at least one joint. Rejects NaN: every comparison with it is false, so the robot would never arrive
/// or rest.
fn joints(reply: &Frame<'_>) -> Result<[f64; JOINTS], StepCause> {
    let value = Any::read(reply.args).map_err(StepCause::Reply)?;
    let wrong = StepCause::Reply(ReplyError { expected: "an array of joints", found: Some(value.vartype()) });
    let mut joints = [0.0; JOINTS];
    let array = value.as_array().filter(|array| !array.is_empty()).ok_or(wrong)?;
    for (joint, element) in joints.iter_mut().zip(array) {
        *joint = element.as_f64().filter(|number| number.is_finite()).ok_or(wrong)?;
    }
    Ok(joints)
}

/// Reads the code of an error, which controllers send as I4, UI4, ERROR or I8.
fn code(value: &Variant<'_>) -> Option<HResult> {
    match *value {
        Variant::I4(n) => Some(HResult(n)),
        Variant::Ui4(n) => Some(HResult(n.cast_signed())),
        Variant::Error(code) => Some(code),
        Variant::I8(n) => u32::try_from(n).map(u32::cast_signed).or_else(|_| i32::try_from(n)).ok().map(HResult),
        _ => None,
    }
}
