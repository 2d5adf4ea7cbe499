//! Poses, in the order of the wire.
//!
//! ```text
//!          numbers                                    with an extended joint (b-CAP specification, section 5.4)
//!   P   7  X Y Z RX RY RZ Fig                         9 or 10  ... option [J7] [J8]
//!   J   8  J1 .. J8                                         9  ... option
//!   T  10  X Y Z  Ox Oy Oz  Ax Ay Az  Fig            12 or 13  ... option [J7] [J8]
//!
//!   option = 0x00400000 | 0x40 (axis 7) | 0x80 (axis 8)
//! ```
//!
//! The constructors take arrays of the right length, so a pose of a wrong length is a compile error.

use core::fmt;

use super::mode::{J_LEN, P_LEN, PoseType, T_LEN};
use crate::position::{Joints, Position, Transform};

/// The maximum number of values of a pose.
const MAX: usize = 13;
/// The bit that marks the element of the extended-joint option.
const OPTION: u32 = 0x0040_0000;

/// The extended joints that slvMove commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExtendedAxes {
    /// None: the option is not sent.
    #[default]
    None,
    /// Axis 7.
    Seven,
    /// Axis 8.
    Eight,
    /// Axes 7 and 8.
    Both,
}

impl ExtendedAxes {
    const fn bits(self) -> u32 {
        match self {
            Self::None => 0,
            Self::Seven => 0x40,
            Self::Eight => 0x80,
            Self::Both => 0xc0,
        }
    }

    /// Returns whether axis 7 and axis 8 are among them.
    pub(super) const fn has(self) -> (bool, bool) {
        (self.bits() & 0x40 != 0, self.bits() & 0x80 != 0)
    }
}

/// The commanded positions of extended joints, in degrees or millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Extended {
    /// Axis 7.
    Seven(f64),
    /// Axis 8.
    Eight(f64),
    /// Axes 7 and 8.
    Both(f64, f64),
}

/// The layout of a pose: its type and its extended joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PoseLayout {
    /// The type.
    pub pose: PoseType,
    /// The extended joints.
    pub extended: ExtendedAxes,
}

impl PoseLayout {
    /// Returns the number of values in slvMove.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no pose is empty")]
    pub const fn len(self) -> usize {
        let appended = match (self.extended, self.pose) {
            (ExtendedAxes::None, _) => 0,
            (_, PoseType::J) => 1,
            (ExtendedAxes::Both, _) => 3,
            (_, _) => 2,
        };
        self.pose.len().wrapping_add(appended)
    }
}

impl fmt::Display for PoseLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.pose {
            PoseType::P => "P",
            PoseType::J => "J",
            PoseType::T => "T",
        })?;
        f.write_str(match self.extended {
            ExtendedAxes::None => "",
            ExtendedAxes::Seven => " with axis 7",
            ExtendedAxes::Eight => " with axis 8",
            ExtendedAxes::Both => " with axes 7 and 8",
        })
    }
}

/// A commanded position of the robot, for one slvMove.
///
/// # Examples
///
/// ```
/// use bcap_core::slave::{Extended, Pose};
///
/// let pose = Pose::p([364.16, 0.0, 278.5, 180.0, 0.0, 180.0, 5.0]).with_extended(Extended::Eight(12.5));
/// assert_eq!(pose.as_slice()[7..], [f64::from(0x0040_0080), 12.5]);
/// ```
#[derive(Clone, Copy, PartialEq)]
pub struct Pose {
    /// In the order of the wire; zeros from `layout.len()` on.
    numbers: [f64; MAX],
    layout: PoseLayout,
}

impl Pose {
    /// Creates a P pose: X, Y, Z in mm, RX, RY, RZ in degrees, Fig.
    #[must_use]
    pub fn p(numbers: [f64; P_LEN]) -> Self {
        Self::new(PoseType::P, &numbers)
    }

    /// Creates a J pose: eight joints in degrees (millimetres for linear ones). The controller ignores joints that the robot
    /// does not have.
    #[must_use]
    pub fn j(numbers: [f64; J_LEN]) -> Self {
        Self::new(PoseType::J, &numbers)
    }

    /// Creates a T pose: X, Y, Z in mm, the orientation and the approach vector, Fig.
    #[must_use]
    pub fn t(numbers: [f64; T_LEN]) -> Self {
        Self::new(PoseType::T, &numbers)
    }

