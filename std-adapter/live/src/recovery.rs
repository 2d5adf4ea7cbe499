//! An interactive recovery of a robot: each step waits for the user's confirmation.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_core::procedure::{NotRecovered, RecoveryConfig, RecoveryStep, RecoveryStepSet, StepCause};
use bcap_std::blocking::{Arm, Controller};

use crate::link::{Access, Error, Link};

/// The maximum time from one step to the next.
pub const IDLE: Duration = Duration::from_secs(120);

/// The state that a page and the thread of a recovery share. It cannot be restarted.
#[derive(Debug, Default)]
pub struct Recovery {
    state: Mutex<State>,
    changed: Condvar,
}

/// The state of a recovery.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// The steps of this model and state, in their order.
    pub plan: Vec<RecoveryStep>,
    /// The completed steps, each with `Err` and the code if the controller does not support it.
    pub done: Vec<(RecoveryStep, Result<(), HResult>)>,
    /// The most recent step that the user confirmed.
    agreed: Option<RecoveryStep>,
    /// Why it ends.
    end: Option<String>,
    /// How it has ended.
    pub outcome: Option<Result<&'static str, String>>,
}

impl State {
    /// Returns the next step; `None` after the last one.
    #[must_use]
    pub fn next(&self) -> Option<RecoveryStep> {
        self.plan.iter().copied().find(|step| !self.is_done(*step))
    }

    fn is_done(&self, step: RecoveryStep) -> bool {
        self.done.iter().any(|(done, _)| *done == step)
    }

    /// Returns whether the confirmed step is still pending.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.agreed.is_some_and(|agreed| !self.is_done(agreed))
    }
}

impl Recovery {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the state.
    #[must_use]
    pub fn state(&self) -> State {
        self.lock().clone()
    }

    /// Confirms the next step, by its name.
    ///
    /// # Errors
    ///
    /// A text if this is not the next step, or the previous step is still pending.
    pub fn agree(&self, name: &str) -> Result<(), String> {
        let mut state = self.lock();
        match state.next().filter(|step| step.name() == name) {
            _ if state.outcome.is_some() || state.end.is_some() => Err("the recovery has ended; begin it again".into()),
            _ if state.is_busy() => Err("the step before is not made yet; wait a moment".into()),
            None => Err(format!("{name} is not the next step; nothing was done")),
            Some(step) => {
                state.agreed = Some(step);
                self.changed.notify_all();
                Ok(())
            }
        }
    }

    /// Ends the recovery after the running step. A motor that it has switched on is switched off. Returns whether this is the
    /// first call.
    pub fn end(&self, why: &str) -> bool {
        let mut state = self.lock();
        let is_first = state.end.is_none();
        state.end.get_or_insert_with(|| why.to_owned());
        self.changed.notify_all();
        is_first
    }

    /// Returns whether the running step can move the robot by itself: MotionPreparation of a COBOTTA. [`end`](Self::end) does
    /// not stop it, so after an end the caller halts the robot over another session while this is `true`.
    #[must_use]
    pub fn moves(&self) -> bool {
        let state = self.lock();
        state.outcome.is_none() && state.is_busy() && state.agreed == Some(RecoveryStep::MotionPreparation)
    }

