//! Arms of six axes with an offset wrist: all joints for a frame of the flange.
//!
//! The flange carries the axis of J5, and J6 turns it about the flange axis. So J6 determines the position of the wrist centre
//! on a circle, and thereby J1, J2 and J3. J6 is right if the axis of J5 is perpendicular to the forearm:
//!
//! ```text
//!   g(J6) = axis of J5 . direction of the forearm = 0
//! ```
//!
//! A turn of J6 is divided into intervals, and interval arithmetic encloses g and its slope in each. An interval whose values
//! exclude 0 has no solution. An interval whose slopes exclude 0 has at most one solution, where g changes its sign. All other
//! intervals are halved. So no solution is missed, even where two of them nearly coincide. At the ends of the arm's reach the slope is
//! infinite; there the last interval and its ends are tried.

use std::collections::VecDeque;
use std::f64::consts::PI;

use super::frame::{Frame, Joints, OutOfReach, SINGULAR, dot, multiply, normal, rz_matrix, transpose};
use super::interval::{Enclosure, Interval};
use super::vertical::{BELOW, LEFTY, NONFLIP, Vertical};

/// A value of g below this is rounding.
const EXACT: f64 = 1e-10;

/// The largest g of a solution of the search: at the ends of the reach, rounding of the wrist centre changes the angle of the
/// elbow by 1e-8.
const ROUNDED: f64 = 1e-7;

/// J6 is searched so far to either side: a little more than half a turn, so that rounding leaves no gap.
const HALF_TURN: f64 = PI + 1e-6;

/// An interval of J6 that is not halved, in radians: two solutions within it count as one.
const FINEST: f64 = 1e-9;

/// The maximum number of intervals that are halved, for a frame with solutions everywhere.
const HALVINGS: usize = 20_000;

/// Returns the joints for a frame of the flange in a posture, each within ±180 degrees.
///
/// At a singularity, an undefined joint keeps its value of `near`. There may be several solutions in one posture: the first that
/// `accept` accepts counts.
pub(super) fn inverse(
    arm: &Vertical,
    frame: &Frame,
    posture: u8,
    near: &Joints,
    accept: &dyn Fn(&Joints) -> bool,
) -> Result<Joints, OutOfReach> {
    let search = Search { arm, frame, posture, near };
    if let Some(joints) = search.follow().filter(accept) {
        return Ok(joints);
    }
    let found = search.all();
    match found.iter().find(|joints| accept(joints)).or(found.first()) {
        Some(joints) => Ok(*joints),
        // the axis that cannot reach with J6 as it is, or else the elbow
        None => Err(search.place(near[5].to_radians()).err().unwrap_or(OutOfReach::Unreachable)),
    }
}

/// A frame of the flange to be reached in one posture.
struct Search<'a> {
    arm: &'a Vertical,
    frame: &'a Frame,
    posture: u8,
    /// The values in degrees of joints that the frame does not define.
    near: &'a Joints,
}

/// The arm for one value of J6.
struct Candidate {
    /// In radians.
    j6: f64,
    /// J1, J2 and J3, in radians.
    arm: [f64; 3],
    /// The direction of the axis of J5.
    axis: [f64; 3],
    /// The direction of the forearm.
    forearm: [f64; 3],
}

impl Candidate {
    /// Returns g.
    fn error(&self) -> f64 {
        dot(self.axis, self.forearm)
    }
}

