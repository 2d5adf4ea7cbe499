//! A task: its states, and its activity while it runs.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use super::steps::{ReadyStep, Steps};
use super::timed::Timed;
use crate::answer::{Answer, Answered};
use crate::command_name::command_of;
use crate::context::Context;
use crate::program::{Program, PublicValues};
use crate::rules;
use crate::table::Command;
use crate::value::{ValueResult, one_int, owned};

type TaskHandler = fn(&mut Task, &Variant<'_>) -> Answered;

/// The commands of Task_Execute.
pub(crate) const COMMANDS: &[Command<TaskHandler>] = &[
    Command::new("GetStatus", |task, _| task.status_value().map(Answer::Value)),
    Command::new("GetThreadPriority", |task, _| Answer::of(task.priority)),
    Command::new("SetThreadPriority", Task::set_priority as TaskHandler)
        .accepts("nothing, which is 0, or one number, -2 to 2"),
];

/// The priorities of a task; they have no effect.
const PRIORITIES: std::ops::RangeInclusive<i32> = -2..=2;

/// The state of a task, with the numbers of `@STATUS` and GetStatus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskStatus {
    /// Deleted.
    NonExistent = 0,
    /// Stopped within a cycle.
    Suspended = 1,
    /// At its beginning.
    Ready = 2,
    /// Running.
    Running = 3,
    /// Stopped at the end of a line.
    StepStop = 4,
}

/// The mode of Task_Start that goes one line back.
const STEP_BACK: i32 = 4;

/// The point at which a running task stops by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Until {
    Stopped,
    CycleEnd,
    /// The end of a line; of a loop of fixed time, as a time within the cycle.
    LineEnd(Duration),
}

/// The work of a running task.
#[derive(Clone, Debug)]
enum Activity {
    Timed(Timed),
    Steps(Steps),
}

/// A task.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    name: String,
    activity: Activity,
    status: TaskStatus,
    until: Until,
    /// Until when the running time is counted.
    since: Instant,
    cycles: u64,
    /// The time that it has been running since it was last started from its beginning.
    pub(super) elapsed: Duration,
    /// It has completed a cycle, without being stopped, since it was last started.
    completed: bool,
    priority: i32,
    public: PublicValues,
}

impl Task {
    pub(super) fn timed(name: String, cycle: Duration, lines: u32) -> Self {
        Self::new(name, Activity::Timed(Timed::new(cycle, lines)), PublicValues::default())
    }

    pub(super) fn of(program: Program) -> Self {
        let public = program.public.clone();
        Self::new(program.name.clone(), Activity::Steps(Steps::new(program)), public)
    }

    const fn new(name: String, activity: Activity, public: PublicValues) -> Self {
        Self {
            name,
            activity,
            status: TaskStatus::Ready,
            until: Until::Stopped,
            since: Instant::ZERO,
            cycles: 0,
            elapsed: Duration::ZERO,
            completed: false,
            priority: 0,
            public,
        }
    }

    pub(crate) fn public(&self) -> &PublicValues {
        &self.public
    }

