//! Turns of single axes: DriveEx, DriveAEx and Robot_Drive, and the extended joints of Robot_Move.
//!
//! | form                                    | example                                                   |
//! |-----------------------------------------|-----------------------------------------------------------|
//! | BSTR: pass, pairs of axis and value     | `"@E (1, 5), (2, 5)"`, `"(7, -15)"`                       |
//! | VARIANT array: pairs                    | `[[[1, 5], -1, -2], [[2, -5], -1, 0]]`, `[[1, 5], [2, 5]]`, `[[1, 5], -1, -2]` |
//! | Robot_Move, BSTR: after the pose        | `"@P P1 EX((7, 30.5))"`, `"P1 EXA((7, 10), (8, 5))"`      |
//! | Robot_Move, VARIANT array: 4th element  | `[2, [7, 10]]`, `["EXA", [7, 10]]`                        |
//!
//! EX (1) and DriveEx are relative to the position of the axis, EXA (2) and DriveAEx to its zero. The values of a pair
//! are in degrees or mm. In the array, each pair is an array of two numbers, alone or with the type (-1) and the pass that the
//! public ROS 2 driver sends. Robot_Move turns only the extended joints, 7 and 8, this way.

use bcap_core::hresult::HResult;
use bcap_core::variant::{Array, Variant};

use crate::kinematics::Axes;
use crate::options::{Pass, pass_item, split_pass};
use crate::value::{numbers_of_array, numbers_of_text, whole};

/// The largest number of axes of an arm, and the first extended axis.
const AXES: usize = 8;
const FIRST_EXTENDED: usize = 7;

/// Turns of single axes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Drive {
    /// The values are relative to the zero of the axis; otherwise to its position.
    absolute: bool,
    /// The axis, 1 to 8, and its value; each axis once.
    turns: Vec<(usize, f64)>,
    /// The pass of the text, or of the last pair of an array.
    pub(crate) pass: Pass,
}

impl Drive {
    /// Makes the turn of one axis relative to its position.
    pub(crate) fn relative(axis: i32, value: f64) -> Result<Self, HResult> {
        Self::new(false, vec![(f64::from(axis), value)])
    }

    fn new(absolute: bool, pairs: Vec<(f64, f64)>) -> Result<Self, HResult> {
        let mut turns: Vec<(usize, f64)> = Vec::new();
        for (axis, value) in pairs {
            let axis = usize::try_from(whole(axis)?).map_err(|_| HResult::E_INVALIDARG)?;
            let again = turns.iter().any(|(known, _)| *known == axis);
            if !(1..=AXES).contains(&axis) || again || !value.is_finite() {
                return Err(HResult::E_INVALIDARG);
            }
            turns.push((axis, value));
        }
        if turns.is_empty() { Err(HResult::E_INVALIDARG) } else { Ok(Self { absolute, turns, pass: Pass::Stop }) }
    }

    /// Reads the pairs of DriveEx or DriveAEx.
    pub(crate) fn parse(absolute: bool, value: &Variant<'_>) -> Result<Self, HResult> {
        match value.flatten() {
            Variant::Bstr(text) => {
                let text = text.to_string();
                let (pass, pairs) = split_pass(&text)?;
                Ok(Self { pass, ..Self::new(absolute, pairs_of_text(pairs)?)? })
            }
            // one pair alone
            Variant::Array(array) if is_pair(array) => Self::new(absolute, vec![pair(&value.flatten())?]),
            Variant::Array(array) if array.len() > AXES => Err(HResult::E_INVALIDARG),
            // one pair with its type and its pass
            Variant::Array(array) if array.len() > 1 && !is_array(&array.get(1).unwrap_or(Variant::Empty)) => {
                let (turn, pass) = pair_item(&value.flatten())?;
                Ok(Self { pass, ..Self::new(absolute, vec![turn])? })
            }
            Variant::Array(array) => {
                let pairs: Vec<_> = array.iter().map(|item| pair_item(&item)).collect::<Result<_, _>>()?;
                let pass = pairs.last().map(|(_, pass)| *pass).unwrap_or_default();
                Ok(Self { pass, ..Self::new(absolute, pairs.into_iter().map(|(pair, _)| pair).collect())? })
            }
            _ => Err(HResult::E_INVALIDARGTYPE),
        }
    }

