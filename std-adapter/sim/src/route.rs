//! The routes of motions: the target of a motion command, from which its path is planned.
//!
//! A route consists of flange poses relative to the base; its lines and circles are paths of the tool.

use crate::curve::{Arc, Point, on_curve};
use crate::drive::Drive;
use crate::kinematics::{Axes, Frame, Geometry, Joints, OutOfReach, six, with_joints};
use crate::path::{Blocked, LINE_PARTS, Path};
use crate::pose::Pose;

/// The largest part of a rotation, in degrees: a full circle is planned in as many parts as a line.
const TURN_PART: f64 = 360.0 / LINE_PARTS as f64;

/// The target of a motion command.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Route {
    /// To the joints of a pose; the extended joints turn with them.
    Joints(Pose, Option<Drive>),
    /// To a pose on a straight line.
    Line(Pose, Option<Drive>),
    /// Turns of axes.
    Turn(Drive),
    /// To these joints; the extended joints stay.
    Home(Joints),
    /// To a pose on a circle through a point, relative to the base. The tool turns evenly to the orientation of the pose.
    Arc(Point, Pose),
    /// Against the approach vector by a distance in mm, on a line or by the joints.
    Depart { distance: f64, line: bool },
    /// By a vector in base coordinates, on a line or by the joints.
    Draw { way: Point, line: bool },
    /// To a pose of the flange, over the top of an arch, a vector in base coordinates.
    Arch { pose: Pose, top: Point },
    /// Through frames of the tool, relative to the base, on a curve.
    Through(Vec<Frame>),
    /// About the approach vector by an angle in degrees, in place.
    RotateTool(f64),
    /// On a circle about an axis of the base, or of the tool at its start, with the flange turning like the circle or not at all.
    Rotate { arc: Arc, turns: bool, of_tool: bool },
}

impl Route {
    /// Plans the path of a tool from a position of the axes.
    pub(crate) fn path(&self, arm: &Geometry, here: &Axes, tool: &Frame) -> Result<Path, Blocked> {
        let axes = |end: Axes| Ok(Path::axes(arm, *here, in_range(arm, end)?));
        match self {
            Self::Joints(pose, extended) => axes(with_joints(&pose.joints(arm, &six(here))?, &turned(extended, here))),
            Self::Line(pose, extended) => line(arm, here, tool, pose, &turned(extended, here)),
            Self::Turn(drive) => axes(drive.apply(here)),
            Self::Home(joints) => axes(with_joints(joints, here)),
            Self::Arc(via, pose) => arc_path(arm, here, tool, *via, pose),
            Self::Depart { distance, line } => {
                let from = arm.forward(&six(here)).times(tool);
                to_frame(arm, here, tool, &arm.withdraw(&from, *distance), *line)
            }
            Self::Draw { way, line } => {
                let from = arm.forward(&six(here)).times(tool);
                to_frame(arm, here, tool, &from.moved_to([0, 1, 2].map(|i| from.position[i] + way[i])), *line)
            }
            Self::Arch { pose, top } => {
                let (from, (to, fig)) = (arm.forward(&six(here)).times(tool), tip(arm, pose, tool)?);
                let (way, turn) = from.distance(&to);
                let height = top.iter().map(|n| n * n).sum::<f64>().sqrt();
                let path = Path::along(arm, *here, here, (way + 2.0 * height, turn), LINE_PARTS, |part| {
                    let (straight, lift) = (from.towards(&to, part), (std::f64::consts::PI * part).sin());
                    straight.moved_to([0, 1, 2].map(|i| straight.position[i] + top[i] * lift)).times(&tool.inverse())
                })?;
                keeps_posture(path, fig)
            }
            Self::Through(points) => {
                let points = [&[arm.forward(&six(here)).times(tool)], &points[..]].concat();
                let sizes = points.windows(2).map(|two| two[0].distance(&two[1]));
                let size = sizes.fold((0.0, 0.0), |sum, size| (sum.0 + size.0, sum.1 + size.1));
                let last = points.len() - 1;
                // each point is the end of a part
                let parts = last * LINE_PARTS.div_ceil(last);
                Path::along(arm, *here, here, size, parts, |part| on_curve(&points, part).times(&tool.inverse()))
            }
            Self::RotateTool(degrees) => {
                let from = arm.forward(&six(here)).times(tool);
                let arc = Arc { centre: from.position, axis: from.direction([0.0, 0.0, 1.0]), degrees: *degrees };
                Self::Rotate { arc, turns: true, of_tool: false }.path(arm, here, tool)
            }
            Self::Rotate { arc, turns, of_tool } => {
                let (from, flange) = (arm.forward(&six(here)).times(tool), tool.inverse());
                let axis = if *of_tool { from.direction(arc.axis) } else { arc.axis };
                let arc = Arc { axis, ..*arc };
                let size = (arc.length(from.position), if *turns { arc.degrees.abs() } else { 0.0 });
                let parts = LINE_PARTS.max((arc.degrees.abs() / TURN_PART).ceil() as usize);
                Path::along(arm, *here, here, size, parts, |part| {
                    let turned = from.turned(arc.centre, arc.axis, arc.degrees * part);
                    if *turns { turned } else { from.moved_to(turned.position) }.times(&flange)
                })
            }
        }
    }
}

