//! Starting a motion, letting others follow it, and waiting for the end.
//!
//! ```text
//!  from rest:  CurJnt ─► (the variable, or CurTrn) ─► Robot_Move NEXT
//!  each poll:  SysState ─► (DestJnt) ─► CurJnt ─► at rest: (CurPos, CurTrn) ─► Arrived, Halted, Unknown
//!                  └─► GetCurErrorCount ─► GetCurErrorInfo ─► (Robot_Halt) ─► Failed
//! ```
//!
//! Arrival is judged by the position: the robot has arrived when it rests at the [`Target`] of its motion. A SysState without a
//! motion is not sufficient, because SysState reports no motion after a halt either.
//!
//! A motion that is shorter than the tolerance ends within it only after the robot has moved, or when the time to begin has
//! passed.
//!
//! A robot that rests elsewhere was halted, unless SysState reports a motion (a slow start, a motion on hold) or the robot
//! has not begun to move yet. DestJnt alone is never sufficient, because after a halt it may be the place where the robot
//! rests. It counts if two polls saw it during the motion, and then only where the target cannot be compared.
//!
//! An error of the controller ends the motion, but not every error stops the robot. So the robot is halted, unless it has been
//! seen at rest after it had moved. If the halt is refused, which it may be because of the error, the next polls must find the
//! robot at rest.
//!
//! A motion that follows another is sent while the previous motion runs, or from rest at its end. At most one motion waits for
//! the running motion.

use core::convert::identity;
use core::time::Duration;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::provider::Handles;
use super::queue::{AT_REST, LATEST, Motion, MotionConfig, MotionQueue, within};
use super::sequence::{Argument, NextStep, Sequence, StepCall, Steps, Undo};
use super::target::{Before, Comparison, End, JOINTS, Target};
use crate::bcap::call::{Any, Int, Reply, ReplyError};
use crate::bcap::{Frame, FunctionId};
use crate::hresult::HResult;
use crate::position::{Position, Transform};
use crate::time::Instant;
use crate::variant::{Encode, FromVariant, Variant};

/// The call that starts a motion. Its options contain `NEXT`: otherwise the reply arrives when the motion has ended.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
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

/// Starts a motion and waits for its end, which `target` describes.
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
    target: Target,
    config: MotionConfig,
) -> impl Procedure<Output = Motion, Error = StepError> {
    let steps = MoveSteps::new(handles, MotionQueue::new(config), Some((motion, target)), Until::Ended);
    Sequence::new(steps, |queue: MotionQueue| queue.ended.unwrap_or(Motion::Unknown))
}

/// Until when [`run_queue`] runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Until {
    /// Until the last motion has begun, or the robot rests.
    Begun,
    /// Until the robot rests.
    Ended,
}

/// Adds a motion to a queue, if there is one, and runs until the last motion has begun or the robot rests.
///
/// The controller gets the motion before the running motion ends, so the robot does not stop between them if the pass of the
/// first allows it. From rest at the end of the previous motion, it starts immediately. If the robot was stopped before that
/// end, the motion is not sent, and the queue has [ended](MotionQueue::ended).
///
/// [`Motion::Arrived`] means that the robot rests at the end of the last motion. One halt can go undetected: it stops a motion
/// completely between the last poll and the acceptance of the next motion, which the robot then executes from there. A
/// controller that is braking, or has an error after the halt, refuses that motion, and it is not sent again.
///
/// # Cancel safety
///
/// Same as [`move_and_wait`].
pub fn run_queue<D: Encode, O: AsRef<str>>(
    handles: Handles,
    queue: MotionQueue,
    motion: Option<(MotionStart<D, O>, Target)>,
    until: Until,
) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    Sequence::new(MoveSteps::new(handles, queue, motion, until), identity)
}

