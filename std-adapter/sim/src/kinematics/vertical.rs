//! Arms of six axes: four lengths in a vertical plane, a wrist, and offsets beside the plane.

use super::frame::{Frame, Joints, Matrix, OutOfReach, SINGULAR, multiply, normal, ry_matrix, rz_matrix, transpose};

pub(super) const LEFTY: u8 = 1;
const BELOW: u8 = 2;
const NONFLIP: u8 = 4;

/// The intervals in which J6 of an arm with an offset wrist is searched.
const INTERVALS: u32 = 180;

/// An error of J6 below this, in radians, is rounding.
const EXACT: f64 = 1e-10;

/// The lengths of an arm of six axes, in mm. The documentation of [`kinematics`](super) has a drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertical {
    /// Base to the shoulder axis J2.
    pub d1: f64,
    /// Shoulder axis J2 before the axis of J1.
    pub a1: f64,
    /// Upper arm, J2 to J3.
    pub a2: f64,
    /// Forearm axis beside the elbow axis.
    pub a3: f64,
    /// Forearm, J3 to the wrist centre.
    pub d4: f64,
    /// Forearm axis J4 beside the plane of the arm, along y.
    pub b4: f64,
    /// Flange axis J6 beside the forearm axis, along y. Other than 0, the wrist is not spherical.
    pub b6: f64,
    /// Wrist centre to the flange.
    pub d6: f64,
}

impl Vertical {
    pub(super) fn forward(&self, joints: &Joints) -> Frame {
        let [j1, j2, j3, j4, j5, j6] = *joints;
        let base = rz_matrix(j1);
        let upper_arm = multiply(&base, &ry_matrix(j2));
        let forearm = multiply(&base, &ry_matrix(j2 + j3));
        let wrist = multiply(&multiply(&forearm, &rz_matrix(j4)), &ry_matrix(j5));
        let position = [0, 1, 2].map(|i| {
            let shoulder = if i == 2 { self.d1 } else { 0.0 };
            shoulder
                + self.a1 * base[i][0]
                + self.a2 * upper_arm[i][2]
                + self.a3 * forearm[i][0]
                + self.b4 * forearm[i][1]
                + self.d4 * forearm[i][2]
                + self.b6 * wrist[i][1]
                + self.d6 * wrist[i][2]
        });
        Frame { position, rotation: multiply(&wrist, &rz_matrix(j6)) }
    }

    /// Returns the posture of the joints: shoulder, elbow and wrist.
    pub(super) fn posture(&self, joints: &Joints) -> u8 {
        let [_, j2, j3, _, j5, _] = *joints;
        let bend = self.elbow_bend(j3);
        // the distance of the wrist centre from the axis of J1, negative behind it
        let reach = self.a1 + self.a2 * j2.to_radians().sin() + self.forearm_length() * (j2.to_radians() + bend).sin();
        let lefty = reach >= -SINGULAR;
        let below = if lefty { bend < 0.0 } else { bend > 0.0 };
        let bit = |on: bool, bit: u8| if on { bit } else { 0 };
        bit(lefty, LEFTY) | bit(below, BELOW) | bit(j5 >= 0.0, NONFLIP)
    }

    /// Returns the joints for a frame of the flange in a posture, each within ±180 degrees.
    ///
    /// At a singularity, an undefined joint keeps its value of `near`. An arm with an offset wrist may have several solutions
    /// in one posture: the first that `accept` accepts counts.
    pub(super) fn inverse(
        &self,
        frame: &Frame,
        posture: u8,
        near: &Joints,
        accept: &dyn Fn(&Joints) -> bool,
    ) -> Result<Joints, OutOfReach> {
        let degrees = |joints: Joints| joints.map(f64::to_degrees);
        if self.b6 == 0.0 {
            // the wrist is spherical: its centre does not depend on J6
            return self.with_sixth(frame, 0.0, posture, near).map(degrees);
        }
        let start = near[5].to_radians();
        let followed = self.follow(frame, posture, near, start).map(degrees).filter(accept);
        if let Some(joints) = followed {
            return Ok(joints);
        }
        let found: Vec<Joints> = self.search(frame, posture, near, start).into_iter().map(degrees).collect();
        match found.iter().find(|joints| accept(joints)).or(found.first()) {
            Some(joints) => Ok(*joints),
            // the axis that cannot reach with J6 as it is, or else the elbow
            None => Err(self.with_sixth(frame, start, posture, near).err().unwrap_or(OutOfReach(3))),
        }
    }

