//! Limits on the commanded speed and acceleration of each axis, checked before a pose is sent.
//!
//! The controller refuses a pose that exceeds an axis' speed with 0x8420405n, one that exceeds its acceleration with
//! 0x8420404n, and leaves Slave Mode (b-CAP specification, section 5.8). The engine computes both from the poses of
//! successive cycles:
//!
//! ```text
//!   speed n        = (pose n - pose n-1) / cycle
//!   acceleration n = (speed n - speed n-1) / cycle           the stream starts at rest, at the robot's position
//! ```

use core::fmt;

use super::pose::{Pose, half_turn};
use super::{FormatError, PoseType};

/// The maximum commanded speed and acceleration of each axis.
///
/// For J poses the axes are the joints. For P poses 1 to 3 are X, Y, Z and 4 to 6 RX, RY, RZ, for T poses 1 to 3 are X, Y,
/// Z and 4 to 6 are not checked; 7 and 8 are the extended joints. For P and T poses only the controller can compute the
/// motion of the joints, so it may refuse a pose within these limits.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisLimits {
    /// In degrees or mm per second, axis 1 first.
    pub speed: [f64; 8],
    /// In degrees or mm per second squared, axis 1 first.
    pub acceleration: [f64; 8],
}

impl AxisLimits {
    /// No limits: every finite pose passes.
    pub const NONE: Self = Self { speed: [f64::INFINITY; 8], acceleration: [f64::INFINITY; 8] };

    /// Sets the same limits for all axes.
    #[must_use]
    pub const fn uniform(speed: f64, acceleration: f64) -> Self {
        Self { speed: [speed; 8], acceleration: [acceleration; 8] }
    }

    /// Checks a path of poses, one every `cycle` seconds, from rest at the first pose.
    ///
    /// # Errors
    ///
    /// The index of the first pose that exceeds a limit or has a number that is not finite, with the reason.
    pub fn check_path<'a>(
        &self,
        cycle: f64,
        poses: impl IntoIterator<Item = &'a Pose>,
    ) -> Result<(), (usize, PoseError)> {
        let mut reached: Option<(&Pose, Velocity)> = None;
        for (index, pose) in poses.into_iter().enumerate() {
            let (last, before) = reached.unwrap_or((pose, [0.0; 8]));
            let velocity = check(self, cycle, last, &before, pose).map_err(|error| (index, error))?;
            reached = Some((pose, velocity));
        }
        Ok(())
    }
}

impl Default for AxisLimits {
    fn default() -> Self {
        Self::NONE
    }
}

/// A pose was refused before it was sent; the stream continues with another pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PoseError {
    /// No pose is needed now: [`Engine::poll`](super::Engine::poll) reports when.
    NotNow,
    /// It does not have the layout of the format.
    Format(FormatError),
    /// A number is infinite or not a number.
    NotFinite {
        /// Its position in the pose, counted from 1.
        number: u8,
    },
    /// An axis would exceed its speed limit: the controller would reply 0x8420405n.
    Speed {
        /// The axis, counted from 1.
        axis: u8,
        /// Its speed, in degrees or mm per second.
        speed: f64,
        /// Its limit.
        limit: f64,
    },
    /// An axis would exceed its acceleration limit: the controller would reply 0x8420404n.
    Acceleration {
        /// The axis, counted from 1.
        axis: u8,
        /// Its acceleration, in degrees or mm per second squared.
        acceleration: f64,
        /// Its limit.
        limit: f64,
    },
}

impl fmt::Display for PoseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotNow => f.write_str("no pose is needed now"),
            Self::Format(error) => error.fmt(f),
            Self::NotFinite { number } => write!(f, "number {number} of the pose is not finite"),
            Self::Speed { axis, speed, limit } => {
                write!(
                    f,
                    "axis {axis} would move at {speed} degrees or mm per second, its limit is {limit}: put the poses closer"
                )
            }
            Self::Acceleration { axis, acceleration, limit } => write!(
                f,
                "axis {axis} would accelerate by {acceleration} degrees or mm per second squared, its limit is {limit}: change \
                 speed more gently"
            ),
        }
    }
}

impl core::error::Error for PoseError {}

impl From<FormatError> for PoseError {
    fn from(error: FormatError) -> Self {
        Self::Format(error)
    }
}

/// The speed of each axis, in degrees or mm per cycle.
pub(super) type Velocity = [f64; 8];

/// Checks the step from `last`, reached at the speed `before`, to `next`, and returns the speed of that step.
pub(super) fn check(
    limits: &AxisLimits,
    cycle: f64,
    last: &Pose,
    before: &Velocity,
    next: &Pose,
) -> Result<Velocity, PoseError> {
    let numbers = next.as_slice().iter();
    if let Some((_, number)) = numbers.zip(1_u8..).map(|(n, count)| (n.is_finite(), count)).find(|(finite, _)| !finite)
    {
        return Err(PoseError::NotFinite { number });
    }
    let velocity = steps(last, next);
    let axes = velocity.iter().zip(before).zip(limits.speed).zip(limits.acceleration).zip(1_u8..);
    for ((((step, step_before), speed_limit), acceleration_limit), axis) in axes {
        let speed = (step / cycle).abs();
        if speed > speed_limit {
            return Err(PoseError::Speed { axis, speed, limit: speed_limit });
        }
        let acceleration = ((step - step_before) / (cycle * cycle)).abs();
        if acceleration > acceleration_limit {
            return Err(PoseError::Acceleration { axis, acceleration, limit: acceleration_limit });
        }
    }
    Ok(velocity)
}

/// Returns the motion of each axis; angles take the shorter direction.
fn steps(last: &Pose, next: &Pose) -> Velocity {
    let (from, to) = (last.axes(), next.axes());
    let mut out = [0.0; 8];
    for ((slot, a), b) in out.iter_mut().zip(from).zip(to) {
        *slot = b - a;
    }
    if next.layout().pose == PoseType::P {
        out.iter_mut().skip(3).take(3).for_each(|angle| *angle = half_turn(*angle));
    }
    out
}

/// Returns the fraction of the current speed by which each cycle may slow down within the limits: 1 stops immediately.
pub(super) fn slow_down(limits: &AxisLimits, cycle: f64, velocity: &Velocity) -> f64 {
    /// The usable fraction of a limit; the rest is a margin for rounding.
    const SHARE: f64 = 0.9;
    let mut part: f64 = 1.0;
    for (step, limit) in velocity.iter().zip(limits.acceleration) {
        let step = step.abs();
        if step > 0.0 {
            part = part.min(SHARE * limit * cycle * cycle / step);
        }
    }
    // with a limit of 0 the stop would never end
    if part > 0.0 { part } else { 1e-3 }
}
