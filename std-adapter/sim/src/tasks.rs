//! Tasks: programs that run on the injected clock.
//!
//! A task has no program text. It is a loop that takes a fixed time a cycle and counts its lines at an even pace:
//!
//! ```text
//!              Start 1, 2                    end of the cycle: mode 1, or Stop 3
//!   READY (2) ------------> RUNNING (3) ----------------------------> READY
//!      ^                     |  |  ^
//!      | Stop 4, error       |  |  | Start: goes on where it was
//!      +---------------------+  |  |
//!                    Stop 0, 1  v  |   Stop 2, or Start 3: at the end of the line
//!                   SUSPENDED (1)  +-- STEP STOP (4)
//! ```

use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// What a task is doing; the numbers are those of `@STATUS` and GetStatus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskStatus {
    /// Stopped in the middle.
    Suspended = 1,
    /// At its beginning.
    Ready = 2,
    /// Running.
    Running = 3,
    /// Stopped at the end of a line.
    StepStop = 4,
}

/// When a running task stops by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Until {
    Stopped,
    CycleEnd,
    /// This point of the cycle, the end of a line.
    LineEnd(Duration),
}

/// A task.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    name: String,
    cycle: Duration,
    lines: u32,
    status: TaskStatus,
    until: Until,
    /// How far in its cycle it was at `since`.
    progress: Duration,
    since: Instant,
    cycles: u64,
    elapsed: Duration,
}

