//! The commands that compute with poses: conversions, Dev and DevH, OutRange, definitions of tools and work
//! coordinates. Nothing moves.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::coordinates::{Coordinates, Definitions};
use crate::kinematics::{Frame, OutOfReach, angle, measured, pose_numbers};
use crate::pose::Pose;
use crate::robot::{Robot, tool, work};
use crate::rules;
use crate::value::{ValueResult, one_int, owned, whole};

/// Converts a pose to another kind; of several postures, takes the nearest to the robot's.
pub(super) fn convert(arm: &Arm, ctx: &Context<'_>, from: Kind, to: Kind, param: &Variant<'_>) -> Answered {
    let near = arm.robot.joints(ctx.now);
    let pose = Pose::parse_as(from, param, ctx.variables)?;
    let coordinates = arm.robot.coordinates();
    let joints = coordinates.flange(pose).joints(&coordinates.arm, &near).map_err(OutOfReach::of_conversion)?;
    Answer::of(match (to, pose) {
        (Kind::P, Pose::Frame(frame, _)) => pose_numbers(&frame, coordinates.arm.figure(&joints)),
        (Kind::P, Pose::Joints(_)) => coordinates.position(&joints),
        (Kind::T, _) => coordinates.trans(&joints),
        _ => angle(&joints),
    })
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
    Answer::of(measured([x, y, z, rx, ry, rz, fig.map_or(-1.0, f64::from)]))
}

/// Executes OutRange: 0, the bits of the axes that would leave their ranges, -1 out of reach, or -2 singular.
pub(super) fn out_range(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let robot = &arm.robot;
    let near = robot.joints(ctx.now);
    let (pose, coordinates) = match param.flatten() {
        Variant::Array(array) if array.len() == 3 && is_pose(&array.get(0).unwrap_or(Variant::Empty)) => {
            // with -1, the current ones
            let number = |place: usize, present: i32| match one_int(&array.get(place).unwrap_or(Variant::Empty))? {
                -1 => Ok(present),
                number => Ok(number),
            };
            let settings = robot.settings();
            let tool = robot.tools.get(number(1, settings.tool).and_then(tool)?);
            let work = robot.works.get(number(2, settings.work).and_then(work)?);
            (array.get(0).unwrap_or(Variant::Empty), Coordinates { arm: *robot.geometry(), tool, work })
        }
        _ => (*param, robot.coordinates()),
    };
    let pose = coordinates.flange(pose_of(&pose, ctx)?);
    Answer::of(match pose.joints(&coordinates.arm, &near) {
        Ok(joints) if matches!(pose, Pose::Frame(..)) && coordinates.arm.is_singular(&joints) => -2,
        Ok(_) => 0,
        Err(OutOfReach::Limits(axes)) => axes.into(),
        Err(OutOfReach::Unreachable) => -1,
        Err(OutOfReach::Singular) => -2,
    })
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
    let [from, to] = [work(from)?, work(to)?].map(|number| arm.robot.works.get(number));
    let Pose::Frame(frame, fig) = pose_of(&item(0), ctx)? else { return Err(HResult::E_INVALIDARG) };
    let [x, y, z, rx, ry, rz] = to.inverse().times(&from.times(&frame)).to_xyz_rpy();
    Answer::of(measured([x, y, z, rx, ry, rz, fig.map_or(-1.0, f64::from)]))
}

/// Executes CheckVirtualFence: 0, because there are no fences.
pub(super) fn check_fence(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    pose_of(param, ctx)?;
    Answer::of(0)
}

/// The definitions that a command or a variable concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameKind {
    Tool,
    Work,
    Base,
}

impl FrameKind {
    fn of(self, robot: &Robot) -> &Definitions {
        match self {
            Self::Tool => &robot.tools,
            Self::Work => &robot.works,
            Self::Base => &robot.bases,
        }
    }

    /// Checks the number of a definition.
    fn number(self, number: i32) -> Result<i32, HResult> {
        match self {
            Self::Tool => tool(number),
            Self::Work | Self::Base => work(number),
        }
    }
}

