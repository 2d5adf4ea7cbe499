//! Tasks: programs that run on the injected clock, and the functions of the task object.
//!
//! A [scenario](crate::scenario) defines tasks with a program, a list of steps. Each step is a line. The other tasks have
//! no program: they are loops whose cycle takes a fixed time, in which the lines pass evenly.
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
//!
//! Start 4 goes one line back. KillAll of the controller stops all tasks as Stop 4 does, SuspendAll as Stop 1, StepStopAll as
//! Stop 2; ContinueStartAll continues the suspended tasks in the mode of their last start. An error of level 2 suspends all
//! tasks, as does the end of Auto mode; an error from level 3 on resets them, unless it only refuses a call. A task whose step
//! fails raises the code of the failure as an error of the controller, which names the task and the line.
//!
//! Task_Delete removes a task that does not run; of a running one it is refused with `E_CAO_CMD_EXECUTE`. A deleted task
//! has the state 0, and its other functions answer `E_CAO_OBJECT_NOTFOUND`.
//!
//! A task that moves the arm takes it for the time of its cycle, if it is free. When the task stops within a motion, the
//! motion brakes to a halt. When the task continues, it begins the motion again from there. A task whose motion a client
//! halts is suspended.

mod steps;
mod task;
mod task_variables;
mod timed;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::config::Config;
use crate::levels::TaskStop;
use crate::program::Program;

pub(crate) use task::Task;
pub use task::TaskStatus;
pub(crate) use task_variables::VARIABLES;

/// All tasks. A deleted task keeps its place.
#[derive(Clone, Debug)]
pub(crate) struct Tasks {
    list: Vec<Task>,
}

impl Tasks {
    pub(crate) fn new(config: &Config) -> Self {
        let task = |name: &String| Task::timed(name.clone(), config.task_cycle, config.task_lines);
        Self { list: config.tasks.iter().map(task).collect() }
    }

    /// Defines the task of a program, in place of one with the same name. Returns its place in the list.
    pub(crate) fn define(&mut self, program: Program) -> usize {
        let found = self.position(&program.name);
        let place = found.unwrap_or(self.list.len());
        let task = Task::of(program);
        match self.list.get_mut(place) {
            Some(present) => *present = task,
            None => self.list.push(task),
        }
        place
    }

    pub(crate) fn advance(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.advance(now));
    }

    pub(crate) fn suspend(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.suspend(now));
    }

    /// Stops all tasks and returns them to their beginning.
    pub(crate) fn kill(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.reset(now));
    }

    /// Stops the running tasks at the end of their lines.
    pub(crate) fn step_stop(&mut self, _: Instant) {
        self.list.iter_mut().filter(|task| task.is_running()).for_each(Task::stop_at_line_end);
    }

    /// Continues the suspended tasks.
    pub(crate) fn continue_start(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.continue_start(now));
    }

    /// Stops the tasks because of an error, as its effects say.
    pub(crate) fn fail(&mut self, effect: TaskStop, now: Instant) {
        match effect {
            TaskStop::Continue => {}
            TaskStop::Suspend => self.suspend(now),
            TaskStop::Reset => self.kill(now),
        }
    }

    /// Returns when the next step of a program continues, and the place of its task.
    pub(crate) fn deadline(&self) -> Option<(Instant, usize)> {
        let deadline = self.list.iter().enumerate().filter_map(|(n, task)| Some((task.deadline()?, n)));
        deadline.min()
    }

    /// Returns when the next step of a program continues that is not polled.
    pub(crate) fn acts(&self) -> Option<Instant> {
        self.list.iter().filter_map(Task::acts).min()
    }

    /// Checks all polled steps again, because variables may have changed.
    pub(crate) fn wake(&mut self, now: Instant) {
        self.list.iter_mut().for_each(|task| task.wake(now));
    }

    /// Iterates over the tasks that are not deleted.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Task> {
        self.list.iter().filter(|task| task.status() != TaskStatus::NonExistent)
    }

    /// Returns the number of tasks, deleted ones included.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// Returns the place of a task in the list, ignoring the case of its name.
    pub(crate) fn position(&self, name: &str) -> Option<usize> {
        let named = |task: &Task| task.status() != TaskStatus::NonExistent && task.name().eq_ignore_ascii_case(name);
        self.list.iter().position(named)
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
