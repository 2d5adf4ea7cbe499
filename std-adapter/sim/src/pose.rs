//! POSEDATA: the poses, vectors and lengths of motion commands, in all forms of the RC8 provider guide, appendix B.
//!
//! | form                               | example                                                      |
//! |------------------------------------|--------------------------------------------------------------|
//! | BSTR: a variable                   | `"P1"`, `"@E J[3]"`                                          |
//! | BSTR: numbers                      | `"P(400, 0, 300, 180, 0, 180, 5)"`, `"@P J(0,45,90,0,45,0)"` |
//! | VARIANT array: numbers, type, pass | `[[0,45,90,0,45,0], "J", "@E"]`, `[[...], 2, -2]`            |
//! | VARIANT array: index, type, pass   | `[1, "P", "@E"]`                                             |
//! | array of 7, 8 or 10 numbers        | P, J or T by their count                                     |
//! | a vector, 3 numbers                | `"V1"`, `"V(1,2,3)"`, `[1, "V"]`, `[[1,2,3], 3]`, an array   |
//! | a length or an angle               | `30`, `"@P 30"`, `[30, "", "@P"]`, `[30, -1, -1]`            |
//!
//! Types are 0 P, 1 T, 2 J, 3 V, -1 or `""` no type. A pose without a type is a P. The pass is `@P` (-1), `@E` (-2), `@C`, `@0`
//! or `@n`, and `""` no pass; [`arm`](crate::arm) describes its effect. A J may have four numbers or more; the others are 0. As
//! text it may also precede the type, as in a public sample program: `[[...], "@E", "P"]`. If a P has no Fig or a negative one,
//! the arm takes the nearest posture.
//!
//! An arc has two poses in one text, `"P1, @E P2"`: the point on the circle, and the end.
//!
//! Extended joints may follow the pose: `"P1 EX((7, 30.5))"`, or `[1, [7, 30.5]]` as the fourth element. With 1 or EX
//! the values are relative to the position of the axis, with 2 or EXA to its zero.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::{Array, Variant};

use crate::drive::Drive;
use crate::kinematics::{Frame, Geometry, Joints, OutOfReach};
use crate::options::{Pass, pass_item, split_outside_brackets, split_pass};
use crate::value::{number, numbers, numbers_of_text, one_int, whole};
use crate::variables::{Family, Variables, parse_name};

/// The target of a motion command.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Target {
    pub(crate) pose: Pose,
    /// The turns of extended joints.
    pub(crate) extended: Option<Drive>,
    pub(crate) pass: Pass,
}

/// A pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Pose {
    Joints(Joints),
    /// A frame of the flange, and the Fig; `None` for the nearest posture.
    Frame(Frame, Option<u8>),
}

impl Target {
    /// Reads a motion command's pose, its pass, and the turns of extended joints that follow it.
    pub(crate) fn parse(value: &Variant<'_>, vars: &Variables) -> Result<Self, HResult> {
        match value.flatten() {
            Variant::Bstr(text) => Self::parse_text(&text.to_string(), vars),
            Variant::Array(array) if (1..=4).contains(&array.len()) => {
                let (pose, pass) = Pose::parse_items(array, vars)?;
                let more = array.get(3).unwrap_or(Variant::Empty).flatten();
                let extended = if more.is_empty() { None } else { Some(Drive::parse_extended(&more)?) };
                Ok(Self { pose, extended, pass })
            }
            Variant::Array(array) => {
                let pose = Pose::new(kind_of(array.len())?, &numbers(value)?)?;
                Ok(Self { pose, extended: None, pass: Pass::Stop })
            }
            _ => Err(HResult::E_INVALIDARGTYPE),
        }
    }

