//! The values of P, J and T variables: positions, joints and transforms, with units in the names.
//!
//! ```text
//!            numbers                              variable   system value      number of the type in Robot_Move
//!  Position  X Y Z RX RY RZ Fig                   P  R4[7]   CurPos  R8[7]     0
//!  Transform X Y Z Ox Oy Oz Ax Ay Az Fig          T  R4[10]  CurTrn  R8[10]    1
//!  Joints    J1 .. J8                             J  R4[8]   CurJnt  R8[8]     2
//! ```
//!
//! Each type converts from an array of exactly this many numbers ([`FromVariant`]), so the value of a P, V or T variable
//! does not convert to [`Joints`]. Only the number of elements can be checked: CurPosEx (the time and a position) and
//! GetSrvData have eight numbers too, and are not joints.
//!
//! Each type is sent as an array of R4, as variables require ([`Encode`]). R4 has 24 bits: a number near 1000 is
//! rounded by at most 0.00003. [`target`](Position::target) returns the destination of Robot_Move, in R8. Neither sends a NaN
//! or an infinite number. `From` makes a pose of Slave Mode ([`slave::Pose`](crate::slave::Pose)) from each type.
//!
//! # Orientation
//!
//! The orient vector of a transform is the y axis of the flange, and the approach vector its z axis, as a public driver uses
//! them (rosilo_denso_communication). The documents at hand do not define the order of the rotations RX, RY and RZ. Hence
//! there is no conversion between [`Position`] and [`Transform`] here. The controller gives the current position in both
//! forms (CurPos and CurTrn).

use crate::error::EncodeError;
use crate::num::to_f32;
use crate::variant::convert::{element, elements};
use crate::variant::{ConvertError, Encode, FromVariant, VarType, Variant, Writer};

/// The Fig that leaves the choice of the posture to the controller, as public drivers send it.
pub const ANY_FIGURE: i32 = -1;

/// A position and orientation: the value of a P variable and of CurPos.
///
/// # Examples
///
/// ```
/// use bcap_core::position::Position;
/// use bcap_core::variant::VariantBuf;
///
/// let home = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
/// let p1 = VariantBuf::<64>::new(&home)?;
/// assert_eq!(format!("{p1:?}"), "R4[400.0, 0.0, 300.0, 180.0, 0.0, 180.0, 5.0]");
///
/// let read: Position = p1.as_variant().convert()?;
/// assert_eq!((read.xyz_mm, read.figure), ([400.0, 0.0, 300.0], 5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Position {
    /// X, Y, Z in mm.
    pub xyz_mm: [f64; 3],
    /// RX, RY, RZ in degrees.
    pub rotation_degrees: [f64; 3],
    /// Fig, the posture of the arm: 0 or above, or [`ANY_FIGURE`].
    pub figure: i32,
}

impl Position {
    /// Creates a position from X, Y, Z in mm and RX, RY, RZ in degrees, with [`ANY_FIGURE`].
    #[must_use]
    pub const fn new(xyz_mm: [f64; 3], rotation_degrees: [f64; 3]) -> Self {
        Self { xyz_mm, rotation_degrees, figure: ANY_FIGURE }
    }

    /// Returns the position with this Fig.
    #[must_use]
    pub const fn figure(self, figure: i32) -> Self {
        Self { figure, ..self }
    }

    /// Creates a position from X, Y, Z, RX, RY, RZ, Fig; `None` if Fig is not an integer of 32 bits.
    #[must_use]
    pub fn from_array(numbers: [f64; 7]) -> Option<Self> {
        let [x, y, z, rx, ry, rz, fig] = numbers;
        Some(Self::new([x, y, z], [rx, ry, rz]).figure(Variant::R8(fig).convert().ok()?))
    }

    /// Returns X, Y, Z, RX, RY, RZ, Fig.
    #[must_use]
    pub fn to_array(self) -> [f64; 7] {
        let ([x, y, z], [rx, ry, rz]) = (self.xyz_mm, self.rotation_degrees);
        [x, y, z, rx, ry, rz, f64::from(self.figure)]
    }

