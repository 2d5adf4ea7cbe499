//! The axes along which a person moves a robot by steps, and the robot's position on each.

use std::fmt;
use std::str::FromStr;

use bcap_core::position::{Joints, Position};
use bcap_std::{Destination, Error, Move, blocking::Robot};

/// A joint or a coordinate, with its place among the numbers of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// J1 to J8.
    Joint(u8),
    /// X, Y, Z, RX, RY, RZ of the selected work coordinates.
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

/// A relative step: the motion, and its destination.
#[derive(Clone, Debug)]
pub struct Step {
    /// The motion.
    pub motion: Move,
    /// The end of the motion.
    pub end: Destination,
}

impl Axis {
    /// Returns the motion of one step from the robot's resting position; `None` if the position has no valid Fig. The arm must
    /// be taken, and the tool selected, so that the position is still true when the robot moves.
    ///
    /// # Errors
    ///
    /// An [`Error`] of a call.
    pub fn step(self, by: f64, robot: &mut Robot<'_>) -> Result<Option<Step>, Error> {
        Ok(match self {
            Self::Joint(joint) => {
                let mut degrees = robot.joints()?.degrees;
                degrees.iter_mut().skip(usize::from(joint) - 1).take(1).for_each(|degree| *degree += by);
                Some(Step { motion: Move::drive_by([(joint, by)]), end: Joints { degrees }.into() })
            }
            Self::Coordinate(place) => {
                let mut numbers = robot.position()?.to_array();
                numbers.iter_mut().skip(place).take(1).for_each(|number| *number += by);
                Position::from_array(numbers).map(|to| Step { motion: Move::line(to), end: to.into() })
            }
        })
    }

    /// Reads the robot's position on each axis.
    ///
    /// # Errors
    ///
    /// An [`Error`] of a call.
    pub fn read_all(robot: &mut Robot<'_>) -> Result<Vec<(Self, f64)>, Error> {
        let (joints, position) = (robot.joints()?.degrees, robot.position()?.to_array());
        let coordinates = (0..COORDINATES.len()).map(Self::Coordinate).zip(position);
        Ok((1..).map(Self::Joint).zip(joints).chain(coordinates).collect())
    }
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
