//! Arms of six axes: four lengths in a vertical plane, a wrist, and offsets from the plane.

use serde::Serialize;

use super::frame::{Frame, Joints, Matrix, OutOfReach, SINGULAR, multiply, normal, ry_matrix, rz_matrix, transpose};

pub(super) const LEFTY: u8 = 1;
pub(super) const BELOW: u8 = 2;
pub(super) const NONFLIP: u8 = 4;

/// The lengths of an arm of six axes, in mm. The documentation of [`kinematics`](super) has a drawing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Vertical {
    /// Base to the shoulder axis J2.
    pub d1: f64,
    /// Shoulder axis J2 before the axis of J1.
    pub a1: f64,
    /// Upper arm, J2 to J3.
    pub a2: f64,
    /// Offset of the forearm axis from the elbow axis.
    pub a3: f64,
    /// Forearm, J3 to the wrist centre.
    pub d4: f64,
    /// Offset of the forearm axis J4 from the plane of the arm, along y.
    pub b4: f64,
    /// Offset of the flange axis J6 from the forearm axis, along y. Unless it is 0, the wrist is not spherical.
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

    /// Returns the joints of an arm with a spherical wrist for a frame of the flange in a posture, each within ±180 degrees.
    ///
    /// At a singularity, an undefined joint keeps its value of `near`.
    pub(super) fn inverse(&self, frame: &Frame, posture: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        // the wrist centre does not depend on J6
        let arm = self.arm(self.wrist_centre(frame, 0.0), posture, near)?;
        let flange = multiply(&transpose(&Self::forearm_rotation(arm)), &frame.rotation);
        let ([j1, j2, j3], [j4, j5, j6]) = (arm, wrist_angles(&flange, posture & NONFLIP != 0, near[3].to_radians()));
        Ok([j1, j2, j3, j4, j5, j6].map(f64::to_degrees))
    }

    /// Returns the direction of the axis of J5 that the flange has with this J6, in radians.
    pub(super) fn wrist_axis(frame: &Frame, j6: f64) -> [f64; 3] {
        let (sine, cosine) = j6.sin_cos();
        frame.rotation.map(|row| row[0] * sine + row[1] * cosine)
    }

    /// Returns the wrist centre that the flange has with this J6, in radians.
    pub(super) fn wrist_centre(&self, frame: &Frame, j6: f64) -> [f64; 3] {
        let axis = Self::wrist_axis(frame, j6);
        [0, 1, 2].map(|i| frame.position[i] - self.d6 * frame.rotation[i][2] - self.b6 * axis[i])
    }

    /// Returns J1, J2 and J3, in radians, for a wrist centre.
    pub(super) fn arm(&self, centre: [f64; 3], posture: u8, near: &Joints) -> Result<[f64; 3], OutOfReach> {
        let lefty = posture & LEFTY != 0;
        let (j1, reach) = self.base_angle(centre, lefty, near[0].to_radians())?;
        let cosine = self.elbow_cosine(reach - self.a1, centre[2] - self.d1);
        // the elbow cannot stretch or fold further
        if !(-1.0 - SINGULAR..=1.0 + SINGULAR).contains(&cosine) {
            return Err(OutOfReach::Unreachable);
        }
        let angle = cosine.clamp(-1.0, 1.0).acos();
        let bend = if (posture & BELOW != 0) != lefty { angle } else { -angle };
        let (length, reach, height) = (self.forearm_length(), reach - self.a1, centre[2] - self.d1);
        let j2 = reach.atan2(height) - (length * bend.sin()).atan2(self.a2 + length * bend.cos());
        Ok([j1, normal(j2), bend - self.a3.atan2(self.d4)])
    }

    /// Returns the rotation of the forearm.
    pub(super) fn forearm_rotation([j1, j2, j3]: [f64; 3]) -> Matrix {
        multiply(&rz_matrix(j1.to_degrees()), &ry_matrix((j2 + j3).to_degrees()))
    }

    /// The distance of a wrist centre from the axis of J1 in the plane of the arm, negative behind it.
    fn reach(&self, centre: [f64; 3], lefty: bool) -> f64 {
        (centre[0] * centre[0] + centre[1] * centre[1] - self.b4 * self.b4).max(0.0).sqrt()
            * if lefty { 1.0 } else { -1.0 }
    }

    /// Returns J1, and the distance of the wrist centre from the axis of J1 in the plane of the arm.
    fn base_angle(&self, centre: [f64; 3], lefty: bool, near: f64) -> Result<(f64, f64), OutOfReach> {
        let distance = centre[0].hypot(centre[1]);
        if distance + SINGULAR < self.b4.abs() {
            return Err(OutOfReach::Unreachable);
        }
        let reach = self.reach(centre, lefty);
        if distance < SINGULAR {
            return Ok((near, reach));
        }
        Ok((normal(centre[1].atan2(centre[0]) - self.b4.atan2(reach)), reach))
    }

    /// Solves the triangle of shoulder, elbow and wrist centre for the cosine of the bend of the elbow.
    fn elbow_cosine(&self, reach: f64, height: f64) -> f64 {
        let length = self.forearm_length();
        (reach * reach + height * height - self.a2 * self.a2 - length * length) / (2.0 * self.a2 * length)
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
