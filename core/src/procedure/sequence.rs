//! Sequences of calls, on which the procedures are based: calls in order, and their undo calls after a failure.
//!
//! ```text
//!  Forward ── next() is End, handles are kept ──────────────────► Done(Ok)
//!     │  └─── next() is End, handles are not kept ──► Backward ──► Done(Ok)
//!     └────── a call fails ─────────────────────────► Backward ──► Done(Err)
//! ```
//!
//! Backward undoes the calls in reverse order: it releases handles, gives the arm back, halts a motion, switches
//! the motor off. The sequence reports the first failure, and whether all undo calls were executed. While the controller is
//! busy with an abandoned call, they are repeated.

use core::time::Duration;

use super::action::{Action, Channel, Procedure};
use super::failure::{Failure, StepCause, StepError};
use crate::bcap::call::{Call, Maybe, handle_of};
use crate::bcap::{Frame, FrameWriter, FunctionId, Object};
use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::time::Instant;
use crate::variant::Encode;

/// Maximum number of undo entries of a sequence: a service, a controller, and the objects on the deepest path.
pub(super) const UNDO_MAX: usize = 8;

/// How long a call is repeated while the controller is busy, and the pause between its attempts.
pub(crate) const BUSY_LIMIT: Duration = Duration::from_secs(5);
pub(crate) const BUSY_PAUSE: Duration = Duration::from_millis(10);

/// A call that undoes the effect of another call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Undo {
    /// Releases this object; the handle of the service is not used.
    Release(Object, i32),
    /// Gives the arm of this robot back.
    GiveArm(i32),
    /// Halts this robot.
    Halt(i32),
    /// Switches the motor of this robot off.
    MotorOff(i32),
}

/// The parameter of Motor: off, and reply when the motor is off.
pub(super) const MOTOR_OFF: [i32; 2] = [0, 0];

impl Undo {
    fn call<'a>(self) -> StepCall<'a> {
        match self {
            Self::Release(Object::Service, _) => StepCall::new(FunctionId::SERVICE_STOP),
            Self::Release(object, handle) => StepCall::new(object.released_by()).with(handle),
            Self::GiveArm(robot) => {
                StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot).with("GiveArm").with(Argument::Empty)
            }
            Self::Halt(robot) => StepCall::new(FunctionId::ROBOT_HALT).with(robot).with(""),
            Self::MotorOff(robot) => {
                StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot).with("Motor").with(Argument::Value(&MOTOR_OFF))
            }
        }
    }
}

/// The next step of a sequence.
pub(super) enum NextStep<'a> {
    Call(StepCall<'a>),
    Wait(Instant),
    End,
}

/// The calls of a sequence and what their replies mean.
pub(super) trait Steps {
    /// The result of the sequence.
    type Output;

    /// Whether the objects that were opened stay open after a success.
    const KEEPS_OBJECTS: bool;

    /// Whether the calls are repeated while the controller is busy with an abandoned call, as undo calls are.
    const REPEATS: bool = false;

    /// Returns the next step; it stays the same until [`succeeded`](Self::succeeded).
    fn next(&self) -> NextStep<'_>;

    /// Takes the reply to a call that succeeded, and moves to the next step.
    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause>;

    /// Moves to the step after [`NextStep::Wait`].
    fn waited(&mut self) {}

    /// Returns the undo entry of the current call, in addition to the release of an object that it opened. `cause` is the
    /// reason of its failure; `None` after a success.
    fn undo(&self, cause: Option<&StepCause>) -> Option<Undo> {
        let _ = cause;
        None
    }

    /// Returns whether a call that succeeded has an effect that no undo entry ends.
    fn has_effect(&self) -> bool {
        false
    }

    /// Handles a failed call: `true` when the steps continue without it.
    fn recovered(&mut self, cause: &StepCause) -> bool {
        let _ = cause;
        false
    }

    /// Returns the result, after [`NextStep::End`].
    fn output(&mut self) -> Self::Output;
}