/// Plans a motion of the tool to a frame, on a line or by the joints.
fn to_frame(arm: &Geometry, here: &Axes, tool: &Frame, to: &Frame, straight: bool) -> Result<Path, Blocked> {
    let pose = Pose::Frame(to.times(&tool.inverse()), None);
    match straight {
        true => line(arm, here, tool, &pose, here),
        false => Route::Joints(pose, None).path(arm, here, tool),
    }
}

fn turned(extended: &Option<Drive>, here: &Axes) -> Axes {
    extended.as_ref().map_or(*here, |drive| drive.apply(here))
}

fn in_range(arm: &Geometry, axes: Axes) -> Result<Axes, OutOfReach> {
    arm.out_of_range(&axes).map_or(Ok(axes), Err)
}

/// Plans a line, on which the posture cannot change; J7 and J8 move to their positions in `extended`.
fn line(arm: &Geometry, here: &Axes, tool: &Frame, pose: &Pose, extended: &Axes) -> Result<Path, Blocked> {
    let (from, (to, fig), flange) = (arm.forward(&six(here)).times(tool), tip(arm, pose, tool)?, tool.inverse());
    let end = in_range(arm, with_joints(&six(here), extended))?;
    let frame = |part| from.towards(&to, part).times(&flange);
    let path = Path::along(arm, *here, &end, from.distance(&to), LINE_PARTS, frame)?;
    keeps_posture(path, fig)
}

/// Plans an arc, on which the posture cannot change.
fn arc_path(arm: &Geometry, here: &Axes, tool: &Frame, via: Point, pose: &Pose) -> Result<Path, Blocked> {
    let (from, (to, fig), flange) = (arm.forward(&six(here)).times(tool), tip(arm, pose, tool)?, tool.inverse());
    let arc = Arc::through(from.position, via, to.position).ok_or(Blocked::Invalid)?;
    let size = (arc.length(from.position), from.distance(&to).1);
    let path = Path::along(arm, *here, here, size, LINE_PARTS, |part| {
        let position = from.turned(arc.centre, arc.axis, arc.degrees * part).position;
        from.towards(&to, part).moved_to(position).times(&flange)
    })?;
    keeps_posture(path, fig)
}

/// Returns the frame of the tool for a pose of the flange, and the Fig if the pose has one. Joints have one, and are checked.
fn tip(arm: &Geometry, pose: &Pose, tool: &Frame) -> Result<(Frame, Option<u8>), OutOfReach> {
    match pose {
        Pose::Joints(joints) => match arm.out_of_range(joints) {
            None => Ok((arm.forward(joints).times(tool), Some(arm.figure(joints)))),
            Some(error) => Err(error),
        },
        Pose::Frame(frame, fig) => Ok((frame.times(tool), *fig)),
    }
}

/// Checks that a path ends in the posture that its command requires.
fn keeps_posture(path: Path, fig: Option<u8>) -> Result<Path, Blocked> {
    // the turns of J4 and J6 result from the path
    match fig {
        Some(fig) if !path.arm.same_posture(path.arm.figure(&six(&path.end())), fig) => Err(Blocked::Figure),
        _ => Ok(path),
    }
}
