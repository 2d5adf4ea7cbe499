//! The end of a motion, as far as it can be compared with the position of the robot.
//!
//! ```text
//!  Target (of a command)                    read before the motion     End (compared afterwards)
//!  joints(..)                               -                          CurJnt
//!  position(..), transform(..)              -                          CurPos, CurTrn
//!  variable(handle)                         Variable_GetValue          as its value: J, P or T
//!  drive_by(..), drive_to(..)               CurJnt, from rest          CurJnt
//!  here().back(mm), position(..).back(mm)   CurTrn, from rest          CurTrn, CurPos
//!  UNKNOWN                                  -                          DestJnt, if seen during the motion
//! ```
//!
//! A motion that follows another begins at the end of the previous motion, so its end is computed from that end.

use crate::bcap::call::VariableHandle;
use crate::position::{Joints, Position, Transform};
use crate::variant::Variant;

/// The joints of CurJnt and DestJnt.
pub(super) const JOINTS: usize = 8;

/// How far a robot at rest may be from the end of its motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    /// Degrees or mm of each joint.
    pub(super) joint: f64,
    /// Of the tool, along each axis.
    pub(super) distance_mm: f64,
    /// Of the tool's orientation.
    pub(super) angle_degrees: f64,
}

impl Tolerance {
    /// For destinations of the same motion, which differ by rounding only.
    pub(super) const DESTINATION: Self = Self { joint: 0.05, distance_mm: 0.1, angle_degrees: 0.05 };
}

/// Where a motion ends, for the comparison with the robot.
///
/// # Examples
///
/// ```
/// use bcap_core::position::Joints;
/// use bcap_core::procedure::Target;
///
/// let home = Target::joints(Joints::new([0.0, 45.0, 90.0, 0.0, 45.0, 0.0]), 6);
/// let depart = Target::here().back(50.0);
/// assert_ne!(home, depart);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Target {
    place: Place,
    back_mm: f64,
    pub(super) is_loop: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Place {
    Unknown,
    Here,
    Joints([f64; JOINTS], u8),
    Position(Position),
    Transform(Transform),
    Variable(VariableHandle),
    DriveBy([f64; JOINTS]),
    DriveTo([Option<f64>; JOINTS]),
}

/// The reading that a target needs before the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Before {
    Variable(VariableHandle),
    Frame,
}

impl Target {
    /// An end that cannot be compared. Such a motion has arrived only if two polls saw its destination.
    pub const UNKNOWN: Self = Self::new(Place::Unknown);

    const fn new(place: Place) -> Self {
        Self { place, back_mm: 0.0, is_loop: false }
    }

    /// The first `axes` joints, in degrees or mm; the others are not compared.
    #[must_use]
    pub const fn joints(joints: Joints, axes: u8) -> Self {
        Self::new(Place::Joints(joints.degrees, axes))
    }

    /// A position in the current tool and work coordinates. A robot that rests there with another figure has not arrived.
    #[must_use]
    pub const fn position(position: Position) -> Self {
        Self::new(Place::Position(position))
    }

    /// A transform in the current tool and work coordinates. A robot that rests there with another figure has not arrived.
    #[must_use]
    pub const fn transform(transform: Transform) -> Self {
        Self::new(Place::Transform(transform))
    }

    /// A P, J or T variable, which is read before the motion.
    #[must_use]
    pub const fn variable(variable: VariableHandle) -> Self {
        Self::new(Place::Variable(variable))
    }

    /// The joints where the motion begins, plus these, in degrees or mm.
    #[must_use]
    pub const fn drive_by(joints: Joints) -> Self {
        Self::new(Place::DriveBy(joints.degrees))
    }

    /// These joints, in degrees or mm; the others stay.
    #[must_use]
    pub const fn drive_to(joints: [Option<f64>; 8]) -> Self {
        Self::new(Place::DriveTo(joints))
    }

    /// Where the motion begins.
    #[must_use]
    pub const fn here() -> Self {
        Self::new(Place::Here)
    }

    /// The place `mm` before this one, against the direction of the tool.
    #[must_use]
    pub const fn back(self, mm: f64) -> Self {
        Self { back_mm: mm, ..self }
    }

