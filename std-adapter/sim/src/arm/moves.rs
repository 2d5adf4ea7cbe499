//! The motions of the arm: their targets, paths and options. The tables are in [`arm`](super).

use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::drive::Drive;
use crate::kinematics::{Axes, OutOfReach, figure, forward, out_of_range, six, with_joints};
use crate::motion::Path;
use crate::options::options;
use crate::pose::Pose;
use crate::robot::{Percent, Robot, percent};
use crate::variables::Variables;
use crate::waits::Wait;

/// The options of a motion.
struct MoveOptions {
    internal: Percent,
    /// Answer at once.
    next: bool,
}

/// Executes Robot_Move.
pub(super) fn move_to(robot: &mut Robot, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
    let option = request.text(3).to_string();
    let interpolation = request.int(1);
    if ![1, 2].contains(&interpolation) {
        return Err(if [3, 4].contains(&interpolation) { HResult::E_NOTIMPL } else { HResult::E_INVALIDARG });
    }
    let (pose, drive) = Pose::parse_target(&request.value(2), ctx.variables)?;
    if let Some(drive) = &drive {
        drive.check(ctx.config.extended_axes)?;
    }
    let extended = |here: &Axes| drive.as_ref().map_or(*here, |drive| drive.apply(here));
    if interpolation == 1 {
        let target = |here: &Axes| Ok(with_joints(&pose.joints(&six(here))?, &extended(here)));
        return move_axes(robot, ctx, &option, target);
    }
    let options = MoveOptions::read(&option, robot.settings().line, ctx.variables)?;
    if !may_start(robot, ctx)? {
        return Ok(Answer::Until(Wait::Turn));
    }
    let here = robot.axes(ctx.now);
    let path = line(here, &pose, &extended(&here))?.map_err(|error| ctx.raise(error.code()))?;
    start(robot, ctx, path, options)
}

/// Executes DriveEx or DriveAEx, whose parameter is `[pairs, option]` or the pairs as text.
pub(super) fn drive_command(robot: &mut Robot, ctx: &mut Context<'_>, absolute: bool, param: &Variant<'_>) -> Answered {
    let param = param.flatten();
    let (pairs, option) = match param {
        Variant::Array(array) => match array.get(1).map(|item| item.flatten()) {
            Some(Variant::Bstr(option)) if array.len() == 2 => (array.get(0).unwrap_or(param), option.to_string()),
            _ => (param, String::new()),
        },
        _ => (param, String::new()),
    };
    drive(robot, ctx, &Drive::parse(absolute, &pairs)?, &option)
}

/// Turns single axes.
pub(super) fn drive(robot: &mut Robot, ctx: &mut Context<'_>, drive: &Drive, option: &str) -> Answered {
    drive.check(ctx.config.extended_axes)?;
    move_axes(robot, ctx, option, |here| Ok(drive.apply(here)))
}

/// Moves the axes to `target`, a function of their present position.
pub(super) fn move_axes(
    robot: &mut Robot,
    ctx: &mut Context<'_>,
    option: &str,
    target: impl FnOnce(&Axes) -> Result<Axes, OutOfReach>,
) -> Answered {
    let options = MoveOptions::read(option, robot.settings().joint, ctx.variables)?;
    if !may_start(robot, ctx)? {
        return Ok(Answer::Until(Wait::Turn));
    }
    let here = robot.axes(ctx.now);
    let end = target(&here).and_then(in_range).map_err(|error| ctx.raise(error.code()))?;
    start(robot, ctx, Path::axes(here, end), options)
}

/// Checks what a motion needs; `false` if it must wait for the end of this client's own motion with NEXT.
fn may_start(robot: &Robot, ctx: &mut Context<'_>) -> Result<bool, HResult> {
    match robot.may_move(ctx) {
        Err(HResult::E_ROBOTISBUSY) if robot.executes_motion_of(ctx.peer) => Ok(false),
        checked => checked.map(|()| true),
    }
}

/// Starts a motion. Without NEXT, the call is answered at its end.
fn start(robot: &mut Robot, ctx: &mut Context<'_>, path: Path, options: MoveOptions) -> Answered {
    let id = robot.start(ctx.peer, path, options.internal, ctx.now);
    if !options.next {
        return Ok(Answer::Until(Wait::Motion(id)));
    }
    // a motion without length ends at once
    robot.advance(ctx.now, ctx.waits);
    Ok(Answer::Done)
}

impl MoveOptions {
    fn read(text: &str, internal: Percent, variables: &Variables) -> Result<Self, HResult> {
        let mut read = Self { internal, next: false };
        for (key, value) in options(text) {
            let scaled = |base: f32| -> Result<f32, HResult> {
                let value = variables.number_of_text(value.ok_or(HResult::E_INVALIDARG)?)?;
                Ok(base * percent(value)? / 100.0)
            };
            match key.to_ascii_uppercase().as_str() {
                "NEXT" if value.is_none() => read.next = true,
                "SPEED" | "S" => read.internal.speed = scaled(internal.speed)?,
                "ACCEL" => read.internal.accel = scaled(internal.accel)?,
                "DECEL" => read.internal.decel = scaled(internal.decel)?,
                _ => return Err(HResult::E_INVALIDARG),
            }
        }
        Ok(read)
    }
}

fn in_range(axes: Axes) -> Result<Axes, OutOfReach> {
    out_of_range(&axes).map_or(Ok(axes), |axis| Err(OutOfReach(axis)))
}

/// Plans a line, on which the posture cannot change; J7 and J8 move to those of `extended`.
fn line(here: Axes, pose: &Pose, extended: &Axes) -> Result<Result<Path, OutOfReach>, HResult> {
    let (frame, fig) = match pose {
        Pose::Joints(joints) => (forward(joints), None),
        Pose::Frame(frame, fig) => (*frame, *fig),
    };
    let end = with_joints(&six(&here), extended);
    let path = in_range(end).and_then(|end| Path::line(here, &forward(&six(&here)), &frame, &end));
    // shoulder, elbow and wrist; the turns of J4 and J6 result from the line
    const POSTURE: u8 = 7;
    match (&path, fig) {
        (Ok(path), Some(fig)) if (figure(&six(&path.end())) ^ fig) & POSTURE != 0 => Err(HResult::E_INVALIDARG),
        _ => Ok(path),
    }
}
