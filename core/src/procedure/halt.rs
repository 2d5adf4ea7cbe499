//! Halting a robot, even while a task of the controller owns the arm, and verifying that it rests.
//!
//! ```text
//!  Robot_Halt ─► accepted ─────────────────────────────────────────────────────────► verify ─► once more, if it still moves
//!       └─────► refused ─► KillAll ─► done ────────────────────────► Robot_Halt ─► verify
//!                             ├────► refused: GetTaskNames             ▲
//!                             │         └─► each task that does not rest: Task_Stop 4
//!                             └── no effect within the time limit ◄─ verify
//!
//!  verify: (slvGetMode ─► SysState ─► CurJnt ─► pause)*: rest, or the time limit
//! ```
//!
//! A controller refuses Robot_Halt while a task owns the arm (RC8 provider guide, 5.2.22); stopping the task halts its
//! motion. The guide gives no code for that, so any refusal counts, unless it says that the handle is invalid.
//!
//! A motion that another thread or client began at the same time may be executed just after Robot_Halt, which then has no
//! effect on it. So Robot_Halt is sent once more: immediately if its reply was that nothing moved and a poll sees a motion, and
//! otherwise after the time limit.
//!
//! Robot_Halt is always the first call. Real controllers end Slave Mode when they get a call that it does not allow, such as
//! SysState. So SysState is sent only after slvGetMode has answered 0; otherwise rest is judged by the joints alone.

use core::convert::identity;
use core::fmt;
use core::time::Duration;

use super::action::Procedure;
use super::failure::{Failure, StepCause, StepError};
use super::motion::{MOVING, joints};
use super::path::{Name, name_at};
use super::provider::Handles;
use super::queue::{AT_REST, within};
use super::sequence::{Argument, NextStep, Sequence, StepCall, Steps};
use super::target::JOINTS;
use crate::bcap::call::{Int, Reply, TaskHandle, handle_of};
use crate::bcap::{Frame, FunctionId};
use crate::hresult::HResult;
use crate::time::Instant;

/// How [`halt`] verifies that the robot rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HaltConfig {
    /// The time limit for the robot to be at rest after the last stop was answered. It begins again after a second Robot_Halt,
    /// after KillAll and after the tasks were stopped individually.
    pub limit: Duration,
    /// The pause between two polls of the robot.
    pub interval: Duration,
    /// The number of polls in a row that must find the robot at the position of the poll before them.
    pub still: u8,
}

impl HaltConfig {
    /// Returns a configuration with this time limit. It polls every 20 ms; two polls must find the robot at rest.
    #[must_use]
    pub const fn within(limit: Duration) -> Self {
        Self { limit, interval: Duration::from_millis(20), still: 2 }
    }
}

/// The effect of [`halt`].
///
/// The robot is halted only if it rests and Robot_Halt was not refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[must_use = "the robot may still move"]
pub struct Halt {
    /// The answer to the last Robot_Halt.
    pub answer: HaltAnswer,
    /// The tasks that were stopped; `None` if none was.
    pub tasks: Option<StoppedTasks>,
    /// Whether the robot was seen at rest.
    pub rests: bool,
}

/// The answer to Robot_Halt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum HaltAnswer {
    /// Accepted; the robot was moving.
    Halted,
    /// Accepted; the robot was not moving, neither by the reply nor by any poll.
    NothingMoved,
    /// Refused, by default because a task owns the arm.
    Refused(HResult),
}

/// The tasks that [`halt`] has stopped. Their next start begins at their first line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StoppedTasks {
    /// All tasks but supervisory ones, by KillAll.
    All,
    /// KillAll was accepted, but SysState still reports a running task, possibly a supervisory task.
    AllButRunning,
    /// This number of tasks, each by Task_Stop, because KillAll was refused or had no effect.
    Single(u8),
}

impl Halt {
    /// Returns whether the robot rests and Robot_Halt was not refused. A task that still runs may move it again: see
    /// [`tasks`](Self::tasks).
    #[must_use]
    pub const fn is_halted(&self) -> bool {
        self.rests && !matches!(self.answer, HaltAnswer::Refused(_))
    }
}

