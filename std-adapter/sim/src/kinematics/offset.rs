//! Arms of six axes with an offset wrist: all joints for a frame of the flange.
//!
//! The flange carries the axis of J5, and J6 turns it about the flange axis. So J6 decides where the wrist centre is, on a circle,
//! and thereby J1, J2 and J3. J6 is right if the axis of J5 is perpendicular to the forearm:
//!
//! ```text
//!   g(J6) = axis of J5 . direction of the forearm = 0
//! ```
//!
//! For one shoulder and one elbow, g is smooth on each arc of the circle that the arm reaches. At the end of an arc two elbows or
//! two shoulders meet, and the slope of g is infinite there. As a function of t, with J6 = middle - half cos t, g has a finite slope.
//! The arc is divided until neither direction turns by more than [`TURN`] within a part; such a part has at most one extremum of g.

use std::f64::consts::PI;

use super::frame::{Frame, Joints, OutOfReach, SINGULAR, dot, multiply, normal, rz_matrix, transpose};
use super::vertical::{NONFLIP, Vertical};

/// The cosine of the angle that a direction turns at most in one part of an arc: 17 degrees.
const TURN: f64 = 0.956;

/// How often a part is halved at most.
const HALVINGS: u32 = 30;

/// A value of g below this is rounding.
const EXACT: f64 = 1e-10;

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
        let mut found: Vec<Candidate> = self.arcs(start).into_iter().flat_map(|arc| self.on_arc(arc)).collect();
        found.sort_by(|a, b| (a.j6 - start).abs().total_cmp(&(b.j6 - start).abs()));
        found.iter().filter_map(|place| self.joints(place)).collect()
    }

    /// Returns the arcs of a turn of J6 about `start` that the arm reaches.
    fn arcs(&self, start: f64) -> Vec<(f64, f64)> {
        let centre = |j6: f64| self.arm.wrist_centre(self.frame, j6);
        let base = |j6: f64| self.arm.base_margin(centre(j6));
        let elbow = |j6: f64| self.arm.elbow_margin(centre(j6), self.posture);
        // both margins have few extrema in a turn
        let turn: Vec<f64> = (0..=36).map(|n| start + (f64::from(n) / 18.0 - 1.0) * PI).collect();
        let mut ends = [zeros(&base, &turn), zeros(&elbow, &turn)].concat();
        ends.extend([start - PI, start + PI]);
        ends.sort_by(f64::total_cmp);
        let arcs = ends.windows(2).map(|pair| (pair[0], pair[1]));
        arcs.filter(|(low, high)| self.place(low.midpoint(*high)).is_ok()).collect()
    }

    /// Returns the solutions on an arc.
    fn on_arc(&self, (low, high): (f64, f64)) -> Vec<Candidate> {
        let at = |t: f64| self.place(low.midpoint(high) - (high - low) / 2.0 * t.cos());
        let g = |t: f64| at(t).map_or(f64::NAN, |place| place.error());
        let mut parts = vec![0.0];
        for n in 0..12 {
            divide(&at, (f64::from(n) * PI / 12.0, f64::from(n + 1) * PI / 12.0), HALVINGS, &mut parts);
        }
        let zeros = zeros(&g, &parts).into_iter().filter_map(|t| at(t).ok());
        zeros.filter(|place| place.error().abs() < EXACT).collect()
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

/// Appends the ends of the parts into which an interval is divided.
fn divide(
    at: &impl Fn(f64) -> Result<Candidate, OutOfReach>,
    (low, high): (f64, f64),
    halvings: u32,
    parts: &mut Vec<f64>,
) {
    let is_far = |a: &Candidate, b: &Candidate| dot(a.axis, b.axis) < TURN || dot(a.forearm, b.forearm) < TURN;
    let middle = low.midpoint(high);
    if halvings > 0 && at(low).is_ok_and(|low| at(high).is_ok_and(|high| is_far(&low, &high))) {
        divide(at, (low, middle), halvings - 1, parts);
        divide(at, (middle, high), halvings - 1, parts);
    } else {
        parts.push(high);
    }
}

/// Returns the zeros of a function that has one extremum at most between two neighbouring places.
fn zeros(function: &impl Fn(f64) -> f64, places: &[f64]) -> Vec<f64> {
    let mut found = Vec::new();
    for pair in places.windows(2) {
        let (low, high) = (pair[0], pair[1]);
        let (a, b) = (function(low), function(high));
        if (a < 0.0) != (b < 0.0) {
            found.push(bisect(function, low, high));
        } else if let Some(dip) = dip(function, (low, a), (high, b)) {
            // the zeros on both sides are one zero if the function only touches 0
            found.extend([bisect(function, low, dip), bisect(function, high, dip)]);
        }
        found.extend((a.abs() < EXACT).then_some(low));
    }
    found.extend(places.last().filter(|last| function(**last).abs() < EXACT));
    found
}

/// Returns the place between two others of the same sign where the function has changed it, or is least.
fn dip(function: &impl Fn(f64) -> f64, (mut low, a): (f64, f64), (mut high, b): (f64, f64)) -> Option<f64> {
    let above = |place: f64| if a < 0.0 { -function(place) } else { function(place) };
    let step = (high - low) * 1e-4;
    if above(low + step) >= a.abs() || above(high - step) >= b.abs() {
        return None;
    }
    for _ in 0..60 {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        let (at_left, at_right) = (above(left), above(right));
        if at_left.min(at_right) < 0.0 {
            return Some(if at_left < 0.0 { left } else { right });
        }
        if at_left < at_right { high = right } else { low = left }
    }
    (above(low) < EXACT).then_some(low)
}

/// Returns a zero between two places with different signs.
fn bisect(function: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let negative = function(low) < 0.0;
    for _ in 0..60 {
        let middle = low.midpoint(high);
        if (function(middle) < 0.0) == negative { low = middle } else { high = middle }
    }
    low
}