/// Maximum pause between two polls while waiting for the beginning of a motion.
const BEGIN_INTERVAL: Duration = Duration::from_millis(5);
/// The bits of SysState for an error, for the emergency stop, and for a motion.
const ERROR: i32 = 1 << 1;
const EMERGENCY_STOP: i32 = 1 << 10;
pub(super) const MOVING: i32 = 0b11 << 20;
/// The answer to a command while the emergency stop is pressed.
const STOPPED: HResult = HResult::from_u32(0x8150_101A);

struct MoveSteps<D, O> {
    handles: Handles,
    motion: Option<(MotionStart<D, O>, Target)>,
    queue: MotionQueue,
    goal: Until,
    /// Whether the motion is still to be sent.
    unsent: bool,
    /// Whether an earlier motion may be running.
    follows: bool,
    /// Whether the controller was busy: it may be braking for a halt, so the motion is sent from rest only.
    busy: bool,
    step: Step,
    /// The value that the target needs, read before the motion.
    reading: End,
    /// The joints of this poll, and the position of the tool.
    joints: [f64; JOINTS],
    position: Option<Position>,
    /// The destination that DestJnt returned in this poll.
    seen: Option<[f64; JOINTS]>,
    /// When the last reply arrived.
    now: Instant,
    /// The index of the error to read.
    error: i32,
    /// Whether an error of the controller ends the motion, and whether the halt after it was refused. Then the robot is polled
    /// until it rests.
    has_error: bool,
    watches: bool,
    /// Whether the emergency stop is pressed. Not every controller reports that as an error.
    is_emergency: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    /// The readings before a motion: the variable, and from rest the joints and the tool.
    Variable,
    Start,
    StartFrame,
    Move,
    Pause(Instant),
    State,
    Destination,
    Position,
    Tool,
    Frame,
    ErrorCount,
    ErrorInfo,
    Halt,
    End,
}

impl<D, O> MoveSteps<D, O> {
    fn new(handles: Handles, mut queue: MotionQueue, motion: Option<(MotionStart<D, O>, Target)>, goal: Until) -> Self {
        let unsent = motion.is_some();
        if unsent && queue.ended == Some(Motion::Arrived) {
            queue.ended = None;
        }
        let follows = !queue.is_new();
        let step = match &motion {
            _ if queue.ended.is_some() => Step::End,
            Some((_, target)) if matches!(target.before(false), Some(Before::Variable(_))) => Step::Variable,
            _ if follows => Step::State,
            Some(_) => Step::Start,
            None => Step::End,
        };
        let (joints, position, seen, now) = ([0.0; JOINTS], None, None, Instant::ZERO);
        let reading = End::Unknown;
        Self {
            handles,
            motion,
            queue,
            goal,
            unsent,
            follows,
            busy: false,
            step,
            reading,
            joints,
            position,
            seen,
            now,
            error: 0,
            has_error: false,
            watches: false,
            is_emergency: false,
        }
    }

    fn target(&self) -> Target {
        self.motion.as_ref().map_or(Target::UNKNOWN, |(_, target)| *target)
    }

    /// Returns whether the motion has not begun yet.
    fn begins(&self) -> bool {
        self.unsent || self.queue.begins
    }

