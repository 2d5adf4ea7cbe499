//! `bcap recover`: shows the problems and the plan, asks for confirmation, and recovers the robot step by step.

use std::io;
use std::ops::ControlFlow;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant as Value;
use bcap_std::blocking::Arm;
use bcap_std::{Error, Examination, Obstacle, RecoveryConfig, RecoveryStep};
use clap::Args;
use serde_json::json;

use crate::commands::robot::errors;
use crate::commands::robot::motion::check_speed;
use crate::failure::Failure;
use crate::interrupt::{Interrupt, State};
use crate::output::{note, print_json, print_line, print_result};
use crate::session::Session;
use crate::session::confirm::Question;

/// The outcome of a recovery that could not undo a step.
const UNKNOWN: &str = "IT IS UNKNOWN whether the motor is off and the arm is free";

/// Recovers the robot after an error: shows the plan, asks, and reports each step
///
/// Reads the errors and the state, which changes nothing and interrupts no stream. If a person or another program must do
/// something first (release the emergency stop, select Auto, end a stream, repair a fault), the command says what, and changes
/// nothing. Otherwise it clears the errors, takes the arm, resets the safe torque off, prepares the motion of a COBOTTA, and
/// switches the motor on: the steps that this model and this state need. The arm of a COBOTTA can move.
///
/// Before errors are cleared the command always asks, because a controller with errors does not say whether another program
/// uses the robot; --yes answers that. Without errors a virtual controller is not asked about.
///
/// In the end the motor that was switched on is switched off, and the arm is given back, also after an error or a signal.
/// --keep leaves the motor on. Where this session has the arm already, it keeps the arm, and the motor stays on.
///
/// With --json the lines are one for each error, as `bcap errors --json`, then {"plan":[STEP..],"obstacles":[TEXT..]}, then
/// {"step":"ClearError","result":"done"} for each step (or "left out", with the code), and {"recovered":true,"motor":false}.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap recover
  bcap recover --yes --keep --speed 10")]
pub(crate) struct Recover {
    /// Leaves the motor on
    #[arg(long)]
    pub(crate) keep: bool,

    /// Sets the external speed, in percent of the maximum
    #[arg(long, value_name = "PERCENT")]
    pub(crate) speed: Option<f64>,

    /// Recovers without asking: no other program uses the robot, and no person is near it
    #[arg(long)]
    pub(crate) yes: bool,
}

/// Checks the arguments before the first call.
pub(crate) fn check(args: &Recover) -> Result<(), Failure> {
    args.speed.map_or(Ok(()), check_speed)
}

/// Runs `bcap recover`.
pub(crate) fn recover(args: &Recover, session: &mut Session, json: bool) -> Result<(), Failure> {
    check(args)?;
    // a signal at the question prevents the recovery
    let interrupt = session.handle_signals()?;
    session.begin()?;
    let state = session.with(|controller| controller.robot()?.examine())?;
    if state.error_count > 0 {
        errors::list(session, json)?;
    }
    let steps: Vec<RecoveryStep> = state.steps(args.speed.is_some()).collect();
    show(&state, &steps, json)?;
    if let Some(obstacle) = state.obstacles().next() {
        let again = if matches!(obstacle, Obstacle::StreamUnknown(_)) {
            "`bcap errors --clear` and `bcap recover`"
        } else {
            "`bcap recover` again"
        };
        let hint = Some(format!("then {again}"));
        return Err(Failure::Unfit { message: format!("not recovered: {obstacle}"), code: obstacle.code(), hint });
    }
    if state.is_ready() && args.speed.is_none() {
        return conclude(true, json);
    }
    let is_alone = ask(args, session, &state, &steps)?;
    // the state may change while the question is open
    let agreed = (!args.yes).then(|| steps.iter().copied().collect());
    let config = RecoveryConfig { is_alone, speed: args.speed, agreed };
    let had_arm = session.has_arm();
    session.prepare_halt(&interrupt)?;
    let (done, is_undone) = perform(session, config, &interrupt, json);
    let given = if had_arm { Ok(()) } else { give(session, args.keep && done.is_ok() && !interrupt.is_interrupted()) };
    interrupt.enter(State::Stepping);
    if interrupt.is_interrupted() && session.is_open() {
        given?;
        let what = if is_undone { "the motor was switched off and the arm given back" } else { UNKNOWN };
        return Err(Failure::Interrupted(format!("interrupted: {what}; errors that were cleared stay cleared")));
    }
    if !is_undone {
        note(UNKNOWN);
    }
    done.and(given)?;
    let was_on = state.state.is_some_and(|state| state.motor_is_on());
    conclude(was_on || had_arm || args.keep, json)
}