    /// Returns the destination of Robot_Move: the numbers as R8, the type and the pass (b-CAP specification, section
    /// 6.3).
    ///
    /// `pass` is -1 for `@P`, -2 for `@E`, 0 for `@0`, and n for `@n`. The specification shows only -2; public drivers use the
    /// others.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::position::Position;
    /// use bcap_core::variant::VariantBuf;
    ///
    /// let there = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
    /// let sent = VariantBuf::<128>::new(&there.target(-2))?;
    /// let text = "VARIANT[R8[400.0, 0.0, 300.0, 180.0, 0.0, 180.0, 5.0], I4(0), I4(-2)]";
    /// assert_eq!(format!("{sent:?}"), text);
    /// # Ok::<(), bcap_core::error::EncodeError>(())
    /// ```
    pub fn target(self, pass: i32) -> impl Encode + Copy + use<> {
        Destination { numbers: self.to_array(), kind: 0, pass }
    }
}

/// The positions of up to eight axes: the value of a J variable and of CurJnt.
///
/// # Examples
///
/// ```
/// use bcap_core::position::Joints;
/// use bcap_core::variant::VariantBuf;
///
/// let joints = Joints::new([0.0, 45.0, 90.0, 0.0, 45.0, 0.0]);
/// assert_eq!(joints.degrees, [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]);
///
/// let current = VariantBuf::<128>::new(&[0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0])?;
/// assert_eq!(current.as_variant().convert::<Joints>()?, joints);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Joints {
    /// J1 to J8 in degrees, or in mm for linear axes; 0 for an axis that the robot does not have.
    pub degrees: [f64; 8],
}

impl Joints {
    /// Creates joints from J1 and the following axes, in degrees, or in mm for linear axes. Missing axes are 0.
    ///
    /// More than eight axes are a compile error.
    #[must_use]
    pub fn new<const N: usize>(degrees: [f64; N]) -> Self {
        const { assert!(N <= 8, "a robot has at most eight axes") }
        let mut degrees = degrees.into_iter();
        Self { degrees: core::array::from_fn(|_| degrees.next().unwrap_or(0.0)) }
    }

    /// Returns the destination of Robot_Move: the numbers as R8, the type and the pass, see [`Position::target`].
    pub fn target(self, pass: i32) -> impl Encode + Copy + use<> {
        Destination { numbers: self.degrees, kind: 2, pass }
    }
}

/// A position with the axes of the flange as vectors: the value of a T variable and of CurTrn.
///
/// # Examples
///
/// ```
/// use bcap_core::position::Transform;
///
/// let down = Transform::new([400.0, 0.0, 300.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]).figure(5);
/// assert_eq!(down.normal(), [-1.0, 0.0, 0.0]);
/// assert_eq!(down.to_array(), [400.0, 0.0, 300.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 5.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Transform {
    /// X, Y, Z in mm.
    pub xyz_mm: [f64; 3],
    /// The orient vector, of length 1: the direction of the flange's y axis.
    pub orient: [f64; 3],
    /// The approach vector, of length 1: the direction of the flange's z axis.
    pub approach: [f64; 3],
    /// Fig, the posture of the arm: 0 or above, or [`ANY_FIGURE`].
    pub figure: i32,
}

impl Transform {
    /// Creates a transform from X, Y, Z in mm, the orient and the approach vector, with [`ANY_FIGURE`].
    #[must_use]
    pub const fn new(xyz_mm: [f64; 3], orient: [f64; 3], approach: [f64; 3]) -> Self {
        Self { xyz_mm, orient, approach, figure: ANY_FIGURE }
    }

    /// Returns the transform with this Fig.
    #[must_use]
    pub const fn figure(self, figure: i32) -> Self {
        Self { figure, ..self }
    }

    /// Creates a transform from X, Y, Z, both vectors and Fig; `None` if Fig is not an integer of 32 bits.
    #[must_use]
    pub fn from_array(numbers: [f64; 10]) -> Option<Self> {
        let [x, y, z, ox, oy, oz, ax, ay, az, fig] = numbers;
        Some(Self::new([x, y, z], [ox, oy, oz], [ax, ay, az]).figure(Variant::R8(fig).convert().ok()?))
    }

    /// Returns X, Y, Z, the orient and the approach vector, Fig.
    #[must_use]
    pub fn to_array(self) -> [f64; 10] {
        let ([x, y, z], [ox, oy, oz], [ax, ay, az]) = (self.xyz_mm, self.orient, self.approach);
        [x, y, z, ox, oy, oz, ax, ay, az, f64::from(self.figure)]
    }

