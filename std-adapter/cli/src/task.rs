//! `bcap task`: starts and stops tasks.

use bcap_core::bcap::FunctionId;
use bcap_std::{TaskStart, TaskStatus, TaskStop};

use crate::args::{Task, TaskCommand};
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::session::Session;
use crate::stream::spare;

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