impl Search<'_> {
    /// Finds the joints, in degrees, by the secant method from J6 of `near`.
    fn follow(&self) -> Option<Joints> {
        let start = self.near[5].to_radians();
        let (mut before, mut here) = (self.place(start + 1e-3).ok()?, self.place(start).ok()?);
        for _ in 0..12 {
            let (error_before, error) = (before.error(), here.error());
            if error.abs() < EXACT {
                return self.joints(&here);
            }
            let step = -error * (here.j6 - before.j6) / (error - error_before);
            // the search replaces steps that are too large for the secant method
            let next = Some(here.j6 + step).filter(|_| step.abs() < 0.5)?;
            (before, here) = (here, self.place(next).ok()?);
        }
        None
    }

    /// Returns all joints, in degrees; those with J6 nearest to that of `near` first.
    fn all(&self) -> Vec<Joints> {
        let start = self.near[5].to_radians();
        let mut found = self.places(start);
        found.sort_by(|a, b| (a.j6 - start).abs().total_cmp(&(b.j6 - start).abs()));
        found.iter().filter_map(|place| self.joints(place)).collect()
    }

    /// Returns the solutions in a turn of J6 about `start`; some of them twice.
    fn places(&self, start: f64) -> Vec<Candidate> {
        let mut found = Vec::new();
        let mut intervals =
            VecDeque::from([Interval::new(start - HALF_TURN, start), Interval::new(start, start + HALF_TURN)]);
        let mut halvings = 0;
        while let Some(j6) = intervals.pop_front() {
            let Some(g) = self.enclose(j6) else { continue };
            let middle = j6.middle();
            let g = match self.enclose(Interval::point(middle)) {
                Some(at_middle) => g.narrowed(j6, at_middle.value),
                None => g,
            };
            if g.value.excludes_zero(EXACT) {
                continue;
            }
            if g.slope.excludes_zero(0.0) {
                found.extend(self.crossing(j6));
            } else if j6.width() > FINEST && halvings < HALVINGS {
                halvings += 1;
                intervals.extend([Interval::new(j6.low, middle), Interval::new(middle, j6.high)]);
            } else {
                let reached = self.reached(j6);
                found.extend(self.crossing(reached));
                found.extend([reached.low, middle, reached.high].into_iter().filter_map(|j6| self.place(j6).ok()));
            }
        }
        found.retain(|place| place.error().abs() < ROUNDED);
        found
    }

    /// Returns the part of an interval that the arm reaches, if that begins or ends in it.
    fn reached(&self, Interval { low, high }: Interval) -> Interval {
        let is_reached = |j6: f64| self.place(j6).is_ok();
        let end = |mut inside: f64, mut outside: f64| {
            for _ in 0..60 {
                let middle = inside.midpoint(outside);
                if is_reached(middle) { inside = middle } else { outside = middle }
            }
            inside
        };
        match (is_reached(low), is_reached(high)) {
            (true, false) => Interval::new(low, end(low, high)),
            (false, true) => Interval::new(end(high, low), high),
            _ => Interval::new(low, high),
        }
    }

    /// Returns a solution in an interval if g has different signs at its ends.
    fn crossing(&self, Interval { mut low, mut high }: Interval) -> Option<Candidate> {
        let is_negative = |j6: f64| self.place(j6).map(|place| place.error() < 0.0).ok();
        let before = is_negative(low)?;
        if is_negative(high)? == before {
            return None;
        }
        for _ in 0..60 {
            let middle = low.midpoint(high);
            if is_negative(middle)? == before { low = middle } else { high = middle }
        }
        self.place(low).ok()
    }

    /// Returns g and its slope for J6 in an interval; `None` if the arm reaches none of the wrist centres.
    fn enclose(&self, j6: Interval) -> Option<Enclosure> {
        let Self { arm, frame, posture, .. } = self;
        let (sine, cosine) = Enclosure::sin_cos(j6);
        let axis = frame.rotation.map(|row| sine * row[0] + cosine * row[1]);
        let [x, y, z] = [0, 1, 2].map(|i| axis[i] * -arm.b6 + (frame.position[i] - arm.d6 * frame.rotation[i][2]));

        // the direction in which the arm reaches, and the wrist centre in the vertical plane through the shoulder
        let across = x.squared() + y.squared();
        let side = if posture & LEFTY != 0 { 1.0 } else { -1.0 };
        let reach = (across + -arm.b4 * arm.b4).sqrt()? * side;
        let scale = across.reciprocal();
        let ahead = [(reach * x + y * arm.b4) * scale, (reach * y - x * arm.b4) * scale].map(Enclosure::of_unit);
        let (reach, height) = (reach + -arm.a1, z + -arm.d1);

        // the triangle of shoulder, elbow and wrist centre, times the distance of shoulder and wrist centre
        let forearm = arm.d4 * arm.d4 + arm.a3 * arm.a3;
        let distance = reach.squared() + height.squared();
        let along = (distance + (forearm - arm.a2 * arm.a2)) * 0.5;
        let bend = if (posture & BELOW != 0) == (posture & LEFTY != 0) { -1.0 } else { 1.0 };
        let aside = (distance * forearm - along.squared()).sqrt()? * bend;
        let scale = distance.reciprocal() * (1.0 / forearm);
        let (out, up) = ((along * reach + aside * height) * scale, (along * height - aside * reach) * scale);
        let out_of_axis = |a: Enclosure, b: Enclosure| (a * arm.d4 + b * arm.a3).of_unit();
        let direction = [out_of_axis(out, up * -1.0), out_of_axis(up, out)];
        Some((axis[0] * ahead[0] + axis[1] * ahead[1]) * direction[0] + axis[2] * direction[1])
    }

    /// Returns the arm with this J6, in radians.
    fn place(&self, j6: f64) -> Result<Candidate, OutOfReach> {
        let axis = Vertical::wrist_axis(self.frame, j6);
        let arm = self.arm.arm(self.arm.wrist_centre(self.frame, j6), self.posture, self.near)?;
        let ((sine1, cosine1), (sine, cosine)) = (arm[0].sin_cos(), (arm[1] + arm[2]).sin_cos());
        Ok(Candidate { j6, arm, axis, forearm: [cosine1 * sine, sine1 * sine, cosine] })
    }

    /// Returns the joints, in degrees, within ±180, unless the wrist is in the other posture.
    fn joints(&self, place: &Candidate) -> Option<Joints> {
        let forearm = Vertical::forearm_rotation(place.arm);
        let flange = multiply(&transpose(&forearm), &self.frame.rotation);
        // Rz(J4) Ry(J5)
        let wrist = multiply(&flange, &rz_matrix(-place.j6.to_degrees()));
        let (j4, j5) = ((-wrist[0][1]).atan2(wrist[1][1]), (-wrist[2][0]).atan2(wrist[2][2]));
        let fits = j5.abs() < SINGULAR || (j5 > 0.0) == (self.posture & NONFLIP != 0);
        let [j1, j2, j3] = place.arm;
        fits.then(|| [j1, j2, j3, j4, j5, normal(place.j6)].map(f64::to_degrees))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kinematics::Links;
    use crate::model::Profile;

    /// The parts are of a turn, or of the ranges of the joints.
    fn encloses(
        profile: Profile,
        parts: [f64; 6],
        posture: u8,
        (middle, half): (f64, f64),
    ) -> Result<(), TestCaseError> {
        let geometry = profile.model().geometry;
        let Links::Vertical(arm) = &geometry.links else { unreachable!("it has six axes") };
        let joints: Joints = std::array::from_fn(|n| {
            let (low, high) = geometry.ranges[n];
            low + (high - low) * parts[n]
        });
        let frame = arm.forward(&joints);
        let search = Search { arm, frame: &frame, posture, near: &joints };
        let j6 = Interval::new(middle - half, middle + half);
        let enclosed = search.enclose(j6);
        let mut before: Option<(f64, f64)> = None;
        for n in 0..=20 {
            let place = j6.low + j6.width() * f64::from(n) / 20.0;
            // the end of the reach, where both round
            let Ok(error) = search.place(place).map(|place| place.error()) else {
                before = None;
                continue;
            };
            let Some(Enclosure { value, slope }) = enclosed else {
                prop_assert!(search.enclose(Interval::point(place)).is_none(), "{place} is reached");
                continue;
            };
            let rounding = 1e-7;
            prop_assert!(
                (value.low - rounding..=value.high + rounding).contains(&error),
                "{error} is not in {value:?}"
            );
            if let Some((last, last_error)) = before {
                let mean = (error - last_error) / (place - last);
                let rounding = 1e-9 / (place - last) + rounding * mean.abs();
                prop_assert!(
                    (slope.low - rounding..=slope.high + rounding).contains(&mean),
                    "{mean} is not in {slope:?}"
                );
            }
            before = Some((place, error));
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn values_and_slopes_are_enclosed(
            parts in prop::array::uniform6(0.001..0.999),
            posture in 0_u8..4,
            middle in -PI..PI,
            exponent in -6.0..0.3,
        ) {
            for profile in [Profile::Cobotta, Profile::CobottaPro] {
                encloses(profile, parts, posture, (middle, 10_f64.powf(exponent)))?;
            }
        }
    }
}
