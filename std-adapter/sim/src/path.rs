//! The path of a motion: positions of the axes, and the speed that all limits permit.

use bcap_core::hresult::HResult;

use crate::codes;
use crate::kinematics::{Axes, Frame, Geometry, OutOfReach, six, with_joints};

/// The largest speed of the flange on a line, in mm per second.
pub const LINE_SPEED: f64 = 2000.0;

/// The largest turning speed of the flange on a line, in degrees per second.
pub const TURN_SPEED: f64 = 360.0;

/// The number of parts in which a line is planned.
pub(crate) const LINE_PARTS: usize = 100;

/// The largest turn of a joint in one part of a line, in degrees; a larger one means a singularity.
const LARGEST_STEP: f64 = 30.0;

/// A path that changes the posture passes a singular point. A path on which an axis permits less than this fraction of
/// the speed of the flange is too close to one.
const SINGULAR_SPEED: f64 = 0.01;

/// A length in mm and an angle in degrees that no controller resolves. On a shorter path, the rounding of the joints would
/// determine whether it is singular.
const SHORT: f64 = 1e-3;

/// Why a route cannot be followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Blocked {
    /// Its goal is out of reach.
    Goal(OutOfReach),
    /// A pose on the way is out of reach.
    Path(OutOfReach),
    /// A straight path ends in another figure.
    Figure,
    /// The command requires something that no path has.
    Invalid,
}

impl Blocked {
    pub(crate) fn code(self) -> HResult {
        match self {
            Self::Goal(reason) => reason.of_goal(),
            Self::Path(reason) => reason.on_path(),
            Self::Figure => codes::OTHER_FIGURE,
            Self::Invalid => HResult::E_INVALIDARG,
        }
    }
}

impl From<OutOfReach> for Blocked {
    fn from(reason: OutOfReach) -> Self {
        Self::Goal(reason)
    }
}

/// Positions of the axes, which a motion passes evenly.
#[derive(Clone, Debug)]
pub(crate) struct Path {
    /// At least two.
    knots: Vec<Axes>,
    /// Maximum speed within all limits, in paths per second.
    pub(crate) full_speed: f64,
    /// The speed above which the bends of the path would exceed the acceleration of an axis, in paths per second.
    pub(crate) bend_speed: f64,
    /// The largest acceleration within all limits, in paths per second squared.
    pub(crate) full_accel: f64,
    /// The arm that follows the path.
    pub(crate) arm: Geometry,
}

impl Path {
    /// Plans a motion in which every axis moves evenly.
    pub(crate) fn axes(arm: &Geometry, from: Axes, to: Axes) -> Self {
        let full_speed = axis_limit(arm, &from, &to, 1.0);
        let full_accel = full_speed / arm.acceleration_time;
        Self { full_speed, bend_speed: f64::INFINITY, full_accel, knots: vec![from, to], arm: *arm }
    }

    /// Plans a motion of the flange in `parts` parts, through the frames of `frame`, a function of the part of the path, 0 to
    /// 1, while J7 and J8 move evenly to those of `end`. The flange moves `size.0` mm and turns `size.1` degrees.
    pub(crate) fn along(
        arm: &Geometry,
        start: Axes,
        end: &Axes,
        size: (f64, f64),
        parts: usize,
        frame: impl Fn(f64) -> Frame,
    ) -> Result<Self, Blocked> {
        let mut full_speed = (LINE_SPEED / size.0).min(TURN_SPEED / size.1);
        let slowest = (LINE_SPEED / size.0.max(SHORT)).min(TURN_SPEED / size.1.max(SHORT)) * SINGULAR_SPEED;
        let mut knots = vec![start];
        let mut here = start;
        for n in 1..=parts {
            let part = n as f64 / parts as f64;
            let joints = arm.inverse_nearest(&frame(part), &six(&here)).map_err(|error| {
                // a goal out of reach explains the path
                arm.inverse_nearest(&frame(1.0), &six(&here)).err().map_or(Blocked::Path(error), Blocked::Goal)
            })?;
            let next = with_joints(&joints, &between(&start, end, part));
            let speed = axis_limit(arm, &here, &next, parts as f64);
            // J7 and J8 do not turn the flange, so a long way of theirs is not singular
            let turning = axis_limit(arm, &here, &with_joints(&joints, &here), parts as f64);
            let jumps = here.iter().zip(&next).take(6).any(|(a, b)| (a - b).abs() > LARGEST_STEP);
            let flips = !arm.same_posture(arm.figure(&six(&here)), arm.figure(&joints));
            if turning < slowest || jumps || flips {
                return Err(Blocked::Path(OutOfReach::Singular));
            }
            full_speed = full_speed.min(speed);
            knots.push(next);
            here = next;
        }
        let (bend_speed, full_accel) = curved(arm, &knots, full_speed);
        Ok(Self { knots, full_speed, bend_speed, full_accel, arm: *arm })
    }

