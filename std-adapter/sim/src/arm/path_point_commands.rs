//! The points of the 20 paths, on which Robot_Move 4 moves.
//!
//! | command           | parameter                         | answer                                          |
//! |-------------------|-----------------------------------|-------------------------------------------------|
//! | AddPathPoint      | \[path, pose\]                    | EMPTY; appends a point, at most 5000            |
//! | ClrPathPoint      | path, 1 to 20                     | EMPTY; removes all points                       |
//! | LoadPathPoint     | path                              | EMPTY; likewise: this model stores no paths     |
//! | GetPathPoint      | \[path, point\], from 1           | R8\[7\]: X Y Z RX RY RZ Fig                     |
//! | GetPathPointCount | path                              | I4                                              |

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::kinematics::measured;
use crate::path_points::{POINTS_MAX, PathPoint, position};
use crate::pose::Pose;
use crate::rules;
use crate::value::{numbers, one_int, whole};

/// Executes AddPathPoint.
pub(super) fn add(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(path), Some(pose), 2) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let (frame, fig) = arm.robot.coordinates().pose_of(&Pose::parse(&pose, ctx.variables)?);
    arm.robot.may(ctx, &rules::SETTING)?;
    let points = arm.paths.path_mut(one_int(&path)?)?;
    if points.len() >= POINTS_MAX {
        return Err(HResult::E_INVALIDARG);
    }
    points.push(PathPoint { frame, fig: fig.map_or(-1.0, f64::from) });
    Ok(Answer::Done)
}

/// Executes ClrPathPoint and LoadPathPoint.
pub(super) fn clear(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    arm.robot.may(ctx, &rules::SETTING)?;
    arm.paths.path_mut(one_int(param)?)?.clear();
    Ok(Answer::Done)
}

/// Executes GetPathPoint.
pub(super) fn point(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [path, point] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    let points = arm.paths.path(whole(path)?)?;
    let PathPoint { frame, fig } =
        position(whole(point)?).and_then(|n| points.get(n)).ok_or(HResult::DISP_E_BADINDEX)?;
    let [x, y, z, rx, ry, rz] = frame.to_xyz_rpy();
    Answer::of(measured([x, y, z, rx, ry, rz, *fig]))
}

/// Executes GetPathPointCount.
pub(super) fn count(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let points = arm.paths.path(one_int(param)?)?.len();
    Answer::of(i32::try_from(points).unwrap_or(i32::MAX))
}