/// A call whose function and arguments are known at run time.
#[derive(Clone, Copy)]
pub(super) struct StepCall<'a> {
    function: FunctionId,
    arguments: [Argument<'a>; 5],
}

/// An argument of a step.
#[derive(Clone, Copy)]
pub(super) enum Argument<'a> {
    /// There are no further arguments.
    End,
    Empty,
    Int(i32),
    Text(&'a str),
    Value(&'a dyn Encode),
}

impl From<i32> for Argument<'_> {
    fn from(number: i32) -> Self {
        Self::Int(number)
    }
}

impl<'a> From<&'a str> for Argument<'a> {
    fn from(text: &'a str) -> Self {
        Self::Text(text)
    }
}

impl<'a> From<&'a dyn Encode> for Argument<'a> {
    fn from(value: &'a dyn Encode) -> Self {
        Self::Value(value)
    }
}

impl<'a> StepCall<'a> {
    /// Creates a call without arguments.
    pub(super) const fn new(function: FunctionId) -> Self {
        Self { function, arguments: [Argument::End; 5] }
    }

    /// Appends an argument. A call has at most five.
    pub(super) fn with(mut self, argument: impl Into<Argument<'a>>) -> Self {
        if let Some(free) = self.arguments.iter_mut().find(|slot| matches!(slot, Argument::End)) {
            *free = argument.into();
        }
        self
    }
}

impl Call for StepCall<'_> {
    type Reply = Maybe;

    fn function(&self) -> FunctionId {
        self.function
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.iter().try_for_each(|argument| match argument {
            Argument::End => Ok(()),
            Argument::Empty => frame.argument(&()),
            Argument::Int(number) => frame.argument(number),
            Argument::Text(text) => frame.argument(text),
            Argument::Value(value) => frame.argument(*value),
        })
    }
}

/// A running sequence; `M` converts the result of the steps to the result of the procedure.
pub(super) struct Sequence<S, M> {
    steps: S,
    map: M,
    undo: heapless::Vec<Undo, UNDO_MAX>,
    backward: bool,
    in_flight: bool,
    error: Option<StepError>,
    lost: bool,
    /// Whether a call of the way back may not have been carried out.
    unsure: bool,
    /// Until when, and when next, a call is repeated while the controller is busy.
    busy_until: Option<Instant>,
    again: Option<Instant>,
}

impl<S: Steps, M> Sequence<S, M> {
    pub(super) const fn new(steps: S, map: M) -> Self {
        Self {
            steps,
            map,
            undo: heapless::Vec::new(),
            backward: false,
            in_flight: false,
            error: None,
            lost: false,
            unsure: false,
            busy_until: None,
            again: None,
        }
    }

    /// Begins with objects that were opened before.
    pub(super) fn with_undo(mut self, undo: impl IntoIterator<Item = Undo>) -> Self {
        for undo in undo {
            // without room for it, the end of the session undoes it
            let _ = self.undo.push(undo);
        }
        self
    }

    /// Returns the steps, at the call that failed after a failure.
    pub(super) const fn steps(&self) -> &S {
        &self.steps
    }