    /// Creates a pose of numbers whose count is known at run time, such as the columns of a file.
    ///
    /// `None` when the type has another count. A J pose may have fewer numbers; missing joints are 0.
    #[must_use]
    pub fn from_numbers(pose: PoseType, numbers: &[f64]) -> Option<Self> {
        let fits = match pose {
            PoseType::J => !numbers.is_empty() && numbers.len() <= J_LEN,
            other => numbers.len() == other.len(),
        };
        fits.then(|| Self::new(pose, numbers))
    }

    /// Creates the pose of zeros in a layout, with its extended-joint option.
    pub(super) fn zero(layout: PoseLayout) -> Self {
        Self::new(layout.pose, &[]).with_axes(layout.extended, 0.0, 0.0)
    }

    fn new(pose: PoseType, numbers: &[f64]) -> Self {
        let mut out = [0.0; MAX];
        for (slot, number) in out.iter_mut().zip(numbers) {
            *slot = *number;
        }
        Self { numbers: out, layout: PoseLayout { pose, extended: ExtendedAxes::None } }
    }

    /// Returns the pose with extended joints; in a J pose they replace J7 and J8.
    #[must_use]
    pub fn with_extended(mut self, extended: Extended) -> Self {
        let (axes, seven, eight) = match extended {
            Extended::Seven(j7) => (ExtendedAxes::Seven, Some(j7), None),
            Extended::Eight(j8) => (ExtendedAxes::Eight, None, Some(j8)),
            Extended::Both(j7, j8) => (ExtendedAxes::Both, Some(j7), Some(j8)),
        };
        self.layout.extended = axes;
        let option = f64::from(OPTION | axes.bits());
        if self.layout.pose == PoseType::J {
            self.put(6, seven);
            self.put(7, eight);
            self.put(J_LEN, Some(option));
        } else {
            let at = self.layout.pose.len();
            self.put(at, Some(option));
            self.put(at.wrapping_add(1), seven.or(eight));
            self.put(at.wrapping_add(2), eight.filter(|_| axes == ExtendedAxes::Both).or(Some(0.0)));
        }
        self
    }

    /// Returns the pose with the extended joints that the format has.
    pub(super) fn with_axes(self, axes: ExtendedAxes, j7: f64, j8: f64) -> Self {
        match axes {
            ExtendedAxes::None => self,
            ExtendedAxes::Seven => self.with_extended(Extended::Seven(j7)),
            ExtendedAxes::Eight => self.with_extended(Extended::Eight(j8)),
            ExtendedAxes::Both => self.with_extended(Extended::Both(j7, j8)),
        }
    }

    fn put(&mut self, at: usize, number: Option<f64>) {
        if let (Some(slot), Some(number)) = (self.numbers.get_mut(at), number) {
            *slot = number;
        }
    }

    /// Returns the layout.
    #[must_use]
    #[inline]
    pub const fn layout(&self) -> PoseLayout {
        self.layout
    }

    /// Returns the numbers in the order of the wire, the extended-joint option included.
    #[must_use]
    #[inline]
    pub fn as_slice(&self) -> &[f64] {
        self.numbers.get(..self.layout.len()).unwrap_or_default()
    }

    /// Returns the numbers in the order of the wire, padded with zeros.
    #[inline]
    pub(super) const fn padded(&self) -> &[f64; MAX] {
        &self.numbers
    }

    /// Returns whether no number is infinite or NaN.
    pub(super) fn is_finite(&self) -> bool {
        self.as_slice().iter().all(|number| number.is_finite())
    }

    /// Returns the numbers without the extended-joint option and the elements after it.
    #[must_use]
    pub fn numbers(&self) -> &[f64] {
        self.numbers.get(..self.layout.pose.len()).unwrap_or_default()
    }

    /// Returns the extended joints; `None` if the pose does not command any.
    #[must_use]
    pub fn extended(&self) -> Option<Extended> {
        let [.., seven, eight] = self.axes();
        match self.layout.extended {
            ExtendedAxes::None => None,
            ExtendedAxes::Seven => Some(Extended::Seven(seven)),
            ExtendedAxes::Eight => Some(Extended::Eight(eight)),
            ExtendedAxes::Both => Some(Extended::Both(seven, eight)),
        }
    }

