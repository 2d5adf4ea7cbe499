//! `bcap move`: a whole motion, from taking the arm to giving it back.

use std::ops::ControlFlow;
use std::time::Duration;

use bcap_capture::duration;
use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_core::procedure::Motion;
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::axis::Axis;
use bcap_std::{Destination, Move, ObjectPath};
use clap::Args;

use crate::commands::robot::axis;
use crate::commands::robot::silence::Silence;
use crate::failure::Failure;
use crate::interrupt::{Interrupt, State};
use crate::output::print_result;
use crate::session::Session;
use crate::session::confirm::Question;
use bcap_live::stream::spare;

/// Moves the robot to a position, and waits until it rests there
///
/// Takes the arm, switches the motor on, moves, switches the motor off again and gives the arm back. Where this session has
/// the arm already (`exec robot TakeArm 0 1` in the shell or a script), it keeps the arm, and the motor stays on. Ctrl-C
/// and Ctrl-Z halt the robot and give the arm back; over a serial line they cannot, because such a line carries one session.
///
/// A real robot moves only after a question, or with --yes; without a terminal the question cannot be asked, so --yes is
/// needed. A virtual controller is recognised by its @FIRMWARE and @SERIAL_NO, and is not asked about.
///
/// A COBOTTA needs its motion prepared before its motor can be switched on: --prepare does it, and can move the arm.
///
/// POSITION is a variable (P1, J2, T3), or a value as the controller's language writes it: 'J(0, 45, 90, 0, 45, 0)',
/// 'P(400, 0, 300, 180, 0, 180, 5)'. The exit code is 0 only if the robot rests at the destination, or,
/// with --no-wait, if the motion has begun.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap move P1 --line --speed 10
  bcap move 'J(0, 45, 90, 0, 45, 0)' --speed 20 --within 30s")]
pub(crate) struct MoveArgs {
    /// The destination
    #[arg(value_name = "POSITION")]
    pub(crate) to: String,

    /// Moves the tool along a line; without it all joints move at the same time
    #[arg(long)]
    pub(crate) line: bool,

    /// Returns when the motion has begun. It needs the arm of the session, so only the shell and scripts have it
    #[arg(long)]
    pub(crate) no_wait: bool,

    #[command(flatten)]
    pub(crate) how: MotionArgs,

    /// One step of an axis instead of the destination.
    #[arg(skip)]
    pub(crate) step: Option<(Axis, f64)>,
}

/// The conditions of a motion.
#[derive(Clone, Debug, Args)]
pub(crate) struct MotionArgs {
    /// The speed, in percent of the speed that the arm is set to
    #[arg(long, value_name = "PERCENT", default_value_t = 10.0)]
    pub(crate) speed: f64,

    /// Selects the tool first; 0 is the flange
    #[arg(long, value_name = "N")]
    pub(crate) tool: Option<u8>,

    /// Selects the work coordinates first; 0 is the base of the robot
    #[arg(long, value_name = "N")]
    pub(crate) work: Option<u8>,

    /// Halts the robot if it has not arrived after this time
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "3min")]
    pub(crate) within: Duration,

    /// Prepares the motion of a COBOTTA first, if that has not been done. The preparation can move the arm
    #[arg(long)]
    pub(crate) prepare: bool,

    /// Moves a real robot without asking for confirmation
    #[arg(long)]
    pub(crate) yes: bool,
}

/// Runs `bcap move`.
pub(crate) fn motion(args: &MoveArgs, session: &mut Session, json: bool) -> Result<(), Failure> {
    check(args)?;
    if !confirmed(args, session)? {
        return Ok(());
    }
    let (key, text) = if args.no_wait { ("started", "on the way to") } else { ("arrived", "at") };
    let to = &args.to;
    Ok(print_result(json, &serde_json::json!({ key: to }), &format!("{text} {to}"))?)
}