    /// Finds the joints by the secant method from a value of J6, in radians.
    fn follow(&self, frame: &Frame, posture: u8, near: &Joints, start: f64) -> Option<Joints> {
        let (mut before, mut here) = (start + 1e-3, start);
        let mut error_before = normal(self.with_sixth(frame, before, posture, near).ok()?[5] - before);
        for _ in 0..12 {
            let joints = self.with_sixth(frame, here, posture, near).ok()?;
            let error = normal(joints[5] - here);
            if error.abs() < EXACT {
                return Some(joints);
            }
            let slope = (error - error_before) / (here - before);
            if slope == 0.0 || !slope.is_finite() {
                return None;
            }
            (before, error_before) = (here, error);
            // a far step is a guess: the search is better
            here -= Some(error / slope).filter(|step| step.abs() < 0.5)?;
        }
        None
    }

    /// Finds the solutions, that with J6 nearest to `start`, in radians, first: a change of sign of its error, then bisection.
    fn search(&self, frame: &Frame, posture: u8, near: &Joints, start: f64) -> Vec<Joints> {
        let error = |j6: f64| self.with_sixth(frame, j6, posture, near).ok().map(|joints| normal(joints[5] - j6));
        // a turn, and an interval more at each end, so that a solution at half a turn is between two places, too
        let place = |n: u32| start + ((f64::from(n) - 1.0) / f64::from(INTERVALS) - 0.5) * std::f64::consts::TAU;
        // the places where the error is known: with the places up to which the arm stretches, and the least errors between
        let mut places: Vec<(f64, f64)> = Vec::new();
        let mut last = error(place(0));
        for n in 1..=INTERVALS + 2 {
            let (low, high, next) = (place(n - 1), place(n), error(place(n)));
            places.extend(last.map(|error| (low, error)));
            let edge = match (last, next) {
                (Some(_), None) => Some(edge(&error, low, high)),
                (None, Some(_)) => Some(edge(&error, high, low)),
                _ => None,
            };
            places.extend(edge.and_then(|edge| Some((edge, error(edge)?))));
            last = next;
        }
        let dips: Vec<_> = places.windows(3).filter_map(|three| dip(&error, three)).collect();
        places.extend(dips);
        places.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let crosses = |pair: &&[(f64, f64)]| {
            let ((_, a), (_, b)) = (pair[0], pair[1]);
            // an error that jumps by a turn changes its sign, too
            (a < 0.0) != (b < 0.0) && (a - b).abs() < std::f64::consts::PI
        };
        let pairs = places.windows(2).filter(crosses);
        let found = pairs.filter_map(|pair| self.bisect(frame, posture, near, (pair[0].0, pair[1].0)));
        let mut found: Vec<(f64, Joints)> = found.collect();
        found.sort_by(|(a, _), (b, _)| (a - start).abs().total_cmp(&(b - start).abs()));
        found.into_iter().map(|(_, joints)| joints).collect()
    }

    /// Halves an interval of J6 until the joints are exact.
    fn bisect(&self, frame: &Frame, posture: u8, near: &Joints, (low, high): (f64, f64)) -> Option<(f64, Joints)> {
        let error = |j6: f64| self.with_sixth(frame, j6, posture, near).ok().map(|joints| normal(joints[5] - j6));
        let (mut low, mut high, rising) = (low, high, error(low)? < 0.0);
        for _ in 0..60 {
            let middle = low.midpoint(high);
            if (error(middle)? < 0.0) == rising { low = middle } else { high = middle }
        }
        let joints = self.with_sixth(frame, low, posture, near).ok()?;
        (normal(joints[5] - low).abs() < EXACT).then_some((low, joints))
    }

    /// Returns the joints, in radians, if J6 had this value, which decides only where the wrist centre is.
    fn with_sixth(&self, frame: &Frame, j6: f64, posture: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        let r = &frame.rotation;
        let (sine, cosine) = j6.sin_cos();
        let centre = [0, 1, 2].map(|i| {
            let along_y = if self.b6 == 0.0 { 0.0 } else { self.b6 * (r[i][0] * sine + r[i][1] * cosine) };
            frame.position[i] - self.d6 * r[i][2] - along_y
        });
        let lefty = posture & LEFTY != 0;
        let (j1, reach) = self.base_angle(centre, lefty, near[0].to_radians())?;
        let (j2, j3) = self.arm_angles(reach - self.a1, centre[2] - self.d1, (posture & BELOW != 0) != lefty)?;
        let arm = multiply(&rz_matrix(j1.to_degrees()), &ry_matrix((j2 + j3).to_degrees()));
        let [j4, j5, j6] = wrist_angles(&multiply(&transpose(&arm), r), posture & NONFLIP != 0, near[3].to_radians());
        Ok([j1, j2, j3, j4, j5, j6])
    }

