//! `bcap halt`: halts the robot over a separate connection; in `bcap shell` and `bcap run` over the session's
//! connection.

use std::time::Duration;

use bcap_std::blocking::Halted;
use bcap_std::{Error, Halt, StoppedTasks};
use clap::Args;

use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output::{note, print_block, print_json};
use crate::session::budget::Budget;
use crate::session::connect::not_halted;
use crate::session::{Session, with_session};

/// Halts the robot, even when another client moves it
///
/// Uses a separate connection and needs neither the arm nor the executable token. If the controller does not answer a call within
/// 3 s, or does not end it within 10 s, the exit code is 4. A controller may need seconds to stop a task, so the limit of the whole command
/// grows with the number of tasks; --timeout limits the whole command. The halted motion leaves the error 0x83500076, which must be
/// cleared before the next one; a Slave Mode stream fails because Slave Mode is off.
///
/// A controller refuses a halt while one of its tasks owns the arm. Then all tasks are stopped (KillAll, or Task_Stop of each task if
/// KillAll is refused or has no effect), and the robot is halted again; a task that is started again starts at its first line.
/// `halted` and `nothing was moving` are printed only after the robot was seen at rest. If it was not within 1 s of the last stop, the
/// first line of the output is `the robot STILL MOVES`, and the exit code is 1.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap halt
  bcap halt --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9")]
pub(crate) struct HaltArgs {}

/// The time limit of each call with its keep-alives. The whole halt has no other limit: each task adds the calls that stop it.
const LIMIT: Duration = Duration::from_secs(10);

/// Runs `bcap halt`.
pub(crate) fn halt(session: &mut Session, json: bool) -> Result<(), Failure> {
    let halted = if session.is_open() { attempt(session) } else { limited(session.link(), attempt) };
    match halted {
        Ok(Ok(halted)) if json => print_json(&to_json(halted))?,
        Ok(Ok(halted)) => print_block(&lines(halted))?,
        Ok(Err(halt)) => {
            // with --json the failure is the first line of the output
            if !json {
                print_block(&format!("{halt:#}"))?;
            }
            return Err(not_halted(&halt));
        }
        Err(failure) => {
            if !failure.leaves_the_session_alive() {
                note("the robot may still move; use the emergency stop");
            }
            return Err(failure);
        }
    }
    Ok(())
}

/// Halts the robot over a separate connection.
pub(crate) fn halt_now(link: &LinkArgs) -> Result<Halted, Failure> {
    limited(link, |session| session.with(|controller| controller.robot()?.halt()))
}

/// Calls `halt` with a session that has short time limits, so that a failure is reported while the user still has time to act.
fn limited<T>(link: &LinkArgs, halt: impl FnOnce(&mut Session) -> Result<T, Failure>) -> Result<T, Failure> {
    with_session(&link.limited(), |session| {
        session.begin()?;
        session.set_budget(Budget::start(link));
        session.limit_calls(LIMIT);
        halt(session)
    })
}

/// Halts the robot; the inner error is a robot that may still move.
fn attempt(session: &mut Session) -> Result<Result<Halted, Halt>, Failure> {
    session.with(|controller| match controller.robot()?.halt() {
        Err(Error::NotHalted(halt)) => Ok(Err(halt)),
        halted => halted.map(Ok),
    })
}

fn lines(halted: Halted) -> String {
    match halted {
        Halted::NothingMoved => "nothing was moving".into(),
        Halted::TasksStopped(tasks) => format!("halted\n{tasks}"),
        _ => "halted".into(),
    }
}

/// Returns the members `halted`, and `tasks` if some were stopped: `"all"`, `"all but running"` or their number.
fn to_json(halted: Halted) -> String {
    let tasks = match halted {
        Halted::TasksStopped(StoppedTasks::Single(count)) => format!(",\"tasks\":{count}"),
        Halted::TasksStopped(StoppedTasks::AllButRunning) => ",\"tasks\":\"all but running\"".into(),
        Halted::TasksStopped(_) => ",\"tasks\":\"all\"".into(),
        _ => String::new(),
    };
    format!("{{\"halted\":{}{tasks}}}", halted != Halted::NothingMoved)
}