/// Prints the obstacles and the plan.
fn show(state: &Examination, steps: &[RecoveryStep], json: bool) -> io::Result<()> {
    let obstacles: Vec<String> = state.obstacles().map(|obstacle| obstacle.to_string()).collect();
    let is_needed = !state.is_ready() && obstacles.is_empty();
    let plan: Vec<&str> = steps.iter().filter(|_| is_needed).map(|step| step.name()).collect();
    if json {
        return print_json(&json!({ "plan": plan, "obstacles": obstacles }).to_string());
    }
    obstacles.iter().try_for_each(|obstacle| print_line(&format!("first    {obstacle}")))?;
    if is_needed { print_line(&format!("plan     {}", plan.join(", "))) } else { Ok(()) }
}

/// Asks for confirmation. Returns whether the user has vouched that no other program uses the robot.
fn ask(args: &Recover, session: &mut Session, state: &Examination, steps: &[RecoveryStep]) -> Result<bool, Failure> {
    let names: Vec<&str> = steps.iter().map(|step| step.name()).collect();
    let what = format!("{} gets {}", session.link().target()?, names.join(", "));
    let warning = if steps.contains(&RecoveryStep::MotionPreparation) {
        "The arm CAN MOVE. No other program may use the robot, and no person may be near it."
    } else {
        "The motor goes on. No other program may use the robot, and no person may be near it."
    };
    let question = Question { what: &what, warning, refused: "nothing was changed" };
    let has_errors = state.state.is_some_and(|state| state.has_error());
    if has_errors {
        question.confirm_by_person(session, args.yes)?;
    } else {
        question.confirm(session, args.yes)?;
    }
    Ok(has_errors)
}

/// Performs the steps, and reports each. A signal ends it after a step; if the arm is taken, the signal also halts the robot.
/// The second value is false if a step could not be undone and no later action undoes it.
fn perform(
    session: &mut Session,
    config: RecoveryConfig,
    interrupt: &Interrupt,
    json: bool,
) -> (Result<(), Failure>, bool) {
    // the preparation and the motor take longer than other calls, and no time limit may prevent undoing them
    session.suspend_budget();
    if session.has_arm() {
        interrupt.enter(State::Moving);
    }
    let (mut printed, mut is_undone) = (Ok(()), true);
    let done = session.with(|controller| {
        let observe = |step, result: Result<(), HResult>| {
            if step == RecoveryStep::TakeArm && result.is_ok() {
                interrupt.enter(State::Moving);
            }
            printed = report(step, result, json);
            if printed.is_err() || interrupt.is_interrupted() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        let had_motor = controller.has_motor();
        let made = controller.make_ready(Some(config), observe).map(Arm::keep);
        let is_unsettled = matches!(&made, Err(Error::NotRecovered(ended)) if ended.error.unsettled);
        // an arm that the session has is given back later
        is_undone = controller.has_arm() || !is_unsettled && controller.has_motor() == had_motor;
        made
    });
    session.restart_budget();
    (printed.map_err(Failure::from).and(done), is_undone)
}

fn report(step: RecoveryStep, result: Result<(), HResult>, json: bool) -> io::Result<()> {
    let name = step.name();
    match result {
        Ok(()) => print_result(json, &json!({ "step": name, "result": "done" }), &format!("done     {step}")),
        Err(code) => print_result(
            json,
            &json!({ "step": name, "result": "left out", "code": code.0, "hresult": code.name() }),
            &format!("left out {step}: the controller does not have it ({code})"),
        ),
    }
}

/// Gives the arm back, and switches the motor off unless it is to stay on.
fn give(session: &mut Session, keeps_motor: bool) -> Result<(), Failure> {
    // halts the robot if the connection was lost
    session.abandon();
    if !keeps_motor {
        return session.give_arm();
    }
    let robot = session.object(&"robot".parse()?)?;
    let arguments = [Value::new(&robot)?, Value::new("GiveArm")?, Value::default()];
    session.call("GiveArm", FunctionId::ROBOT_EXECUTE, &arguments).map(drop)
}

fn conclude(motor: bool, json: bool) -> Result<(), Failure> {
    let line =
        if motor { "recovered: no errors, the motor is on" } else { "recovered: no errors, the motor is off again" };
    Ok(print_result(json, &json!({ "recovered": true, "motor": motor }), line)?)
}
