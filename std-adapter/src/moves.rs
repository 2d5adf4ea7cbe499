//! Motions as a robot is told them.

use std::fmt::Write as _;

/// A motion to a destination, for [`Arm::move_to`](crate::blocking::Arm::move_to).
///
/// The destination is a variable (`P1`, `J[3]`, `T2`) or numbers: `P(x, y, z, rx, ry, rz, fig)` in mm and degrees,
/// `J(j1, ..., j6)` in degrees. It is checked by the controller.
///
/// # Examples
///
/// ```
/// use bcap_std::Move;
///
/// let approach = Move::joint("P1").speed_percent(20.0);
/// let slow = Move::line("P(400, 0, 300, 180, 0, 180, 5)").speed_percent(5.0).acceleration_percent(10.0);
/// # let _ = (approach, slow);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[must_use = "a motion begins when it is passed to an arm"]
pub struct Move {
    interpolation: i32,
    destination: String,
    options: String,
}

impl Move {
    /// Moves all joints at the same time, point to point; the path of the tool is not a line.
    pub fn joint(destination: impl Into<String>) -> Self {
        Self::new(1, destination.into())
    }

    /// Moves the tool along a line.
    pub fn line(destination: impl Into<String>) -> Self {
        Self::new(2, destination.into())
    }

    fn new(interpolation: i32, destination: String) -> Self {
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

    /// Returns the interpolation of Robot_Move.
    pub(crate) const fn interpolation(&self) -> i32 {
        self.interpolation
    }

    /// Returns the pose of Robot_Move: `@E` ends the motion exactly at the destination (S2:1305).
    pub(crate) fn pose(&self) -> String {
        format!("@E {}", self.destination)
    }

    /// Returns the options of Robot_Move.
    pub(crate) fn options(&self) -> &str {
        &self.options
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_is_written_as_robot_move_takes_it() {
        let motion = Move::line("P1").speed_percent(12.5).acceleration_percent(5.0).deceleration_percent(1.0);
        assert_eq!((motion.interpolation(), motion.pose()), (2, "@E P1".into()));
        assert_eq!(motion.options(), "NEXT,SPEED=12.5,ACCEL=5,DECEL=1");
        assert_eq!(Move::joint("J1").interpolation(), 1);
    }
}