impl fmt::Display for Halt {
    /// Writes what happened, the robot first, with `; ` between the parts; `{:#}` writes a line for each.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.rests, self.answer) {
            (false, _) => "the robot STILL MOVES",
            (true, HaltAnswer::NothingMoved) if self.tasks.is_none() => "nothing was moving",
            (true, HaltAnswer::Refused(_)) => "the robot rests, but is not halted: a task may move it at any time",
            (true, _) => "halted",
        })?;
        let separator = if f.alternate() { "\n" } else { "; " };
        if let HaltAnswer::Refused(code) = self.answer {
            write!(f, "{separator}Robot_Halt was refused: {code}")?;
        }
        self.tasks.map_or(Ok(()), |tasks| write!(f, "{separator}{tasks}"))
    }
}

impl fmt::Display for StoppedTasks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all tasks were stopped (KillAll)"),
            Self::AllButRunning => f.write_str("KillAll was accepted, but a task still runs"),
            Self::Single(1) => f.write_str("1 task was stopped (Task_Stop)"),
            Self::Single(count) => write!(f, "{count} tasks were stopped (Task_Stop)"),
        }
    }
}

/// Halts the robot, and verifies that it rests.
///
/// If Robot_Halt is refused, it stops the tasks of the controller and halts again. It also stops them if the robot still
/// moves after the time limit and SysState says that a task runs. The tasks are stopped by KillAll. If the controller
/// refuses that, or after the time limit still refuses Robot_Halt or moves the robot by a task, they are stopped by
/// Task_Stop of each task that is neither ready nor missing; a Task_Stop that fails is repeated once. While the controller is
/// busy with an abandoned call, each call is repeated, for up to 5 s in all.
///
/// Robot_Halt is repeated once for a motion that may have begun just after it: if a poll sees the robot move after the answer
/// that nothing moved, or if it still moves after the time limit and no task runs.
///
/// The robot rests if its joints do not change and, outside of Slave Mode, SysState reports no motion. A refused SysState or
/// slvGetMode counts as unknown; then rest is judged by the joints alone.
///
/// # Errors
///
/// The output says whether the robot rests. An error means that this is unknown: Robot_Halt or a poll has no reply, or the
/// handle is invalid. The robot may still move.
///
/// # Cancel safety
///
/// When a run is dropped, run the procedure again: it fails if it waited for the reply to a poll or to the first Robot_Halt,
/// and otherwise continues.
pub fn halt(handles: Handles, config: HaltConfig) -> impl Procedure<Output = Halt, Error = StepError> + use<> {
    let steps = HaltSteps {
        handles,
        config,
        step: Step::Halt,
        answer: HaltAnswer::NothingMoved,
        stage: Stage::Halt,
        halted_again: false,
        repeated: false,
        tasks: None,
        place: 0,
        name: Name::new(),
        task: TaskHandle(0),
        until: None,
        state: 0,
        last: None,
        still: 0,
        moved: false,
    };
    Sequence::new(steps, identity)
}

/// The bit of SysState for a task that runs.
const RUNNING: i32 = 1;
/// The mode of Task_Stop that also frees the arm: stop immediately, back to the first line.
const INITIALIZE: i32 = 4;
/// The states of an idle task: it does not exist, it can be started.
const IDLE: [i32; 2] = [0, 2];

#[derive(Debug)]
struct HaltSteps {
    handles: Handles,
    config: HaltConfig,
    step: Step,
    answer: HaltAnswer,
    stage: Stage,
    /// Whether Robot_Halt was repeated because the robot moved on.
    halted_again: bool,
    /// Whether the current Task_Stop was repeated.
    repeated: bool,
    tasks: Option<StoppedTasks>,
    /// The index of the current task in the list of names.
    place: u8,
    /// Its name and, once it is open, its handle.
    name: Name,
    task: TaskHandle,
    /// When the robot must rest, from the first poll on.
    until: Option<Instant>,
    /// The bits of SysState in this poll; 0 if they are unknown.
    state: i32,
    /// Where the robot was when it was last seen to move, or first seen.
    last: Option<[f64; JOINTS]>,
    /// Polls in a row with the robot at rest.
    still: u8,
    /// Whether a poll has seen it move.
    moved: bool,
}

/// The strongest means in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Robot_Halt alone.
    Halt,
    /// KillAll.
    All,
    /// Task_Stop of each task.
    Single,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Halt,
    KillAll,
    TaskNames,
    OpenTask,
    TaskStatus,
    StopTask,
    ReleaseTask,
    SlaveMode,
    State,
    Position,
    Pause(Instant),
    End,
}

