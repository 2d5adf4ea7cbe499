//! The kinematics of the arm: the frame of the flange for given joints, and the joints for a given frame.
//!
//! A vertical arm of six axes with a spherical wrist. All joints 0 stretches it straight up. The dimensions are those of the
//! default arm, in mm; a [model](crate::model) may have others.
//!
//! ```text
//!            z                          d1  345   base to the shoulder axis J2
//!            |   J3 o===d4===(J4)=o J5  a2  250   upper arm, J2 to J3
//!            |     /|a3           |     a3  -10   forearm axis beside the elbow axis (above it, with J3 = 90)
//!            |  a2/               | d6  d4  255   forearm, J3 to the wrist centre
//!            |   /                v     d6   70   wrist centre to the flange
//!         J2 o--/               flange
//!            | d1
//!         ---+--- J1 ------> x
//!
//!   flange = Rz(J1) Ry(J2 + J3) Rz(J4) Ry(J5) Rz(J6),   position through the same chain
//! ```
//!
//! The lengths are those of a small arm of this maker, chosen to match the pair of pose and joints in the guide's
//! slvMove example: joints (0, 45, 90, 0, 45, 0) are the pose (364.16, 0, 278.5355, 180, 0, 180,
//! Fig 5). That example fixes a2 + d4 - a3 and d1 - d6 + (a2 - d4 - a3) / √2, not each length. Ranges and speeds of
//! the joints are decisions of this model. Poses are of the tool centre point in work coordinates, which without
//! definitions are the flange and the base.
//!
//! Fig is a sum of: 1 the shoulder reaches forward (LEFTY), 2 the elbow is below (BELOW), 4 the wrist is not flipped
//! (NONFLIP: J5 >= 0), 8 J4 is beyond ±180 (DOUBLE4), 16 J6 is beyond ±180 (DOUBLE6). That NONFLIP, ABOVE and LEFTY
//! make 5 is shown in the guide; the bits 8 and 16 have the names and the order of the maker's manuals.

use bcap_core::hresult::HResult;

/// J1 to J6, in degrees.
pub type Joints = [f64; 6];

/// J1 to J8; an axis that the arm lacks is 0.
pub(crate) type Axes = [f64; 8];

/// The number of axes: J1 to J6, and the extended ones.
const AXES: usize = 8;

/// The dimensions, ranges and speeds of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Base to the shoulder axis J2, in mm.
    pub d1: f64,
    /// Upper arm, J2 to J3, in mm.
    pub a2: f64,
    /// Forearm axis beside the elbow axis, in mm.
    pub a3: f64,
    /// Forearm, J3 to the wrist centre, in mm.
    pub d4: f64,
    /// Wrist centre to the flange, in mm.
    pub d6: f64,
    /// The ranges of J1 to J8, in degrees or mm.
    pub ranges: [(f64, f64); AXES],
    /// The largest speeds of J1 to J8, in degrees or mm per second.
    pub speeds: [f64; AXES],
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

impl Geometry {
    /// The default arm.
    pub const DEFAULT: Self = {
        let ([r1, r2, r3, r4, r5, r6], extended) = (RANGES, (-EXTENDED_RANGE, EXTENDED_RANGE));
        let [s1, s2, s3, s4, s5, s6] = SPEEDS;
        Self {
            d1: 345.0,
            a2: 250.0,
            a3: -10.0,
            d4: 255.0,
            d6: 70.0,
            ranges: [r1, r2, r3, r4, r5, r6, extended, extended],
            speeds: [s1, s2, s3, s4, s5, s6, EXTENDED_SPEED, EXTENDED_SPEED],
        }
    };
}

/// A sine below this counts as zero: two wrist axes are in line, or the wrist centre is over J1.
const SINGULAR: f64 = 1e-9;

const LEFTY: u8 = 1;
const BELOW: u8 = 2;
const NONFLIP: u8 = 4;
const DOUBLE4: u8 = 8;
const DOUBLE6: u8 = 16;

/// A 3x3 rotation, by rows.
type Matrix = [[f64; 3]; 3];

/// The position and orientation of the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    /// In mm.
    pub(crate) position: [f64; 3],
    rotation: Matrix,
}

/// A pose out of reach: the axis, 1 to 8, that would leave its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct OutOfReach(pub(crate) u8);

impl OutOfReach {
    /// Returns the error of the controller.
    pub(crate) fn code(self) -> HResult {
        HResult::from_u32(0x8320_4070 + u32::from(self.0))
    }
}