    /// Marks a motion that may end where it begins, such as an arc: rest there is its end only if the robot was seen elsewhere.
    #[must_use]
    pub const fn with_loop(self) -> Self {
        Self { is_loop: true, ..self }
    }

    /// Returns the end, if it is known by joints without a reading.
    pub(super) fn joints_end(&self) -> Option<End> {
        match self.place {
            Place::Joints(joints, axes) if self.back_mm == 0.0 => Some(End::Joints(joints, axes)),
            _ => None,
        }
    }

    /// Returns the reading that [`resolve`](Self::resolve) needs, besides the joints; `from_rest`: whether no other motion
    /// precedes it.
    pub(super) const fn before(&self, from_rest: bool) -> Option<Before> {
        match self.place {
            Place::Variable(variable) => Some(Before::Variable(variable)),
            Place::Here if from_rest => Some(Before::Frame),
            _ => None,
        }
    }

    /// Computes the end of the motion. `joints` are the joints before it, and `reading` is the value that was read before it;
    /// `last` is the end of the motion that it follows, `None` from rest.
    pub(super) fn resolve(&self, joints: &[f64; JOINTS], reading: End, last: Option<End>) -> End {
        let here = last.map_or(Some(*joints), |last| last.joints_from(joints));
        let end = match self.place {
            Place::Unknown => End::Unknown,
            Place::Joints(joints, axes) => End::Joints(joints, axes),
            Place::Position(position) => End::Position(position, 0.0),
            Place::Transform(transform) => End::Transform(transform),
            Place::Variable(_) => reading,
            Place::Here => last.unwrap_or(reading),
            Place::DriveBy(by) => here.map_or(End::Unknown, |here| {
                let mut by = by.iter();
                End::all(here.map(|joint| joint + by.next().unwrap_or(&0.0)))
            }),
            Place::DriveTo(to) => here.map_or(End::Unknown, |here| {
                let mut to = to.iter();
                End::all(here.map(|joint| to.next().copied().flatten().unwrap_or(joint)))
            }),
        };
        if self.back_mm == 0.0 { end } else { end.back(self.back_mm) }
    }
}

/// The end of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum End {
    Unknown,
    /// The number of joints that are compared.
    Joints([f64; JOINTS], u8),
    /// Millimetres before a position, against the direction of the tool there.
    Position(Position, f64),
    Transform(Transform),
}

/// How a reading compares with the end of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Comparison {
    /// The robot is there.
    There,
    /// The tool is there, but its orientation differs or is written in another way, or the figure differs.
    Turned,
    Elsewhere,
}

impl End {
    const fn all(joints: [f64; JOINTS]) -> Self {
        Self::Joints(joints, u8::MAX)
    }

    /// Reads the value of a P, J or T variable, which differ in their lengths, or of CurTrn.
    pub(super) fn of_value(value: &Variant<'_>) -> Self {
        match value.as_array().map_or(0, |array| array.len()) {
            7 => value.convert().map_or(Self::Unknown, |position| Self::Position(position, 0.0)),
            8 => value.convert().map_or(Self::Unknown, |joints: Joints| Self::all(joints.degrees)),
            10 => value.convert().map_or(Self::Unknown, Self::Transform),
            _ => Self::Unknown,
        }
    }

    /// Returns the place `mm` before this one, against the direction of the tool.
    fn back(self, mm: f64) -> Self {
        match self {
            Self::Position(position, before) => Self::Position(position, before + mm),
            Self::Transform(transform) => {
                Self::Transform(Transform { xyz_mm: moved(transform.xyz_mm, -mm, transform.approach), ..transform })
            }
            // the direction of the tool is not known
            Self::Joints(..) | Self::Unknown => Self::Unknown,
        }
    }

    /// Returns the joints at the end, if it is given by joints; `here` has the joints that it leaves out.
    pub(super) fn joints_from(&self, here: &[f64; JOINTS]) -> Option<[f64; JOINTS]> {
        let Self::Joints(mut joints, axes) = *self else { return None };
        for (joint, here) in joints.iter_mut().zip(here).skip(usize::from(axes)) {
            *joint = *here;
        }
        Some(joints)
    }

