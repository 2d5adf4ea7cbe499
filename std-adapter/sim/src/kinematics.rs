//! The kinematics of arms: the frame of the flange for given joints, and the joints for a given frame.
//!
//! # Six axes
//!
//! With all joints at 0 the arm points straight up. The dimensions are of the default arm, in mm; a
//! [model](crate::model) may have others.
//!
//! ```text
//!            z                          d1  345   base to the shoulder axis J2
//!            |   J3 o===d4===(J4)=o J5  a2  250   upper arm, J2 to J3
//!            |     /|a3           |     a3  -10   offset of the forearm axis from the elbow axis (above it, with J3 = 90)
//!            |  a2/               | d6  d4  255   forearm, J3 to the wrist centre
//!            |   /                v     d6   70   wrist centre to the flange
//!         J2 o--/               flange
//!            | d1                       a1    0   shoulder axis J2 before the axis of J1
//!         ---+--- J1 ------> x          b4    0   offset of the forearm axis from this plane, along y
//!                                       b6    0   offset of the flange axis from the forearm axis, along y
//!
//!   flange = Rz(J1) Ry(J2 + J3) Rz(J4) Ry(J5) Rz(J6),   position through the same chain
//! ```
//!
//! The default arm has the lengths of a small arm of this maker, chosen to match the pair of pose and joints in the
//! guide's slvMove example: joints (0, 45, 90, 0, 45, 0) are the pose (364.16, 0, 278.5355, 180, 0, 180, Fig 5). That
//! example fixes a2 + d4 - a3 and d1 - d6 + (a2 - d4 - a3) / √2, not each length. Ranges and speeds of its joints are
//! decisions. [Other arms](crate::model::ArmProfile) have the lengths, ranges and speeds of public descriptions.
//!
//! Without b6 the wrist is spherical, and the joints are solved in closed form. With b6, as in COBOTTA and COBOTTA PRO, the
//! wrist centre depends on J6: J6 is found by the secant method from the current joints, or all its values by a search.
//!
//! Fig is a sum of: 1 the shoulder reaches forward (LEFTY), 2 the elbow is below (BELOW), 4 the wrist is not flipped
//! (NONFLIP: J5 >= 0), 8 J4 is beyond ±180 (DOUBLE4), 16 J6 is beyond ±180 (DOUBLE6). That NONFLIP, ABOVE and LEFTY
//! make 5 is shown in the guide; the bits 8 and 16 have the names and the order of the maker's manuals.
//!
//! # Four axes
//!
//! ```text
//!          a1          a2                d1  base to the flange, with J3 at 0
//!   J1 o---------J2 o-------o J3, J4     all joints 0 stretch the arm along x
//!                           | flange
//!
//!   x, y = a1 (J1) + a2 (J1 + J2),   z = d1 + J3,   RZ = J1 + J2 + J4,   RX = RY = 0
//! ```
//!
//! With J1 to J4 at 0, the axes of the flange equal the axes of the base, as in the public description of an HSR: z
//! points up. A pose that tilts the flange is out of reach. Fig is a sum of: 1 LEFTY (J2 < 0), 16 J4 is beyond ±180
//! (DOUBLE), as the maker's manual of RC8 has it: "RIGHTY" is an elbow at the positive side.
//!
//! Poses are of the tool centre point in work coordinates, which without definitions are the flange and the base.

mod frame;
mod horizontal;
mod interval;
mod offset;
mod vertical;

use serde::Serialize;

pub use self::frame::Joints;
pub(crate) use self::frame::{Frame, OutOfReach, cross, dot, unit};
pub use self::horizontal::Horizontal;
pub use self::vertical::Vertical;

/// J1 to J8; an axis that the arm lacks is 0.
pub(crate) type Axes = [f64; 8];

/// The number of axes: J1 to J6, and the extended ones.
const AXES: usize = 8;

/// The dimensions, ranges and speeds of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// The kind of the arm, and its lengths.
    pub links: Links,
    /// The ranges of J1 to J8, in degrees or mm.
    pub ranges: [(f64, f64); AXES],
    /// The largest speeds of J1 to J8, in degrees or mm per second.
    pub speeds: [f64; AXES],
    /// The time in which each axis reaches its largest speed, in seconds: its largest acceleration.
    pub acceleration_time: f64,
}

/// The kind of an arm, and its lengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
#[non_exhaustive]
pub enum Links {
    /// Six axes.
    Vertical(Vertical),
    /// Four axes (SCARA).
    Horizontal(Horizontal),
}

/// The ranges of J1 to J6 of the default arm, in degrees.
pub const RANGES: [(f64, f64); 6] =
    [(-170.0, 170.0), (-120.0, 120.0), (-120.0, 150.0), (-270.0, 270.0), (-120.0, 120.0), (-360.0, 360.0)];

/// The largest speeds of J1 to J6 of the default arm, in degrees per second.
pub const SPEEDS: Joints = [375.0, 330.0, 405.0, 450.0, 450.0, 720.0];