    /// Reads the extended joints after a pose in text: `EX((7,1))` or `EXA((7,1),(8,2))`.
    pub(crate) fn parse_extended_text(text: &str) -> Result<Self, HResult> {
        let upper = text.trim().to_ascii_uppercase();
        let rest = upper.strip_prefix("EX").ok_or(HResult::E_INVALIDARG)?;
        let (absolute, list) = rest.strip_prefix('A').map_or((false, rest), |list| (true, list));
        let inner = list.trim().strip_prefix('(').and_then(|list| list.strip_suffix(')'));
        let pairs = match inner.ok_or(HResult::E_INVALIDARG)?.trim() {
            // one pair in the brackets of the list, as an example of the guide has it
            pair if !pair.is_empty() && !pair.starts_with('(') => pairs_of_text(&format!("({pair})"))?,
            pairs => pairs_of_text(pairs)?,
        };
        Self::new(absolute, pairs)?.extended_only()
    }

    /// Reads the extended joints of a pose in an array: the mode, then the pairs.
    pub(crate) fn parse_extended(value: &Variant<'_>) -> Result<Self, HResult> {
        let Variant::Array(array) = value.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
        if array.len() > AXES {
            return Err(HResult::E_INVALIDARG);
        }
        let mut items = array.iter();
        let absolute = match items.next().map(|mode| mode.flatten()) {
            Some(Variant::Bstr(mode)) if mode.to_string().trim().eq_ignore_ascii_case("EX") => false,
            Some(Variant::Bstr(mode)) if mode.to_string().trim().eq_ignore_ascii_case("EXA") => true,
            Some(mode) if mode.as_i32() == Some(1) => false,
            Some(mode) if mode.as_i32() == Some(2) => true,
            _ => return Err(HResult::E_INVALIDARG),
        };
        Self::new(absolute, items.map(|item| pair(&item)).collect::<Result<_, _>>()?)?.extended_only()
    }

    fn extended_only(self) -> Result<Self, HResult> {
        match self.turns.iter().all(|(axis, _)| *axis >= FIRST_EXTENDED) {
            true => Ok(self),
            false => Err(HResult::E_INVALIDARG),
        }
    }

    /// Checks that an arm with this number of joints and of extended axes has all axes of the turns.
    pub(crate) fn check(&self, joints: usize, extended: u8) -> Result<(), HResult> {
        let axes = FIRST_EXTENDED - 1 + usize::from(extended);
        let exists = |axis: usize| axis <= joints || (FIRST_EXTENDED..=axes).contains(&axis);
        match self.turns.iter().all(|(axis, _)| exists(*axis)) {
            true => Ok(()),
            false => Err(HResult::E_INVALIDARG),
        }
    }

    /// Returns the position of the axes after the turns.
    pub(crate) fn apply(&self, here: &Axes) -> Axes {
        let mut axes = *here;
        for (axis, value) in &self.turns {
            let place = &mut axes[axis - 1];
            *place = if self.absolute { *value } else { *place + value };
        }
        axes
    }
}

/// Reads one element of the list of DriveEx: a pair alone, or with its type and its pass.
fn pair_item(item: &Variant<'_>) -> Result<((f64, f64), Pass), HResult> {
    let item = item.flatten();
    let Variant::Array(array) = item else { return Err(HResult::E_INVALIDARGTYPE) };
    if is_pair(array) {
        return Ok((pair(&item)?, Pass::Stop));
    }
    let pass = pass_item(&array.get(2).unwrap_or(Variant::Empty))?;
    Ok((pair(&array.get(0).ok_or(HResult::E_INVALIDARG)?)?, pass))
}

fn is_array(value: &Variant<'_>) -> bool {
    matches!(value.flatten(), Variant::Array(_))
}

