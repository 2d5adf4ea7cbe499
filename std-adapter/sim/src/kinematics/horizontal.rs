//! Arms of four axes (SCARA): two links in a horizontal plane, a vertical axis J3, and J4 that turns the flange about it.

use serde::Serialize;

use super::frame::{Frame, Joints, OutOfReach, SINGULAR, normal, rz_matrix};
use super::vertical::LEFTY;

/// A flange is upright if its axis leans by less than this, in radians.
const UPRIGHT: f64 = 1e-6;

/// The lengths of an arm of four axes, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Horizontal {
    /// Base to the flange, with J3 at 0.
    pub d1: f64,
    /// First link, J1 to J2.
    pub a1: f64,
    /// Second link, J2 to J3.
    pub a2: f64,
}

impl Horizontal {
    pub(super) fn forward(&self, joints: &Joints) -> Frame {
        let [j1, j2, j3, j4, ..] = *joints;
        let (first, second) = (j1.to_radians().sin_cos(), (j1 + j2).to_radians().sin_cos());
        let position = [self.a1 * first.1 + self.a2 * second.1, self.a1 * first.0 + self.a2 * second.0, self.d1 + j3];
        Frame { position, rotation: rz_matrix(j1 + j2 + j4) }
    }

    /// Returns the posture of the joints: LEFTY, or 0.
    pub(super) fn posture(joints: &Joints) -> u8 {
        if joints[1] < 0.0 { LEFTY } else { 0 }
    }

    /// Returns the joints for a frame of the flange in a posture; J1, J2 and J4 are within ±180 degrees.
    pub(super) fn inverse(&self, frame: &Frame, posture: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        let (r, [x, y, z]) = (&frame.rotation, frame.position);
        if r[0][2].hypot(r[1][2]) > UPRIGHT || r[2][2] < 0.0 {
            // only an axis that this arm lacks could tilt the flange
            return Err(OutOfReach::Unreachable);
        }
        let cosine = (x * x + y * y - self.a1 * self.a1 - self.a2 * self.a2) / (2.0 * self.a1 * self.a2);
        if !(-1.0 - SINGULAR..=1.0 + SINGULAR).contains(&cosine) {
            return Err(OutOfReach::Unreachable);
        }
        let angle = cosine.clamp(-1.0, 1.0).acos();
        let j2 = if posture & LEFTY == 0 { angle } else { -angle };
        let j1 = if x.hypot(y) < SINGULAR {
            near[0].to_radians()
        } else {
            normal(y.atan2(x) - (self.a2 * j2.sin()).atan2(self.a1 + self.a2 * j2.cos()))
        };
        let j4 = normal(r[1][0].atan2(r[0][0]) - j1 - j2);
        Ok([j1.to_degrees(), j2.to_degrees(), z - self.d1, j4.to_degrees(), 0.0, 0.0])
    }
}
