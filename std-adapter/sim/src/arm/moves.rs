//! The motions of the arm: their routes and options. The tables are in [`arm`](super).

use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::{Array, Variant};

use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::curve::Arc;
use crate::drive::Drive;
use crate::kinematics::{Frame, cross, unit};
use crate::options::{Pass, options, pass_of_text, split_outside_brackets};
use crate::path::Blocked;
use crate::path_points::PathPoints;
use crate::pose::{Pose, Target, length_and_pass, three_vectors, vector, vector_and_pass};
use crate::robot::{Percent, Robot, percent};
use crate::route::Route;
use crate::rules;
use crate::value::{number, numbers, whole};
use crate::waits::Wait;

/// The largest angle of Robot_Rotate, in degrees: ten turns. Planning takes longer for a larger one.
const ROTATION_MAX: f64 = 3600.0;

/// Whose internal speed a motion has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Speed {
    Line,
    Joints,
}

impl Speed {
    const fn of(line: bool) -> Self {
        if line { Self::Line } else { Self::Joints }
    }
}

/// The options of a motion.
struct MoveOptions {
    internal: Percent,
    /// Answer immediately.
    next: bool,
}

/// Executes Robot_Move.
pub(super) fn move_to(
    robot: &mut Robot,
    ctx: &mut Context<'_>,
    interpolation: i32,
    pose: &Variant<'_>,
    option: &str,
) -> Answered {
    match interpolation {
        interpolation @ (1 | 2) => {
            let Target { pose, extended, pass } = Target::parse(pose, ctx.variables)?;
            let pose = robot.coordinates().flange(pose);
            if let Some(drive) = &extended {
                drive.check(robot.geometry().joints(), ctx.config.extended_axes)?;
            }
            match interpolation {
                1 => start(robot, ctx, (Route::Joints(pose, extended), pass), Speed::Joints, option),
                _ => start(robot, ctx, (Route::Line(pose, extended), pass), Speed::Line, option),
            }
        }
        3 => {
            let (via, Target { pose, pass, .. }) = Target::parse_two(pose, ctx.variables)?;
            let coordinates = robot.coordinates();
            let via = coordinates.work.times(&coordinates.pose_of(&via).0).position;
            start(robot, ctx, (Route::Arc(via, coordinates.flange(pose)), pass), Speed::Line, option)
        }
        _ => Err(HResult::E_INVALIDARG),
    }
}

/// Executes Approach: `[interpolation, pose, length]`, optionally with a motion option after them.
pub(super) fn approach(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (line, [pose, length, option]) = straight_or_not(param)?;
    let (distance, pass) = length_and_pass(&length)?;
    if Target::has_pass(&pose) {
        return Err(HResult::E_INVALIDARG);
    }
    let coordinates = robot.coordinates();
    let (frame, fig) = coordinates.pose_of(&Pose::parse(&pose, ctx.variables)?);
    let pose = coordinates.flange(Pose::Frame(coordinates.arm.withdraw(&frame, distance), fig));
    let route = if line { Route::Line(pose, None) } else { Route::Joints(pose, None) };
    start(robot, ctx, (route, pass), Speed::of(line), &text_or_nothing(&option)?)
}

/// Executes Depart: `[interpolation, length]`, optionally with a motion option after them.
pub(super) fn depart(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (line, [length, option]) = straight_or_not(param)?;
    let (distance, pass) = length_and_pass(&length)?;
    start(robot, ctx, (Route::Depart { distance, line }, pass), Speed::of(line), &text_or_nothing(&option)?)
}

/// Executes Robot_Move 4: through the points of a path.
pub(super) fn follow(
    robot: &mut Robot,
    paths: &PathPoints,
    ctx: &mut Context<'_>,
    path: &Variant<'_>,
    option: &str,
) -> Answered {
    let (path, pass) = length_and_pass(path)?;
    let coordinates = robot.coordinates();
    let points: Vec<_> = paths.frames(whole(path)?)?.iter().map(|frame| coordinates.work.times(frame)).collect();
    if points.is_empty() {
        return Err(HResult::E_INVALIDARG);
    }
    start(robot, ctx, (Route::Through(points), pass), Speed::Line, option)
}

/// Executes Draw: `[interpolation, vector]`, optionally with a motion option after them.
pub(super) fn draw(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (line, [way, option]) = straight_or_not(param)?;
    let (way, pass) = vector_and_pass(&way, ctx.variables)?;
    let way = robot.coordinates().work.direction(way);
    start(robot, ctx, (Route::Draw { way, line }, pass), Speed::of(line), &text_or_nothing(&option)?)
}