impl Frame {
    /// Makes a frame from X Y Z in mm and RX RY RZ in degrees: turned about the fixed axes x, then y, then z.
    pub(crate) fn from_xyz_rpy(p: [f64; 6]) -> Self {
        let [x, y, z, rx, ry, rz] = p;
        Self { position: [x, y, z], rotation: multiply(&rz_matrix(rz), &multiply(&ry_matrix(ry), &rx_matrix(rx))) }
    }

    /// Returns X Y Z RX RY RZ.
    pub(crate) fn to_xyz_rpy(self) -> [f64; 6] {
        let r = &self.rotation;
        let cos_y = r[0][0].hypot(r[1][0]);
        let ry = (-r[2][0]).atan2(cos_y);
        // with RY at ±90 only the sum of the other two is defined; RZ is 0
        let (rx, rz) = if cos_y < SINGULAR {
            ((-r[1][2]).atan2(r[1][1]), 0.0)
        } else {
            (r[2][1].atan2(r[2][2]), r[1][0].atan2(r[0][0]))
        };
        let [x, y, z] = self.position;
        [x, y, z, rx.to_degrees(), ry.to_degrees(), rz.to_degrees()]
    }

    /// Makes a frame from a T: position, orient vector (y of the flange), approach vector (z of the flange).
    ///
    /// `None` if the vectors do not span a plane.
    pub(crate) fn from_trans(t: [f64; 9]) -> Option<Self> {
        let [x, y, z, ox, oy, oz, ax, ay, az] = t;
        let approach = unit([ax, ay, az])?;
        let normal = unit(cross([ox, oy, oz], approach))?;
        let orient = cross(approach, normal);
        let rotation = [0, 1, 2].map(|i| [normal[i], orient[i], approach[i]]);
        Some(Self { position: [x, y, z], rotation })
    }

    /// Returns position, orient vector and approach vector.
    pub(crate) fn to_trans(self) -> [f64; 9] {
        let ([x, y, z], r) = (self.position, self.rotation);
        [x, y, z, r[0][1], r[1][1], r[2][1], r[0][2], r[1][2], r[2][2]]
    }

    /// Returns the distance in mm, and the angle in degrees, to another frame.
    pub(crate) fn distance(&self, other: &Self) -> (f64, f64) {
        let delta = [0, 1, 2].map(|i| other.position[i] - self.position[i]);
        (dot(delta, delta).sqrt(), axis_angle(&multiply(&transpose(&self.rotation), &other.rotation)).1.to_degrees())
    }

    /// Interpolates to another frame on a straight line, turning about one axis; `part` is 0 to 1.
    pub(crate) fn towards(&self, other: &Self, part: f64) -> Self {
        let (axis, angle) = axis_angle(&multiply(&transpose(&self.rotation), &other.rotation));
        Self {
            position: [0, 1, 2].map(|i| self.position[i] + (other.position[i] - self.position[i]) * part),
            rotation: multiply(&self.rotation, &about(axis, angle * part)),
        }
    }
}

impl Frame {
    /// The frame of the coordinates themselves.
    pub(crate) const IDENTITY: Self =
        Self { position: [0.0; 3], rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// Returns the frame of these coordinates, relative to this frame.
    pub(crate) fn inverse(&self) -> Self {
        let rotation = transpose(&self.rotation);
        Self { position: rotation.map(|row| -dot(row, self.position)), rotation }
    }

    /// Returns a direction of the coordinates of this frame in those in which the frame is given.
    pub(crate) fn direction(&self, vector: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| dot(row, vector))
    }

    /// Returns this frame moved to another position.
    pub(crate) fn moved_to(&self, position: [f64; 3]) -> Self {
        Self { position, rotation: self.rotation }
    }

    /// Returns this frame moved against its approach vector (its z) by a distance in mm.
    pub(crate) fn withdrawn(&self, distance: f64) -> Self {
        let position = [0, 1, 2].map(|i| self.position[i] - self.rotation[i][2] * distance);
        Self { position, rotation: self.rotation }
    }

    /// Returns this frame turned about an axis (a unit vector) through a point, right-handed.
    pub(crate) fn turned(&self, centre: [f64; 3], axis: [f64; 3], degrees: f64) -> Self {
        let turn = about(axis, degrees.to_radians());
        let arm = [0, 1, 2].map(|i| self.position[i] - centre[i]);
        let position = [0, 1, 2].map(|i| centre[i] + dot(turn[i], arm));
        Self { position, rotation: multiply(&turn, &self.rotation) }
    }

