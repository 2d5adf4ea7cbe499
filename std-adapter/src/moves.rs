//! Descriptions of motions: destination, interpolation, speed, pass.

mod destination;

use std::fmt::{self, Write as _};

use bcap_core::bcap::call::VariableHandle;
use bcap_core::error::EncodeError;
use bcap_core::position::{Joints, Position, Transform};
use bcap_core::procedure::{MotionStart, Target};
use bcap_core::variant::{Encode, Writer};

pub use self::destination::DestinationError;

/// Where a motion ends.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Destination {
    /// A variable (`P1`, `J[3]`, `T2`), or a value as the controller's language writes it (`J(0, 45, 90, 0, 45, 0)`).
    Text(String),
    /// A position of the tool.
    Position(Position),
    /// The joints.
    Joints(Joints),
    /// A position of the tool with its orientation as vectors.
    Transform(Transform),
}

macro_rules! destinations {
    ($($kind:ident $from:ty;)*) => {$(
        impl From<$from> for Destination {
            fn from(destination: $from) -> Self {
                Self::$kind(destination.into())
            }
        }
    )*};
}

destinations! {
    Text &str;
    Text String;
    Position Position;
    Joints Joints;
    Transform Transform;
}

/// Writes the destination in the controller's language.
impl fmt::Display for Destination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Position(position) => list(f, 'P', &position.to_array()),
            Self::Joints(joints) => list(f, 'J', &joints.degrees),
            Self::Transform(transform) => list(f, 'T', &transform.to_array()),
        }
    }
}

impl Destination {
    /// Returns the name of the variable, if it is a P, J or T variable, such as `P1` for `p[1]`.
    fn variable(&self) -> Option<String> {
        let Self::Text(text) = self else { return None };
        let (kind, index) = text.trim().split_at_checked(1)?;
        let index = index.trim();
        let index = index.strip_prefix('[').map_or(Some(index), |inside| inside.strip_suffix(']'))?.trim();
        let is_variable = matches!(kind, "P" | "p" | "J" | "j" | "T" | "t");
        let index = index.parse::<u32>().ok().filter(|_| is_variable)?;
        Some(format!("{}{index}", kind.to_ascii_uppercase()))
    }

    /// Returns the place to compare the robot with; `variable` is the handle of the variable.
    fn target(&self, variable: Option<VariableHandle>) -> Target {
        match self {
            Self::Position(position) => Target::position(*position),
            Self::Joints(joints) => Target::joints(*joints, 8),
            Self::Transform(transform) => Target::transform(*transform),
            Self::Text(text) => variable.map_or_else(|| literal(text.trim()), Target::variable),
        }
    }
}

/// Parses a value of the controller's language, such as `J(0, 45, 90, 0, 45, 0)`.
fn literal(text: &str) -> Target {
    let numbers = |inside: &str| -> Option<Vec<f64>> {
        inside.strip_suffix(')')?.split(',').map(|number| number.trim().parse().ok()).collect()
    };
    let Some((kind, Some(numbers))) = text.split_once('(').map(|(kind, inside)| (kind.trim(), numbers(inside))) else {
        return Target::UNKNOWN;
    };
    match (kind, numbers.as_slice()) {
        ("P" | "p", &[x, y, z, rx, ry, rz]) => Target::position(Position::new([x, y, z], [rx, ry, rz])),
        ("P" | "p", &[x, y, z, rx, ry, rz, fig]) => {
            Position::from_array([x, y, z, rx, ry, rz, fig]).map_or(Target::UNKNOWN, Target::position)
        }
        ("T" | "t", &[x, y, z, ox, oy, oz, ax, ay, az]) => {
            Target::transform(Transform::new([x, y, z], [ox, oy, oz], [ax, ay, az]))
        }
        ("T" | "t", &[x, y, z, ox, oy, oz, ax, ay, az, fig]) => {
            Transform::from_array([x, y, z, ox, oy, oz, ax, ay, az, fig]).map_or(Target::UNKNOWN, Target::transform)
        }
        ("J" | "j", joints @ [_, ..]) if joints.len() <= 8 => {
            let degrees = std::array::from_fn(|axis| joints.get(axis).copied().unwrap_or(0.0));
            Target::joints(Joints { degrees }, u8::try_from(joints.len()).unwrap_or(8))
        }
        _ => Target::UNKNOWN,
    }
}