/// The default range of an extended axis (J7, J8) to either side, in degrees or mm.
pub const EXTENDED_RANGE: f64 = 1000.0;

/// The default largest speed of an extended axis (J7, J8), in degrees or mm per second.
pub const EXTENDED_SPEED: f64 = 500.0;

/// The time in which an axis of the default arm reaches its largest speed, in seconds.
pub const ACCELERATION_TIME: f64 = 0.2;

impl Geometry {
    /// The default arm.
    pub const DEFAULT: Self = {
        let ([r1, r2, r3, r4, r5, r6], extended) = (RANGES, (-EXTENDED_RANGE, EXTENDED_RANGE));
        let [s1, s2, s3, s4, s5, s6] = SPEEDS;
        Self {
            links: Links::Vertical(Vertical {
                d1: 345.0,
                a1: 0.0,
                a2: 250.0,
                a3: -10.0,
                d4: 255.0,
                b4: 0.0,
                b6: 0.0,
                d6: 70.0,
            }),
            ranges: [r1, r2, r3, r4, r5, r6, extended, extended],
            speeds: [s1, s2, s3, s4, s5, s6, EXTENDED_SPEED, EXTENDED_SPEED],
            acceleration_time: ACCELERATION_TIME,
        }
    };
}

/// Shoulder, elbow and wrist in a Fig.
const POSTURE: u8 = 7;
const DOUBLE4: u8 = 8;
const DOUBLE6: u8 = 16;
/// J4 of an arm of four axes is beyond ±180.
const DOUBLE: u8 = 16;

impl Geometry {
    /// Returns the largest accelerations of J1 to J8, in degrees or mm per second squared.
    pub(crate) fn accelerations(&self) -> Axes {
        self.speeds.map(|speed| speed / self.acceleration_time)
    }

    /// Returns the number of joints: 4 or 6.
    pub(crate) const fn joints(&self) -> usize {
        match self.links {
            Links::Vertical(_) => 6,
            Links::Horizontal(_) => 4,
        }
    }

    /// Returns the frame of the flange for these joints.
    pub(crate) fn forward(&self, joints: &Joints) -> Frame {
        match &self.links {
            Links::Vertical(links) => links.forward(joints),
            Links::Horizontal(links) => links.forward(joints),
        }
    }

    /// Returns the Fig of the joints.
    pub(crate) fn figure(&self, joints: &Joints) -> u8 {
        let [_, _, _, j4, _, j6] = *joints;
        let bit = |angle: f64, bit: u8| if angle.abs() > 180.0 { bit } else { 0 };
        match &self.links {
            Links::Vertical(links) => links.posture(joints) | bit(j4, DOUBLE4) | bit(j6, DOUBLE6),
            Links::Horizontal(_) => Horizontal::posture(joints) | bit(j4, DOUBLE),
        }
    }

    /// Returns whether J4 and J6 of an arm of six axes are in line.
    pub(crate) const fn is_singular(&self, joints: &Joints) -> bool {
        const IN_LINE: f64 = 1e-6;
        matches!(self.links, Links::Vertical(_)) && joints[4].abs() < IN_LINE
    }

    /// Returns whether two Figs have the same shoulder, elbow and wrist, as far as the arm has them.
    pub(crate) const fn same_posture(&self, a: u8, b: u8) -> bool {
        let bits = match self.links {
            Links::Vertical(_) => POSTURE,
            Links::Horizontal(_) => vertical::LEFTY,
        };
        (a ^ b) & bits == 0
    }

    /// Moves a frame of the tool away from its pose by a distance in mm, as Depart does: against the approach vector, the z of
    /// the flange, or for four axes along it.
    pub(crate) fn withdraw(&self, frame: &Frame, distance: f64) -> Frame {
        match self.links {
            Links::Vertical(_) => frame.withdrawn(distance),
            Links::Horizontal(_) => frame.withdrawn(-distance),
        }
    }

    /// Returns the joints for a frame of the flange in the posture `fig`.
    ///
    /// At a singularity, an undefined joint keeps its value of `near`.
    pub(crate) fn inverse(&self, frame: &Frame, fig: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        let joints = match &self.links {
            Links::Vertical(links) if links.b6 == 0.0 => links.inverse(frame, fig, near),
            // of several solutions in one posture, one within the ranges
            Links::Vertical(links) => {
                offset::inverse(links, frame, fig, near, &|joints| self.turned(joints, fig, near).is_ok())
            }
            Links::Horizontal(links) => links.inverse(frame, fig, near),
        }?;
        self.turned(&joints, fig, near)
    }