    /// Returns this frame moved and turned by `offset` in the coordinates in which both are given.
    pub(crate) fn displaced(&self, offset: &Self) -> Self {
        let position = [0, 1, 2].map(|i| self.position[i] + offset.position[i]);
        Self { position, rotation: multiply(&offset.rotation, &self.rotation) }
    }

    /// Returns the frame that `offset` is in the coordinates of this one.
    pub(crate) fn times(&self, offset: &Self) -> Self {
        let position = [0, 1, 2].map(|i| self.position[i] + dot(self.rotation[i], offset.position));
        Self { position, rotation: multiply(&self.rotation, &offset.rotation) }
    }
}

impl Geometry {
    /// Returns the frame of the flange for these joints.
    pub(crate) fn forward(&self, joints: &Joints) -> Frame {
        let [j1, j2, j3, j4, j5, j6] = *joints;
        let forearm = multiply(&rz_matrix(j1), &ry_matrix(j2 + j3));
        let wrist = multiply(&multiply(&rz_matrix(j4), &ry_matrix(j5)), &rz_matrix(j6));
        let rotation = multiply(&forearm, &wrist);
        let upper_arm = multiply(&rz_matrix(j1), &ry_matrix(j2));
        let position = [0, 1, 2].map(|i| {
            let shoulder = if i == 2 { self.d1 } else { 0.0 };
            shoulder
                + self.a2 * upper_arm[i][2]
                + self.a3 * forearm[i][0]
                + self.d4 * forearm[i][2]
                + self.d6 * rotation[i][2]
        });
        Frame { position, rotation }
    }

    /// Returns the Fig of the joints.
    pub(crate) fn figure(&self, joints: &Joints) -> u8 {
        let [_, j2, j3, j4, j5, j6] = *joints;
        let bend = self.elbow_bend(j3);
        // the distance of the wrist centre from the axis of J1, negative behind it
        let reach = self.a2 * j2.to_radians().sin() + self.forearm_length() * (j2.to_radians() + bend).sin();
        let lefty = reach >= -SINGULAR;
        let below = if lefty { bend < 0.0 } else { bend > 0.0 };
        let bit = |on: bool, bit: u8| if on { bit } else { 0 };
        bit(lefty, LEFTY)
            | bit(below, BELOW)
            | bit(j5 >= 0.0, NONFLIP)
            | bit(j4.abs() > 180.0, DOUBLE4)
            | bit(j6.abs() > 180.0, DOUBLE6)
    }

    /// Returns the joints for a frame of the flange in the posture `fig`.
    ///
    /// At a singularity, an undefined joint keeps its value of `near`.
    pub(crate) fn inverse(&self, frame: &Frame, fig: u8, near: &Joints) -> Result<Joints, OutOfReach> {
        let r = &frame.rotation;
        let centre = [0, 1, 2].map(|i| frame.position[i] - self.d6 * r[i][2]);
        let lefty = fig & LEFTY != 0;
        let j1 = base_angle(centre, lefty, near[0].to_radians());
        let reach = centre[0].hypot(centre[1]) * if lefty { 1.0 } else { -1.0 };
        let (j2, j3) = self.arm_angles(reach, centre[2] - self.d1, (fig & BELOW != 0) != lefty)?;
        let arm = multiply(&rz_matrix(j1.to_degrees()), &ry_matrix((j2 + j3).to_degrees()));
        let [j4, j5, j6] = wrist_angles(&multiply(&transpose(&arm), r), fig & NONFLIP != 0, near[3].to_radians());
        let turned = |angle: f64, double: bool| match (double, angle > 0.0) {
            (false, _) => angle,
            (true, true) => angle - 360.0,
            (true, false) => angle + 360.0,
        };
        let joints = [
            j1.to_degrees(),
            j2.to_degrees(),
            j3.to_degrees(),
            turned(j4.to_degrees(), fig & DOUBLE4 != 0),
            j5.to_degrees(),
            turned(j6.to_degrees(), fig & DOUBLE6 != 0),
        ];
        match self.out_of_range(&joints) {
            None => Ok(joints),
            Some(axis) => Err(OutOfReach(axis)),
        }
    }

