//! Motions as a robot is told them.

use std::fmt::Write as _;

use bcap_core::error::EncodeError;
use bcap_core::position::{Joints, Position, Transform};
use bcap_core::procedure::MoveParameters;
use bcap_core::variant::{Encode, Writer};

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

/// The pass `@E`: the motion ends exactly at the destination (S2:1305).
const EXACT: i32 = -2;

impl Encode for Destination {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Text(text) => format!("@E {text}").as_str().encode(out),
            Self::Position(position) => position.target(EXACT).encode(out),
            Self::Joints(joints) => joints.target(EXACT).encode(out),
            Self::Transform(transform) => transform.target(EXACT).encode(out),
        }
    }
}

/// A motion to a destination, for [`Arm::move_to`](crate::blocking::Arm::move_to).
///
/// # Examples
///
/// ```
/// use bcap_std::{Joints, Move, Position};
///
/// let by_name = Move::joint("P1").speed_percent(20.0);
/// let home = Move::joint(Joints::new([0.0, 45.0, 90.0, 0.0, 45.0, 0.0]));
/// let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
/// let down = Move::line(position).speed_percent(5.0).acceleration_percent(10.0);
/// # let _ = (by_name, home, down);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[must_use = "a motion begins when it is passed to an arm"]
pub struct Move {
    interpolation: i32,
    destination: Destination,
    options: String,
}

impl Move {
    /// Moves all joints at the same time, point to point; the path of the tool is not a line.
    pub fn joint(destination: impl Into<Destination>) -> Self {
        Self::new(1, destination.into())
    }

    /// Moves the tool along a line.
    pub fn line(destination: impl Into<Destination>) -> Self {
        Self::new(2, destination.into())
    }

    fn new(interpolation: i32, destination: Destination) -> Self {
        Self { interpolation, destination, options: "NEXT".into() }
    }

    /// Sets the speed in percent of the speed that the arm is set to.
    pub fn speed_percent(self, percent: f64) -> Self {
        self.option("SPEED", percent)
    }

    /// Sets the acceleration in percent.
    pub fn acceleration_percent(self, percent: f64) -> Self {
        self.option("ACCEL", percent)
    }

    /// Sets the deceleration in percent.
    pub fn deceleration_percent(self, percent: f64) -> Self {
        self.option("DECEL", percent)
    }

    fn option(mut self, name: &str, value: f64) -> Self {
        // writing to a string cannot fail; the controller refuses a value that is out of range
        let _ = write!(self.options, ",{name}={value}");
        self
    }

    /// Returns the parameters of Robot_Move.
    pub(crate) fn parameters(&self) -> MoveParameters<&Destination, &str> {
        let Self { interpolation, destination, options } = self;
        MoveParameters { interpolation: *interpolation, pose: destination, option: options }
    }

    /// Returns the parameters of Robot_Move.
    #[cfg(feature = "tokio")]
    pub(crate) fn into_parameters(self) -> MoveParameters<Destination, String> {
        let Self { interpolation, destination, options } = self;
        MoveParameters { interpolation, pose: destination, option: options }
    }
}

#[cfg(test)]
mod tests {
    use bcap_core::variant::OwnedVariant;

    use super::*;

    #[test]
    fn a_motion_is_written_as_robot_move_takes_it() {
        let motion = Move::line("P1").speed_percent(12.5).acceleration_percent(5.0).deceleration_percent(1.0);
        let parameters = motion.parameters();
        assert_eq!((parameters.interpolation, parameters.option), (2, "NEXT,SPEED=12.5,ACCEL=5,DECEL=1"));
        let written = |motion: Move| format!("{:?}", OwnedVariant::new(motion.parameters().pose).unwrap());
        assert_eq!(written(motion), "\"@E P1\"");
        let joints = "VARIANT[R8[1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], I4(2), I4(-2)]";
        assert_eq!(written(Move::joint(Joints::new([1.0, 2.0]))), joints);
    }
}