    /// Returns the normal vector, the direction of the flange's x axis: the cross product of orient and approach.
    ///
    /// Normal, orient and approach are the columns of the rotation matrix.
    #[must_use]
    pub const fn normal(self) -> [f64; 3] {
        let ([ox, oy, oz], [ax, ay, az]) = (self.orient, self.approach);
        [oy * az - oz * ay, oz * ax - ox * az, ox * ay - oy * ax]
    }

    /// Returns the destination of Robot_Move: the numbers as R8, the type and the pass, see [`Position::target`].
    pub fn target(self, pass: i32) -> impl Encode + Copy + use<> {
        Destination { numbers: self.to_array(), kind: 1, pass }
    }
}

/// Reads an array of `N` numbers, the last of which is the Fig.
fn with_figure<const N: usize>(value: Variant<'_>) -> Result<([f64; N], i32), ConvertError> {
    let figure = elements(value, N, N)?.last().unwrap_or((0, Variant::Empty));
    Ok((value.convert()?, element(figure)?))
}

/// An array of seven numbers: X, Y, Z, RX, RY, RZ, Fig.
impl<'a> FromVariant<'a> for Position {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        let ([x, y, z, rx, ry, rz, _], figure) = with_figure(value)?;
        Ok(Self::new([x, y, z], [rx, ry, rz]).figure(figure))
    }
}

/// An array of ten numbers: X, Y, Z, orient vector, approach vector, Fig.
impl<'a> FromVariant<'a> for Transform {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        let ([x, y, z, ox, oy, oz, ax, ay, az, _], figure) = with_figure(value)?;
        Ok(Self::new([x, y, z], [ox, oy, oz], [ax, ay, az]).figure(figure))
    }
}

/// An array of eight numbers, J1 to J8: a controller sends 0 for each axis that the robot does not have. A shorter array is
/// refused, because it can be a P (7 numbers, the first three in mm) or a V.
impl<'a> FromVariant<'a> for Joints {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        Ok(Self { degrees: value.convert()? })
    }
}

/// The destination of Robot_Move.
#[derive(Clone, Copy)]
struct Destination<const N: usize> {
    numbers: [f64; N],
    /// The number of the type: 0 P, 1 T, 2 J.
    kind: i32,
    pass: i32,
}

impl<const N: usize> Encode for Destination<N> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        if self.numbers.iter().all(|number| number.is_finite()) {
            return (self.numbers, self.kind, self.pass).encode(out);
        }
        Err(EncodeError::OutOfRange(VarType::R8.0))
    }
}

/// Appends an array of R4.
fn encode_r4<const N: usize>(numbers: [f64; N], out: &mut Writer<'_>) -> Result<(), EncodeError> {
    let rounded = numbers.map(to_f32);
    if rounded.iter().all(|number| number.is_finite()) {
        return rounded.encode(out);
    }
    Err(EncodeError::OutOfRange(VarType::R4.0))
}

/// An array of seven R4, the value of a P variable. NaN and numbers out of the range of R4 are errors.
impl Encode for Position {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        encode_r4(self.to_array(), out)
    }
}

/// An array of eight R4, the value of a J variable. NaN and numbers out of the range of R4 are errors.
impl Encode for Joints {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        encode_r4(self.degrees, out)
    }
}

/// An array of ten R4, the value of a T variable. NaN and numbers out of the range of R4 are errors.
impl Encode for Transform {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        encode_r4(self.to_array(), out)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::variant::VariantBuf;
    use std::format;
    use std::string::{String, ToString};

    const P: Position = Position::new([364.16, 0.0, 278.5355], [180.0, 0.0, -180.0]).figure(5);
    const T: Transform = Transform::new([1.0, 2.0, 3.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]).figure(69);

    fn sent(value: impl Encode) -> VariantBuf<256> {
        VariantBuf::new(&value).unwrap()
    }

    fn refused<T: for<'a> FromVariant<'a> + core::fmt::Debug>(value: impl Encode) -> String {
        sent(value).as_variant().convert::<T>().unwrap_err().to_string()
    }