    /// Reads two poses of the same type, in text (`P1, @E P2`) or in an array; the second one has the pass.
    pub(crate) fn parse_two(value: &Variant<'_>, vars: &Variables) -> Result<(Pose, Self), HResult> {
        let (via, end) = match value.flatten() {
            Variant::Bstr(text) => {
                let text = text.to_string();
                let mut poses = split_outside_brackets(&text);
                let (Some(via), Some(end), None) = (poses.next(), poses.next(), poses.next()) else {
                    return Err(HResult::E_INVALIDARG);
                };
                (Self::parse_text(via, vars)?, Self::parse_text(end, vars)?)
            }
            Variant::Array(array) if array.len() == 2 => {
                let item = |n| array.get(n).unwrap_or(Variant::Empty);
                (Self::parse(&item(0), vars)?, Self::parse(&item(1), vars)?)
            }
            _ => return Err(HResult::E_INVALIDARGTYPE),
        };
        let is_same =
            matches!((&via.pose, &end.pose), (Pose::Joints(_), Pose::Joints(_)) | (Pose::Frame(..), Pose::Frame(..)));
        match (via, end) {
            (Self { pose, extended: None, pass: Pass::Stop }, end @ Self { extended: None, .. }) if is_same => {
                Ok((pose, end))
            }
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Returns whether a value has a pass of any kind, even one that stops.
    pub(crate) fn has_pass(value: &Variant<'_>) -> bool {
        let is_pass =
            |item: &Variant<'_>| matches!(item, Variant::Bstr(text) if text.to_string().trim().starts_with('@'));
        match value.flatten() {
            Variant::Array(array) => (0..3).any(|n| is_pass(&array.get(n).unwrap_or(Variant::Empty).flatten())),
            value => is_pass(&value),
        }
    }

    fn parse_text(text: &str, vars: &Variables) -> Result<Self, HResult> {
        let (pass, text) = split_pass(text)?;
        let (text, extended) = match text.to_ascii_uppercase().find("EX") {
            Some(n) => (&text[..n], Some(Drive::parse_extended_text(&text[n..])?)),
            None => (text, None),
        };
        Ok(Self { pose: Pose::parse_text(text.trim(), vars)?, extended, pass })
    }
}

impl Pose {
    /// Creates a pose from the numbers of a P, J or T.
    pub(crate) fn new(kind: Kind, numbers: &[f64]) -> Result<Self, HResult> {
        if numbers.iter().any(|n| !n.is_finite()) {
            return Err(HResult::E_INVALIDARG);
        }
        match (kind, numbers) {
            (Kind::P, [x, y, z, rx, ry, rz, fig @ ..]) => {
                Ok(Self::Frame(Frame::from_xyz_rpy([*x, *y, *z, *rx, *ry, *rz]), figure(fig)?))
            }
            (Kind::J, [j1, j2, j3, j4, j5, j6, more @ ..]) if more.len() <= 2 => {
                // J7 and J8 move by EX and EXA only
                if more.iter().any(|n| *n != 0.0) {
                    return Err(HResult::E_INVALIDARG);
                }
                Ok(Self::Joints([*j1, *j2, *j3, *j4, *j5, *j6]))
            }
            (Kind::J, [j1, j2, j3, j4, more @ ..]) => {
                Ok(Self::Joints([*j1, *j2, *j3, *j4, more.first().copied().unwrap_or(0.0), 0.0]))
            }
            (Kind::T, [t @ .., _]) if numbers.len() == 10 => Self::transform(t, figure(&numbers[9..])?),
            (Kind::T, t) => Self::transform(t, None),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    fn transform(numbers: &[f64], fig: Option<u8>) -> Result<Self, HResult> {
        let t = numbers.try_into().map_err(|_| HResult::E_INVALIDARG)?;
        Ok(Self::Frame(Frame::from_trans(t).ok_or(HResult::E_INVALIDARG)?, fig))
    }

    /// Reads a pose alone.
    pub(crate) fn parse(value: &Variant<'_>, vars: &Variables) -> Result<Self, HResult> {
        match Target::parse(value, vars)? {
            Target { pose, extended: None, .. } => Ok(pose),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Reads a command's parameter that is a pose of one kind: numbers alone, or any form of a motion's pose.
    pub(crate) fn parse_as(kind: Kind, value: &Variant<'_>, vars: &Variables) -> Result<Self, HResult> {
        match value.flatten() {
            Variant::Array(array) if array.len() > 4 => Self::new(kind, &numbers(value)?),
            _ => Self::parse(value, vars),
        }
    }

    fn parse_text(text: &str, vars: &Variables) -> Result<Self, HResult> {
        if let Some((family, Some(index))) = parse_name(text) {
            return Self::of_variable(family, index, vars);
        }
        if let Ok(index) = text.parse() {
            return Self::of_variable(Family::Plain(Kind::P), index, vars);
        }
        let (letter, list) = text.split_once('(').ok_or(HResult::E_INVALIDARG)?;
        let list = list.trim_end().strip_suffix(')').ok_or(HResult::E_INVALIDARG)?;
        Self::new(kind_of_letter(letter)?, &numbers_of_text(list)?)
    }

    /// Reads `[numbers or index, type, pass]`, or the pass before the type; ignores a fourth element.
    fn parse_items(array: Array<'_>, vars: &Variables) -> Result<(Self, Pass), HResult> {
        let item = |n| array.get(n).unwrap_or(Variant::Empty).flatten();
        let has_pass = |item: &Variant<'_>| matches!(item, Variant::Bstr(text) if text.to_string().starts_with('@'));
        let (kind, pass) = if has_pass(&item(1)) { (item(2), item(1)) } else { (item(1), item(2)) };
        let pass = pass_item(&pass)?;
        let kind = match kind {
            Variant::Empty | Variant::Null => None,
            Variant::Bstr(letter) if letter.to_string().trim().is_empty() => None,
            Variant::Bstr(letter) => Some(kind_of_letter(&letter.to_string())?),
            number => match number.as_i32() {
                Some(0) => Some(Kind::P),
                Some(1) => Some(Kind::T),
                Some(2) => Some(Kind::J),
                Some(-1) => None,
                _ => return Err(HResult::E_INVALIDARG),
            },
        };
        match (item(0), kind) {
            (Variant::Array(list), kind) => {
                let list = numbers(&Variant::Array(list))?;
                Ok((Self::new(kind.map_or_else(|| kind_of(list.len()), Ok)?, &list)?, pass))
            }
            (Variant::Bstr(text), None) => {
                let text = text.to_string();
                let (own, text) = split_pass(&text)?;
                Ok((Self::parse_text(text, vars)?, if own == Pass::Stop { pass } else { own }))
            }
            (index, kind) => {
                let kind = kind.unwrap_or(Kind::P);
                let index = whole(number(&index).ok_or(HResult::E_INVALIDARGTYPE)?)?;
                let index = u32::try_from(index).map_err(|_| HResult::DISP_E_BADINDEX)?;
                Ok((Self::of_variable(Family::Plain(kind), index, vars)?, pass))
            }
        }
    }

    fn of_variable(family: Family, index: u32, vars: &Variables) -> Result<Self, HResult> {
        match family {
            Family::Plain(kind @ (Kind::P | Kind::J | Kind::T)) => Self::new(kind, &vars.pose(kind, index)?),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Returns the joints of the pose; for a frame, the joints nearest to `near`.
    pub(crate) fn joints(&self, arm: &Geometry, near: &Joints) -> Result<Joints, OutOfReach> {
        match self {
            Self::Joints(joints) => match arm.out_of_range(joints) {
                None => Ok(*joints),
                Some(error) => Err(error),
            },
            Self::Frame(frame, Some(fig)) => arm.inverse(frame, *fig, near),
            Self::Frame(frame, None) => arm.inverse_nearest(frame, near),
        }
    }
}

/// Reads a vector: a point of a motion, or a size.
pub(crate) fn vector(value: &Variant<'_>, vars: &Variables) -> Result<[f64; 3], HResult> {
    Ok(vector_and_pass(value, vars)?.0)
}

/// Reads a vector and its pass.
pub(crate) fn vector_and_pass(value: &Variant<'_>, vars: &Variables) -> Result<([f64; 3], Pass), HResult> {
    let (numbers, pass) = match value.flatten() {
        Variant::Bstr(text) => {
            let text = text.to_string();
            let (pass, text) = split_pass(&text)?;
            (vector_of_text(text, vars)?, pass)
        }
        // the three numbers, unless they are an index, the type and the pass
        Variant::Array(array) if array.len() == 3 && !is_vector_type(array.get(1)) => (numbers(value)?, Pass::Stop),
        Variant::Array(array) => {
            let item = |n| array.get(n).unwrap_or(Variant::Empty).flatten();
            let numbers = match item(0) {
                Variant::Bstr(text) => vector_of_text(text.to_string().trim(), vars)?,
                list @ Variant::Array(_) => numbers(&list)?,
                index => vars.pose(Kind::V, u32::try_from(one_int(&index)?).map_err(|_| HResult::DISP_E_BADINDEX)?)?,
            };
            if !item(1).is_empty() && !is_vector_type(array.get(1)) {
                return Err(HResult::E_INVALIDARG);
            }
            (numbers, pass_item(&item(2))?)
        }
        _ => return Err(HResult::E_INVALIDARGTYPE),
    };
    let vector: [f64; 3] = numbers.try_into().map_err(|_| HResult::E_INVALIDARG)?;
    if vector.iter().all(|n| n.is_finite()) { Ok((vector, pass)) } else { Err(HResult::E_INVALIDARG) }
}

/// Returns whether an element of an array is the type V.
fn is_vector_type(item: Option<Variant<'_>>) -> bool {
    match item.map(|item| item.flatten()) {
        Some(Variant::Bstr(text)) => text.to_string().trim().eq_ignore_ascii_case("V"),
        Some(Variant::I4(kind)) => kind == 3,
        _ => false,
    }
}

/// Reads `V(1, 2, 3)`, or a variable V.
fn vector_of_text(text: &str, vars: &Variables) -> Result<Vec<f64>, HResult> {
    match parse_name(text) {
        Some((Family::Plain(Kind::V), Some(index))) => vars.pose(Kind::V, index),
        Some(_) => Err(HResult::E_INVALIDARG),
        None => {
            let list = text.strip_prefix(['V', 'v']).unwrap_or(text).trim().strip_prefix('(');
            numbers_of_text(list.and_then(|rest| rest.strip_suffix(')')).ok_or(HResult::E_INVALIDARG)?)
        }
    }
}

/// Reads three vectors: `"V1, V2, V3"` with commas or blanks, or an array of them.
pub(crate) fn three_vectors(value: &Variant<'_>, vars: &Variables) -> Result<[[f64; 3]; 3], HResult> {
    let vectors: Vec<_> = match value.flatten() {
        Variant::Bstr(text) => {
            let text = text.to_string();
            // a blank separates two vectors, but not the numbers of one
            let mut depth = 0_i32;
            let separated: String = text
                .chars()
                .map(|c| {
                    depth += i32::from(c == '(') - i32::from(c == ')');
                    if c.is_whitespace() && depth <= 0 { ',' } else { c }
                })
                .collect();
            let points = split_outside_brackets(&separated).filter(|point| !point.is_empty());
            points.map(|point| vector_of_text(point, vars)?.try_into().map_err(|_| HResult::E_INVALIDARG)).collect()
        }
        Variant::Array(array) if array.len() == 3 => array.iter().map(|item| vector(&item, vars)).collect(),
        _ => Err(HResult::E_INVALIDARG),
    }?;
    vectors.try_into().map_err(|_| HResult::E_INVALIDARG)
}

/// Reads a length in mm, or an angle in degrees, and its pass.
pub(crate) fn length_and_pass(value: &Variant<'_>) -> Result<(f64, Pass), HResult> {
    let (length, pass) = match value.flatten() {
        Variant::Bstr(text) => {
            let text = text.to_string();
            let (pass, length) = split_pass(&text)?;
            (length.parse().map_err(|_| HResult::E_INVALIDARG)?, pass)
        }
        Variant::Array(array) if array.len() <= 3 => {
            let item = |n: usize| array.get(n).unwrap_or(Variant::Empty).flatten();
            let has_type = match item(1) {
                Variant::Empty | Variant::Null => false,
                Variant::Bstr(text) => !text.to_string().trim().is_empty(),
                kind => kind.as_i32() != Some(-1),
            };
            if has_type {
                return Err(HResult::E_INVALIDARG);
            }
            match item(0) {
                text @ Variant::Bstr(_) if array.len() == 1 => return length_and_pass(&text),
                length => (number(&length).ok_or(HResult::E_INVALIDARGTYPE)?, pass_item(&item(2))?),
            }
        }
        other => (number(&other).ok_or(HResult::E_INVALIDARGTYPE)?, Pass::Stop),
    };
    if length.is_finite() { Ok((length, pass)) } else { Err(HResult::E_INVALIDARG) }
}

/// A bit of the Fig that programs of a COBOTTA send, and read from it, as in 261; no source has its meaning.
const FIG_OF_COBOTTA: f64 = 256.0;

/// Reads the rest after the coordinates: nothing, a Fig of 0 to 31, optionally with [`FIG_OF_COBOTTA`], or a negative number
/// for any Fig.
fn figure(rest: &[f64]) -> Result<Option<u8>, HResult> {
    match rest {
        [] => Ok(None),
        [fig] if *fig < 0.0 => Ok(None),
        [fig] if fig.fract() == 0.0 && (0.0..32.0).contains(&(fig % FIG_OF_COBOTTA)) && *fig < 2.0 * FIG_OF_COBOTTA => {
            Ok(Some((fig % FIG_OF_COBOTTA) as u8))
        }
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn kind_of(len: usize) -> Result<Kind, HResult> {
    match len {
        6 | 7 => Ok(Kind::P),
        8 => Ok(Kind::J),
        10 => Ok(Kind::T),
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn kind_of_letter(letter: &str) -> Result<Kind, HResult> {
    match letter.trim() {
        "P" | "p" | "" => Ok(Kind::P),
        "J" | "j" => Ok(Kind::J),
        "T" | "t" => Ok(Kind::T),
        _ => Err(HResult::E_INVALIDARG),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variables::Sizes;
    use bcap_core::variant::{Encode, VariantBuf};

    const JOINTS: Joints = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];

    fn parse(value: &impl Encode) -> Result<Pose, HResult> {
        let mut vars = Variables::new(&Sizes::default());
        let j1 = VariantBuf::<64>::new(&[0.0_f32, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]).unwrap();
        vars.put(Family::Plain(Kind::J), 1, &j1.as_variant()).unwrap();
        Pose::parse(&VariantBuf::<256>::new(value).unwrap().as_variant(), &vars)
    }

    #[test]
    fn every_form_of_a_pose_is_read() {
        let same = Ok(Pose::Joints(JOINTS));
        for text in ["J1", "@E J1", "@0 j[1]", " @P  J( 0, 45,90,0,45,0 )", "J(0,45,90,0,45,0,0,0)"] {
            assert_eq!(parse(&text), same, "{text}");
        }
        assert_eq!(parse(&(JOINTS, "J", "@E")), same);
        assert_eq!(parse(&(JOINTS, 2, -2)), same);
        assert_eq!(parse(&(1, "J", "@E")), same);
        assert_eq!(parse(&(1, 2)), same);
        assert_eq!(parse(&[0.0_f32, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]), same);
        let Ok(Pose::Frame(_, fig)) = parse(&"P(1,2,3,4,5,6,7)") else { panic!("no frame") };
        assert_eq!(fig, Some(7));
        assert!(matches!(parse(&"P(1,2,3,4,5,6,-1)"), Ok(Pose::Frame(_, None))));
        assert!(matches!(parse(&([1.0_f64, 2.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 5.0], 1, 0)), Ok(Pose::Frame(..))));
    }

    #[test]
    fn invalid_poses_are_refused() {
        for text in ["", "X1", "J", "@E", "@X J1", "I1", "J(1,2)", "J(0,45,90,0,45,0,1)", "P(1,2,3,4,5,6,32)", "V1"] {
            assert_eq!(parse(&text), Err(HResult::E_INVALIDARG), "{text}");
        }
        assert_eq!(parse(&"J(a,b,c,d,e,f)"), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(parse(&"J(0,45,90,0,45,nan)"), Err(HResult::E_INVALIDARG));
        assert_eq!(parse(&"J100"), Err(HResult::DISP_E_BADINDEX));
        assert_eq!(parse(&1), Err(HResult::E_INVALIDARGTYPE));
        assert_eq!(parse(&(JOINTS, "J", "@E", (3, [7, 1]))), Err(HResult::E_INVALIDARG));
        assert_eq!(parse(&(JOINTS, "J", "@E", (1, [6, 1]))), Err(HResult::E_INVALIDARG));
        assert_eq!(parse(&(JOINTS, "J", "@E", 1)), Err(HResult::E_INVALIDARGTYPE));
        assert_eq!(parse(&(JOINTS, "V")), Err(HResult::E_INVALIDARG));
        assert_eq!(parse(&[1.0_f64; 5]), Err(HResult::E_INVALIDARG));
    }
}