/// Moves the robot after the question. Returns as [`go`].
pub(crate) fn confirmed(args: &MoveArgs, session: &mut Session) -> Result<bool, Failure> {
    let way = if args.line { "along a line " } else { "" };
    ask(&format!("moves {way}to {}", args.to), &args.how, session)?;
    go(args, session)
}

/// Returns the motion by a step.
pub(crate) fn step(axis: Axis, by: f64, how: &MotionArgs) -> MoveArgs {
    MoveArgs {
        to: format!("the end of the step {axis} {by:+}"),
        line: matches!(axis, Axis::Coordinate(_)),
        no_wait: false,
        how: how.clone(),
        step: Some((axis, by)),
    }
}

/// Asks for confirmation before the robot moves.
pub(crate) fn ask(what: &str, how: &MotionArgs, session: &mut Session) -> Result<(), Failure> {
    check_speed(how.speed)?;
    // a signal at the question prevents the motion
    session.handle_signals()?;
    session.begin()?;
    let what = format!("{} {what} at {} % of its speed", session.link().target()?, how.speed);
    let warning = if how.prepare { "The robot will move, also for its preparation." } else { "The robot will move." };
    Question { what: &what, warning, refused: "the robot was not moved" }.confirm(session, how.yes)
}

/// Checks the arguments before the first call.
pub(crate) fn check(args: &MoveArgs) -> Result<(), Failure> {
    check_speed(args.how.speed)?;
    Ok(args.to.parse::<Destination>().map(drop)?)
}

/// Checks the speed of a motion.
pub(crate) fn check_speed(speed: f64) -> Result<(), Failure> {
    if speed > 0.0 && speed <= 100.0 {
        return Ok(());
    }
    Err(Failure::Input(format!("--speed {speed}: write a speed above 0 and up to 100")))
}

/// Moves the robot. Returns whether it is where it should be; `false` after an interruption that the line of the shell or the
/// script reports.
pub(crate) fn go(args: &MoveArgs, session: &mut Session) -> Result<bool, Failure> {
    if args.no_wait && !session.has_arm() {
        return Err(Failure::Input(
            "--no-wait needs the arm of this session, which would otherwise be given back while the robot moves; in \
             `bcap shell` or `bcap run` write `exec robot TakeArm 0 1` first"
                .into(),
        ));
    }
    let ended = with_arm(&args.how, session, |session| moved(args, session))?;
    concluded(args, ended)
}

/// Takes the arm with the motor on for `body`, and then gives the arm back with the motor off. An arm that this session has
/// already stays taken. `None` after an interruption that the line of the shell or the script reports.
pub(crate) fn with_arm<T>(
    how: &MotionArgs,
    session: &mut Session,
    body: impl FnOnce(&mut Session) -> Result<T, Failure>,
) -> Result<Option<T>, Failure> {
    let had_arm = session.has_arm();
    let interrupt = session.handle_signals()?;
    if !had_arm {
        // another client's stream
        spare(session, FunctionId::ROBOT_EXECUTE, Some("TakeArm"))?;
    }
    session.prepare_halt(&interrupt)?;
    interrupt.enter(State::Moving);
    // a signal from now on halts the robot, an earlier one prevents the motion
    let ready = if interrupt.is_interrupted() { Ok(()) } else { prepared(how, session, &interrupt, had_arm) };
    let ended = match ready {
        // the preparation was stopped
        Err(_) if how.prepare && interrupt.is_interrupted() && session.is_open() => Ok(None),
        Ok(()) if interrupt.is_interrupted() => Ok(None),
        Ok(()) => body(session).map(Some),
        Err(failure) => Err(failure),
    };
    if had_arm {
        return ended;
    }
    // halts the robot if the connection was lost: the controller releases the arm only when it detects the loss
    session.abandon();
    let given = session.give_arm();
    interrupt.enter(State::Stepping);
    if interrupt.is_interrupted() && ended.as_ref().is_ok_and(|_| given.is_ok()) {
        return Err(interrupt.failure(false));
    }
    // an error of the motion is more useful than an error of giving the arm back
    let ended = ended?;
    given.map(|()| ended)
}

