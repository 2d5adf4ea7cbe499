//! The work of a task with a program: the current step, and when it continues.

use std::sync::Arc;
use std::time::Duration;

use bcap_core::time::Instant;

use crate::program::{Program, Step};

/// A program and its progress.
#[derive(Clone, Debug)]
pub(super) struct Steps {
    program: Program,
    /// The current step.
    at: usize,
    /// The current step has begun.
    entered: bool,
    /// When the current step continues, while the task runs.
    deadline: Instant,
    /// When the current step was first checked, while it is polled.
    polled: Option<Instant>,
    /// The rest of the current step, while the task is stopped.
    left: Duration,
    /// When the cycle began.
    began: Instant,
    /// The time of the last whole cycle.
    pub(super) cycle: Duration,
}

/// The current step of a task, ready to be executed.
#[derive(Clone, Debug)]
pub(crate) struct ReadyStep {
    steps: Arc<[Step]>,
    at: usize,
    /// Whether the step begins; otherwise it ends, if the event that it waits for has happened.
    pub(crate) begins: bool,
}

impl ReadyStep {
    pub(crate) fn step(&self) -> Option<&Step> {
        self.steps.get(self.at)
    }
}

impl Steps {
    pub(super) fn new(program: Program) -> Self {
        Self {
            program,
            at: 0,
            entered: false,
            deadline: Instant::ZERO,
            polled: None,
            left: Duration::ZERO,
            began: Instant::ZERO,
            cycle: Duration::ZERO,
        }
    }

    /// Returns the current line, from 1.
    pub(super) fn line(&self) -> i32 {
        i32::try_from(self.at).unwrap_or(i32::MAX).saturating_add(1)
    }

    /// Returns when the current step continues, while the task runs.
    pub(super) fn deadline(&self) -> Instant {
        self.deadline
    }

    pub(super) fn reset(&mut self) {
        (self.at, self.entered, self.left, self.polled) = (0, false, Duration::ZERO, None);
    }

    /// Goes back to the beginning of the previous step.
    pub(super) fn step_back(&mut self) {
        (self.at, self.entered, self.left, self.polled) = (self.at.saturating_sub(1), false, Duration::ZERO, None);
    }

    /// Continues, or starts at the beginning.
    pub(super) fn resume(&mut self, now: Instant) {
        if self.at == 0 && !self.entered {
            self.began = now;
        }
        self.deadline = now.saturating_add(self.left);
    }

    /// Stops within the step. A motion begins again when the task continues.
    pub(super) fn suspend(&mut self, now: Instant) {
        (self.left, self.polled) = (self.deadline.saturating_since(now), None);
        if let Some(Step::Move { .. }) = self.program.steps.get(self.at) {
            (self.entered, self.left) = (false, Duration::ZERO);
        }
    }

    pub(super) fn turn(&self) -> ReadyStep {
        ReadyStep { steps: Arc::clone(&self.program.steps), at: self.at, begins: !self.entered }
    }

    /// Records that the current step has begun, and when it ends or is checked.
    pub(super) fn begun(&mut self, now: Instant, time: Duration) {
        self.entered = true;
        self.deadline = now.saturating_add(time.max(self.program.line));
    }

    /// Checks the current step again at this time, but not before the next line time.
    pub(super) fn wait(&mut self, now: Instant, until: Instant) {
        (self.deadline, self.polled) = (until.max(now.saturating_add(self.program.line)), None);
    }

    /// Checks the current step again at the first multiple of the line time, counted from the first check, after `quiet`.
    pub(super) fn poll(&mut self, now: Instant, quiet: Instant) {
        let first = *self.polled.get_or_insert(now);
        self.deadline = self.next_check(first, quiet.max(now));
    }

    /// Checks a polled step again, at the next whole line time.
    pub(super) fn wake(&mut self, now: Instant) {
        if let Some(first) = self.polled {
            self.deadline = self.deadline.min(self.next_check(first, now));
        }
    }

    pub(super) fn is_polled(&self) -> bool {
        self.polled.is_some()
    }

    /// Returns the first time after `time` that is whole line times after the first check.
    fn next_check(&self, first: Instant, time: Instant) -> Instant {
        let line = self.program.line.as_micros().max(1);
        let lines = time.saturating_since(first).as_micros() / line + 1;
        let micros = u64::try_from(lines.saturating_mul(line)).unwrap_or(u64::MAX);
        first.saturating_add(Duration::from_micros(micros))
    }

    /// Ends the current step. Returns whether it was the last step of the cycle.
    pub(super) fn end_step(&mut self, now: Instant) -> bool {
        (self.at, self.entered, self.deadline) = (self.at + 1, false, now);
        (self.left, self.polled) = (Duration::ZERO, None);
        if self.at < self.program.steps.len() {
            return false;
        }
        (self.at, self.cycle, self.began) = (0, now.saturating_since(self.began), now);
        true
    }
}