/// Executes ArchMove: `[pose, height]`, optionally with the lengths of the rise and the fall.
pub(super) fn arch(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let item = |n: usize| array.get(n).unwrap_or(Variant::Empty).flatten();
    let length = |n: usize| if item(n).is_empty() { Some(0.0) } else { number(&item(n)) };
    let [Some(height), Some(rise), Some(fall)] = [1, 2, 3].map(length) else { return Err(HResult::E_INVALIDARGTYPE) };
    let is_valid = height > 0.0 && [rise, fall].iter().all(|length| (0.0..=height).contains(length));
    if !is_valid || !(2..=4).contains(&array.len()) {
        return Err(HResult::E_INVALIDARG);
    }
    let Target { pose, extended: None, pass } = Target::parse(&item(0), ctx.variables)? else {
        return Err(HResult::E_INVALIDARG);
    };
    let coordinates = robot.coordinates();
    let top = coordinates.work.direction([0.0, 0.0, height]);
    start(robot, ctx, (Route::Arch { pose: coordinates.flange(pose), top }, pass), Speed::Line, "")
}

/// Executes Arrive: waits until the current motion has covered a part of its path, in percent.
pub(super) fn arrive(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [percent] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    if !(percent > 0.0 && percent <= 100.0) {
        return Err(HResult::E_INVALIDARG);
    }
    robot.may(ctx, &rules::SETTING)?;
    Ok(robot.motion().map_or(Answer::Done, |id| Answer::Until(Wait::Part(id, (percent * 1e3).round() as u32))))
}

/// Executes Robot_Rotate.
pub(super) fn rotate(robot: &mut Robot, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
    let plane = request.value(1);
    let name = match plane.flatten() {
        Variant::Bstr(text) => text.to_string().trim().to_ascii_uppercase(),
        _ => String::new(),
    };
    let work = robot.coordinates().work;
    let (of_tool, plane_axis) = match name.strip_suffix('H').map_or((false, name.as_str()), |name| (true, name)) {
        (of_tool, "XY") => (of_tool, [0.0, 0.0, 1.0]),
        (of_tool, "YZ") => (of_tool, [1.0, 0.0, 0.0]),
        (of_tool, "ZX") => (of_tool, [0.0, 1.0, 0.0]),
        _ => {
            let [a, b, c] = three_vectors(&plane, ctx.variables)?;
            let way = |to: [f64; 3]| [0, 1, 2].map(|i| to[i] - a[i]);
            // the points of a plane are in base coordinates
            (false, work.inverse().direction(unit(cross(way(b), way(c))).ok_or(HResult::E_INVALIDARG)?))
        }
    };
    let degrees = request.float(2);
    if !(-ROTATION_MAX..=ROTATION_MAX).contains(&degrees) {
        return Err(HResult::E_INVALIDARG);
    }
    let centre = vector(&request.value(3), ctx.variables)?;
    let (mut turns, mut pass) = (false, Pass::Stop);
    let option = request.text(4).to_string();
    let mut others = Vec::new();
    for part in split_outside_brackets(&option) {
        let (key, value) = part.split_once('=').map_or((part, None), |(key, value)| (key, Some(value.trim())));
        match (key.trim().to_ascii_uppercase().as_str(), value) {
            ("POSE", Some("1")) => turns = true,
            ("POSE", Some("2")) => turns = false,
            (text, None) if text.starts_with('@') => pass = pass_of_text(text)?,
            _ => others.push(part),
        }
    }
    let centre = work.times(&Frame::IDENTITY.moved_to(centre)).position;
    let axis = if of_tool { plane_axis } else { work.direction(plane_axis) };
    let route = Route::Rotate { arc: Arc { centre, axis, degrees }, turns, of_tool };
    start(robot, ctx, (route, pass), Speed::Line, &others.join(","))
}

/// Executes RotateH: an angle, or `[angle, option]`.
pub(super) fn rotate_tool(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let param = param.flatten();
    let (angle, option) = match param {
        Variant::Array(array) if array.len() <= 2 => {
            (array.get(0).unwrap_or(param), text_or_nothing(&array.get(1).unwrap_or(Variant::Empty))?)
        }
        _ => (param, String::new()),
    };
    let (degrees, pass) = length_and_pass(&angle)?;
    if degrees.abs() > 180.0 {
        return Err(HResult::E_INVALIDARG);
    }
    start(robot, ctx, (Route::RotateTool(degrees), pass), Speed::Line, &option)
}