impl Task {
    pub(crate) fn new(name: String, cycle: Duration, lines: u32) -> Self {
        Self {
            name,
            // a cycle without time or lines could not be divided
            cycle: cycle.max(Duration::from_millis(1)),
            lines: lines.clamp(1, 1000),
            status: TaskStatus::Ready,
            until: Until::Stopped,
            progress: Duration::ZERO,
            since: Instant::ZERO,
            cycles: 0,
            elapsed: Duration::ZERO,
        }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn status(&self) -> TaskStatus {
        self.status
    }

    pub(crate) fn is_running(&self) -> bool {
        self.status == TaskStatus::Running
    }

    /// Tells whether it runs over and over.
    pub(crate) fn is_continuous(&self) -> bool {
        self.is_running() && self.until == Until::Stopped
    }

    pub(crate) fn cycles(&self) -> u64 {
        self.cycles
    }

    pub(crate) fn cycle_time(&self) -> Duration {
        self.cycle
    }

    /// Returns how long it has been running since it was last started from its beginning.
    pub(crate) fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// Returns the line it is at, from 1.
    pub(crate) fn line(&self) -> i32 {
        let done = self.progress.as_micros() / self.line_time().as_micros().max(1);
        i32::try_from(done).unwrap_or(i32::MAX).saturating_add(1).min(self.lines.cast_signed())
    }

    /// Starts or goes on: mode 1 to the end of the cycle, 2 over and over, 3 to the end of the line.
    pub(crate) fn start(&mut self, mode: i32, now: Instant) -> Result<(), HResult> {
        let until = match mode {
            1 => Until::CycleEnd,
            2 => Until::Stopped,
            3 => Until::LineEnd(self.line_end()),
            _ => return Err(HResult::E_INVALIDARG),
        };
        if self.is_running() {
            return Err(HResult::E_CAO_CMD_EXECUTE);
        }
        if self.status == TaskStatus::Ready {
            self.progress = Duration::ZERO;
            self.elapsed = Duration::ZERO;
        }
        self.until = until;
        self.status = TaskStatus::Running;
        self.since = now;
        Ok(())
    }

    /// Stops: mode 0 and 1 at once, 2 at the end of the line, 3 at the end of the cycle, 4 at once and to its start.
    ///
    /// `false` when there was nothing to stop.
    pub(crate) fn stop(&mut self, mode: i32) -> Result<bool, HResult> {
        let running = self.is_running();
        match mode {
            0 | 1 => self.suspend(),
            2 => self.until = Until::LineEnd(self.line_end()),
            3 => self.until = Until::CycleEnd,
            4 => {
                let changed = self.status != TaskStatus::Ready;
                self.reset();
                return Ok(changed);
            }
            _ => return Err(HResult::E_INVALIDARG),
        }
        Ok(running)
    }

    pub(crate) fn suspend(&mut self) {
        if self.is_running() {
            self.status = TaskStatus::Suspended;
        }
    }

    /// Stops it and puts it back to its beginning.
    pub(crate) fn reset(&mut self) {
        self.status = TaskStatus::Ready;
        self.progress = Duration::ZERO;
    }

    /// Lets it run until `now`.
    pub(crate) fn advance(&mut self, now: Instant) {
        if !self.is_running() {
            return;
        }
        let passed = now.saturating_since(self.since);
        self.since = now;
        let reached = self.progress.saturating_add(passed);
        let end = match self.until {
            Until::Stopped => None,
            Until::CycleEnd => Some(self.cycle),
            Until::LineEnd(end) => Some(end),
        };
        match end.filter(|end| reached >= *end) {
            Some(end) => {
                self.elapsed = self.elapsed.saturating_add(end.saturating_sub(self.progress));
                self.progress = end;
                self.status = TaskStatus::StepStop;
                if end >= self.cycle {
                    self.cycles = self.cycles.saturating_add(1);
                    self.reset();
                }
            }
            None => {
                self.elapsed = self.elapsed.saturating_add(passed);
                let cycle = self.cycle.as_micros();
                let micros = |n: u128| u64::try_from(n).unwrap_or(u64::MAX);
                self.cycles = self.cycles.saturating_add(micros(reached.as_micros() / cycle));
                self.progress = Duration::from_micros(micros(reached.as_micros() % cycle));
            }
        }
    }

    fn line_time(&self) -> Duration {
        self.cycle / self.lines
    }

    /// Returns where the line ends that it is in.
    fn line_end(&self) -> Duration {
        let line = self.line().unsigned_abs();
        if line >= self.lines { self.cycle } else { self.line_time() * line }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> Task {
        Task::new("Pro1".to_owned(), Duration::from_millis(100), 10)
    }

    fn ms(n: u64) -> Instant {
        Instant::from_millis(n)
    }

    #[test]
    fn one_cycle_ends_by_itself() {
        let mut task = task();
        task.start(1, ms(0)).unwrap();
        task.advance(ms(45));
        assert_eq!((task.status(), task.line(), task.cycles()), (TaskStatus::Running, 5, 0));
        assert_eq!(task.start(1, ms(45)), Err(HResult::E_CAO_CMD_EXECUTE));
        task.advance(ms(1000));
        assert_eq!((task.status(), task.line(), task.cycles()), (TaskStatus::Ready, 1, 1));
        assert_eq!(task.elapsed(), Duration::from_millis(100));
    }

    #[test]
    fn continuous_cycles_are_counted_in_one_go_and_stop_at_the_end_of_one() {
        let mut task = task();
        task.start(2, ms(0)).unwrap();
        task.advance(ms(1_000_050));
        assert_eq!((task.cycles(), task.line()), (10_000, 6));
        assert_eq!(task.stop(3), Ok(true));
        task.advance(ms(1_000_099));
        assert_eq!(task.status(), TaskStatus::Running);
        task.advance(ms(1_000_100));
        assert_eq!((task.status(), task.cycles()), (TaskStatus::Ready, 10_001));
        assert_eq!(task.stop(1), Ok(false));
    }

    #[test]
    fn steps_walk_line_by_line() {
        let mut task = task();
        for line in 1..10 {
            task.start(3, ms(line * 1000)).unwrap();
            task.advance(ms(line * 1000 + 500));
            assert_eq!((task.status(), task.line()), (TaskStatus::StepStop, i32::try_from(line).unwrap() + 1));
        }
        task.start(3, ms(20_000)).unwrap();
        task.advance(ms(20_500));
        assert_eq!((task.status(), task.cycles()), (TaskStatus::Ready, 1));
    }

    #[test]
    fn a_suspended_task_goes_on_where_it_was() {
        let mut task = task();
        task.start(1, ms(0)).unwrap();
        task.advance(ms(60));
        assert_eq!(task.stop(0), Ok(true));
        task.advance(ms(5000));
        assert_eq!((task.status(), task.line()), (TaskStatus::Suspended, 7));
        task.start(1, ms(5000)).unwrap();
        task.advance(ms(5040));
        assert_eq!(task.status(), TaskStatus::Ready);
        assert_eq!(task.stop(5), Err(HResult::E_INVALIDARG));
        assert_eq!(task.start(0, ms(6000)), Err(HResult::E_INVALIDARG));
    }
}
