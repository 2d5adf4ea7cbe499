//! The commands that compute with poses: conversions, Dev and DevH, OutRange. Nothing moves.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::Answered;
use crate::context::Context;
use crate::kinematics::{angle, figure, measured, pose_numbers, position, trans};
use crate::pose::Pose;
use crate::route::frame_of;
use crate::value::{Value, one_int};

/// Converts a pose to another kind; of several postures, takes the nearest to the robot's.
pub(super) fn convert(arm: &Arm, ctx: &Context<'_>, from: Kind, to: Kind, param: &Variant<'_>) -> Answered {
    let near = arm.robot.joints(ctx.now);
    let pose = Pose::parse_as(from, param, ctx.variables)?;
    // an argument out of reach is no error of the controller
    let joints = pose.joints(&near).map_err(|error| error.code())?;
    Ok(Value::R8s(match (to, pose) {
        (Kind::P, Pose::Frame(frame, _)) => pose_numbers(&frame, figure(&joints)),
        (Kind::P, Pose::Joints(_)) => position(&joints),
        (Kind::T, _) => trans(&joints),
        _ => angle(&joints),
    })
    .into())
}

/// Executes Dev or DevH: a pose moved and turned by an offset in the coordinates of the base, or of the flange.
pub(super) fn deviation(_: &Arm, ctx: &Context<'_>, param: &Variant<'_>, of_flange: bool) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(pose), Some(offset), 2) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let (pose, fig) = frame_of(&pose_of(&pose, ctx)?);
    let Pose::Frame(offset, _) = pose_of(&offset, ctx)? else { return Err(HResult::E_INVALIDARG) };
    let moved = if of_flange { pose.times(&offset) } else { pose.displaced(&offset) };
    let [x, y, z, rx, ry, rz] = moved.to_xyz_rpy();
    Ok(Value::R8s(measured([x, y, z, rx, ry, rz, fig.map_or(-1.0, f64::from)])).into())
}

/// Executes OutRange: 0, or the bit of the axis that would leave its range.
pub(super) fn out_range(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let near = arm.robot.joints(ctx.now);
    let pose = match param.flatten() {
        Variant::Array(array) if array.len() == 3 && is_pose(&array.get(0).unwrap_or(Variant::Empty)) => {
            for coordinates in [1, 2] {
                // with -1, the present ones; all definitions are zero
                if one_int(&array.get(coordinates).unwrap_or(Variant::Empty))? != -1 {
                    return Err(HResult::E_INVALIDARG);
                }
            }
            array.get(0).unwrap_or(Variant::Empty)
        }
        _ => *param,
    };
    Ok(Value::I4(match pose_of(&pose, ctx)?.joints(&near) {
        Ok(_) => 0,
        Err(out_of_reach) => 1 << out_of_reach.0.saturating_sub(1),
    })
    .into())
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
