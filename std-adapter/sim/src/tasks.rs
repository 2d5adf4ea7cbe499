//! Tasks: programs that run on the injected clock, and the functions of the task object.
//!
//! A task has no program text. It is a loop whose cycle takes a fixed time, in which it counts its lines evenly:
//!
//! ```text
//!              Start 1, 2                    end of the cycle: mode 1, or Stop 3
//!   READY (2) ------------> RUNNING (3) ----------------------------> READY
//!      ^                     |  |  ^
//!      | Stop 4, error       |  |  | Start: continues
//!      +---------------------+  |  |
//!                    Stop 0, 1  v  |   Stop 2, or Start 3: at the end of the line
//!                   SUSPENDED (1)  +-- STEP STOP (4)
//! ```

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::config::Config;
use crate::context::Context;
use crate::function::command_of;
use crate::table::{Command, Property};
use crate::value::{Value, one_int};

/// The priority of every task.
const PRIORITY: i32 = 128;

type Read = fn(&Task) -> Value;
type Write = fn(&mut Task, &mut Context<'_>, &Variant<'_>) -> Answered;

/// The commands of Task_Execute.
const COMMANDS: &[Command<Read>] = &[Command::new("GetStatus", Task::status_value)];

const fn read(name: &'static str, get: Read) -> Property<Read, Write> {
    Property::read(name, get)
}

const fn write(name: &'static str, put: Write, accepts: &'static str) -> Property<Read, Write> {
    Property::write(name, put, accepts)
}

/// The system variables of a task, in the order of Task_GetVariableNames.
pub(crate) const VARIABLES: &[Property<Read, Write>] = &[
    read("@STATUS", Task::status_value),
    read("@STATUS_DETAILS", |_| Value::I4(0)),
    read("@PRIORITY", |_| Value::I4(PRIORITY)),
    read("@LINE_NO", |task| Value::I4s(vec![task.line()])),
    read("@CYCLE_TIME", |task| millis(task.cycle)),
    read("@ELAPSED_TIME", |task| millis(task.elapsed)),
    write(
        "@START",
        |task, ctx, mode| task.start_for(ctx, one_int(mode)?),
        "one number: 1 one cycle, 2 continuous, 3 one line",
    ),
    write(
        "@STOP",
        |task, _, mode| {
            task.stop(one_int(mode)?)?;
            Ok(Answer::Done)
        },
        "one number, 0 to 4",
    ),
];

fn millis(time: Duration) -> Value {
    Value::I4(i32::try_from(time.as_millis()).unwrap_or(i32::MAX))
}

/// The state of a task, with the numbers of `@STATUS` and GetStatus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskStatus {
    /// Stopped within a cycle.
    Suspended = 1,
    /// At its beginning.
    Ready = 2,
    /// Running.
    Running = 3,
    /// Stopped at the end of a line.
    StepStop = 4,
}

/// The point at which a running task stops by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Until {
    Stopped,
    CycleEnd,
    /// The end of a line, as a time within the cycle.
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
    /// The time within the cycle at `since`.
    progress: Duration,
    since: Instant,
    cycles: u64,
    /// The time that the task has been running since it was last started from its beginning.
    elapsed: Duration,
}

/// All tasks.
#[derive(Clone, Debug)]
pub(crate) struct Tasks {
    list: Vec<Task>,
}

impl Tasks {
    pub(crate) fn new(config: &Config) -> Self {
        let task = |name: &String| Task::new(name.clone(), config.task_cycle, config.task_lines);
        Self { list: config.tasks.iter().map(task).collect() }
    }

    pub(crate) fn advance(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.advance(now));
    }

    pub(crate) fn suspend(&mut self) {
        self.list.iter_mut().for_each(Task::suspend);
    }

    /// Stops the tasks because of an error: from level 3 on it also resets them.
    pub(crate) fn fail(&mut self, code: HResult) {
        match code.level() {
            Some(3..) => self.list.iter_mut().for_each(Task::reset),
            _ => self.suspend(),
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Task> {
        self.list.iter()
    }

    /// Returns the place of a task in the list, ignoring the case of its name.
    pub(crate) fn position(&self, name: &str) -> Option<usize> {
        self.list.iter().position(|task| task.name.eq_ignore_ascii_case(name))
    }

    /// # Errors
    ///
    /// `E_CAO_OBJECT_NOTFOUND` for a task that does not exist.
    pub(crate) fn get(&self, n: usize) -> Result<&Task, HResult> {
        self.list.get(n).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
    }

    /// # Errors
    ///
    /// `E_CAO_OBJECT_NOTFOUND` for a task that does not exist.
    pub(crate) fn get_mut(&mut self, n: usize) -> Result<&mut Task, HResult> {
        self.list.get_mut(n).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
    }
}

impl Task {
    fn new(name: String, cycle: Duration, lines: u32) -> Self {
        Self {
            name,
            // the least that can be divided
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

    /// Tells whether it runs until it is stopped.
    pub(crate) fn is_continuous(&self) -> bool {
        self.is_running() && self.until == Until::Stopped
    }

    pub(crate) fn cycles(&self) -> u64 {
        self.cycles
    }

    fn status_value(&self) -> Value {
        Value::I4(self.status as i32)
    }

    /// Executes a function of the task object that concerns this task.
    pub(crate) fn call(&mut self, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::TASK_EXECUTE => {
                let name = command_of(request).unwrap_or_default();
                Ok(Command::handler(COMMANDS, &name, ctx.config.profile)?(self).into())
            }
            FunctionId::TASK_START => self.start_for(ctx, request.int(1)),
            FunctionId::TASK_STOP => self.stop(request.int(1)).map(Answer::done_if),
            FunctionId::TASK_GET_FILE_NAME => Ok(Value::Text(format!("{}.pcs", self.name)).into()),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Starts it for a client, which needs Auto mode, the executable token and no error.
    fn start_for(&mut self, ctx: &mut Context<'_>, mode: i32) -> Answered {
        ctx.may_execute()?;
        self.start(mode, ctx.now)?;
        Ok(Answer::Done)
    }

    /// Returns the present line, from 1.
    fn line(&self) -> i32 {
        let done = self.progress.as_micros() / self.line_time().as_micros().max(1);
        i32::try_from(done).unwrap_or(i32::MAX).saturating_add(1).min(self.lines.cast_signed())
    }

    /// Starts or continues it: mode 1 to the end of the cycle, 2 until it is stopped, 3 to the end of the line.
    fn start(&mut self, mode: i32, now: Instant) -> Result<(), HResult> {
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

    /// Stops it: mode 0 and 1 at once, 2 at the end of the line, 3 at the end of the cycle, 4 at once and back to its
    /// beginning. Returns whether there was something to stop.
    fn stop(&mut self, mode: i32) -> Result<bool, HResult> {
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

    fn suspend(&mut self) {
        if self.is_running() {
            self.status = TaskStatus::Suspended;
        }
    }

    /// Stops it and returns it to its beginning.
    fn reset(&mut self) {
        self.status = TaskStatus::Ready;
        self.progress = Duration::ZERO;
    }

    /// Advances it to `now`.
    fn advance(&mut self, now: Instant) {
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

    /// Returns the end of the present line, as a time within the cycle.
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
        assert_eq!(task.elapsed, Duration::from_millis(100));
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