    /// Returns the joints for a frame of the flange with the least turning from `near`, in any posture.
    pub(crate) fn inverse_nearest(&self, frame: &Frame, near: &Joints) -> Result<Joints, OutOfReach> {
        // a search for J6 in each posture is slow; along a path the posture stays
        const NEAR: f64 = 30.0;
        let turning = |joints: &Joints| joints.iter().zip(near).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if let Links::Vertical(Vertical { b6, .. }) = self.links
            && b6 != 0.0
            && let Ok(joints) = self.inverse(frame, self.figure(near), near)
            && turning(&joints) <= NEAR
        {
            return Ok(joints);
        }
        let mut best: Result<(f64, Joints), OutOfReach> = Err(OutOfReach::Unreachable);
        for fig in (0..32).filter(|fig| self.may_have(*fig)) {
            match (self.inverse(frame, fig, near), &best) {
                (Ok(joints), best_so_far) => {
                    let turning = turning(&joints);
                    if best_so_far.is_err() || best_so_far.is_ok_and(|(least, _)| turning < least) {
                        best = Ok((turning, joints));
                    }
                }
                // an axis beyond its limit says more than a frame out of reach
                (Err(error), Err(OutOfReach::Unreachable)) => best = Err(error),
                (Err(_), _) => {}
            }
        }
        best.map(|(_, joints)| joints)
    }

    /// Returns whether the ranges permit that J4 and J6 are beyond ±180, where the Fig says so.
    fn may_have(&self, fig: u8) -> bool {
        let beyond = |axis: usize| self.ranges[axis].0 < -180.0 || self.ranges[axis].1 > 180.0;
        match self.links {
            Links::Vertical(_) => (fig & DOUBLE4 == 0 || beyond(3)) && (fig & DOUBLE6 == 0 || beyond(5)),
            Links::Horizontal(_) => fig & !(vertical::LEFTY | DOUBLE) == 0 && (fig & DOUBLE == 0 || beyond(3)),
        }
    }

    /// Turns J4 and J6 to the side that the Fig names and J1 to the side of `near`, and checks the ranges.
    fn turned(&self, joints: &Joints, fig: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        let beyond = |angle: f64, double: u8| match (fig & double != 0, angle > 0.0) {
            (false, _) => angle,
            (true, true) => angle - 360.0,
            (true, false) => angle + 360.0,
        };
        let [j1, j2, j3, j4, j5, j6] = *joints;
        let j1 = self.nearest_turn(j1, near[0]);
        let joints = match self.links {
            Links::Vertical(_) => [j1, j2, j3, beyond(j4, DOUBLE4), j5, beyond(j6, DOUBLE6)],
            Links::Horizontal(_) => [j1, j2, j3, beyond(j4, DOUBLE), j5, j6],
        };
        self.out_of_range(&joints).map_or(Ok(joints), Err)
    }

    /// Returns the value of J1 within its range that is nearest to `near` among those a full turn apart.
    fn nearest_turn(&self, j1: f64, near: f64) -> f64 {
        let (low, high) = self.ranges[0];
        let turns = [j1, j1 - 360.0, j1 + 360.0].into_iter().filter(|turn| (low..=high).contains(turn));
        turns.min_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs())).unwrap_or(j1)
    }

    /// Returns the axes whose value is NaN or outside its range. The slice has J1 to J6, or all axes.
    pub(crate) fn out_of_range(&self, axes: &[f64]) -> Option<OutOfReach> {
        // a pose computed at the end of a range may be beyond it through rounding
        const SLACK: f64 = 1e-6;
        let outside = |(place, (low, high)): (&f64, &(f64, f64))| !(*low - SLACK..=*high + SLACK).contains(place);
        let bits = axes.iter().zip(&self.ranges).map(outside).enumerate();
        let bits = bits.fold(0_u8, |bits, (axis, outside)| if outside { bits | 1 << axis } else { bits });
        (bits != 0).then_some(OutOfReach::Limits(bits))
    }
}

/// Returns J1 to J6.
pub(crate) fn six(axes: &Axes) -> Joints {
    let [j1, j2, j3, j4, j5, j6, ..] = *axes;
    [j1, j2, j3, j4, j5, j6]
}

/// Returns these joints with J7 and J8 of `rest`.
pub(crate) fn with_joints(joints: &Joints, rest: &Axes) -> Axes {
    let ([j1, j2, j3, j4, j5, j6], [.., j7, j8]) = (*joints, *rest);
    [j1, j2, j3, j4, j5, j6, j7, j8]
}

/// Rounds numbers to the resolution of a controller: 1e-6 mm or degrees.
pub(crate) fn measured<const N: usize>(numbers: [f64; N]) -> Vec<f64> {
    // + 0.0 makes 0 of -0
    numbers.iter().map(|n| (n * 1e6).round() / 1e6 + 0.0).collect()
}

/// Returns X Y Z RX RY RZ Fig.
pub(crate) fn pose_numbers(frame: &Frame, fig: u8) -> Vec<f64> {
    let [x, y, z, rx, ry, rz] = frame.to_xyz_rpy();
    measured([x, y, z, rx, ry, rz, f64::from(fig)])
}

/// Returns J1 to J8 of six joints; axes 7 and 8 are 0.
pub(crate) fn angle(joints: &Joints) -> Vec<f64> {
    measured(with_joints(joints, &[0.0; 8]))
}
#[cfg(test)]
mod tests;