/// Executes GetToolDef, GetWorkDef or GetBaseDef: the last two have the attribute as seventh number.
pub(super) fn definition(arm: &Arm, of: FrameKind, param: &Variant<'_>) -> Answered {
    numbers_of(arm, of, one_int(param)?).map(Answer::Value)
}

/// Returns the numbers of a definition.
pub(super) fn numbers_of(arm: &Arm, of: FrameKind, number: i32) -> ValueResult {
    let (definitions, number) = (of.of(&arm.robot), of.number(number)?);
    let mut numbers = measured(definitions.get(number).to_xyz_rpy());
    if of != FrameKind::Tool {
        numbers.push(definitions.attribute(number).into());
    }
    owned(numbers)
}

/// Executes WorkAttribute.
pub(super) fn attribute(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(arm.robot.works.attribute(work(one_int(param)?)?))
}

/// Executes SetToolDef, SetWorkDef or SetBaseDef: `[number, pose]`, the last two optionally with the attribute.
pub(super) fn define(arm: &mut Arm, ctx: &mut Context<'_>, of: FrameKind, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(number), Some(pose), 2 | 3) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let attribute = array.get(2).map_or(Ok(0), |attribute| one_int(&attribute))?;
    if attribute != 0 && (attribute != 1 || of == FrameKind::Tool) {
        return Err(HResult::E_INVALIDARG);
    }
    let Pose::Frame(frame, _) = pose_of(&pose, ctx)? else { return Err(HResult::E_INVALIDARG) };
    set_definition(arm, ctx, of, one_int(&number)?, (frame, attribute))
}

/// Writes the numbers of a definition.
pub(super) fn put_numbers(arm: &mut Arm, ctx: &mut Context<'_>, of: FrameKind, number: i32, given: &[f64]) -> Answered {
    let (frame, attribute) = match (of, given) {
        (_, frame) if frame.len() == 6 => (frame, 0),
        (FrameKind::Work | FrameKind::Base, [frame @ .., attribute @ (0.0 | 1.0)]) => (frame, whole(*attribute)?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    let Pose::Frame(frame, _) = Pose::new(Kind::P, frame)? else { return Err(HResult::E_INVALIDARG) };
    set_definition(arm, ctx, of, number, (frame, attribute))
}

fn set_definition(
    arm: &mut Arm,
    ctx: &mut Context<'_>,
    of: FrameKind,
    number: i32,
    (frame, attribute): (Frame, i32),
) -> Answered {
    arm.robot.may(ctx, &rules::DEFINITION)?;
    let number = of.number(number)?;
    let definitions = match of {
        FrameKind::Tool => &mut arm.robot.tools,
        FrameKind::Work => &mut arm.robot.works,
        FrameKind::Base => &mut arm.robot.bases,
    };
    if definitions.set(number, frame, attribute) { Ok(Answer::Done) } else { Err(HResult::E_INVALIDARG) }
}

/// Executes TMul: the product of two transforms, with the Fig of the first.
pub(super) fn product(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let (Some(first), Some(second), 2) = (array.get(0), array.get(1), array.len()) else {
        return Err(HResult::E_INVALIDARG);
    };
    let ((first, fig), (second, _)) = (transform(&first, ctx)?, transform(&second, ctx)?);
    trans_numbers(&first.times(&second), fig)
}

/// Executes TInv.
pub(super) fn inverse(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (frame, fig) = transform(param, ctx)?;
    trans_numbers(&frame.inverse(), fig)
}

/// Executes TNorm: reading a transform makes its vectors units at right angles.
pub(super) fn normalised(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (frame, fig) = transform(param, ctx)?;
    trans_numbers(&frame, fig)
}

fn transform(value: &Variant<'_>, ctx: &Context<'_>) -> Result<(Frame, Option<u8>), HResult> {
    match Pose::parse_as(Kind::T, value, ctx.variables)? {
        Pose::Frame(frame, fig) => Ok((frame, fig)),
        Pose::Joints(_) => Err(HResult::E_INVALIDARG),
    }
}

fn trans_numbers(frame: &Frame, fig: Option<u8>) -> Answered {
    let mut numbers = measured(frame.to_trans());
    numbers.push(fig.map_or(-1.0, f64::from));
    Answer::of(numbers)
}

/// Returns whether the first element of an array is a pose itself, not the numbers of one.
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