/// Takes the arm, prepares the motion if wanted, and switches the motor on.
fn prepared(how: &MotionArgs, session: &mut Session, interrupt: &Interrupt, had_arm: bool) -> Result<(), Failure> {
    let prepared = session.with(|controller| {
        // a motor that was on before stays on
        let on = controller.robot()?.read::<bool>("@SERVO_ON");
        let go_on = |_, _| if interrupt.is_interrupted() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let mut arm = if how.prepare { controller.make_ready(None, go_on)? } else { controller.arm()? };
        let prepared = (|| {
            if !matches!(on, Ok(true)) {
                arm.motor_on()?;
            }
            how.tool.map_or(Ok(()), |tool| arm.select_tool(tool))?;
            how.work.map_or(Ok(()), |work| arm.select_work(work))
        })();
        if prepared.is_ok() || had_arm {
            arm.keep();
        }
        prepared
    });
    prepared.map_err(|failure| match failure {
        Failure::Refused { code: code @ HResult::E_MOTION_UNPREPARED, .. } => Failure::Unfit {
            message: failure.to_string(),
            code: Some(code),
            hint: Some("keep clear of the arm, which can move: `bcap recover` prepares it after this error, --prepare before a motion".into()),
        },
        failure => failure,
    })
}

/// Moves, and returns how the motion ended; with `no_wait`, returns `Arrived` once it has started.
fn moved(args: &MoveArgs, session: &mut Session) -> Result<Motion, Failure> {
    // the motion has its own time limit
    session.suspend_budget();
    if args.no_wait {
        return started(args, session).map(|()| Motion::Arrived);
    }
    let motion = commanded(args, session)?;
    let silence = Silence::watch(session)?;
    let ended = session.with(|controller| {
        let mut arm = controller.arm()?;
        let ended = arm.move_to(&motion, args.how.within);
        arm.keep();
        ended
    });
    drop(silence);
    session.restart_budget();
    ended
}

fn commanded(args: &MoveArgs, session: &mut Session) -> Result<Move, Failure> {
    let to = args.to.as_str();
    let motion = match args.step {
        Some((axis, by)) => axis::step(axis, by, session)?,
        None if args.line => Move::line(to),
        None => Move::joint(to),
    };
    Ok(motion.speed_percent(args.how.speed))
}

/// Starts a motion without waiting for its end.
fn started(args: &MoveArgs, session: &mut Session) -> Result<(), Failure> {
    let robot = session.object(&"robot".parse::<ObjectPath>()?)?;
    let interpolation = if args.line { 2_i32 } else { 1 };
    let (to, option) = (format!("@E {}", args.to), format!("NEXT,SPEED={}", args.how.speed));
    let arguments = [Value::new(&robot)?, Value::new(&interpolation)?, Value::new(&to)?, Value::new(&option)?];
    session.call("robot", FunctionId::ROBOT_MOVE, &arguments).map(drop)
}

fn concluded(args: &MoveArgs, ended: Option<Motion>) -> Result<bool, Failure> {
    let to = &args.to;
    let unfit = |message: String, code| Err(Failure::Unfit { message, code, hint: None });
    match ended {
        None => Ok(false),
        Some(Motion::Arrived) => Ok(true),
        Some(Motion::Failed(code)) => unfit(format!("not at {to}: the controller has the error {code}"), Some(code)),
        Some(Motion::TimedOut) => unfit(
            format!("not at {to}: it took more than {:?} (--within), so the robot was halted", args.how.within),
            None,
        ),
        Some(Motion::Halted) => Err(Failure::unfit(
            format!("not at {to}: the robot was halted"),
            "if that has left an error (`bcap errors`), clear it before the next motion: `bcap errors --clear`",
        )),
        Some(_) => unfit(format!("the robot rests, and whether it is at {to} is unknown: read its position"), None),
    }
}