/// Reads the interpolation and the other elements of a parameter; elements at its end may be absent.
fn straight_or_not<'v, const N: usize>(param: &Variant<'v>) -> Result<(bool, [Variant<'v>; N]), HResult> {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    if array.len() > N + 1 {
        return Err(HResult::E_INVALIDARG);
    }
    let item = |n: usize| array.get(n).unwrap_or(Variant::Empty).flatten();
    let line = match item(0).as_i32() {
        Some(1) => false,
        Some(2) => true,
        _ => return Err(HResult::E_INVALIDARG),
    };
    let mut others = [Variant::Empty; N];
    others.iter_mut().enumerate().for_each(|(n, other)| *other = item(n + 1));
    Ok((line, others))
}

fn text_or_nothing(value: &Variant<'_>) -> Result<String, HResult> {
    match value.flatten() {
        Variant::Bstr(text) => Ok(text.to_string()),
        Variant::Empty | Variant::Null => Ok(String::new()),
        _ => Err(HResult::E_INVALIDARGTYPE),
    }
}

/// Executes DriveEx or DriveAEx, whose parameter is `[pairs, option]` or the pairs as text.
pub(super) fn drive_command(robot: &mut Robot, ctx: &mut Context<'_>, absolute: bool, param: &Variant<'_>) -> Answered {
    let param = param.flatten();
    let (pairs, option) = match param {
        Variant::Array(array) => {
            match (array.get(0).map(|item| item.flatten()), array.get(1).map(|item| item.flatten())) {
                (Some(pairs), Some(Variant::Bstr(option))) if array.len() == 2 => (pairs, option.to_string()),
                // the pairs alone, without an option
                (Some(pairs @ Variant::Bstr(_)), None) => (pairs, String::new()),
                (Some(pairs @ Variant::Array(list)), None) if is_list(list) => (pairs, String::new()),
                _ => (param, String::new()),
            }
        }
        _ => (param, String::new()),
    };
    drive(robot, ctx, Drive::parse(absolute, &pairs)?, &option)
}

/// Returns whether an array is a list of pairs, or a pair with its type.
fn is_list(array: Array<'_>) -> bool {
    array.get(0).is_some_and(|item| matches!(item.flatten(), Variant::Array(_)))
}

/// Turns single axes.
pub(super) fn drive(robot: &mut Robot, ctx: &mut Context<'_>, drive: Drive, option: &str) -> Answered {
    drive.check(robot.geometry().joints(), ctx.config.extended_axes)?;
    let pass = drive.pass;
    start(robot, ctx, (Route::Turn(drive), pass), Speed::Joints, option)
}

/// Executes Robot_GoHome.
pub(super) fn go_home(robot: &mut Robot, ctx: &mut Context<'_>) -> Answered {
    let home = ctx.config.home;
    start(robot, ctx, (Route::Home(home), Pass::Stop), Speed::Joints, "")
}

/// Starts a motion, or appends it to the queue. Without NEXT, the call is answered at the end of the motion.
fn start(robot: &mut Robot, ctx: &mut Context<'_>, way: (Route, Pass), speed: Speed, option: &str) -> Answered {
    let internal = if speed == Speed::Line { robot.settings().line } else { robot.settings().joint };
    let options = MoveOptions::read(option, internal, ctx)?;
    match robot.may(ctx, &rules::MOTION) {
        Err(HResult::E_ROBOTISBUSY) if robot.may_follow(ctx.peer) => {}
        checked => checked?,
    }
    let started = robot.start(ctx.peer, way, options.internal, ctx.now);
    let id = started.map_err(Blocked::code)?;
    if !options.next {
        return Ok(Answer::Until(Wait::Motion(id)));
    }
    // a motion without length ends immediately
    robot.advance(ctx.now, ctx.waits);
    Ok(Answer::Done)
}

impl MoveOptions {
    fn read(text: &str, internal: Percent, ctx: &Context<'_>) -> Result<Self, HResult> {
        let mut read = Self { internal, next: false };
        for (key, value) in options(text) {
            let scaled = |base: f32| -> Result<f32, HResult> {
                let value = ctx.variables.number_of_text(value.ok_or(HResult::E_INVALIDARG)?)?;
                Ok(base * percent(value)? / 100.0)
            };
            match key.to_ascii_uppercase().as_str() {
                "NEXT" if value.is_none() => read.next = true,
                "SPEED" | "S" => read.internal.speed = scaled(internal.speed)?,
                "ACCEL" => read.internal.accel = scaled(internal.accel)?,
                "DECEL" => read.internal.decel = scaled(internal.decel)?,
                // the guide has no unit of the time; the motion does not depend on it
                "TIME" => drop(ctx.variables.number_of_text(value.ok_or(HResult::E_INVALIDARG)?)?),
                _ => ctx.config.unknown_option("a motion", key)?,
            }
        }
        Ok(read)
    }
}