    /// Returns J1, and the distance of the wrist centre from the axis of J1 in the plane of the arm.
    fn base_angle(&self, centre: [f64; 3], lefty: bool, near: f64) -> Result<(f64, f64), OutOfReach> {
        let distance = centre[0].hypot(centre[1]);
        if distance + SINGULAR < self.b4.abs() {
            return Err(OutOfReach(1));
        }
        let reach = (distance * distance - self.b4 * self.b4).max(0.0).sqrt() * if lefty { 1.0 } else { -1.0 };
        if distance < SINGULAR {
            return Ok((near, reach));
        }
        Ok((normal(centre[1].atan2(centre[0]) - self.b4.atan2(reach)), reach))
    }

    /// Solves the triangle of shoulder, elbow and wrist centre for J2 and J3, in the plane of the arm.
    fn arm_angles(&self, reach: f64, height: f64, bend_positive: bool) -> Result<(f64, f64), OutOfReach> {
        let length = self.forearm_length();
        let cosine = (reach * reach + height * height - self.a2 * self.a2 - length * length) / (2.0 * self.a2 * length);
        // the elbow cannot stretch or fold further
        if !(-1.0 - SINGULAR..=1.0 + SINGULAR).contains(&cosine) {
            return Err(OutOfReach(3));
        }
        let angle = cosine.clamp(-1.0, 1.0).acos();
        let bend = if bend_positive { angle } else { -angle };
        let j2 = reach.atan2(height) - (length * bend.sin()).atan2(self.a2 + length * bend.cos());
        Ok((normal(j2), bend - self.a3.atan2(self.d4)))
    }

    /// The distance from the elbow to the wrist centre, in the plane of the arm.
    fn forearm_length(&self) -> f64 {
        self.d4.hypot(self.a3)
    }

    /// The angle between the upper arm and the line from the elbow to the wrist centre.
    pub(super) fn elbow_bend(&self, j3: f64) -> f64 {
        j3.to_radians() + self.a3.atan2(self.d4)
    }
}

/// Returns the last place in reach between one in reach and one out of it.
fn edge(error: &impl Fn(f64) -> Option<f64>, mut inside: f64, mut outside: f64) -> f64 {
    for _ in 0..50 {
        let middle = inside.midpoint(outside);
        if error(middle).is_some() { inside = middle } else { outside = middle }
    }
    inside
}

/// Returns the place of the least error about the middle of three, if the error does not change its sign at them but there.
fn dip(error: &impl Fn(f64) -> Option<f64>, three: &[(f64, f64)]) -> Option<(f64, f64)> {
    let [(low, a), (_, b), (high, c)] = three else { return None };
    let (mut low, mut high, negative) = (*low, *high, *b < 0.0);
    if (*a < 0.0) != negative || (*c < 0.0) != negative || b.abs() > a.abs() || b.abs() > c.abs() {
        return None;
    }
    for _ in 0..40 {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        let (at_left, at_right) = (error(left)?, error(right)?);
        if (at_left < 0.0) != negative {
            return Some((left, at_left));
        }
        if at_left.abs() < at_right.abs() { high = right } else { low = left }
    }
    None
}

/// Solves `Rz(J4) Ry(J5) Rz(J6)`.
fn wrist_angles(r: &Matrix, nonflip: bool, near_j4: f64) -> [f64; 3] {
    let sine = r[0][2].hypot(r[1][2]);
    if sine < SINGULAR {
        // J4 and J6 turn about parallel lines: J4 stays, J6 turns by the rest
        let (j5, sum) = if r[2][2] > 0.0 {
            (0.0, r[1][0].atan2(r[0][0]))
        } else {
            (std::f64::consts::PI, (-r[1][0]).atan2(-r[0][0]))
        };
        let j4 = normal(near_j4);
        return [j4, j5, normal(if j5 == 0.0 { sum - j4 } else { j4 - sum })];
    }
    let s = if nonflip { 1.0 } else { -1.0 };
    [(s * r[1][2]).atan2(s * r[0][2]), (s * sine).atan2(r[2][2]), (s * r[2][1]).atan2(-s * r[2][0])]
}