    /// Compares the joints; `None` if the end is not given by joints.
    pub(super) fn compare_joints(&self, joints: &[f64; JOINTS], tolerance: &Tolerance) -> Option<Comparison> {
        let Self::Joints(end, axes) = self else { return None };
        let mut near = joints.iter().zip(end).take(usize::from(*axes));
        let there = near.all(|(joint, end)| (joint - end).abs() <= tolerance.joint);
        Some(if there { Comparison::There } else { Comparison::Elsewhere })
    }

    /// Returns whether CurTrn is needed.
    pub(super) const fn needs_frame(&self) -> bool {
        match self {
            Self::Position(_, back) => *back != 0.0,
            Self::Transform(_) => true,
            Self::Joints(..) | Self::Unknown => false,
        }
    }

    /// Returns whether CurPos is needed.
    pub(super) const fn needs_position(&self) -> bool {
        matches!(self, Self::Position(..))
    }

    /// Compares CurPos and CurTrn; reads only the needed ones.
    pub(super) fn compare_tool(
        &self,
        position: Option<&Position>,
        frame: Option<&Transform>,
        tolerance: &Tolerance,
    ) -> Comparison {
        let near = |one: [f64; 3], other: [f64; 3], distance: f64| {
            one.iter().zip(other).all(|(one, other)| (one - other).abs() <= distance)
        };
        let (is_placed, is_turned) = match (self, position, frame) {
            (Self::Position(end, back), Some(here), frame) => {
                let tip = match frame {
                    Some(frame) if *back != 0.0 => moved(frame.xyz_mm, *back, frame.approach),
                    _ => here.xyz_mm,
                };
                (
                    near(tip, end.xyz_mm, tolerance.distance_mm),
                    !is_same_rotation(here.rotation_degrees, end.rotation_degrees, tolerance.angle_degrees)
                        || differ(here.figure, end.figure),
                )
            }
            (Self::Transform(end), _, Some(here)) => {
                // the sine of a small angle
                let turn = tolerance.angle_degrees * (core::f64::consts::PI / 180.0);
                let same = near(here.orient, end.orient, turn) && near(here.approach, end.approach, turn);
                (near(here.xyz_mm, end.xyz_mm, tolerance.distance_mm), !same || differ(here.figure, end.figure))
            }
            _ => (false, false),
        };
        match (is_placed, is_turned) {
            (true, false) => Comparison::There,
            (true, true) => Comparison::Turned,
            (false, _) => Comparison::Elsewhere,
        }
    }
}

/// Returns whether two figures differ. A negative figure stands for any figure.
const fn differ(one: i32, other: i32) -> bool {
    one >= 0 && other >= 0 && one != other
}

/// Returns the point at a distance from another point, along a vector of length 1.
fn moved(from: [f64; 3], distance: f64, along: [f64; 3]) -> [f64; 3] {
    let mut along = along.iter();
    from.map(|from| from + distance * along.next().unwrap_or(&0.0))
}

/// Returns whether RX, RY, RZ describe the same orientation. Every orientation has two descriptions, one in each half of
/// RY. At RY = 90 degrees only the difference of RX and RZ counts, at -90 only their sum.
fn is_same_rotation(one: [f64; 3], other: [f64; 3], tolerance: f64) -> bool {
    let near = |one: f64, other: f64| turn(one, other) <= tolerance;
    let ([rx, ry, rz], [x, y, z]) = (one, other);
    let same = |[a, b, c]: [f64; 3]| near(a, x) && near(b, y) && near(c, z);
    let at = |pole: f64| near(ry, pole) && near(y, pole);
    same(one)
        || same([rx + 180.0, 180.0 - ry, rz + 180.0])
        || (at(90.0) && near(rx - rz, x - z))
        || (at(-90.0) && near(rx + rz, x + z))
}

/// Returns the angle between two directions, 0 to 180 degrees.
fn turn(one: f64, other: f64) -> f64 {
    // 1.5 * 2^52: added and subtracted, it rounds to a whole number. The remainder operator would need a library function
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let difference = one - other;
    let turns = (difference / 360.0 + ROUND) - ROUND;
    (difference - turns * 360.0).abs()
}
