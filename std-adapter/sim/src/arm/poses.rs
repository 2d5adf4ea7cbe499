//! The commands that compute with poses: conversions, Dev and DevH, OutRange, definitions of tools and work
//! coordinates. Nothing moves.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::coordinates::Coordinates;
use crate::kinematics::{OutOfReach, angle, measured, pose_numbers};
use crate::pose::Pose;
use crate::robot::coordinates;
use crate::rules;
use crate::value::{Value, one_int};

/// Converts a pose to another kind; of several postures, takes the nearest to the robot's.
pub(super) fn convert(arm: &Arm, ctx: &Context<'_>, from: Kind, to: Kind, param: &Variant<'_>) -> Answered {
    let near = arm.robot.joints(ctx.now);
    let pose = Pose::parse_as(from, param, ctx.variables)?;
    let coordinates = arm.robot.coordinates();
    let joints = coordinates.flange(pose).joints(&coordinates.arm, &near).map_err(OutOfReach::of_conversion)?;
    Ok(Value::R8s(match (to, pose) {
        (Kind::P, Pose::Frame(frame, _)) => pose_numbers(&frame, coordinates.arm.figure(&joints)),
        (Kind::P, Pose::Joints(_)) => coordinates.position(&joints),
        (Kind::T, _) => coordinates.trans(&joints),
        _ => angle(&joints),
    })
    .into())
}

/// Executes Dev or DevH: a pose moved and turned by an offset in work or tool coordinates.
pub(super) fn deviation(arm: &Arm, ctx: &Context<'_>, param: &Variant<'_>, of_flange: bool) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(pose), Some(offset), 2) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let (pose, fig) = arm.robot.coordinates().pose_of(&pose_of(&pose, ctx)?);
    let Pose::Frame(offset, _) = pose_of(&offset, ctx)? else { return Err(HResult::E_INVALIDARG) };
    let moved = if of_flange { pose.times(&offset) } else { pose.displaced(&offset) };
    let [x, y, z, rx, ry, rz] = moved.to_xyz_rpy();
    Ok(Value::R8s(measured([x, y, z, rx, ry, rz, fig.map_or(-1.0, f64::from)])).into())
}

/// Executes OutRange: 0, the bits of the axes that would leave their ranges, -1 out of reach, or -2 singular.
pub(super) fn out_range(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let robot = &arm.robot;
    let near = robot.joints(ctx.now);
    let (pose, coordinates) = match param.flatten() {
        Variant::Array(array) if array.len() == 3 && is_pose(&array.get(0).unwrap_or(Variant::Empty)) => {
            // with -1, the present ones
            let number = |place: usize, present: i32| match one_int(&array.get(place).unwrap_or(Variant::Empty))? {
                -1 => Ok(present),
                number => coordinates(number),
            };
            let settings = robot.settings();
            let tool = robot.tools.get(number(1, settings.tool)?);
            let work = robot.works.get(number(2, settings.work)?);
            (array.get(0).unwrap_or(Variant::Empty), Coordinates { arm: *robot.geometry(), tool, work })
        }
        _ => (*param, robot.coordinates()),
    };
    let pose = coordinates.flange(pose_of(&pose, ctx)?);
    Ok(Value::I4(match pose.joints(&coordinates.arm, &near) {
        Ok(joints) if matches!(pose, Pose::Frame(..)) && coordinates.arm.is_singular(&joints) => -2,
        Ok(_) => 0,
        Err(OutOfReach::Limits(axes)) => axes.into(),
        Err(OutOfReach::Unreachable) => -1,
        Err(OutOfReach::Singular) => -2,
    })
    .into())
}

/// Executes ConvertPosWork: `[pose, from, to]`, the same place in other work coordinates.
pub(super) fn convert_work(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let item = |place: usize| array.get(place).unwrap_or(Variant::Empty);
    let (from, to) = match array.len() {
        2 => (one_int(&item(1))?, arm.robot.settings().work),
        3 => (one_int(&item(1))?, one_int(&item(2))?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    let [from, to] = [coordinates(from)?, coordinates(to)?].map(|number| arm.robot.works.get(number));
    let Pose::Frame(frame, fig) = pose_of(&item(0), ctx)? else { return Err(HResult::E_INVALIDARG) };
    let [x, y, z, rx, ry, rz] = to.inverse().times(&from.times(&frame)).to_xyz_rpy();
    Ok(Value::R8s(measured([x, y, z, rx, ry, rz, fig.map_or(-1.0, f64::from)])).into())
}

/// Executes CheckVirtualFence: 0, because there are no fences.
pub(super) fn check_fence(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    pose_of(param, ctx)?;
    Ok(Value::I4(0).into())
}

/// The definitions that a command concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Definition {
    Tool,
    Work,
}

/// Executes GetToolDef or GetWorkDef.
pub(super) fn definition(arm: &Arm, of: Definition, param: &Variant<'_>) -> Answered {
    let number = coordinates(one_int(param)?)?;
    let definitions = if of == Definition::Tool { &arm.robot.tools } else { &arm.robot.works };
    Ok(Value::R8s(measured(definitions.get(number).to_xyz_rpy())).into())
}

/// Executes SetToolDef or SetWorkDef: `[number, pose]`.
pub(super) fn define(arm: &mut Arm, ctx: &mut Context<'_>, of: Definition, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(number), Some(pose), 2) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let Pose::Frame(frame, _) = pose_of(&pose, ctx)? else { return Err(HResult::E_INVALIDARG) };
    let number = one_int(&number)?;
    arm.robot.may(ctx, &rules::DEFINITION)?;
    let definitions = if of == Definition::Tool { &mut arm.robot.tools } else { &mut arm.robot.works };
    if definitions.set(number, frame) { Ok(Answer::Done) } else { Err(HResult::E_INVALIDARG) }
}

/// Tells whether the first element of an array is a pose itself, not the numbers of one.
fn is_pose(item: &Variant<'_>) -> bool {
    match item.flatten() {
        Variant::Bstr(_) => true,
        Variant::Array(array) => matches!(array.get(0).unwrap_or(Variant::Empty).flatten(), Variant::Array(_)),
        _ => false,
    }
}

/// Reads a pose in any form of a motion's pose, or as the six or more numbers of a P alone.
fn pose_of(value: &Variant<'_>, ctx: &Context<'_>) -> Result<Pose, HResult> {
    match value.flatten() {
        Variant::Array(array) if array.len() == 6 => Pose::parse_as(Kind::P, value, ctx.variables),
        _ => Pose::parse(value, ctx.variables),
    }
}