/// Returns whether an array is a pair itself, not a list of them.
fn is_pair(array: Array<'_>) -> bool {
    array.len() == 2 && !array.iter().any(|item| matches!(item.flatten(), Variant::Array(_) | Variant::Bstr(_)))
}

fn pair(value: &Variant<'_>) -> Result<(f64, f64), HResult> {
    match numbers_of_array(value)?[..] {
        [axis, value] => Ok((axis, value)),
        _ => Err(HResult::E_INVALIDARG),
    }
}

/// Reads `(1, 5), (2, 5)`.
fn pairs_of_text(text: &str) -> Result<Vec<(f64, f64)>, HResult> {
    let mut pairs = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        if pairs.len() == AXES {
            return Err(HResult::E_INVALIDARG);
        }
        let (list, more) = rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or(HResult::E_INVALIDARG)?;
        let [axis, value] = numbers_of_text(list)?[..] else { return Err(HResult::E_INVALIDARG) };
        pairs.push((axis, value));
        rest = match more.trim_start().strip_prefix(',') {
            Some(next) if next.trim().is_empty() => return Err(HResult::E_INVALIDARG),
            Some(next) => next.trim_start(),
            None if more.trim().is_empty() => "",
            None => return Err(HResult::E_INVALIDARG),
        };
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::{Encode, VariantBuf};

    const HERE: Axes = [10.0, 20.0, 30.0, 0.0, 0.0, 0.0, 7.0, 8.0];

    fn drive(absolute: bool, value: &impl Encode) -> Result<Axes, HResult> {
        let value = VariantBuf::<512>::new(value).unwrap();
        Drive::parse(absolute, &value.as_variant()).map(|drive| drive.apply(&HERE))
    }

    #[test]
    fn every_form_of_the_pairs_is_read() {
        let moved = Ok([15.0, 15.0, 30.0, 0.0, 0.0, 0.0, 7.0, 8.0]);
        for text in ["(1,5),(2,-5)", "@E (1, 5), (2, -5)", " @0 ( 1 ,5.0 ) ,(2,-5) "] {
            assert_eq!(drive(false, &text), moved, "{text}");
        }
        // as the ROS 2 driver sends it, and with numbers of different types
        assert_eq!(drive(false, &(([1.0_f32, 5.0], -1, -2), ([2.0_f32, -5.0], -1, 0))), moved);
        assert_eq!(drive(false, &((1, 5.0_f64), (2_u8, -5_i16))), moved);
        assert_eq!(drive(true, &[8, 1]), Ok([10.0, 20.0, 30.0, 0.0, 0.0, 0.0, 7.0, 1.0]));
    }

    #[test]
    fn invalid_pairs_are_refused() {
        for text in
            ["", "1,5", "(1,5", "(1,5)(2,5)", "(1,5),", "(1)", "(9,1)", "(0,1)", "(1,5),(1,6)", "@X (1,5)", "(1,inf)"]
        {
            assert_eq!(drive(false, &text), Err(HResult::E_INVALIDARG), "{text}");
        }
        assert_eq!(drive(false, &"(a,5)"), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(drive(false, &"(1.5,5)"), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(drive(false, &5), Err(HResult::E_INVALIDARGTYPE));
        assert_eq!(drive(false, &((1, 5, 6), 2)), Err(HResult::E_INVALIDARG));
        assert_eq!(drive(false, &(5, 6, 7)), Err(HResult::E_INVALIDARGTYPE));
    }

    #[test]
    fn extended_joints_are_read_from_text() {
        let apply = |text| Drive::parse_extended_text(text).map(|drive| drive.apply(&HERE)[6..].to_vec());
        assert_eq!(apply("EX((7,30.5))"), Ok(vec![37.5, 8.0]));
        assert_eq!(apply("exa( (7,10) , (8,5) )"), Ok(vec![10.0, 5.0]));
        assert_eq!(apply("EXA(7, 30.5)"), Ok(vec![30.5, 8.0]));
        for text in ["EX(7)", "EX", "EXB((7,1))", "EX((6,1))", "EX()"] {
            assert_eq!(apply(text), Err(HResult::E_INVALIDARG), "{text}");
        }
    }
}
