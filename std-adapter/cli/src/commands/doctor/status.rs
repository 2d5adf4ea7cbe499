//! `bcap status`: the state of the controller and of the robot, each line with the command that changes it.
//!
//! Variables are always read. While a stream of Slave Mode runs, or may run, the command sends nothing that would end it.

use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::procedure::SysState;
use bcap_std::{Examination, ObjectPath, TaskStatus};
use clap::Args;

use super::report::{Finding, Report};
use super::{PERMISSION, emergency_stop, errors, mode, token_finding, variable};
use crate::failure::Failure;
use crate::session::Session;
use crate::session::variables::{list, short_type, shown};
use bcap_live::stream::StreamCheck;

/// Shows the state of the controller and of the robot: what it is, what it does, and why it is not ready
///
/// Lines are as in `bcap doctor`: FAILED is a reason why the robot is not ready, and the line after it has the remedy. It only
/// reads, never takes the arm, and asks nothing that would end a stream of Slave Mode. The exit code is 0 for any state that
/// was read.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap status
  bcap status --json")]
pub(crate) struct Status {}

/// Why a line is left out whose question only a robot answers.
const NO_ROBOT: &str = "the controller gives no robot; the last line has the reason";

/// Runs `bcap status`.
pub(crate) fn status(session: &mut Session, json: bool) -> Result<(), Failure> {
    session.begin()?;
    let mut report = Report::new(json);
    let mut read = |name: &str| Ok::<_, Failure>(variable(session, name)?.map(|value| shown(&value)));
    let (kind, version, number) = (read("@TYPE")?, read("@VERSION")?.unwrap_or_default(), read("@MODE")?);
    let (servo, speed) = (read("robot/@SERVO_ON")?, read("robot/@EXTSPEED")?);
    let position = read("robot/@CURRENT_POSITION")?;
    let state = match session.with(|controller| controller.robot()?.examine()) {
        // a controller without a robot, or whose robot is not ready, has the other lines
        Err(refused @ Failure::Refused { .. }) => Err(refused.to_string()),
        state => Ok(state?),
    };
    let kind = short_type(&kind.unwrap_or_default());
    report.note("controller", Finding::Passed(format!("{kind} {version}")))?;
    report.note("mode", number.map_or_else(|| Finding::skipped("unknown"), |number| mode(number == "3")))?;
    report.note("permission", Finding::skipped(PERMISSION))?;
    report.note("token", of_state(&state, |bits, _| token_finding(bits.has_outside_token())))?;
    report.note("errors", of_state(&state, errors))?;
    report.note("emergency stop", of_state(&state, |bits, state| emergency_stop(bits, state.torque_off)))?;
    report.note("motor", motor(servo.as_deref()))?;
    report.note("arm", state.as_ref().map_or_else(|_| Finding::skipped(NO_ROBOT), arm))?;
    let known = |value: Option<String>, unit| value.map_or_else(|| "unknown".into(), |value| format!("{value}{unit}"));
    report.note("speed", Finding::Passed(format!("{}; `bcap move --speed` changes it", known(speed, " %"))))?;
    report
        .note("position", Finding::Passed(format!("{}; X,Y,Z in mm, RX,RY,RZ in degrees, FIG", known(position, ""))))?;
    report.note("tasks", tasks(session)?)?;
    let missing =
        |why: &String| Finding::failed(why.as_str(), "`bcap names robot` lists the robots, `bcap errors` the errors");
    report.note("ready", state.as_ref().map_or_else(missing, |state| ready(state, servo.as_deref())))
}

/// Returns a finding about the state; skipped if it is unknown, such as during a stream.
fn of_state(state: &Result<Examination, String>, finding: impl FnOnce(SysState, &Examination) -> Finding) -> Finding {
    match state.as_ref().map(|state| (state, state.state, state.stream)) {
        Ok((state, Some(bits), _)) => finding(bits, state),
        Ok((_, None, StreamState::Runs)) => {
            Finding::skipped("a stream of Slave Mode runs, and the question would end it")
        }
        Ok(_) => Finding::skipped("the controller does not say it"),
        Err(_) => Finding::skipped(NO_ROBOT),
    }
}

fn motor(servo: Option<&str>) -> Finding {
    Finding::Passed(match servo {
        Some("true") => "on; `bcap exec robot Motor 0` switches it off".into(),
        Some(_) => "off; `bcap move` and `bcap recover --keep` switch it on".into(),
        None => "unknown".into(),
    })
}

fn arm(state: &Examination) -> Finding {
    match (state.stream, state.owns_arm) {
        (StreamState::Runs, _) => Finding::Passed("a client in Slave Mode has it; `bcap halt` stops the robot".into()),
        (_, true) => Finding::Passed("this session has it; `exec robot GiveArm` gives it back".into()),
        _ => Finding::skipped(
            "only taking it shows whether another client has it, which `bcap doctor` does for a moment",
        ),
    }
}

/// Returns the tasks that run.
fn tasks(session: &mut Session) -> Result<Finding, Failure> {
    let mut check = StreamCheck::default();
    for (function, command) in
        [(FunctionId::CONTROLLER_GET_TASK_NAMES, None), (FunctionId::TASK_EXECUTE, Some("GetStatus"))]
    {
        if let Some(why) = check.skip(session, function, command)? {
            return Ok(Finding::Skipped(why));
        }
    }
    let names = match list(session, &ObjectPath::controller(), FunctionId::CONTROLLER_GET_TASK_NAMES) {
        Err(failure) if failure.leaves_the_session_alive() => return Ok(Finding::Skipped(failure.to_string())),
        names => names?,
    };
    let mut running = Vec::new();
    for name in names {
        if session.with(|controller| controller.task(&name)?.status())? == TaskStatus::Running {
            running.push(name);
        }
    }
    Ok(Finding::Passed(match running.as_slice() {
        [] => "none runs; `bcap task start` starts one".into(),
        running => format!("{} running; `bcap task stop` stops one, `bcap halt` the robot", running.join(", ")),
    }))
}

/// Returns whether a motion can start, and otherwise why not.
fn ready(state: &Examination, servo: Option<&str>) -> Finding {
    let mut reasons: Vec<String> = state.obstacles().map(|obstacle| obstacle.to_string()).collect();
    if state.error_count > 0 && reasons.is_empty() {
        reasons.push("the controller has errors".into());
    }
    match (reasons.as_slice(), servo) {
        ([], Some("true")) => Finding::Passed("yes, if no other client has the arm".into()),
        ([], _) => Finding::Passed("yes, after the motor is on, if no other client has the arm".into()),
        (reasons, _) => {
            Finding::failed(reasons.join("; "), "`bcap recover` shows the steps, and asks before it changes anything")
        }
    }
}