    /// Plans the path on which axes at these speeds come to rest together, within their limits of acceleration.
    ///
    /// `None` for axes at rest. An axis that would leave its range stops at the end of the range, so it brakes harder.
    pub(crate) fn braking(arm: &Geometry, from: Axes, speeds: &Axes, limits: &Axes) -> Option<Self> {
        let seconds = speeds.iter().zip(limits).map(|(speed, limit)| speed.abs() / limit).fold(0.0, f64::max);
        let to = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| {
            let (low, high) = arm.ranges[i];
            // through rounding, an axis may be slightly beyond its range
            (from[i] + speeds[i] * seconds / 2.0).clamp(low.min(from[i]), high.max(from[i]))
        });
        let full_speed = 2.0 / seconds;
        let full_accel = full_speed / arm.acceleration_time;
        (seconds > 1e-6).then(|| Self {
            knots: vec![from, to],
            full_speed,
            bend_speed: f64::INFINITY,
            full_accel,
            arm: *arm,
        })
    }

    /// Returns the position of the axes at its end.
    pub(crate) fn end(&self) -> Axes {
        self.knots.last().copied().unwrap_or_default()
    }

    /// Returns the position of the axes at its beginning.
    pub(crate) fn start(&self) -> Axes {
        self.knots.first().copied().unwrap_or_default()
    }

    /// Returns the least and the greatest position of each axis between two places on the path.
    pub(crate) fn bounds(&self, from: f64, to: f64) -> [(f64, f64); 8] {
        let parts = (self.knots.len() - 1) as f64;
        let inner = |n: &usize| (from..=to).contains(&(*n as f64 / parts));
        let knots = (0..self.knots.len()).filter(inner).map(|n| self.knots[n]);
        knots.chain([self.at(to)]).fold(self.at(from).map(|place| (place, place)), |bounds, axes| {
            [0, 1, 2, 3, 4, 5, 6, 7].map(|i| (bounds[i].0.min(axes[i]), bounds[i].1.max(axes[i])))
        })
    }

    pub(crate) fn at(&self, part: f64) -> Axes {
        let place = part.clamp(0.0, 1.0) * (self.knots.len() - 1) as f64;
        let before = (place as usize).min(self.knots.len() - 2);
        let (a, b, rest) = (&self.knots[before], &self.knots[before + 1], place - before as f64);
        if rest >= 1.0 { *b } else { between(a, b, rest) }
    }
}

/// Interpolates between two positions of the axes; `part` is 0 to 1.
fn between(a: &Axes, b: &Axes, part: f64) -> Axes {
    [0, 1, 2, 3, 4, 5, 6, 7].map(|i| a[i] + (b[i] - a[i]) * part)
}

/// Returns the speed at which the first axis reaches its limit, in paths per second.
fn axis_limit(arm: &Geometry, from: &Axes, to: &Axes, parts: f64) -> f64 {
    let limits = from.iter().zip(to).zip(&arm.speeds).map(|((a, b), speed)| speed / ((a - b).abs() * parts));
    limits.fold(f64::INFINITY, f64::min)
}

/// Returns the largest speed and acceleration along a path, in paths per second (squared), that its bends permit.
///
/// Where an axis turns unevenly, its acceleration has two parts: one along the path, and one from the bend of the path,
/// which grows with the square of the speed. Each may take at least half of the limit.
fn curved(arm: &Geometry, knots: &[Axes], full_speed: f64) -> (f64, f64) {
    let parts = (knots.len() - 1) as f64;
    let limits = arm.accelerations();
    let bends = || {
        knots.windows(3).flat_map(move |three| {
            let (a, b, c) = (three[0], three[1], three[2]);
            (0..8).map(move |i| {
                let (slope, bend) =
                    ((c[i] - a[i]).abs() * parts / 2.0, (c[i] - 2.0 * b[i] + a[i]).abs() * parts * parts);
                (limits[i], slope, bend)
            })
        })
    };
    let bend_speed = bends().fold(f64::INFINITY, |speed, (limit, _, bend)| speed.min((limit / 2.0 / bend).sqrt()));
    let (speed, most) = (full_speed.min(bend_speed), full_speed / arm.acceleration_time);
    let accel = bends().fold(most, |accel, (limit, slope, bend)| accel.min((limit - bend * speed * speed) / slope));
    (bend_speed, accel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ArmProfile;

    /// A line close to the axis of J1, where J1 must turn fast: at full speed and full acceleration no axis exceeds its limits.
    #[test]
    fn a_bent_path_keeps_the_accelerations_of_all_axes() {
        for arm in [Geometry::DEFAULT, ArmProfile::Vs060.arm().geometry, ArmProfile::Hsr065.arm().geometry] {
            let (tilt, height) = if arm.joints() == 6 { (180.0, 300.0) } else { (0.0, 100.0) };
            let [from, to] = [-150.0, 150.0].map(|y| Frame::from_xyz_rpy([200.0, y, height, tilt, 0.0, tilt]));
            let start = with_joints(&arm.inverse_nearest(&from, &[0.0; 6]).unwrap(), &[0.0; 8]);
            let path =
                Path::along(&arm, start, &start, (300.0, 0.0), LINE_PARTS, |part| from.towards(&to, part)).unwrap();
            let (speed, accel) = (path.full_speed.min(path.bend_speed), path.full_accel);
            let parts = LINE_PARTS as f64;
            let mut largest = 0.0_f64;
            for three in path.knots.windows(3) {
                for (i, limit) in arm.accelerations().into_iter().enumerate() {
                    let slope = (three[2][i] - three[0][i]) * parts / 2.0;
                    let bend = (three[2][i] - 2.0 * three[1][i] + three[0][i]) * parts * parts;
                    let here = slope.abs() * accel + bend.abs() * speed * speed;
                    assert!(here <= limit * 1.000_001, "J{}: {here} is above {limit}", i + 1);
                    largest = largest.max(here / limit);
                }
            }
            assert!(largest > 0.9, "the limit is used: {largest}");
        }
    }
}
