//! Starting a motion, letting others follow it, and waiting for the end.
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
//!
//! A motion that follows another one:
//!
//! ```text
//!  SysState ─► CurJnt: under way to A ─► Robot_Move NEXT to B ─► (pause ─► SysState ─► DestJnt ─► CurJnt)*
//!     DestJnt is A, and the robot moves: it was not halted before B was accepted
//!     DestJnt is B twice, and the robot moves: it has reached A, and B is the destination from now on
//! ```
//!
//! DestJnt is the destination of the motion under way, so it tells B only when the motion to B has begun. After a halt it may
//! be the place where the robot rests, so it counts only while the robot moves and is not there. At most one motion waits
//! behind the one under way: with more, a destination could be missed.

use core::convert::identity;
use core::time::Duration;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::provider::Handles;
use super::queue::{AT_REST, JOINTS, Motion, MotionConfig, MotionQueue, within};
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

/// Starts a motion and waits for its end.
///
/// The arm must be taken and the motor on. When a call fails after the motion may have started, the robot is halted,
/// because its state is unknown. A motion on hold counts as a motion until the time limit passes.
///
/// One halt cannot be detected: one that comes before the robot has moved by the tolerance, and before DestJnt is read, one
/// round trip after the start. It looks like a motion to the place where the robot is, and ends as [`Motion::Arrived`].
/// [`run_queue`] with [`Until::Begun`] does not have this gap, because it does not accept motions of no length.
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
    let steps = MoveSteps::new(handles, MotionQueue::new(config), Some(motion), Until::Ended);
    Sequence::new(steps, |queue: MotionQueue| queue.ended.unwrap_or(Motion::Halted))
}

/// Until when [`run_queue`] runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Until {
    /// Until the last motion has begun, or the robot was stopped before.
    Begun,
    /// Until the robot rests.
    Ended,
}

/// Adds a motion to a queue, if there is one, and runs until the last motion has begun or the robot rests.
///
/// The controller gets the motion before the one under way ends, so it moves from one to the next without a stop if the
/// pass of the first allows it. From rest at the destination the motion starts at once. If the robot was stopped before
/// that destination, the motion is not sent, and the queue has [ended](MotionQueue::ended).
///
/// A motion of a queue counts only if two polls see it under way, because DestJnt then tells where it ends. One that ends where
/// it begins is never seen, nor is one that is shorter than the polls: both end as [`Motion::Halted`], and so does one that was
/// accepted so late that a halt before it cannot be excluded. The robot is halted then.
///
/// # Cancel safety
///
/// As [`move_and_wait`].
pub fn run_queue<D: Encode, O: AsRef<str>>(
    handles: Handles,
    queue: MotionQueue,
    motion: Option<MotionStart<D, O>>,
    until: Until,
) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    Sequence::new(MoveSteps::new(handles, queue, motion, until), identity)
}

/// The longest pause between two polls while the beginning of a motion is waited for.
const BEGIN_INTERVAL: Duration = Duration::from_millis(5);
/// The bits of SysState for an error, for the emergency stop, and for a motion.
const ERROR: i32 = 1 << 1;
const EMERGENCY_STOP: i32 = 1 << 10;
pub(super) const MOVING: i32 = 0b11 << 20;

struct MoveSteps<D, O> {
    handles: Handles,
    motion: Option<MotionStart<D, O>>,
    queue: MotionQueue,
    goal: Until,
    /// Whether the motion is still to be sent.
    unsent: bool,
    /// Whether the motion must be seen to begin.
    strict: bool,
    follow: Follow,
    step: Step,
    /// What DestJnt said in this poll.
    seen: [f64; JOINTS],
    /// When the last reply arrived.
    now: Instant,
    /// The index of the error to ask for.
    error: i32,
}

/// What is known of a motion of a queue that was accepted and has not begun.
#[derive(Clone, Copy, PartialEq)]
enum Follow {
    /// There is no such motion.
    None,
    /// It was accepted behind another motion. The robot may have been halted before.
    Accepted,
    /// It was accepted at rest, or the motion before was still under way after that.
    InOrder,
    /// The robot was once seen to move to this destination.
    Seen([f64; JOINTS]),
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
    fn new(handles: Handles, queue: MotionQueue, motion: Option<MotionStart<D, O>>, goal: Until) -> Self {
        let unsent = motion.is_some();
        let step = match queue.ended {
            None if !queue.is_new() => Step::State,
            None if unsent => Step::Move,
            _ => Step::End,
        };
        let strict = goal == Until::Begun || !queue.is_new();
        let (follow, seen, now) = (Follow::None, [0.0; JOINTS], Instant::ZERO);
        Self { handles, motion, queue, goal, unsent, strict, follow, step, seen, now, error: 0 }
    }

    /// Tells whether the motion has not begun yet.
    fn begins(&self) -> bool {
        self.unsent || self.follow != Follow::None
    }

    fn of_robot(&self, command: &'static str) -> Next<'_> {
        let execute = StepCall::new(FunctionId::ROBOT_EXECUTE).with(self.handles.robot.0);
        Next::Call(execute.with(command).with(Argument::Empty))
    }

    fn of_controller<'a>(&'a self, command: &'static str, parameter: Argument<'a>) -> Next<'a> {
        let execute = StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(self.handles.controller.0);
        Next::Call(execute.with(command).with(parameter))
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