fn list(f: &mut fmt::Formatter<'_>, letter: char, numbers: &[f64]) -> fmt::Result {
    write!(f, "{letter}(")?;
    for (index, number) in numbers.iter().enumerate() {
        write!(f, "{}{number}", if index == 0 { "" } else { ", " })?;
    }
    f.write_char(')')
}

/// The accuracy at the end of a motion (b-CAP specification, section 5.6.1).
///
/// # Examples
///
/// ```no_run
/// # use std::time::Duration;
/// # use bcap_std::{Move, Pass, Settings, blocking::Controller};
/// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
/// # let mut arm = cell.robot()?.take_arm()?;
/// // round a corner at P1, without a stop, and rest exactly at P2
/// let moving = arm.start(&Move::line("P1").pass(Pass::Within(20)), Duration::from_secs(30))?;
/// println!("{:?}", moving.then(&Move::line("P2").pass(Pass::Exact))?.wait()?);
/// # Ok::<(), bcap_std::Error>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Pass {
    /// `@E`: the measured position has reached the destination.
    #[default]
    Exact,
    /// `@0`: the commanded position has reached the destination.
    Commanded,
    /// `@P`: near the destination, at a distance that the controller chooses.
    Near,
    /// `@n`: this many mm from the destination.
    Within(u16),
}

impl Pass {
    /// Returns the number of an array's element.
    fn number(self) -> i32 {
        match self {
            Self::Exact => -2,
            Self::Near => -1,
            Self::Commanded => 0,
            Self::Within(mm) => mm.into(),
        }
    }
}

/// Writes the pass before a pose.
impl fmt::Display for Pass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact => f.write_str("@E"),
            Self::Near => f.write_str("@P"),
            Self::Commanded => f.write_str("@0"),
            Self::Within(mm) => write!(f, "@{mm}"),
        }
    }
}

/// The way between two positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Interpolation {
    /// All joints move at the same time; the path of the tool is not a line.
    Joint,
    /// The tool moves along a line.
    Line,
}

impl Interpolation {
    const fn number(self) -> i32 {
        match self {
            Self::Joint => 1,
            Self::Line => 2,
        }
    }
}

/// The plane of a rotation, in the base coordinates of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    /// About the z axis.
    Xy,
    /// About the x axis.
    Yz,
    /// About the y axis.
    Zx,
}

/// A motion, for `Arm::move_to` and `Arm::start`.
///
/// Each line names the controller's command. `NEXT` is always among the options: the library itself waits for the end, so that
/// it can halt the robot at any time. Not offered: free curves (interpolation 4) and `TIME=`, because no source describes what
/// the controller expects.
///
/// # Examples
///
/// ```
/// use bcap_std::{Interpolation, Joints, Move, Pass, Position};
///
/// let by_name = Move::joint("P1").speed_percent(20.0);
/// let home = Move::joint(Joints::new([0.0, 45.0, 90.0, 0.0, 45.0, 0.0]));
/// let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
/// let down = Move::line(position).pass(Pass::Within(5)).speed_percent(5.0).acceleration_percent(10.0);
/// let above = Move::approach(Interpolation::Line, "P1", 50.0);
/// # let _ = (by_name, home, down, above);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[must_use = "a motion begins when it is passed to an arm"]
pub struct Move {
    way: Way,
    pass: Pass,
    speed: Option<f64>,
    acceleration: Option<f64>,
    deceleration: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
enum Way {
    To(Interpolation, Destination),
    Circle { via: Destination, end: Destination },
    Drive { command: &'static str, axes: Vec<(u8, f64)> },
    Approach(Interpolation, Destination, f64),
    Depart(Interpolation, f64),
    Rotate { plane: Plane, degrees: f32, centre_mm: [f64; 3] },
}

impl Move {
    /// Moves all joints at the same time, point to point; the path of the tool is not a line. Robot_Move, interpolation 1.
    pub fn joint(destination: impl Into<Destination>) -> Self {
        Self::new(Way::To(Interpolation::Joint, destination.into()))
    }

    /// Moves the tool along a line. Robot_Move, interpolation 2.
    pub fn line(destination: impl Into<Destination>) -> Self {
        Self::new(Way::To(Interpolation::Line, destination.into()))
    }