    fn next(&self) -> NextStep<'_> {
        if !self.backward {
            return self.steps.next();
        }
        match self.undo.last() {
            Some(undo) if !self.lost => NextStep::Call(undo.call()),
            _ => NextStep::End,
        }
    }

    fn advance(&mut self, function: FunctionId, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        if let Some(undo) = self.steps.undo(None) {
            self.push(undo)?;
        }
        if let Some(object) = function.opens() {
            let handle = if object == Object::Service { 0 } else { handle_of(reply.args).map_err(StepCause::Reply)? };
            self.push(Undo::Release(object, handle))?;
        }
        self.steps.succeeded(reply, now)
    }

    fn push(&mut self, undo: Undo) -> Result<(), StepCause> {
        self.undo.push(undo).map_err(|_| StepCause::TooLarge)
    }

    fn fail(&mut self, function: FunctionId, cause: StepCause) {
        if let Some(undo) = self.steps.undo(Some(&cause)) {
            // without room for it, the end of the session undoes it
            let _ = self.undo.push(undo);
        }
        self.error = Some(StepError { function, cause, undone: true, unsettled: false });
        self.backward = true;
    }

    /// Repeats the call in flight after a pause, unless the controller has been busy for too long.
    fn repeats(&mut self, now: Instant) -> bool {
        let until = *self.busy_until.get_or_insert(now.saturating_add(BUSY_LIMIT));
        self.again = Some(now.saturating_add(BUSY_PAUSE)).filter(|again| *again <= until);
        self.again.is_some()
    }

    /// Handles the end of a call of the way back.
    fn ended_undo(&mut self, code: Option<HResult>, is_busy: bool) {
        if self.lost {
            return;
        }
        let undo = self.undo.pop();
        self.unsure |= match code {
            Some(code) if code.is_ok() => false,
            // an arm or an object that the controller refuses to release is not there
            Some(code) => {
                is_busy || code == HResult::E_TIMEOUT || matches!(undo, Some(Undo::Halt(_) | Undo::MotorOff(_)))
            }
            None => true,
        };
    }

    /// Handles the end of the call in flight.
    fn ended(&mut self, failure: Option<Failure>, reply: Option<&Frame<'_>>, now: Instant) {
        if !core::mem::take(&mut self.in_flight) {
            return;
        }
        let code = reply.map(Frame::hresult);
        let is_busy = match code {
            Some(HResult::E_BUSY_PROC) => self.backward || S::REPEATS,
            // it brakes
            Some(HResult::E_ROBOTISBUSY) => self.backward,
            _ => false,
        };
        if is_busy && self.repeats(now) {
            return;
        }
        if self.backward {
            return self.ended_undo(code, is_busy);
        }
        let NextStep::Call(StepCall { function, .. }) = self.steps.next() else { return };
        if function.releases().is_some() {
            // the object that was opened last; its release is sent once, as in the undo calls
            self.undo.pop();
        }
        let result = match (reply, failure) {
            (Some(reply), _) if reply.hresult().is_err() => Err(StepCause::Refused(reply.hresult())),
            (Some(reply), _) => self.advance(function, reply, now),
            (None, failure) => Err(StepCause::Failed(failure.unwrap_or(Failure::Timeout))),
        };
        if let Err(cause) = result
            && !self.steps.recovered(&cause)
        {
            self.fail(function, cause);
        }
    }
}

impl<S: Steps, M: FnMut(S::Output) -> T, T> Procedure for Sequence<S, M> {
    type Output = T;
    type Error = StepError;

    fn poll(&mut self, now: Instant) -> Action<Result<T, StepError>> {
        if let Some(again) = self.again.filter(|again| now < *again) {
            return Action::Wait(again);
        }
        self.again = None;
        loop {
            match self.next() {
                NextStep::Call(_) => {
                    self.in_flight = true;
                    return Action::Call(Channel::Motion);
                }
                NextStep::Wait(until) if now < until => return Action::Wait(until),
                NextStep::Wait(_) => self.steps.waited(),
                NextStep::End if !self.backward && !S::KEEPS_OBJECTS && !self.undo.is_empty() => self.backward = true,
                NextStep::End => {
                    return Action::Done(match self.error {
                        Some(error) => {
                            let unsettled = self.unsure || !self.undo.is_empty();
                            let undone = !unsettled && !self.steps.has_effect();
                            Err(StepError { undone, unsettled, ..error })
                        }
                        None => Ok((self.map)(self.steps.output())),
                    });
                }
            }
        }
    }

    fn request(&self) -> Option<impl Call> {
        match self.next() {
            NextStep::Call(call) if self.in_flight => Some(call),
            _ => None,
        }
    }

    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant) {
        self.ended(None, Some(reply), now);
    }

    fn handle_failure(&mut self, failure: Failure, now: Instant) {
        self.lost |= matches!(failure, Failure::Lost | Failure::Closed);
        self.ended(Some(failure), None, now);
    }
}