    /// Returns the continuous values, for limits and ramps; missing ones are 0.
    ///
    /// ```text
    ///   P   X Y Z RX RY RZ J7 J8       J   J1 .. J8       T   X Y Z  0  0  0 J7 J8
    /// ```
    pub(super) fn axes(&self) -> [f64; 8] {
        let n = &self.numbers;
        let [a, b, c, d, e, f, g, h, ..] = *n;
        let (seven, eight) = self.extended_values();
        match self.layout.pose {
            PoseType::P => [a, b, c, d, e, f, seven, eight],
            PoseType::J => [a, b, c, d, e, f, g, h],
            PoseType::T => [a, b, c, 0.0, 0.0, 0.0, seven, eight],
        }
    }

    /// Returns the values of axes 7 and 8, after the option of a P or T pose.
    fn extended_values(&self) -> (f64, f64) {
        let at = self.layout.pose.len();
        let value = |by: usize| self.numbers.get(at.wrapping_add(by)).copied().unwrap_or(0.0);
        match self.layout.extended {
            ExtendedAxes::None => (0.0, 0.0),
            ExtendedAxes::Seven => (value(1), 0.0),
            ExtendedAxes::Eight => (0.0, value(1)),
            ExtendedAxes::Both => (value(1), value(2)),
        }
    }

    /// Returns the pose plus a difference; angles stay within ±180 degrees, vectors keep the length 1.
    pub(super) fn shifted(&self, by: &Delta) -> Self {
        let mut out = *self;
        for (slot, step) in out.numbers.iter_mut().zip(by.0) {
            *slot += step;
        }
        match self.layout.pose {
            PoseType::P => {
                out.numbers.iter_mut().skip(3).take(3).for_each(|angle| *angle = half_turn(*angle));
            }
            PoseType::T => {
                let (_, vectors) = out.numbers.split_at_mut(3);
                if let [o1, o2, o3, a1, a2, a3, ..] = vectors {
                    normalize([o1, o2, o3]);
                    normalize([a1, a2, a3]);
                }
            }
            PoseType::J => {}
        }
        out
    }

    /// Returns the difference from `earlier` to this pose; the values of Fig and of the option are 0.
    pub(super) fn since(&self, earlier: &Self) -> Delta {
        let mut out = [0.0; MAX];
        for ((slot, to), from) in out.iter_mut().zip(self.numbers).zip(earlier.numbers) {
            *slot = to - from;
        }
        let fixed = match self.layout.pose {
            PoseType::P => {
                out.iter_mut().skip(3).take(3).for_each(|angle| *angle = half_turn(*angle));
                6..8
            }
            PoseType::J => 8..9,
            PoseType::T => 9..11,
        };
        out.iter_mut().take(fixed.end).skip(fixed.start).for_each(|number| *number = 0.0);
        Delta(out)
    }
}

impl From<Position> for Pose {
    fn from(position: Position) -> Self {
        Self::p(position.to_array())
    }
}

impl From<Joints> for Pose {
    fn from(joints: Joints) -> Self {
        Self::j(joints.degrees)
    }
}

impl From<Transform> for Pose {
    fn from(transform: Transform) -> Self {
        Self::t(transform.to_array())
    }
}

impl fmt::Debug for Pose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.layout.pose)?;
        f.debug_list().entries(self.as_slice()).finish()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Pose {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{} {}", self.layout.pose, self.as_slice());
    }
}

/// The difference of two poses of one layout.
#[derive(Clone, Copy, Debug)]
pub(super) struct Delta([f64; MAX]);

impl Delta {
    pub(super) const ZERO: Self = Self([0.0; MAX]);

    pub(super) fn scaled(&self, factor: f64) -> Self {
        Self(self.0.map(|number| number * factor))
    }
}

/// Brings an angle between -540 and 540 degrees into -180 to 180 degrees.
pub(super) fn half_turn(angle: f64) -> f64 {
    if angle > 180.0 {
        angle - 360.0
    } else if angle < -180.0 {
        angle + 360.0
    } else {
        angle
    }
}

/// Normalises a vector whose length is already close to 1.
fn normalize(vector: [&mut f64; 3]) {
    let square: f64 = vector.iter().map(|n| **n * **n).sum();
    // Newton's iteration for 1 / sqrt(square), because `core` has no square root
    let mut inverse = 1.0;
    for _ in 0..4 {
        inverse *= 1.5 - 0.5 * square * inverse * inverse;
    }
    if (0.5..2.0).contains(&square) {
        vector.into_iter().for_each(|number| *number *= inverse);
    }
}