    fn of_robot(&self, command: &'static str) -> NextStep<'_> {
        let execute = StepCall::new(FunctionId::ROBOT_EXECUTE).with(self.handles.robot.0);
        NextStep::Call(execute.with(command).with(Argument::Empty))
    }

    fn of_controller<'a>(&'a self, command: &'static str, parameter: Argument<'a>) -> NextStep<'a> {
        let execute = StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(self.handles.controller.0);
        NextStep::Call(execute.with(command).with(parameter))
    }

    fn end(&mut self, outcome: Motion) {
        self.queue.ended = Some(outcome);
        self.step = Step::End;
    }

    fn halt(&mut self, outcome: Motion) {
        self.queue.ended = Some(outcome);
        self.step = Step::Halt;
    }

    /// Waits for the next poll.
    fn pause(&mut self, now: Instant) {
        let MotionQueue { config, until, .. } = self.queue;
        let interval = if self.begins() { config.interval.min(BEGIN_INTERVAL) } else { config.interval };
        self.step = Step::Pause(now.saturating_add(interval).min(until));
    }

    /// Records the joints before a motion from rest.
    fn starts_at(&mut self, joints: [f64; JOINTS]) {
        self.joints = joints;
        let needs_frame = self.target().before(true) == Some(Before::Frame);
        self.step = if needs_frame { Step::StartFrame } else { Step::Move };
    }

    /// Records that the controller has accepted the motion.
    fn accepted(&mut self, now: Instant) {
        self.unsent = false;
        let target = self.target();
        let queue = &mut self.queue;
        if queue.is_new() {
            queue.until = now.saturating_add(queue.config.limit).min(LATEST);
        }
        if self.follows {
            queue.previous = queue.destination.or_else(|| queue.end.joints_from(&self.joints));
            queue.is_ambiguous = queue.previous.is_none();
            queue.end = target.resolve(&self.joints, self.reading, Some(queue.end));
            queue.is_loop = true;
        } else {
            (queue.previous, queue.is_ambiguous) = (None, false);
            queue.end = target.resolve(&self.joints, self.reading, None);
            (queue.is_loop, queue.moved) = (target.is_loop, false);
            (queue.rest, queue.still) = (Some(self.joints), 0);
        }
        queue.begins = self.follows || self.goal == Until::Begun;
        (queue.glimpsed, queue.destination) = (None, None);
        queue.start_until = now.saturating_add(queue.config.start);
        (self.follows, self.step) = (true, Step::State);
    }

    /// Records the position of this poll, and compares it with the end of the motion if the robot rests.
    fn update_position(&mut self, joints: [f64; JOINTS], now: Instant) {
        (self.joints, self.position) = (joints, None);
        let queue = &mut self.queue;
        queue.update_rest(&joints, now);
        if let Some(seen) = self.seen.take() {
            queue.update_destination(seen, &joints);
        }
        // from rest the robot can only move to the end of this motion
        let follows = queue.previous.is_some() || queue.is_ambiguous;
        if !follows && queue.reports_motion && queue.moved && matches!(queue.end, End::Joints(..)) {
            queue.begins = false;
        }
        if let Some(comparison) = queue.end.compare_joints(&joints, &queue.tolerance(now)) {
            return self.judge(comparison, now);
        }
        if queue.end == End::Unknown {
            let there = queue.is_at_destination(&joints) == Some(true);
            return self.judge(if there { Comparison::There } else { Comparison::Elsewhere }, now);
        }
        match queue.still {
            0 => self.judge(Comparison::Elsewhere, now),
            _ if queue.end.needs_position() => self.step = Step::Tool,
            _ => self.step = Step::Frame,
        }
    }

    /// Compares the position of the tool with the end of the motion.
    fn update_tool(&mut self, frame: Option<&Transform>, now: Instant) {
        let tolerance = self.queue.tolerance(now);
        let comparison = self.queue.end.compare_tool(self.position.as_ref(), frame, &tolerance);
        self.judge(comparison, now);
    }

    /// Chooses the next step from the position of this poll.
    fn judge(&mut self, comparison: Comparison, now: Instant) {
        let MotionQueue { reports_motion, moved, still, is_loop, .. } = self.queue;
        let there = comparison == Comparison::There;
        let stopped = self.queue.is_stopped(self.begins());
        // the robot rests at the end of the motion before
        let waits = self.queue.begins && self.queue.previous.is_some_and(|end| within(&self.joints, &end, AT_REST));
        // a motion may end where it begins, and a sequence may pass its end, so rest there is not always the end
        let rests = match (reports_motion, is_loop) {
            (false, false) => still >= 1,
            (false, true) => still >= 1 && moved,
            (true, false) => moved && self.queue.is_still(self.begins()),
            (true, true) => false,
        };
        if rests && there {
            if !self.unsent {
                self.end(Motion::Arrived);
            } else if self.busy && now >= self.queue.until {
                // it refuses the next motion although the robot rests
                self.halt(Motion::TimedOut);
            } else {
                (self.follows, self.step) = (false, Step::Start);
            }
        } else if stopped && moved && !waits && !there {
            self.end(self.queue.outcome_elsewhere(&self.joints, comparison));
        } else if stopped && now >= self.queue.start_until {
            // a motion of no length cannot be distinguished from a motion that was not executed
            self.halt(if is_loop && !moved { Motion::Unknown } else { Motion::Halted });
        } else if now >= self.queue.until {
            self.halt(Motion::TimedOut);
        } else if self.unsent && !self.busy && reports_motion && !there {
            self.step = Step::Move;
        } else if self.goal == Until::Begun && !self.begins() {
            self.step = Step::End;
        } else {
            self.pause(now);
        }
    }

    /// Takes the state of the controller.
    fn update_state(&mut self, bits: i32) {
        self.queue.reports_motion = bits & MOVING != 0;
        self.is_emergency = bits & EMERGENCY_STOP != 0;
        self.step = match bits & (ERROR | EMERGENCY_STOP) {
            _ if self.watches => Step::Position,
            0 if self.queue.needs_destination() => Step::Destination,
            0 => Step::Position,
            _ => Step::ErrorCount,
        };
    }

    /// Takes the first error of the controller; `S_OK` if it has none.
    fn update_error(&mut self, code: HResult) {
        let outcome = match code {
            HResult::E_MOTION_STOPPED | HResult::S_OK if self.is_emergency => Motion::Failed(STOPPED),
            // the error that a halted motion leaves
            HResult::E_MOTION_STOPPED => Motion::Halted,
            HResult::S_OK => Motion::Failed(HResult::E_FAIL),
            code => Motion::Failed(code),
        };
        self.has_error = true;
        // a robot that has not moved yet may begin later
        let rests = self.queue.moved && self.queue.is_stopped(self.begins());
        if rests { self.end(outcome) } else { self.halt(outcome) }
    }

    /// Watches the robot until it rests. If it does not, it is halted again, and a second refusal is an error.
    fn watch(&mut self, joints: [f64; JOINTS], now: Instant) {
        self.queue.update_rest(&joints, now);
        if self.queue.is_stopped(false) {
            self.step = Step::End;
        } else if now >= self.queue.until {
            self.step = Step::Halt;
        } else {
            self.pause(now);
        }
    }
}

