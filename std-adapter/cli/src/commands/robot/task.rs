//! `bcap task`: starts and stops tasks.

use bcap_core::bcap::FunctionId;
use bcap_std::{TaskStart, TaskStatus, TaskStop};
use clap::{Args, Subcommand};

use crate::failure::Failure;
use crate::output::{print_json, print_line};
use crate::session::Session;
use crate::session::slave_mode::spare;

/// Starts or stops a task, or prints its status
///
/// A program that `task start` has started runs on when the command ends.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap task start Pro1 --once
  bcap task status Pro1
  bcap task stop Pro1")]
pub(crate) struct Task {
    #[command(subcommand)]
    pub(crate) command: TaskCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Starts a task
    Start {
        /// The task
        name: String,
        #[command(flatten)]
        cycles: Cycles,
    },
    /// Stops a task
    Stop {
        /// The task
        name: String,
        #[command(flatten)]
        when: When,
    },
    /// Prints what a task does: running, ready, suspended, stopped at a step, or none
    Status {
        /// The task
        name: String,
    },
}

/// How long a task runs.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub(crate) struct Cycles {
    /// Runs the program once
    #[arg(long)]
    pub(crate) once: bool,

    /// Runs the program again and again
    #[arg(long)]
    pub(crate) forever: bool,

    /// Runs one step of the program
    #[arg(long)]
    pub(crate) step: bool,
}

/// When a task stops.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub(crate) struct When {
    /// Stops at once
    #[arg(long)]
    pub(crate) now: bool,

    /// Stops after the present step
    #[arg(long)]
    pub(crate) after_step: bool,

    /// Stops after the present cycle
    #[arg(long)]
    pub(crate) after_cycle: bool,

    /// Stops at once; the next start begins anew
    #[arg(long)]
    pub(crate) reset: bool,
}

/// Runs `bcap task`.
pub(crate) fn task(args: &Task, session: &mut Session, json: bool) -> Result<(), Failure> {
    match &args.command {
        TaskCommand::Start { name, cycles } => {
            let mode = match (cycles.once, cycles.step) {
                (true, _) => TaskStart::OneCycle,
                (_, true) => TaskStart::OneStep,
                _ => TaskStart::Continuous,
            };
            session.with(|controller| controller.task(name)?.start(mode))
        }
        TaskCommand::Stop { name, when } => {
            let mode = match when {
                when if when.now => TaskStop::Now,
                when if when.after_step => TaskStop::AfterStep,
                when if when.after_cycle => TaskStop::AfterCycle,
                when if when.reset => TaskStop::Initialize,
                _ => TaskStop::Default,
            };
            session.with(|controller| controller.task(name)?.stop(mode))
        }
        TaskCommand::Status { name } => {
            spare(session, FunctionId::CONTROLLER_GET_TASK, None)?;
            let status = session.with(|controller| controller.task(name)?.status())?;
            let status = status_text(status);
            let line = &format!("{name} {status}");
            Ok(if json {
                print_json(&serde_json::json!({ "name": name, "status": status }).to_string())
            } else {
                print_line(line)
            }?)
        }
    }
}

/// Returns the name of a status.
pub(crate) fn status_text(status: TaskStatus) -> String {
    match status {
        TaskStatus::None => "none".into(),
        TaskStatus::Suspended => "suspended".into(),
        TaskStatus::Ready => "ready".into(),
        TaskStatus::Running => "running".into(),
        TaskStatus::StoppedAtStep => "stopped at a step".into(),
        other => format!("{other:?}"),
    }
}