impl HaltSteps {
    /// Takes the next stronger means, which has the whole time limit again.
    fn escalate(&mut self) -> Option<Step> {
        let (stage, step) = match self.stage {
            Stage::Halt => (Stage::All, Step::KillAll),
            // KillAll had no effect
            Stage::All => (Stage::Single, Step::TaskNames),
            Stage::Single => return None,
        };
        (self.stage, self.until, self.tasks, self.still) = (stage, None, None, 0);
        Some(step)
    }

    /// Halts a motion that may have begun after Robot_Halt, once; it has the whole time limit again.
    const fn halt_again(&mut self) -> Option<Step> {
        if self.halted_again || self.is_refused() {
            return None;
        }
        (self.halted_again, self.until, self.still) = (true, None, 0);
        Some(Step::Halt)
    }

    /// Moves to the next task of the list.
    fn next_task(&mut self) -> Step {
        self.repeated = false;
        match self.place.checked_add(1) {
            Some(place) => {
                self.place = place;
                Step::TaskNames
            }
            None => Step::Halt,
        }
    }

    /// Compares the robot's position with the previous position, and returns the next step.
    fn update_position(&mut self, joints: [f64; JOINTS], now: Instant) -> Step {
        let reported = self.state & MOVING != 0;
        let same = self.last.map(|last| within(&joints, &last, AT_REST));
        let moves = reported || same == Some(false);
        self.moved |= moves;
        if same == Some(true) && !reported {
            self.still = self.still.saturating_add(1);
        } else {
            (self.still, self.last) = (0, Some(joints));
        }
        if moves
            && self.answer == HaltAnswer::NothingMoved
            && let Some(step) = self.halt_again()
        {
            return step;
        }
        let until = *self.until.get_or_insert(now.saturating_add(self.config.limit));
        // the tasks that KillAll stops may need a moment to free the arm
        let owned = self.is_refused() && self.stage == Stage::All;
        let rests = self.still >= self.config.still.max(1) && !owned;
        if rests && !(self.runs_after_kill_all() && now < until) {
            return Step::End;
        }
        let next = now.saturating_add(self.config.interval);
        if now < until {
            return Step::Pause(next.min(until));
        }
        if !moves && !owned {
            // slow polls: nothing has shown that it still moves
            return Step::Pause(next);
        }
        if !owned && self.state & RUNNING == 0 {
            return self.halt_again().unwrap_or(Step::End);
        }
        self.escalate().unwrap_or(Step::End)
    }

    /// Returns whether a task runs, although KillAll was accepted.
    fn runs_after_kill_all(&self) -> bool {
        self.tasks == Some(StoppedTasks::All) && self.state & RUNNING != 0
    }

    const fn is_refused(&self) -> bool {
        matches!(self.answer, HaltAnswer::Refused(_))
    }
}

impl Steps for HaltSteps {
    type Output = Halt;
    const KEEPS_OBJECTS: bool = false;
    const REPEATS: bool = true;