    /// Returns the joints for a frame of the flange with the least turning from `near`, in any posture.
    pub(crate) fn inverse_nearest(&self, frame: &Frame, near: &Joints) -> Result<Joints, OutOfReach> {
        let mut best: Result<(f64, Joints), OutOfReach> = Err(OutOfReach(3));
        for fig in 0..32 {
            match (self.inverse(frame, fig, near), &best) {
                (Ok(joints), best_so_far) => {
                    let turning = joints.iter().zip(near).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                    if best_so_far.is_err() || best_so_far.is_ok_and(|(least, _)| turning < least) {
                        best = Ok((turning, joints));
                    }
                }
                (Err(error), Err(_)) => best = Err(error),
                (Err(_), Ok(_)) => {}
            }
        }
        best.map(|(_, joints)| joints)
    }

    /// Returns the first axis whose value is NaN or outside its range. The slice has J1 to J6, or all axes.
    pub(crate) fn out_of_range(&self, axes: &[f64]) -> Option<u8> {
        // a pose computed at the end of a range may be beyond it through rounding
        const SLACK: f64 = 1e-6;
        let outside = |(place, (low, high)): (&f64, &(f64, f64))| !(*low - SLACK..=*high + SLACK).contains(place);
        axes.iter().zip(&self.ranges).position(outside).and_then(|n| u8::try_from(n + 1).ok())
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

    /// The distance from the elbow to the wrist centre.
    fn forearm_length(&self) -> f64 {
        self.d4.hypot(self.a3)
    }

    /// The angle between the upper arm and the line from the elbow to the wrist centre.
    fn elbow_bend(&self, j3: f64) -> f64 {
        j3.to_radians() + self.a3.atan2(self.d4)
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

fn base_angle(centre: [f64; 3], lefty: bool, near: f64) -> f64 {
    if centre[0].hypot(centre[1]) < SINGULAR {
        return near;
    }
    if lefty { centre[1].atan2(centre[0]) } else { (-centre[1]).atan2(-centre[0]) }
}

/// Solves `Rz(J4) Ry(J5) Rz(J6)`.
fn wrist_angles(r: &Matrix, nonflip: bool, near_j4: f64) -> [f64; 3] {
    let sine = r[0][2].hypot(r[1][2]);
    if sine < SINGULAR {
        // J4 and J6 turn about one line: J4 stays, J6 turns by the rest
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

/// Brings an angle into -180 to 180 degrees, in radians.
fn normal(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned == -PI { PI } else { turned }
}

fn rx_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
}

fn ry_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
}

fn rz_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
}

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transpose(a: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| a[j][i]))
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns the vector of length 1 in this direction; `None` for a vector of length 0.
pub(crate) fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(a, a).sqrt();
    (length > 1e-6).then(|| a.map(|x| x / length))
}

/// Returns the axis and the angle in radians, 0 to π, of a rotation.
fn axis_angle(r: &Matrix) -> ([f64; 3], f64) {
    let skew = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]];
    let sine = dot(skew, skew).sqrt() / 2.0;
    let cosine = (r[0][0] + r[1][1] + r[2][2] - 1.0) / 2.0;
    let angle = sine.atan2(cosine);
    if let (true, Some(axis)) = (sine > 1e-6, unit(skew)) {
        return (axis, angle);
    }
    if cosine > 0.0 {
        return ([0.0, 0.0, 1.0], 0.0);
    }
    // a half turn: R + 1 is twice the product of the axis with itself; its longest column is the best conditioned
    let column = |j: usize| [0, 1, 2].map(|i| r[i][j] + if i == j { 1.0 } else { 0.0 });
    let longest = (0..3).max_by(|a, b| r[*a][*a].total_cmp(&r[*b][*b])).unwrap_or(0);
    (unit(column(longest)).unwrap_or([0.0, 0.0, 1.0]), std::f64::consts::PI)
}