    /// Compares the robot's position with its destination and with earlier positions.
    fn update_position(&mut self, joints: &[f64; JOINTS], now: Instant) {
        self.queue.update_rest(joints, now);
        if self.follow != Follow::None {
            self.update_follow(joints, now);
            return;
        }
        let MotionQueue { reports_motion, moved, still, .. } = self.queue;
        let there = self.queue.is_at_destination(joints);
        let stopped = self.queue.is_stopped(self.begins());
        // a motion may end where it began, so rest there does not count as arrival while SysState reports a motion
        if still >= 1 && there && (moved || !reports_motion) && self.unsent {
            // the next motion starts from rest
            (self.queue.destination, self.step) = (None, Step::Move);
        } else if still >= 1 && there && (moved || !reports_motion) {
            self.end(Motion::Arrived);
        } else if stopped && moved {
            self.end(Motion::Halted);
        } else if stopped && now >= self.queue.start_until {
            self.halt(Motion::Halted);
        } else if now >= self.queue.until {
            self.halt(Motion::TimedOut);
        } else if self.unsent && reports_motion && !there {
            self.step = Step::Move;
        } else {
            self.pause(now);
        }
    }

    /// Looks for the beginning of a motion of a queue.
    fn update_follow(&mut self, joints: &[f64; JOINTS], now: Instant) {
        let MotionQueue { reports_motion, config, destination, .. } = self.queue;
        let changed = destination.is_none_or(|before| !within(&self.seen, &before, AT_REST));
        let begins = reports_motion && changed && !within(joints, &self.seen, config.tolerance);
        match self.follow {
            Follow::Accepted if changed => return self.halt(Motion::Halted),
            Follow::Accepted if reports_motion => self.follow = Follow::InOrder,
            Follow::Seen(seen) if begins && within(&self.seen, &seen, AT_REST) => {
                self.queue.aim(seen);
                (self.follow, self.step) = (Follow::None, Step::State);
                if self.goal == Until::Begun {
                    self.step = Step::End;
                }
                return;
            }
            Follow::InOrder | Follow::Seen(_) if begins => self.follow = Follow::Seen(self.seen),
            _ => {}
        }
        let elsewhere = destination.is_some() && !self.queue.is_at_destination(joints);
        if self.queue.is_stopped(self.begins()) && (elsewhere || now >= self.queue.start_until) {
            self.halt(Motion::Halted);
        } else if now >= self.queue.until {
            self.halt(Motion::TimedOut);
        } else {
            self.pause(now);
        }
    }

    /// Records that the controller has accepted the motion.
    fn accepted(&mut self, now: Instant) {
        self.unsent = false;
        let queue = &mut self.queue;
        if queue.is_new() {
            queue.until = now.saturating_add(queue.config.limit);
        }
        if queue.destination.is_some() {
            (self.follow, self.step) = (Follow::Accepted, Step::State);
            return;
        }
        (queue.start_until, queue.rest, queue.moved) = (now.saturating_add(queue.config.start), None, false);
        (self.follow, self.step) =
            if self.strict { (Follow::InOrder, Step::State) } else { (Follow::None, Step::Destination) };
    }

    /// Records what DestJnt said.
    fn aimed(&mut self, destination: [f64; JOINTS]) {
        self.seen = destination;
        if self.follow == Follow::None {
            self.queue.aim(destination);
            self.step = Step::State;
        } else {
            self.step = Step::Position;
        }
    }
}

impl<D: Encode, O: AsRef<str>> MoveSteps<D, O> {
    /// Returns the call that starts the motion.
    fn start(&self) -> Option<StepCall<'_>> {
        let robot = self.handles.robot.0;
        Some(match self.motion.as_ref()? {
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

    fn next(&self) -> Next<'_> {
        match self.step {
            Step::Move => self.start().map_or(Next::End, Next::Call),
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
        self.now = now;
        match self.step {
            Step::Move => self.accepted(now),
            Step::Destination => self.aimed(joints(reply)?),
            Step::State => {
                let bits = Int::read(reply.args).map_err(StepCause::Reply)?;
                self.queue.reports_motion = bits & MOVING != 0;
                self.step = match self.follow {
                    _ if bits & (ERROR | EMERGENCY_STOP) != 0 => Step::ErrorCount,
                    Follow::None => Step::Position,
                    _ => Step::Destination,
                };
            }
            Step::Position => self.update_position(&joints(reply)?, now),
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
        let moves = self.step != Step::Move || self.queue.destination.is_some() || cause.may_have_run();
        moves.then_some(Undo::Halt(self.handles.robot.0))
    }

    /// A controller that is braking, or whose queue is full, is busy: the robot's state tells what follows.
    fn recovered(&mut self, cause: &StepCause) -> bool {
        let busy = *cause == StepCause::Refused(HResult::E_ROBOTISBUSY);
        let waits = busy && self.step == Step::Move && self.queue.destination.is_some();
        if waits {
            self.pause(self.now);
        }
        waits
    }

    fn output(&mut self) -> MotionQueue {
        self.queue
    }
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
fn code(value: &Variant<'_>) -> Option<HResult> {
    match *value {
        Variant::I4(n) => Some(HResult(n)),
        Variant::Ui4(n) => Some(HResult(n.cast_signed())),
        Variant::Error(code) => Some(code),
        Variant::I8(n) => u32::try_from(n).map(u32::cast_signed).or_else(|_| i32::try_from(n)).ok().map(HResult),
        _ => None,
    }
}
