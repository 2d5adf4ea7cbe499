//! The axes of `bcap jog`: the motion by a step, and where the robot is.

use std::fmt;
use std::str::FromStr;

use bcap_core::position::Position;
use bcap_std::Move;

use crate::failure::Failure;
use crate::session::Session;

/// A joint or a coordinate, with its place among the numbers of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Axis {
    Joint(u8),
    Coordinate(usize),
}

const COORDINATES: [&str; 6] = ["X", "Y", "Z", "RX", "RY", "RZ"];

impl FromStr for Axis {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let upper = name.to_ascii_uppercase();
        let joint =
            upper.strip_prefix('J').and_then(|number| number.parse().ok()).filter(|joint| (1..=8).contains(joint));
        let coordinate = COORDINATES.iter().position(|known| *known == upper).map(Self::Coordinate);
        joint.map(Self::Joint).or(coordinate).ok_or_else(|| "write J1 to J8, X, Y, Z, RX, RY or RZ".into())
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Joint(joint) => write!(f, "J{joint}"),
            Self::Coordinate(place) => f.write_str(COORDINATES.get(*place).unwrap_or(&"?")),
        }
    }
}

impl Axis {
    /// Returns the motion by a step. The arm must be taken, and the tool selected, so that the position is still true when the
    /// robot moves.
    pub(crate) fn motion(self, by: f64, session: &mut Session) -> Result<Move, Failure> {
        require_rest(session)?;
        match self {
            Self::Joint(joint) => Ok(Move::drive_by([(joint, by)])),
            Self::Coordinate(place) => {
                let mut numbers = session.with(|controller| controller.robot()?.position())?.to_array();
                numbers.iter_mut().skip(place).take(1).for_each(|number| *number += by);
                let to = Position::from_array(numbers);
                to.map(Move::line).ok_or_else(|| Failure::Input(format!("{self}: the position has no valid Fig")))
            }
        }
    }

    /// Reads where the robot is on each axis.
    pub(crate) fn read_all(session: &mut Session) -> Result<Vec<(Self, f64)>, Failure> {
        session.with(|controller| {
            let mut robot = controller.robot()?;
            let (joints, position) = (robot.joints()?.degrees, robot.position()?.to_array());
            let coordinates = (0..COORDINATES.len()).map(Self::Coordinate).zip(position);
            Ok((1..).map(Self::Joint).zip(joints).chain(coordinates).collect())
        })
    }

    /// Reads where the robot is on this axis.
    pub(crate) fn read(self, session: &mut Session) -> Result<f64, Failure> {
        let all = Self::read_all(session)?;
        Ok(all.iter().find(|(axis, _)| *axis == self).map_or(f64::NAN, |(_, position)| *position))
    }
}

/// Fails unless the robot rests: a position on the way is not one to start from.
pub(crate) fn require_rest(session: &mut Session) -> Result<(), Failure> {
    if !session.with(|controller| controller.robot()?.read::<bool>("@BUSY_STATUS"))? {
        return Ok(());
    }
    Err(Failure::unfit("the robot moves", "wait until it rests, or halt it with `bcap halt`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_a_joint_or_a_coordinate() {
        for (name, axis) in
            [("j1", Axis::Joint(1)), ("J8", Axis::Joint(8)), ("x", Axis::Coordinate(0)), ("RZ", Axis::Coordinate(5))]
        {
            assert_eq!(name.parse(), Ok(axis));
            assert_eq!(axis.to_string(), name.to_uppercase());
        }
        for name in ["J0", "J9", "J", "J01x", "W", "FIG", ""] {
            assert!(name.parse::<Axis>().is_err(), "{name}");
        }
    }
}
