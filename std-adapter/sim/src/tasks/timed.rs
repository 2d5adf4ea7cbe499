//! The work of a task without a program: a loop whose cycle takes a fixed time.

use std::time::Duration;

/// A loop of fixed time, in which the lines pass evenly.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timed {
    pub(super) cycle: Duration,
    lines: u32,
    /// The time within the cycle.
    pub(super) progress: Duration,
}

impl Timed {
    pub(super) fn new(cycle: Duration, lines: u32) -> Self {
        // the least that can be divided
        Self { cycle: cycle.max(Duration::from_millis(1)), lines: lines.clamp(1, 1000), progress: Duration::ZERO }
    }

    /// Returns the current line, from 1.
    pub(super) fn line(&self) -> i32 {
        let done = self.progress.as_micros() / self.line_time().as_micros().max(1);
        i32::try_from(done).unwrap_or(i32::MAX).saturating_add(1).min(self.lines.cast_signed())
    }

    fn line_time(&self) -> Duration {
        self.cycle / self.lines
    }

    /// Returns the end of the current line, as a time within the cycle.
    pub(super) fn line_end(&self) -> Duration {
        let line = self.line().unsigned_abs();
        if line >= self.lines { self.cycle } else { self.line_time() * line }
    }

    /// Goes back to the beginning of the previous line.
    pub(super) fn step_back(&mut self) {
        self.progress = self.line_time() * self.line().unsigned_abs().saturating_sub(2);
    }

    /// Passes whole cycles, and returns their number.
    pub(super) fn pass(&mut self, time: Duration) -> u64 {
        let micros = |n: u128| u64::try_from(n).unwrap_or(u64::MAX);
        let (reached, cycle) = (self.progress.saturating_add(time).as_micros(), self.cycle.as_micros());
        self.progress = Duration::from_micros(micros(reached % cycle));
        micros(reached / cycle)
    }
}