    #[test]
    fn variables_are_r4_arrays_and_widen() {
        let wire = sent(P);
        assert_eq!(wire, sent([364.16_f32, 0.0, 278.5355, 180.0, 0.0, -180.0, 5.0]));
        let read: Position = wire.as_variant().convert().unwrap();
        assert_eq!(read, Position { xyz_mm: [f64::from(364.16_f32), 0.0, f64::from(278.5355_f32)], ..P });
        assert_eq!(sent(read), wire);
        assert_eq!(sent(T), sent([1.0_f32, 2.0, 3.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 69.0]));
        assert_eq!(sent(T).as_variant().convert(), Ok(T));
        assert_eq!(sent(Joints::new([1.5, -2.0])), sent([1.5_f32, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    }

    #[test]
    fn current_values_are_r8_arrays_and_exact() {
        assert_eq!(sent(P.to_array()).as_variant().convert(), Ok(P));
        assert_eq!(sent(T.to_array()).as_variant().convert(), Ok(T));
        assert_eq!(sent([0.1_f64; 8]).as_variant().convert(), Ok(Joints { degrees: [0.1; 8] }));
    }

    #[test]
    fn arrays_round_trip_with_the_figure() {
        assert_eq!(Position::from_array(P.to_array()), Some(P));
        assert_eq!(Transform::from_array(T.to_array()), Some(T));
        assert_eq!(Position::new([0.0; 3], [0.0; 3]).to_array(), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        assert_eq!(Position::from_array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]), None);
    }

    #[test]
    fn other_arrays_are_refused() {
        assert_eq!(
            refused::<Position>([0.0_f32; 8]),
            "expected an array of 7 elements, found VT_ARRAY|VT_R4 of 8 elements"
        );
        assert_eq!(
            refused::<Transform>([0.0_f64; 7]),
            "expected an array of 10 elements, found VT_ARRAY|VT_R8 of 7 elements"
        );
        // a V, the joints of a robot with six axes, CurPos, CurJntEx, CurTrn, and a number
        for wrong in [sent([0.0_f32; 3]), sent([0.0_f64; 6]), sent(P), sent([0.0_f64; 9]), sent(T)] {
            let found = wrong.as_variant().as_array().unwrap();
            let (vartype, count) = (wrong.as_variant().vartype(), found.len());
            let expected = format!("expected an array of 8 elements, found {vartype} of {count} elements");
            assert_eq!(refused::<Joints>(wrong), expected);
        }
        assert_eq!(refused::<Joints>(0.0), "expected an array, found VT_R8");
        assert_eq!(
            refused::<Position>(Joints::default()),
            "expected an array of 7 elements, found VT_ARRAY|VT_R4 of 8 elements"
        );
        assert_eq!(
            refused::<Position>([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.5]),
            "element 6: expected i32 (-2147483648 to 2147483647), found VT_R8 with the value 2.5, \
             which is not exact in this type"
        );
        assert_eq!(
            refused::<Joints>((1.0, 2.0, 3.0, 4.0, "x", 6.0, 7.0, 8.0)),
            "element 4: expected f64, found VT_BSTR"
        );
    }

    #[test]
    fn numbers_that_are_not_finite_are_not_sent() {
        for bad in [f64::NAN, f64::INFINITY, 1e39] {
            let error = VariantBuf::<64>::new(&Joints::new([0.0, bad])).unwrap_err();
            assert_eq!(error, EncodeError::OutOfRange(4), "{bad}");
        }
        for bad in [f64::NAN, f64::NEG_INFINITY] {
            let target = Position { rotation_degrees: [0.0, bad, 0.0], ..P }.target(0);
            assert_eq!(VariantBuf::<128>::new(&target).unwrap_err(), EncodeError::OutOfRange(5), "{bad}");
        }
    }

    #[test]
    fn targets_have_the_type_and_the_pass() {
        assert_eq!(sent(P.target(-2)), sent((P.to_array(), 0, -2)));
        assert_eq!(sent(T.target(0)), sent((T.to_array(), 1, 0)));
        assert_eq!(
            format!("{:?}", sent(Joints::new([1.0]).target(10)).as_variant().as_array().unwrap().get(1)),
            "Some(I4(2))"
        );
    }

    #[test]
    fn the_normal_vector_completes_a_right_handed_frame() {
        let turned = Transform::new([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
        assert_eq!(turned.normal(), [0.0, 1.0, 0.0]);
        assert_eq!(Transform::new([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]).normal(), [1.0, 0.0, 0.0]);
    }
}