    /// Moves the tool along an arc through `via` to `end`. Robot_Move, interpolation 3.
    pub fn circle(via: impl Into<Destination>, end: impl Into<Destination>) -> Self {
        Self::new(Way::Circle { via: via.into(), end: end.into() })
    }

    /// Turns axes, 1 to 8, by degrees or mm from where they are. `DriveEx`.
    pub fn drive_by(axes: impl IntoIterator<Item = (u8, f64)>) -> Self {
        Self::new(Way::Drive { command: DRIVE_BY, axes: axes.into_iter().collect() })
    }

    /// Turns axes, 1 to 8, to a value in degrees or mm. `DriveAEx`.
    pub fn drive_to(axes: impl IntoIterator<Item = (u8, f64)>) -> Self {
        Self::new(Way::Drive { command: DRIVE_TO, axes: axes.into_iter().collect() })
    }

    /// Moves to the position that is `mm` before a destination, against the direction of the tool. `Approach`.
    pub fn approach(interpolation: Interpolation, destination: impl Into<Destination>, mm: f64) -> Self {
        Self::new(Way::Approach(interpolation, destination.into(), mm))
    }

    /// Moves back by `mm`, against the direction of the tool. `Depart`.
    pub fn depart(interpolation: Interpolation, mm: f64) -> Self {
        Self::new(Way::Depart(interpolation, mm))
    }

    /// Moves the tool along a circle about a point in base coordinates; the tool turns with it. Robot_Rotate.
    pub fn rotate(plane: Plane, degrees: f32, centre_mm: [f64; 3]) -> Self {
        Self::new(Way::Rotate { plane, degrees, centre_mm })
    }

    fn new(way: Way) -> Self {
        Self { way, pass: Pass::default(), speed: None, acceleration: None, deceleration: None }
    }

    /// Sets how exactly the motion ends; without it, exactly.
    pub fn pass(self, pass: Pass) -> Self {
        Self { pass, ..self }
    }

    /// Sets the speed in percent of the arm's speed setting. **Without it the motion has the full speed of that setting**,
    /// while `bcap move` takes 10 %.
    pub fn speed_percent(self, percent: f64) -> Self {
        Self { speed: Some(percent), ..self }
    }

    /// Sets the acceleration in percent; without it the setting of the arm applies.
    pub fn acceleration_percent(self, percent: f64) -> Self {
        Self { acceleration: Some(percent), ..self }
    }

    /// Sets the deceleration in percent; without it the setting of the arm applies.
    pub fn deceleration_percent(self, percent: f64) -> Self {
        Self { deceleration: Some(percent), ..self }
    }

    /// Returns the options of the call.
    fn options(&self) -> String {
        let mut options = "NEXT".to_owned();
        let percents = [("SPEED", self.speed), ("ACCEL", self.acceleration), ("DECEL", self.deceleration)];
        for (name, percent) in percents {
            if let Some(percent) = percent {
                // writing to a string cannot fail; the controller refuses a value that is out of range
                let _ = write!(options, ",{name}={percent}");
            }
        }
        options
    }

    /// Returns the variable to read before the motion, to find out where it ends.
    pub(crate) fn variable(&self) -> Option<String> {
        match &self.way {
            Way::To(_, destination) | Way::Circle { end: destination, .. } | Way::Approach(_, destination, _) => {
                destination.variable()
            }
            Way::Drive { .. } | Way::Depart(..) | Way::Rotate { .. } => None,
        }
    }

    /// Returns where the motion ends; `variable` is the handle of [`variable`](Self::variable).
    pub(crate) fn target(&self, variable: Option<VariableHandle>) -> Target {
        match &self.way {
            Way::To(_, destination) => destination.target(variable),
            Way::Circle { end, .. } => end.target(variable).with_loop(),
            Way::Approach(_, destination, mm) => destination.target(variable).back(*mm),
            Way::Depart(_, mm) => Target::here().back(*mm),
            Way::Drive { command, axes } => drive(axes, *command == DRIVE_BY),
            // the work coordinates of the rotation are unknown to the library
            Way::Rotate { .. } => Target::UNKNOWN.with_loop(),
        }
    }