/// Returns the rotation by `angle` radians about a unit vector.
fn about(axis: [f64; 3], angle: f64) -> Matrix {
    let ([x, y, z], (s, c)) = (axis, angle.sin_cos());
    let t = 1.0 - c;
    [
        [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
        [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
        [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
    ]
}

/// Rounds numbers to what a controller can measure: 1e-6 mm or degrees.
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ARM: Geometry = Geometry::DEFAULT;

    fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
        assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance), "{a:?} is not {b:?}");
    }

    /// A number that is the same for 180 and -180.
    fn turn(degrees: f64) -> f64 {
        degrees.to_radians().cos()
    }

    #[test]
    fn the_pose_of_the_guides_slave_move_has_the_joints_of_its_reply() {
        let joints = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];
        let pose = ARM.forward(&joints).to_xyz_rpy();
        assert_close(&pose[..3], &[364.16, 0.0, 278.5355], 1e-3);
        assert_close(&[turn(pose[3]), turn(pose[4]), turn(pose[5])], &[turn(180.0), turn(0.0), turn(180.0)], 1e-9);
        assert_eq!(ARM.figure(&joints), 5);

        let guide = Frame::from_xyz_rpy([364.16, 0.0, 278.5355, 180.0, 1.272222e-14, 180.0]);
        assert_close(&ARM.inverse(&guide, 5, &[0.0; 6]).unwrap(), &joints, 1e-4);
    }

    #[test]
    fn the_straight_arm_is_as_high_as_its_parts() {
        let frame = ARM.forward(&[0.0; 6]);
        assert_close(&frame.position, &[-10.0, 0.0, 345.0 + 250.0 + 255.0 + 70.0], 1e-9);
        assert_close(&frame.to_xyz_rpy()[3..], &[0.0; 3], 1e-9);
        assert_eq!(
            ARM.inverse_nearest(&Frame::from_xyz_rpy([0.0, 0.0, 2000.0, 0.0, 0.0, 0.0]), &[0.0; 6]),
            Err(OutOfReach(3))
        );
    }

    #[test]
    fn a_line_keeps_to_the_line() {
        let from = Frame::from_xyz_rpy([300.0, 0.0, 300.0, 180.0, 0.0, 180.0]);
        let to = Frame::from_xyz_rpy([300.0, 100.0, 350.0, 180.0, 0.0, 90.0]);
        let middle = from.towards(&to, 0.5).to_xyz_rpy();
        assert_close(&middle[..3], &[300.0, 50.0, 325.0], 1e-9);
        assert_close(&[middle[5]], &[135.0], 1e-9);
        assert_close(&[from.distance(&to).1], &[90.0], 1e-9);
        assert_close(&from.towards(&to, 1.0).to_trans(), &to.to_trans(), 1e-9);
    }

    #[test]
    fn half_turns_have_an_axis() {
        for degrees in [[180.0, 0.0, 0.0], [0.0, 180.0, 0.0], [0.0, 0.0, 180.0], [180.0, 0.0, 45.0]] {
            let [rx, ry, rz] = degrees;
            let to = Frame::from_xyz_rpy([0.0, 0.0, 0.0, rx, ry, rz]);
            let from = Frame::from_xyz_rpy([0.0; 6]);
            assert_close(&from.towards(&to, 1.0).to_trans(), &to.to_trans(), 1e-9);
            assert_close(&[from.distance(&to).1], &[180.0], 1e-9);
        }
    }

    #[test]
    fn vectors_that_span_no_plane_are_no_transform() {
        assert!(Frame::from_trans([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]).is_none());
        assert!(Frame::from_trans([0.0; 9]).is_none());
    }

    fn any_joints() -> impl Strategy<Value = Joints> {
        RANGES.map(|(low, high)| low..high)
    }

    proptest! {
        #[test]
        fn joints_come_back_from_their_pose_and_figure(joints in any_joints()) {
            let bend = ARM.elbow_bend(joints[2]).to_degrees();
            let centre = ARM.forward(&joints);
            let r = centre.rotation;
            let over_base = (centre.position[0] - ARM.d6 * r[0][2]).hypot(centre.position[1] - ARM.d6 * r[1][2]);
            // next to a singularity the solution exists but is ill-conditioned
            prop_assume!(bend.abs() > 0.5 && joints[4].abs() > 0.5 && over_base > 1.0);
            let back = ARM.inverse(&ARM.forward(&joints), ARM.figure(&joints), &joints).unwrap();
            assert_close(&back, &joints, 1e-5);
        }

        #[test]
        fn poses_come_back_from_their_joints(joints in any_joints()) {
            let frame = ARM.forward(&joints);
            let near = ARM.inverse_nearest(&frame, &joints).unwrap();
            assert_close(&ARM.forward(&near).to_trans(), &frame.to_trans(), 1e-4);
            let [x, y, z, rx, ry, rz] = frame.to_xyz_rpy();
            assert_close(&Frame::from_xyz_rpy([x, y, z, rx, ry, rz]).to_trans(), &frame.to_trans(), 1e-6);
            assert_close(&Frame::from_trans(frame.to_trans()).unwrap().to_trans(), &frame.to_trans(), 1e-6);
        }
    }
}
