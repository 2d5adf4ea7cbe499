//! Executes the programs of tasks, each step at its own time.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::VariantBuf;

use super::{Controller, Shared};
use crate::answer::Answer;
use crate::config::{Token, peer_of_task};
use crate::errors::{Errors, Origin, SourceLine};
use crate::program::Step;
use crate::tasks::{Task, TaskStatus};
use crate::waits::Wait;

/// The largest encoding of the pose of a step, in bytes.
const POSE_MAX: usize = 4096;

/// The next need of a step.
enum Next {
    /// It takes this time.
    Takes(Duration),
    /// It continues when the motion of the task has ended.
    Motion(Wait),
    /// It begins when the arm is free to move.
    Busy,
    /// It has ended.
    Over,
    /// It is checked again.
    Poll,
    /// Its motion was halted.
    Halted,
}

impl Controller {
    /// Executes the steps that continue by `now`.
    pub(super) fn run_programs(&mut self, now: Instant) {
        while let Some((at, place)) = self.tasks.deadline().filter(|(at, _)| *at <= now) {
            self.pass(self.shared.now.max(at));
            // an error may have stopped the task in the meantime
            if self.tasks.deadline() == Some((at, place)) {
                self.take_turn(place, now);
                self.free_arm_of_tasks();
            }
        }
    }

    /// Begins or ends the current step of a task. Until the next step of another task, or `until`, variables do not change.
    fn take_turn(&mut self, place: usize, until: Instant) {
        let Some(turn) = self.tasks.get(place).ok().and_then(Task::turn) else { return };
        let now = self.shared.now;
        let next = match turn.step() {
            Some(step) if turn.begins => self.begin_step(place, step),
            Some(step) => self.check_step(place, step),
            None => Ok(Next::Over),
        };
        let idle = matches!(next, Ok(Next::Poll | Next::Motion(_) | Next::Busy));
        let quiet = self.tasks.acts().map_or(until, |at| at.min(until));
        let end = match &next {
            Ok(Next::Motion(wait)) => self.arm.end_of(*wait, now),
            _ => None,
        };
        let Ok(task) = self.tasks.get_mut(place) else { return };
        match next {
            Ok(Next::Takes(time)) => task.begun(now, time),
            Ok(Next::Motion(_)) => {
                task.begun(now, Duration::ZERO);
                match end {
                    Some(end) => task.wait(now, end),
                    None => task.poll(now, until),
                }
            }
            Ok(Next::Busy) => task.wait(now, now),
            Ok(Next::Over) => task.end_step(now),
            Ok(Next::Poll) => task.poll(now, quiet),
            Ok(Next::Halted) => task.suspend(now),
            Err(code) => self.fail_in_task(place, code),
        }
        // the events that other tasks wait for may have happened
        if !idle {
            self.tasks.wake(now);
        }
    }

    /// Begins a step.
    ///
    /// # Errors
    ///
    /// The error of the controller that the step causes.
    fn begin_step(&mut self, place: usize, step: &Step) -> Result<Next, HResult> {
        let variables = &mut self.shared.variables;
        match step {
            Step::Set(list) => list.iter().try_for_each(|item| item.write(variables))?,
            Step::Add(list) => list.iter().try_for_each(|item| item.add(variables))?,
            Step::Wait(time) => return Ok(Next::Takes(*time)),
            Step::WaitFor(_) => {}
            Step::Move { interpolation, pose, option } => {
                return self.begin_motion(place, *interpolation, pose, option);
            }
            Step::Error(code) => {
                self.raise_in_task(*code, place);
                // a task that is not reset stops, and continues after it
                let now = self.shared.now;
                if let Ok(task) = self.tasks.get_mut(place) {
                    task.suspend(now);
                    if task.can_continue() {
                        task.end_step(now);
                    }
                }
                return Ok(Next::Halted);
            }
            Step::Message(text) => {
                let source = self.tasks.get(place)?.name().to_owned();
                self.messages.post_text(text, &source, self.shared.now);
            }
        }
        Ok(Next::Takes(Duration::ZERO))
    }

    fn begin_motion(&mut self, place: usize, interpolation: i32, pose: &str, option: &str) -> Result<Next, HResult> {
        let peer = peer_of_task(place);
        let mut ctx = self.shared.context(peer);
        // the executable token concerns clients, and an error that concerns tasks has stopped this one
        let no_errors = Errors::default();
        (ctx.panel.token, ctx.errors) = (Token::Any, &no_errors);
        let pose = VariantBuf::<POSE_MAX>::new(pose).map_err(|_| HResult::E_ARGSIZEOVER)?;
        match self.arm.move_for_task(&mut ctx, interpolation, &pose.as_variant(), option) {
            Ok(Answer::Until(wait)) => {
                self.shared.waits.begin(peer, wait);
                Ok(Next::Motion(wait))
            }
            Ok(_) => Ok(Next::Takes(Duration::ZERO)),
            Err(HResult::E_ROBOTISBUSY) => Ok(Next::Busy),
            Err(code) => Err(code),
        }
    }

    /// Checks whether a step that has begun has ended.
    ///
    /// # Errors
    ///
    /// The error of the controller that the step causes.
    fn check_step(&mut self, place: usize, step: &Step) -> Result<Next, HResult> {
        match step {
            Step::WaitFor(list) => {
                let mut open = false;
                for item in list {
                    open |= !item.holds(&self.shared.variables)?;
                }
                Ok(if open { Next::Poll } else { Next::Over })
            }
            Step::Move { .. } => {
                let peer = peer_of_task(place);
                match self.shared.waits.get(peer) {
                    Some(Wait::Over(result)) => {
                        self.shared.waits.forget(peer);
                        Ok(if result == HResult::S_OK { Next::Over } else { Next::Halted })
                    }
                    Some(wait) => Ok(Next::Motion(wait)),
                    None => Ok(Next::Over),
                }
            }
            _ => Ok(Next::Over),
        }
    }

    /// Raises the error of a task's step, at which the task stops.
    fn fail_in_task(&mut self, place: usize, code: HResult) {
        self.raise_in_task(code, place);
        if let Ok(task) = self.tasks.get_mut(place) {
            task.suspend(self.shared.now);
        }
    }

    fn raise_in_task(&mut self, code: HResult, place: usize) {
        self.enter(code, self.shared.now, Origin::Task, self.place_of(place));
    }

    fn place_of(&self, place: usize) -> Option<SourceLine> {
        let task = self.tasks.get(place).ok()?;
        Some(SourceLine { program: task.name().to_owned(), line: task.line() })
    }

    /// Returns whether a task owns the arm.
    pub(super) fn is_arm_of_task(&self) -> bool {
        self.arm.robot().owner().is_some_and(|owner| self.is_task(owner))
    }

    /// Returns whether a client's number denotes a task.
    pub(super) fn is_task(&self, peer: PeerId) -> bool {
        (0..self.tasks.len()).any(|place| peer_of_task(place) == peer)
    }

    /// Halts the motions of tasks that do not run, and frees the arm from tasks at their beginning.
    pub(super) fn free_arm_of_tasks(&mut self) {
        for place in 0..self.tasks.len() {
            let (peer, Ok(task)) = (peer_of_task(place), self.tasks.get(place)) else { continue };
            let Shared { config, now, waits, .. } = &mut self.shared;
            if !task.is_running() && self.arm.robot().mover() == Some(peer) {
                self.arm.halt(config, *now, waits);
            }
            if matches!(task.status(), TaskStatus::Ready | TaskStatus::NonExistent) {
                self.arm.forget(peer, config, *now, waits);
            }
        }
    }
}