impl<D: Encode, O: AsRef<str>> MoveSteps<D, O> {
    /// Returns the call that starts the motion.
    fn start(&self) -> Option<StepCall<'_>> {
        let robot = self.handles.robot.0;
        Some(match &self.motion.as_ref()?.0 {
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
        })
    }
}

impl<D: Encode, O: AsRef<str>> Steps for MoveSteps<D, O> {
    type Output = MotionQueue;
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> NextStep<'_> {
        match self.step {
            Step::Variable => match self.target().before(false) {
                Some(Before::Variable(variable)) => {
                    NextStep::Call(StepCall::new(FunctionId::VARIABLE_GET_VALUE).with(variable.0))
                }
                _ => NextStep::End,
            },
            Step::Start | Step::Position => self.of_robot("CurJnt"),
            Step::StartFrame | Step::Frame => self.of_robot("CurTrn"),
            Step::Move => self.start().map_or(NextStep::End, NextStep::Call),
            Step::Pause(until) => NextStep::Wait(until),
            Step::State => self.of_controller("SysState", Argument::Empty),
            Step::Destination => self.of_robot("DestJnt"),
            Step::Tool => self.of_robot("CurPos"),
            Step::ErrorCount => self.of_controller("GetCurErrorCount", Argument::Empty),
            Step::ErrorInfo => self.of_controller("GetCurErrorInfo", Argument::Int(self.error)),
            Step::Halt => NextStep::Call(StepCall::new(FunctionId::ROBOT_HALT).with(self.handles.robot.0).with("")),
            Step::End => NextStep::End,
        }
    }

    fn waited(&mut self) {
        self.step = Step::State;
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        self.now = now;
        match self.step {
            Step::Variable => {
                self.reading = End::of_value(&reply.value().unwrap_or(Variant::Empty));
                self.step = if self.follows { Step::State } else { Step::Start };
            }
            Step::Start => self.starts_at(joints(reply)?),
            Step::StartFrame => {
                self.reading = End::of_value(&reply.value().unwrap_or(Variant::Empty));
                self.step = Step::Move;
            }
            Step::Move => self.accepted(now),
            Step::State => self.update_state(Int::read(reply.args).map_err(StepCause::Reply)?),
            Step::Destination => (self.seen, self.step) = (Some(joints(reply)?), Step::Position),
            Step::Position if self.watches => self.watch(joints(reply)?, now),
            Step::Position => self.update_position(joints(reply)?, now),
            Step::Tool => {
                self.position = Some(pose(reply)?);
                if self.queue.end.needs_frame() { self.step = Step::Frame } else { self.update_tool(None, now) }
            }
            Step::Frame => self.update_tool(Some(&pose(reply)?), now),
            Step::ErrorCount => {
                // the last error of the list is the oldest, so the first cause
                self.error = Int::read(reply.args).map_err(StepCause::Reply)?.saturating_sub(1);
                if self.error >= 0 { self.step = Step::ErrorInfo } else { self.update_error(HResult::S_OK) }
            }
            Step::ErrorInfo => {
                let value = Any::read(reply.args).map_err(StepCause::Reply)?;
                let code = value.as_array().and_then(|array| array.iter().next()).as_ref().and_then(code);
                self.update_error(code.unwrap_or(HResult::E_FAIL));
            }
            Step::Halt | Step::Pause(_) | Step::End => self.step = Step::End,
        }
        Ok(())
    }

    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        let cause = cause?;
        let moves = self.follows || (self.step == Step::Move && cause.may_have_run());
        moves.then_some(Undo::Halt(self.handles.robot.0))
    }

    /// A controller that is braking, or whose queue is full, is busy: the position at rest determines the next step. A
    /// controller without a reading leaves the end of the motion unknown.
    fn recovered(&mut self, cause: &StepCause) -> bool {
        let StepCause::Refused(code) = *cause else { return false };
        match self.step {
            Step::Move if code == HResult::E_ROBOTISBUSY && !self.queue.is_new() => {
                self.busy = true;
                self.pause(self.now);
            }
            Step::Variable => self.step = if self.follows { Step::State } else { Step::Start },
            Step::StartFrame => self.step = Step::Move,
            Step::Halt if self.has_error && !self.watches => {
                self.watches = true;
                self.queue.until = self.now.saturating_add(self.queue.config.start);
                self.step = Step::State;
            }
            _ => return false,
        }
        true
    }

    fn output(&mut self) -> MotionQueue {
        self.queue
    }
}

/// Reads a position or a transform.
fn pose<T: for<'a> FromVariant<'a>>(reply: &Frame<'_>) -> Result<T, StepCause> {
    let value = Any::read(reply.args).map_err(StepCause::Reply)?;
    let wrong = StepCause::Reply(ReplyError { expected: "a position", found: Some(value.vartype()) });
    value.convert().map_err(|_| wrong)
}

/// Reads a position of at least one joint. Rejects NaN: every comparison with it is false, so the robot would never arrive
/// or rest.
pub(super) fn joints(reply: &Frame<'_>) -> Result<[f64; JOINTS], StepCause> {
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
pub(super) fn code(value: &Variant<'_>) -> Option<HResult> {
    match *value {
        Variant::I4(n) => Some(HResult(n)),
        Variant::Ui4(n) => Some(HResult(n.cast_signed())),
        Variant::Error(code) => Some(code),
        Variant::I8(n) => u32::try_from(n).map(u32::cast_signed).or_else(|_| i32::try_from(n)).ok().map(HResult),
        _ => None,
    }
}