    fn next(&self) -> NextStep<'_> {
        let Handles { controller, robot } = self.handles;
        let of_robot = |command| StepCall::new(FunctionId::ROBOT_EXECUTE).with(robot.0).with(command);
        let of_controller = |command| StepCall::new(FunctionId::CONTROLLER_EXECUTE).with(controller.0).with(command);
        NextStep::Call(match self.step {
            Step::Halt => StepCall::new(FunctionId::ROBOT_HALT).with(robot.0).with(""),
            // without its argument it is answered immediately, by every version of the provider
            Step::KillAll => of_controller("KillAll").with(Argument::Empty),
            Step::TaskNames => StepCall::new(FunctionId::CONTROLLER_GET_TASK_NAMES).with(controller.0).with(""),
            Step::OpenTask => {
                // a real controller refuses a second handle of a task without this option
                StepCall::new(FunctionId::CONTROLLER_GET_TASK)
                    .with(controller.0)
                    .with(self.name.as_str())
                    .with("@IfNotMember")
            }
            Step::TaskStatus => {
                StepCall::new(FunctionId::TASK_EXECUTE).with(self.task.0).with("GetStatus").with(Argument::Empty)
            }
            Step::StopTask => StepCall::new(FunctionId::TASK_STOP).with(self.task.0).with(INITIALIZE).with(""),
            Step::ReleaseTask => StepCall::new(FunctionId::TASK_RELEASE).with(self.task.0),
            Step::SlaveMode => of_robot("slvGetMode").with(Argument::Empty),
            Step::State => of_controller("SysState").with(Argument::Empty),
            Step::Position => of_robot("CurJnt").with(Argument::Empty),
            Step::Pause(until) => return NextStep::Wait(until),
            Step::End => return NextStep::End,
        })
    }

    fn waited(&mut self) {
        // a task may have owned the arm until now
        self.step = if self.is_refused() { Step::Halt } else { Step::SlaveMode };
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        let number = |reply: &Frame<'_>| Int::read(reply.args).map_err(StepCause::Reply);
        self.step = match self.step {
            Step::Halt => {
                let nothing = reply.hresult() == HResult::S_FALSE;
                self.answer = if nothing { HaltAnswer::NothingMoved } else { HaltAnswer::Halted };
                Step::SlaveMode
            }
            Step::KillAll => {
                self.tasks = Some(StoppedTasks::All);
                Step::Halt
            }
            Step::TaskNames => match name_at(reply, self.place.into())? {
                Some(name) => {
                    self.name = name;
                    Step::OpenTask
                }
                None => Step::Halt,
            },
            Step::OpenTask => {
                self.task = TaskHandle(handle_of(reply.args).map_err(StepCause::Reply)?);
                Step::TaskStatus
            }
            Step::TaskStatus if IDLE.contains(&number(reply)?) => Step::ReleaseTask,
            Step::TaskStatus => Step::StopTask,
            Step::StopTask => {
                let before = if let Some(StoppedTasks::Single(count)) = self.tasks { count } else { 0 };
                self.tasks = Some(StoppedTasks::Single(before.saturating_add(1)));
                Step::ReleaseTask
            }
            Step::ReleaseTask => self.next_task(),
            Step::SlaveMode => {
                self.state = 0;
                if number(reply)? == 0 { Step::State } else { Step::Position }
            }
            Step::State => {
                self.state = number(reply)?;
                Step::Position
            }
            Step::Position => self.update_position(joints(reply)?, now),
            Step::Pause(_) | Step::End => Step::End,
        };
        Ok(())
    }

    fn has_effect(&self) -> bool {
        self.stage != Stage::Halt || self.step != Step::Halt || self.halted_again
    }

    /// A failed call does not end the halt if another call may still stop the robot.
    fn recovered(&mut self, cause: &StepCause) -> bool {
        if *cause == StepCause::Failed(Failure::Lost) {
            return false;
        }
        self.step = match (self.step, cause) {
            // no task is the reason
            (Step::Halt, StepCause::Refused(HResult::E_HANDLE | HResult::E_NOT_CONNECTED | HResult::E_BUSY_PROC)) => {
                return false;
            }
            (Step::Halt, StepCause::Refused(code)) => {
                self.answer = HaltAnswer::Refused(*code);
                match self.stage {
                    Stage::Halt => self.escalate().unwrap_or(Step::End),
                    Stage::All | Stage::Single => Step::SlaveMode,
                }
            }
            // the next poll halts again
            (Step::Halt, _) if self.is_refused() => Step::SlaveMode,
            (Step::KillAll, StepCause::Refused(_)) => self.escalate().unwrap_or(Step::End),
            // it may have been executed
            (Step::KillAll, _) => Step::Halt,
            // a name that is too long for a task
            (Step::TaskNames, StepCause::TooLarge) | (Step::OpenTask | Step::ReleaseTask, _) => self.next_task(),
            (Step::TaskNames, _) => Step::Halt,
            // a task of unknown state may move the arm
            (Step::TaskStatus, _) => Step::StopTask,
            (Step::StopTask, _) if !core::mem::replace(&mut self.repeated, true) => Step::StopTask,
            (Step::StopTask, _) => Step::ReleaseTask,
            (Step::SlaveMode | Step::State, StepCause::Refused(_) | StepCause::Reply(_)) => {
                self.state = 0;
                Step::Position
            }
            _ => return false,
        };
        true
    }

    fn output(&mut self) -> Halt {
        let answer = match self.answer {
            HaltAnswer::NothingMoved if self.moved => HaltAnswer::Halted,
            answer => answer,
        };
        let tasks = if self.runs_after_kill_all() { Some(StoppedTasks::AllButRunning) } else { self.tasks };
        Halt { answer, tasks, rests: self.still >= self.config.still.max(1) }
    }
}