    /// Waits until the user confirms the next step. Breaks if the recovery ends.
    fn wait(&self) -> ControlFlow<()> {
        let mut state = self.lock();
        let until = Instant::now() + IDLE;
        loop {
            if state.end.is_some() {
                // a confirmed step is no longer executed
                state.agreed = None;
                return ControlFlow::Break(());
            }
            if state.is_busy() || state.next().is_none() {
                return ControlFlow::Continue(());
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                state.end = Some(format!("no step was made for {} s", IDLE.as_secs()));
            }
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn made(&self, step: RecoveryStep, result: Result<(), HResult>) -> ControlFlow<()> {
        self.lock().done.push((step, result));
        self.wait()
    }
}

/// Recovers a robot over a new session, one step for each [confirmation](Recovery::agree). At the end a motor that was switched
/// on is off again, and the arm is free.
pub fn run(access: &Access, recovery: &Recovery) {
    let panicked =
        |_| Ok(Err("IT IS UNKNOWN whether the motor is off and the arm is free: the recovery panicked".into()));
    let performed = catch_unwind(AssertUnwindSafe(|| perform(access, recovery))).unwrap_or_else(panicked);
    let outcome = performed.unwrap_or_else(|error| Err(error.to_string()));
    let mut state = recovery.lock();
    state.outcome = Some(match (outcome, state.end.take()) {
        (outcome, None) => outcome,
        (Ok(_), Some(why)) => Err(format!("ended: {why}; errors that were cleared stay cleared")),
        (Err(error), Some(why)) => Err(format!("ended: {why}; errors that were cleared stay cleared; {error}")),
    });
}

/// Plans the steps, and executes them. Fails if nothing was changed; the inner error is a later failure.
fn perform(access: &Access, recovery: &Recovery) -> Result<Result<&'static str, String>, Error> {
    let mut controller = Link::for_motion(access)?;
    let state = controller.robot()?.examine()?;
    if let Some(obstacle) = state.obstacles().next() {
        return Err(Error::Invalid(obstacle.to_string()));
    }
    if state.is_ready() {
        return Ok(Ok("nothing to recover"));
    }
    recovery.lock().plan = state.steps(false).collect();
    if recovery.wait().is_break() {
        return Ok(Ok("nothing was changed"));
    }
    Ok(make(&mut controller, recovery, state.steps(false).collect()))
}

/// Executes the steps of the plan, and gives the arm back.
fn make(controller: &mut Controller, recovery: &Recovery, plan: RecoveryStepSet) -> Result<&'static str, String> {
    // the user has confirmed that no other program uses the robot
    let config = RecoveryConfig { is_alone: true, speed: None, agreed: Some(plan) };
    let made = controller.make_ready(Some(config), |step, result| recovery.made(step, result)).map(Arm::keep);
    let is_unsettled = matches!(&made, Err(bcap_std::Error::NotRecovered(ended)) if ended.error.unsettled);
    let made = match made {
        // between two steps, for the reason of the caller
        Err(bcap_std::Error::NotRecovered(ended)) if is_stopped(&ended) => Ok(()),
        Err(error @ bcap_std::Error::NoReply { .. }) => {
            Err(format!("IT IS UNKNOWN whether the step was made: {error}"))
        }
        made => made.map_err(|error| error.to_string()),
    };
    let given = if controller.has_arm() {
        // after a lost connection the session still has it
        controller.arm().and_then(Arm::give).map_err(|error| error.to_string())
    } else if is_unsettled || controller.has_motor() {
        Err("a step could not be undone".to_owned())
    } else {
        Ok(())
    };
    let given = given.map_err(|error| format!("IT IS UNKNOWN whether the motor is off and the arm is free: {error}"));
    match (made, given) {
        (Ok(()), Ok(())) => Ok("recovered: no errors; the motor is as before, and the arm is free"),
        (Err(error), Ok(())) | (Ok(()), Err(error)) => Err(error),
        (Err(made), Err(given)) => Err(format!("{made}; {given}")),
    }
}

fn is_stopped(ended: &NotRecovered) -> bool {
    ended.obstacle.is_none() && ended.error.cause == StepCause::Stopped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_made_after_the_agreement_to_it() {
        let recovery = Recovery::default();
        recovery.lock().plan = vec![RecoveryStep::ClearError, RecoveryStep::TakeArm, RecoveryStep::Motor];
        assert_eq!(recovery.agree("Motor"), Err("Motor is not the next step; nothing was done".into()));
        recovery.agree("ClearError").unwrap();
        assert!(recovery.agree("ClearError").unwrap_err().contains("wait a moment"));
        // the owner of the arm is queried before the errors are cleared
        assert_eq!(recovery.made(RecoveryStep::TakeArm, Ok(())), ControlFlow::Continue(()));
        recovery.end("HALT was pressed");
        assert_eq!(recovery.made(RecoveryStep::ClearError, Ok(())), ControlFlow::Break(()));
        assert_eq!(recovery.state().next(), Some(RecoveryStep::Motor));
        assert!(recovery.agree("Motor").unwrap_err().contains("has ended"));
    }

    #[test]
    fn the_robot_moves_only_during_its_preparation() {
        let recovery = Recovery::default();
        recovery.lock().plan = vec![RecoveryStep::MotionPreparation, RecoveryStep::Motor];
        assert!(!recovery.moves(), "it waits for the person");
        recovery.agree("MotionPreparation").unwrap();
        assert_eq!(recovery.wait(), ControlFlow::Continue(()));
        recovery.end("the page is closed");
        assert!(recovery.moves(), "the end does not stop the step");
        assert_eq!(recovery.made(RecoveryStep::MotionPreparation, Ok(())), ControlFlow::Break(()));
        assert!(!recovery.moves());
        let ended = Recovery::default();
        ended.lock().plan = vec![RecoveryStep::MotionPreparation];
        ended.agree("MotionPreparation").unwrap();
        ended.end("the page is closed");
        assert_eq!(ended.wait(), ControlFlow::Break(()));
        assert!(!ended.moves(), "the step was not begun");
    }
}
