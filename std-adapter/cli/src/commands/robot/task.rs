//! `bcap task`: starts and stops tasks.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::Variant;
use bcap_live::reader::status_text;
use bcap_std::{ObjectPath, TaskStart, TaskStop};
use clap::{Args, Subcommand};
use serde_json::json;

use crate::failure::Failure;
use crate::output::{note, print_result};
use crate::session::Session;
use crate::session::variables::{get_one, list};
use bcap_live::stream::spare;

/// Lists the tasks, starts or stops some, or prints the status of one
///
/// Without a subcommand a line has the name, the state, the line of the program and the time of its last cycle; `-` is what the
/// controller does not say. A program that `task start` has started runs on when the command ends.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap task
  bcap task start Pro1 --once
  bcap task status Pro1
  bcap task stop Pro1")]
pub(crate) struct Task {
    #[command(subcommand)]
    pub(crate) command: Option<TaskCommand>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Starts tasks, one after the other; the first refusal ends that
    Start {
        /// The tasks
        #[arg(required = true)]
        names: Vec<String>,
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

    /// Stops after the current step
    #[arg(long)]
    pub(crate) after_step: bool,

    /// Stops after the current cycle
    #[arg(long)]
    pub(crate) after_cycle: bool,

    /// Stops at once; the next start begins anew
    #[arg(long)]
    pub(crate) reset: bool,
}

/// Runs `bcap task`.
pub(crate) fn task(args: &Task, session: &mut Session, json: bool) -> Result<(), Failure> {
    let Some(command) = &args.command else { return list_tasks(session, json) };
    match command {
        TaskCommand::Start { names, cycles } => {
            let mode = match (cycles.once, cycles.step) {
                (true, _) => TaskStart::OneCycle,
                (_, true) => TaskStart::OneStep,
                _ => TaskStart::Continuous,
            };
            for (done, name) in names.iter().enumerate() {
                let started = session.with(|controller| controller.task(name)?.start(mode));
                started.inspect_err(|_| match names.get(..done) {
                    None | Some([]) => {}
                    Some(done) => note(&format!("started before: {}", done.join(", "))),
                })?;
            }
            Ok(())
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
            Ok(print_result(json, &json!({ "name": name, "status": status }), &format!("{name} {status}"))?)
        }
    }
}

/// Lists the tasks with their states.
fn list_tasks(session: &mut Session, json: bool) -> Result<(), Failure> {
    spare(session, FunctionId::CONTROLLER_GET_TASK_NAMES, None)?;
    for name in list(session, &ObjectPath::controller(), FunctionId::CONTROLLER_GET_TASK_NAMES)? {
        spare(session, FunctionId::TASK_EXECUTE, Some("GetStatus"))?;
        let status = status_text(session.with(|controller| controller.task(&name)?.status())?);
        let [line, cycle] = ["@LINE_NO", "@CYCLE_TIME"].map(|variable| {
            let path = ObjectPath::controller().join(Object::Task, name.as_str()).join(Object::Variable, variable);
            match get_one(session, &path) {
                Ok(value) => Ok(first_number(value.as_variant())),
                Err(failure) if failure.leaves_the_session_alive() => Ok(None),
                Err(failure) => Err(failure),
            }
        });
        let (line, cycle) = (line?, cycle?);
        let task = json!({ "name": name, "status": status, "line": line, "cycle_ms": cycle });
        let shown = |number: Option<f64>| number.map_or_else(|| "-".into(), |number| number.to_string());
        let row = format!("{name:16} {status:17} line {:5} cycle {} ms", shown(line), shown(cycle));
        print_result(json, &task, &row)?;
    }
    Ok(())
}

/// Returns a number, or the first number of an array, such as the line of `@LINE_NO`.
fn first_number(value: Variant<'_>) -> Option<f64> {
    value.as_array().and_then(|array| array.iter().next()).unwrap_or(value).as_f64()
}