    pub(crate) fn public_mut(&mut self) -> &mut PublicValues {
        &mut self.public
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

    /// Returns whether it is stopped within a cycle, and can continue.
    pub(crate) fn can_continue(&self) -> bool {
        matches!(self.status, TaskStatus::Suspended | TaskStatus::StepStop)
    }

    /// Returns whether it has completed one cycle and stopped.
    pub(crate) fn has_completed(&self) -> bool {
        self.completed
    }

    pub(crate) fn cycles(&self) -> u64 {
        self.cycles
    }

    pub(super) fn status_value(&self) -> ValueResult {
        owned(self.status as i32)
    }

    /// Returns the cycle time; for a program, of its last cycle.
    pub(super) fn cycle_time(&self) -> Duration {
        match &self.activity {
            Activity::Timed(timed) => timed.cycle,
            Activity::Steps(steps) => steps.cycle,
        }
    }

    /// Returns the current line, from 1.
    pub(crate) fn line(&self) -> i32 {
        match &self.activity {
            Activity::Timed(timed) => timed.line(),
            Activity::Steps(steps) => steps.line(),
        }
    }

    /// Executes a function of the task object that concerns this task.
    pub(crate) fn call(&mut self, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::TASK_EXECUTE => {
                let name = command_of(request).unwrap_or_default();
                Command::handler(COMMANDS, &name, ctx.config.model.functions)?(self, &request.value(2))
            }
            // a deleted task answers its state only
            _ if self.status == TaskStatus::NonExistent => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            FunctionId::TASK_START => self.start_for(ctx, request.int(1)),
            FunctionId::TASK_STOP => self.stop_for(ctx, request.int(1)).map(Answer::done_if),
            FunctionId::TASK_DELETE => self.delete_for(ctx),
            FunctionId::TASK_GET_FILE_NAME => Answer::of(format!("{}.pcs", self.name)),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Starts it for a client, which needs Auto mode, the executable token and no error.
    pub(crate) fn start_for(&mut self, ctx: &mut Context<'_>, mode: i32) -> Answered {
        ctx.may(&rules::START_TASK)?;
        self.start(mode, ctx.now)?;
        ctx.record(&format!("task {} started", self.name));
        Ok(Answer::Done)
    }

    /// Starts or continues it: mode 1 to the end of the cycle, 2 until it is stopped, 3 to the end of the line. Mode 4 goes one
    /// line back, and stops there.
    pub(crate) fn start(&mut self, mode: i32, now: Instant) -> Result<(), HResult> {
        if mode == STEP_BACK {
            return self.step_back();
        }
        let until = match mode {
            1 => Until::CycleEnd,
            2 => Until::Stopped,
            3 => self.line_end(),
            _ => return Err(HResult::E_INVALIDARG),
        };
        match self.status {
            TaskStatus::NonExistent => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
            TaskStatus::Running => return Err(HResult::E_CAO_CMD_EXECUTE),
            TaskStatus::Ready => self.elapsed = Duration::ZERO,
            TaskStatus::Suspended | TaskStatus::StepStop => {}
        }
        (self.until, self.status, self.since, self.completed) = (until, TaskStatus::Running, now, false);
        if let Activity::Steps(steps) = &mut self.activity {
            steps.resume(now);
        }
        Ok(())
    }

    /// Executes SetThreadPriority; without a number the priority is 0.
    fn set_priority(&mut self, param: &Variant<'_>) -> Answered {
        let priority = if param.is_empty() { 0 } else { one_int(param)? };
        self.priority = Some(priority).filter(|n| PRIORITIES.contains(n)).ok_or(HResult::E_INVALIDARG)?;
        Ok(Answer::Done)
    }

    /// Goes one line back; a task at its beginning stays there.
    fn step_back(&mut self) -> Result<(), HResult> {
        match self.status {
            TaskStatus::NonExistent => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
            TaskStatus::Running => return Err(HResult::E_CAO_CMD_EXECUTE),
            TaskStatus::Ready => return Ok(()),
            TaskStatus::Suspended | TaskStatus::StepStop => self.status = TaskStatus::StepStop,
        }
        match &mut self.activity {
            Activity::Timed(timed) => timed.step_back(),
            Activity::Steps(steps) => steps.step_back(),
        }
        Ok(())
    }

    /// Stops it at the end of its line.
    pub(super) fn stop_at_line_end(&mut self) {
        self.until = self.line_end();
    }

    /// Continues it, if it is suspended, as it was last started.
    pub(super) fn continue_start(&mut self, now: Instant) {
        if self.status == TaskStatus::Suspended {
            (self.status, self.since) = (TaskStatus::Running, now);
            if let Activity::Steps(steps) = &mut self.activity {
                steps.resume(now);
            }
        }
    }

    /// Stops it for a client.
    pub(super) fn stop_for(&mut self, ctx: &mut Context<'_>, mode: i32) -> Result<bool, HResult> {
        let stopped = self.stop(mode, ctx.now)?;
        ctx.record(&format!("task {} stopped", self.name));
        Ok(stopped)
    }

    /// Stops it: modes 0 and 1 immediately, 2 at the end of the line, 3 at the end of the cycle, 4 immediately and back to its
    /// beginning. Returns whether there was something to stop.
    fn stop(&mut self, mode: i32, now: Instant) -> Result<bool, HResult> {
        let running = self.is_running();
        match mode {
            0 | 1 => self.suspend(now),
            2 => self.stop_at_line_end(),
            3 => self.until = Until::CycleEnd,
            4 => {
                let changed = self.status != TaskStatus::Ready;
                self.reset(now);
                return Ok(changed);
            }
            _ => return Err(HResult::E_INVALIDARG),
        }
        Ok(running)
    }

    /// Deletes it for a client, unless it runs.
    fn delete_for(&mut self, ctx: &mut Context<'_>) -> Answered {
        if self.is_running() {
            return Err(HResult::E_CAO_CMD_EXECUTE);
        }
        ctx.record(&format!("task {} deleted", self.name));
        self.status = TaskStatus::NonExistent;
        Ok(Answer::Done)
    }

    pub(crate) fn suspend(&mut self, now: Instant) {
        self.advance(now);
        if self.is_running() {
            self.status = TaskStatus::Suspended;
            if let Activity::Steps(steps) = &mut self.activity {
                steps.suspend(now);
            }
        }
    }

    /// Stops it and returns it to its beginning.
    pub(super) fn reset(&mut self, now: Instant) {
        self.advance(now);
        if self.status == TaskStatus::NonExistent {
            return;
        }
        self.status = TaskStatus::Ready;
        match &mut self.activity {
            Activity::Timed(timed) => timed.progress = Duration::ZERO,
            Activity::Steps(steps) => steps.reset(),
        }
    }

    /// Advances its running time to `now`, and a loop of fixed time through its lines.
    pub(super) fn advance(&mut self, now: Instant) {
        if !self.is_running() {
            return;
        }
        let passed = now.saturating_since(self.since);
        self.since = now;
        let Activity::Timed(timed) = &mut self.activity else {
            self.elapsed = self.elapsed.saturating_add(passed);
            return;
        };
        let end = match self.until {
            Until::Stopped => None,
            Until::CycleEnd => Some(timed.cycle),
            Until::LineEnd(end) => Some(end),
        };
        match end.filter(|end| timed.progress.saturating_add(passed) >= *end) {
            Some(end) => {
                self.elapsed = self.elapsed.saturating_add(end.saturating_sub(timed.progress));
                timed.progress = end;
                let whole = end >= timed.cycle;
                self.status = TaskStatus::StepStop;
                if whole {
                    self.end_cycle();
                }
            }
            None => {
                self.elapsed = self.elapsed.saturating_add(passed);
                self.cycles = self.cycles.saturating_add(timed.pass(passed));
            }
        }
    }

    /// Ends at the end of a cycle.
    fn end_cycle(&mut self) {
        self.cycles = self.cycles.saturating_add(1);
        (self.status, self.completed) = (TaskStatus::Ready, self.until == Until::CycleEnd);
        if let Activity::Timed(timed) = &mut self.activity {
            timed.progress = Duration::ZERO;
        }
    }

    fn line_end(&self) -> Until {
        Until::LineEnd(match &self.activity {
            Activity::Timed(timed) => timed.line_end(),
            Activity::Steps(_) => Duration::ZERO,
        })
    }

    /// Returns when the current step of its program continues; `None` unless it runs one.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.steps().filter(|_| self.is_running()).map(Steps::deadline)
    }

    fn steps(&self) -> Option<&Steps> {
        match &self.activity {
            Activity::Steps(steps) => Some(steps),
            Activity::Timed(_) => None,
        }
    }

    /// Returns the current step of its program.
    pub(crate) fn turn(&self) -> Option<ReadyStep> {
        self.steps().map(Steps::turn)
    }

    /// Records that the current step has begun, and when it ends or is checked.
    pub(crate) fn begun(&mut self, now: Instant, time: Duration) {
        if let Activity::Steps(steps) = &mut self.activity {
            steps.begun(now, time);
        }
    }

    /// Checks the current step again at this time, but not before the next line time.
    pub(crate) fn wait(&mut self, now: Instant, until: Instant) {
        if let Activity::Steps(steps) = &mut self.activity {
            steps.wait(now, until);
        }
    }

    /// Checks the current step again at the first multiple of the line time after `quiet`. Before that, its condition does not
    /// change, unless [`wake`](Self::wake) is called.
    pub(crate) fn poll(&mut self, now: Instant, quiet: Instant) {
        if let Activity::Steps(steps) = &mut self.activity {
            steps.poll(now, quiet);
        }
    }

    /// Checks a polled step again, at the next multiple of the line time.
    pub(super) fn wake(&mut self, now: Instant) {
        if let Activity::Steps(steps) = &mut self.activity {
            steps.wake(now);
        }
    }

    /// Returns when the current step continues, if the task runs a program and its step is not polled.
    pub(super) fn acts(&self) -> Option<Instant> {
        self.steps().filter(|steps| self.is_running() && !steps.is_polled()).map(Steps::deadline)
    }

    /// Ends the current step of its program and, with the last step, the cycle.
    pub(crate) fn end_step(&mut self, now: Instant) {
        self.advance(now);
        let Activity::Steps(steps) = &mut self.activity else { return };
        match (steps.end_step(now), self.until) {
            (true, Until::CycleEnd | Until::LineEnd(_)) => self.end_cycle(),
            (true, Until::Stopped) => self.cycles = self.cycles.saturating_add(1),
            (false, Until::LineEnd(_)) => self.status = TaskStatus::StepStop,
            (false, _) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task() -> Task {
        Task::timed("Pro1".to_owned(), Duration::from_millis(100), 10)
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
        assert_eq!(task.elapsed, Duration::from_millis(100));
    }

    #[test]
    fn continuous_cycles_are_counted_in_one_go_and_stop_at_the_end_of_one() {
        let mut task = task();
        task.start(2, ms(0)).unwrap();
        task.advance(ms(1_000_050));
        assert_eq!((task.cycles(), task.line()), (10_000, 6));
        assert_eq!(task.stop(3, ms(1_000_050)), Ok(true));
        task.advance(ms(1_000_099));
        assert_eq!(task.status(), TaskStatus::Running);
        task.advance(ms(1_000_100));
        assert_eq!((task.status(), task.cycles()), (TaskStatus::Ready, 10_001));
        assert_eq!(task.stop(1, ms(1_000_100)), Ok(false));
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
        assert_eq!(task.stop(0, ms(60)), Ok(true));
        task.advance(ms(5000));
        assert_eq!((task.status(), task.line()), (TaskStatus::Suspended, 7));
        task.start(1, ms(5000)).unwrap();
        task.advance(ms(5040));
        assert_eq!(task.status(), TaskStatus::Ready);
        assert_eq!(task.stop(5, ms(5040)), Err(HResult::E_INVALIDARG));
        assert_eq!(task.start(0, ms(6000)), Err(HResult::E_INVALIDARG));
    }
}