    /// Returns the call that starts the motion.
    pub(crate) fn start(self) -> MotionStart<Self, String> {
        let option = self.options();
        match &self.way {
            Way::To(interpolation, _) => {
                MotionStart::Move { interpolation: interpolation.number(), pose: self, option }
            }
            Way::Circle { .. } => MotionStart::Move { interpolation: 3, pose: self, option },
            Way::Drive { command, .. } => MotionStart::Execute { command, parameter: self },
            Way::Approach(..) => MotionStart::Execute { command: "Approach", parameter: self },
            Way::Depart(..) => MotionStart::Execute { command: "Depart", parameter: self },
            Way::Rotate { plane, degrees, centre_mm: [x, y, z] } => {
                let plane = match plane {
                    Plane::Xy => "XY",
                    Plane::Yz => "YZ",
                    Plane::Zx => "ZX",
                };
                // without Pose=1 the controller keeps the orientation of the tool
                let option = format!("{},Pose=1,{option}", self.pass);
                MotionStart::Rotate { plane, degrees: *degrees, centre: format!("V({x}, {y}, {z})"), option }
            }
        }
    }
}

/// The commands that turn axes by a distance, and to a value.
const DRIVE_BY: &str = "DriveEx";
const DRIVE_TO: &str = "DriveAEx";

/// Returns the end of a motion of axes by a distance, or to a value.
fn drive(axes: &[(u8, f64)], by: bool) -> Target {
    let mut joints = [None; 8];
    for (axis, value) in axes {
        // the controller refuses other axes
        if let Some(joint) = usize::from(*axis).checked_sub(1).and_then(|index| joints.get_mut(index)) {
            *joint = Some(*value);
        }
    }
    if by {
        Target::drive_by(Joints { degrees: joints.map(Option::unwrap_or_default) })
    } else {
        Target::drive_to(joints)
    }
}

/// The pose of Robot_Move, or the parameter of a command.
impl Encode for Move {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        let Self { way, pass, .. } = self;
        match way {
            Way::To(_, Destination::Position(position)) => position.target(pass.number()).encode(out),
            Way::To(_, Destination::Joints(joints)) => joints.target(pass.number()).encode(out),
            Way::To(_, Destination::Transform(transform)) => transform.target(pass.number()).encode(out),
            Way::To(_, Destination::Text(text)) => format!("{pass} {text}").as_str().encode(out),
            Way::Circle { via, end } => format!("{via}, {pass} {end}").as_str().encode(out),
            Way::Drive { axes, .. } => {
                let pairs: Vec<_> = axes.iter().map(|(axis, value)| format!("({axis}, {value})")).collect();
                (format!("{pass} {}", pairs.join(", ")).as_str(), self.options().as_str()).encode(out)
            }
            Way::Approach(interpolation, destination, mm) => {
                let (destination, length) = (destination.to_string(), format!("{pass} {mm}"));
                (interpolation.number(), destination.as_str(), length.as_str(), self.options().as_str()).encode(out)
            }
            Way::Depart(interpolation, mm) => {
                (interpolation.number(), format!("{pass} {mm}").as_str(), self.options().as_str()).encode(out)
            }
            // its arguments are in the call
            Way::Rotate { .. } => ().encode(out),
        }
    }
}

#[cfg(test)]
mod tests {
    use bcap_core::variant::OwnedVariant;

    use super::*;

    fn written(motion: &Move) -> String {
        format!("{:?}", OwnedVariant::new(motion).unwrap())
    }

    #[test]
    fn a_motion_is_written_as_robot_move_takes_it() {
        let motion = Move::line("P1").speed_percent(12.5).acceleration_percent(5.0).deceleration_percent(1.0);
        assert_eq!(written(&motion), "\"@E P1\"");
        let MotionStart::Move { interpolation: 2, option, .. } = motion.start() else { panic!() };
        assert_eq!(option, "NEXT,SPEED=12.5,ACCEL=5,DECEL=1");
        // each option is sent once
        assert_eq!(Move::line("P1").speed_percent(50.0).speed_percent(5.0), Move::line("P1").speed_percent(5.0));
        let joints = "VARIANT[R8[1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], I4(2), I4(-2)]";
        assert_eq!(written(&Move::joint(Joints::new([1.0, 2.0]))), joints);
        for (pass, text) in [(Pass::Commanded, "@0"), (Pass::Near, "@P"), (Pass::Within(30), "@30")] {
            assert_eq!(written(&Move::joint("P1").pass(pass)), format!("\"{text} P1\""));
        }
        let near = Move::joint(Joints::new([1.0])).pass(Pass::Near);
        assert!(written(&near).ends_with("I4(2), I4(-1)]"), "{}", written(&near));
    }

