//! Frames: position and orientation in space; joints, and the axis that cannot reach a frame.

use bcap_core::hresult::HResult;

use crate::codes;

/// J1 to J6, in degrees; of an arm of four axes J3 is in mm, and J5 and J6 are 0.
pub type Joints = [f64; 6];

/// Why the arm cannot take a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutOfReach {
    /// No joints give this frame.
    Unreachable,
    /// These axes would leave their ranges: bit n - 1 of axis n. At least one.
    Limits(u8),
    /// Axes would turn too far at a singular point.
    Singular,
}

impl OutOfReach {
    /// Returns the error of a motion whose goal it is.
    pub(crate) fn of_goal(self) -> HResult {
        self.code(codes::UNREACHABLE, codes::GOAL_BEYOND_LIMIT, codes::SINGULAR)
    }

    /// Returns the error of a pose on the way.
    pub(crate) fn on_path(self) -> HResult {
        self.code(codes::UNREACHABLE, codes::PATH_BEYOND_LIMIT, codes::SINGULAR)
    }

    /// Returns the error of a pose that is converted only.
    pub(crate) fn of_conversion(self) -> HResult {
        self.code(codes::CONVERSION_UNREACHABLE, codes::CONVERSION_BEYOND_LIMIT, codes::CONVERSION_SINGULAR)
    }

    fn code(self, unreachable: HResult, limit: HResult, singular: HResult) -> HResult {
        match self {
            Self::Unreachable => unreachable,
            Self::Limits(axes) => codes::of_axis(limit, axes.trailing_zeros()),
            Self::Singular => singular,
        }
    }
}

/// A sine below this counts as zero: two axes are in line, or a point is on an axis.
pub(super) const SINGULAR: f64 = 1e-9;

/// A 3x3 rotation, by rows.
pub(super) type Matrix = [[f64; 3]; 3];

/// The position and orientation of the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    /// In mm.
    pub(crate) position: [f64; 3],
    pub(super) rotation: Matrix,
}

impl Frame {
    /// Creates a frame from X Y Z in mm and RX RY RZ in degrees: turned about the fixed axes x, then y, then z.
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

    /// Creates a frame from a T: position, orient vector (y of the flange), approach vector (z of the flange).
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

    /// Returns a direction, given in the coordinates of this frame, in the coordinates of its parent.
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

/// Brings an angle into -180 to 180 degrees, in radians.
pub(super) fn normal(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned == -PI { PI } else { turned }
}

pub(super) fn rx_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
}

pub(super) fn ry_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
}

pub(super) fn rz_matrix(degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
}

pub(super) fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

pub(super) fn transpose(a: &Matrix) -> Matrix {
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
