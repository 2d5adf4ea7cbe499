//! The end of a stream: Slave Mode, the motion, the motor and the arm are released in this order.

use super::{Engine, Health, Phase};
use crate::hresult::HResult;
use crate::procedure::{BUSY_LIMIT, BUSY_PAUSE};
use crate::slave::call::Step;
use crate::slave::fault::{Cause, Released};
use crate::time::Instant;

impl<const N: usize> Engine<N> {
    pub(super) fn leave(&mut self) {
        self.phase = Phase::Leaving;
        self.step = Step::Leave;
        self.busy_until = None;
    }

    /// Returns whether the controller is busy with an abandoned call, so that the current step is repeated.
    fn repeats(&mut self, code: HResult, now: Instant) -> bool {
        code == HResult::E_BUSY_PROC && now < *self.busy_until.get_or_insert(now.saturating_add(BUSY_LIMIT))
    }

    /// Returns when the next step of the end may be sent, after the controller was busy.
    pub(super) fn again_at(&self) -> Option<Instant> {
        self.busy_until.map(|_| self.sent_at.saturating_add(BUSY_PAUSE))
    }

    /// Moves to the next step of the end, or ends.
    pub(super) fn release(&mut self, after: Option<Step>) {
        const ORDER: [Step; 4] = [Step::Leave, Step::Halt, Step::MotorOff, Step::GiveArm];
        if after.is_none() {
            self.busy_until = None;
        }
        let done =
            after.and_then(|step| ORDER.iter().position(|other| *other == step)).map_or(0, |at| at.saturating_add(1));
        let next = ORDER.into_iter().skip(done).find(|step| self.is_unreleased(*step));
        // these calls would end the stream of another client
        let is_foreign =
            !self.may_be_in_mode && self.fault.as_ref().is_some_and(|fault| fault.released == Released::No);
        match next.filter(|_| !is_foreign) {
            // it cannot be released
            Some(_) if self.motion == Health::Lost => self.phase = Phase::Faulted,
            Some(step) => (self.phase, self.step) = (Phase::Leaving, step),
            None => self.end_release(),
        }
    }

    /// Returns whether a step of the end has something to undo.
    const fn is_unreleased(&self, step: Step) -> bool {
        match step {
            Step::Leave => self.gives_up && self.may_be_in_mode,
            // after a stop the robot is at rest
            Step::Halt => self.gives_up && self.may_move,
            Step::MotorOff => self.has_motor && self.config.motor_off,
            _ => self.has_arm,
        }
    }

    fn end_release(&mut self) {
        match self.unreleased.take() {
            None => self.phase = Phase::Finished,
            // the fault that ended the stream says more
            Some(_) if self.gives_up => self.phase = Phase::Faulted,
            Some((step, cause)) => {
                self.step = step;
                self.fail(cause);
            }
        }
    }

    /// Continues after a failed step of the end: the remaining steps are more urgent than reporting its cause.
    pub(super) fn keep_unreleased(&mut self, cause: Cause) {
        self.unreleased.get_or_insert((self.step, cause));
        self.release(Some(self.step));
    }

    pub(super) fn handle_leave(&mut self, code: HResult, now: Instant) {
        if self.repeats(code, now) {
            return;
        }
        let is_off = self.gives_up && self.step == Step::Leave && code == HResult::E_SLVMODE_OFF;
        if code.is_err() && !is_off {
            return match self.step {
                Step::Leave if !self.gives_up => self.fail(Cause::Refused(code)),
                _ => self.keep_unreleased(Cause::Refused(code)),
            };
        }
        match self.step {
            Step::Leave => {
                self.may_be_in_mode = false;
                // a stop leaves Slave Mode at rest
                self.may_move &= self.gives_up;
            }
            Step::Halt => self.may_move = false,
            Step::MotorOff => self.has_motor = false,
            _ => self.has_arm = false,
        }
        self.release(Some(self.step));
    }
}