    #[test]
    fn the_end_of_a_motion_is_known_from_its_destination() {
        let target = |to: &str| Move::joint(to).target(None);
        assert_eq!(target(" J(1, 2.5) "), Target::joints(Joints::new([1.0, 2.5]), 2));
        let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, -90.0]);
        assert_eq!(target("P(400,0,300,180,0,-90)"), Target::position(position));
        assert_eq!(target("p(400, 0, 300, 180, 0, -90, 5)"), Target::position(position.figure(5)));
        let down = Transform::new([1.0, 2.0, 3.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]);
        assert_eq!(target("T(1,2,3,0,1,0,0,0,-1)"), Target::transform(down));
        assert_eq!(target("T(1,2,3,0,1,0,0,0,-1,5)"), Target::transform(down.figure(5)));
        for text in [
            "P(1,2)",
            "P(1,2,3,4,5,6,0.5)",
            "J()",
            "J(1,2,3,4,5,6,7,8,9)",
            "J(1,x)",
            "J(1",
            "V1",
            "P1 EX((7,30))",
            "P-1",
            "P[1",
            "",
            "é",
        ] {
            assert_eq!((target(text), Move::joint(text).variable()), (Target::UNKNOWN, None), "{text}");
        }
        for (text, name) in [("P1", "P1"), ("j[3]", "J3"), (" T 2 ", "T2")] {
            assert_eq!(Move::line(text).variable().as_deref(), Some(name), "{text}");
        }
        let arc = Move::circle("P1", "P2");
        assert_eq!(arc.variable().as_deref(), Some("P2"));
        assert_eq!(arc.target(Some(VariableHandle(9))), Target::variable(VariableHandle(9)).with_loop());
        let by = Move::drive_by([(1, 5.0), (3, -2.5), (9, 1.0)]);
        assert_eq!(by.target(None), Target::drive_by(Joints::new([5.0, 0.0, -2.5])));
        let mut to = [None; 8];
        to[1] = Some(45.0);
        assert_eq!(Move::drive_to([(2, 45.0)]).target(None), Target::drive_to(to));
        assert_eq!(Move::depart(Interpolation::Line, 50.0).target(None), Target::here().back(50.0));
        let above = Move::approach(Interpolation::Line, position, 20.0).target(None);
        assert_eq!(above, Target::position(position).back(20.0));
    }

    #[test]
    fn other_motions_are_written_as_their_commands_take_them() {
        let arc = Move::circle("P1", Position::new([1.0, 2.0, 3.5], [0.0; 3]).figure(5));
        assert_eq!(written(&arc), "\"P1, @E P(1, 2, 3.5, 0, 0, 0, 5)\"");
        assert!(matches!(arc.start(), MotionStart::Move { interpolation: 3, .. }));
        let drive = Move::drive_by([(1, 5.0), (7, -2.5)]).speed_percent(5.0);
        assert_eq!(written(&drive), r#"VARIANT["@E (1, 5), (7, -2.5)", "NEXT,SPEED=5"]"#);
        assert!(matches!(drive.start(), MotionStart::Execute { command: "DriveEx", .. }));
        assert!(matches!(Move::drive_to([(1, 5.0)]).start(), MotionStart::Execute { command: "DriveAEx", .. }));
        let approach = Move::approach(Interpolation::Line, "P1", 50.0).pass(Pass::Near);
        assert_eq!(written(&approach), r#"VARIANT[I4(2), "P1", "@P 50", "NEXT"]"#);
        let depart = Move::depart(Interpolation::Joint, 12.5);
        assert_eq!(written(&depart), r#"VARIANT[I4(1), "@E 12.5", "NEXT"]"#);
        let MotionStart::Rotate { plane, degrees, centre, option } =
            Move::rotate(Plane::Zx, 90.0, [400.0, 0.0, 1.5]).start()
        else {
            panic!()
        };
        assert_eq!(
            (plane, degrees, centre.as_str(), option.as_str()),
            ("ZX", 90.0, "V(400, 0, 1.5)", "@E,Pose=1,NEXT")
        );
    }
}
