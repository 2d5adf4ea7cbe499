//! The motions of the arm: their routes and options. The tables are in [`arm`](super).

use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::drive::Drive;
use crate::options::{Pass, options};
use crate::pose::Target;
use crate::robot::{Percent, Robot, percent};
use crate::route::{Blocked, Route};
use crate::variables::Variables;
use crate::waits::Wait;

/// Whose internal speed a motion has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Speed {
    Line,
    Joints,
}

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
    let Target { pose, extended, pass } = Target::parse(&request.value(2), ctx.variables)?;
    if let Some(drive) = &extended {
        drive.check(ctx.config.extended_axes)?;
    }
    match interpolation {
        1 => start(robot, ctx, (Route::Joints(pose, extended), pass), Speed::Joints, &option),
        _ => start(robot, ctx, (Route::Line(pose, extended), pass), Speed::Line, &option),
    }
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
    drive(robot, ctx, Drive::parse(absolute, &pairs)?, &option)
}

/// Turns single axes.
pub(super) fn drive(robot: &mut Robot, ctx: &mut Context<'_>, drive: Drive, option: &str) -> Answered {
    drive.check(ctx.config.extended_axes)?;
    let pass = drive.pass;
    start(robot, ctx, (Route::Turn(drive), pass), Speed::Joints, option)
}

/// Executes Robot_GoHome.
pub(super) fn go_home(robot: &mut Robot, ctx: &mut Context<'_>) -> Answered {
    let home = ctx.config.home;
    start(robot, ctx, (Route::Home(home), Pass::Stop), Speed::Joints, "")
}

/// Starts a motion, or adds it to those under way. Without NEXT, the call is answered at its end.
fn start(robot: &mut Robot, ctx: &mut Context<'_>, way: (Route, Pass), speed: Speed, option: &str) -> Answered {
    let internal = if speed == Speed::Line { robot.settings().line } else { robot.settings().joint };
    let options = MoveOptions::read(option, internal, ctx.variables)?;
    match robot.may_move(ctx) {
        Err(HResult::E_ROBOTISBUSY) if robot.may_follow(ctx.peer) => {}
        checked => checked?,
    }
    let started = robot.start(ctx.peer, way, options.internal, ctx.now);
    let id = started.map_err(|blocked| refuse(ctx, blocked))?;
    if !options.next {
        return Ok(Answer::Until(Wait::Motion(id)));
    }
    // a motion without length ends at once
    robot.advance(ctx.now, ctx.waits);
    Ok(Answer::Done)
}

/// Returns the code of a motion that cannot be planned; a pose out of reach is an error of the controller.
pub(super) fn refuse(ctx: &mut Context<'_>, blocked: Blocked) -> HResult {
    match blocked {
        Blocked::OutOfReach(reason) => ctx.raise(reason.code()),
        Blocked::Invalid => blocked.code(),
    }
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
