//! Values of answers, and the readers of parameters.
//!
//! The controller keeps and answers every value as an [`OwnedVariant`]: one encoding, made once, which the reply copies.

use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, OwnedVariant, Variant};

/// A value, or the code with which its call is refused.
pub(crate) type ValueResult = Result<OwnedVariant, HResult>;

/// Encodes a value with the VARTYPE of its Rust type.
///
/// # Errors
///
/// `E_TOO_MUCH_DATA` when no frame can carry the value.
pub(crate) fn owned(value: impl Encode) -> ValueResult {
    OwnedVariant::new(&value).map_err(|_| HResult::E_TOO_MUCH_DATA)
}

/// The largest encoding of a tag, an ID or the parameters of a command, in bytes. Every object may have them.
const KEPT_MAX: usize = 4096;

/// Copies a client's value of any type.
pub(crate) fn keep(value: &Variant<'_>) -> ValueResult {
    let copy = OwnedVariant::new(value).map_err(|_| HResult::E_INVALIDARGTYPE)?;
    if copy.as_bytes().len() <= KEPT_MAX { Ok(copy) } else { Err(HResult::E_OUTOFMEMORY) }
}

/// The largest array and the largest text that a command accepts as numbers: reading them delays all other calls.
const NUMBERS_MAX: usize = 256;
const TEXT_MAX: usize = 4096;

/// Reads a number of any numeric type but CY.
pub(crate) fn number(value: &Variant<'_>) -> Option<f64> {
    value.as_f64().or_else(|| value.as_i64().map(|n| n as f64))
}

/// Reads a number of a command without loss; TRUE is -1, as OLE Automation converts it.
pub(crate) fn command_number(value: &Variant<'_>) -> Result<f64, HResult> {
    let value = value.flatten();
    if let Variant::Bool(b) = value {
        return Ok(if b { -1.0 } else { 0.0 });
    }
    let wide = number(&value).ok_or(HResult::E_INVALIDARGTYPE)?;
    match value.as_i64() {
        // i64::MAX rounds up to 2^63, and from there back to itself
        Some(n) if n == i64::MAX || wide as i64 != n => Err(HResult::DISP_E_OVERFLOW),
        _ => Ok(wide),
    }
}

/// Reads the numbers of a command's parameter: one number, an array of numbers, text with commas as in `"1,0"`, or
/// nothing at all. The elements of an array of VARIANT may have different types.
pub(crate) fn numbers(value: &Variant<'_>) -> Result<Vec<f64>, HResult> {
    match value.flatten() {
        Variant::Empty | Variant::Null => Ok(Vec::new()),
        Variant::Bstr(text) if text.as_bytes().len() <= TEXT_MAX => numbers_of_text(&text.to_string()),
        Variant::Bstr(_) => Err(HResult::E_INVALIDARG),
        array @ Variant::Array(_) => numbers_of_array(&array),
        other => Ok(vec![command_number(&other)?]),
    }
}

/// Reads an array of numbers, which may be VARIANTs of different types, and nothing else.
pub(crate) fn numbers_of_array(value: &Variant<'_>) -> Result<Vec<f64>, HResult> {
    match value.flatten() {
        Variant::Array(array) if array.len() <= NUMBERS_MAX => array.iter().map(|item| command_number(&item)).collect(),
        Variant::Array(_) => Err(HResult::E_INVALIDARG),
        _ => Err(HResult::E_INVALIDARGTYPE),
    }
}

/// Reads numbers between commas; no text, no numbers.
pub(crate) fn numbers_of_text(text: &str) -> Result<Vec<f64>, HResult> {
    if text.trim().is_empty() {
        return Ok(Vec::new());
    }
    text.split(',').map(|part| part.trim().parse().map_err(|_| HResult::DISP_E_TYPEMISMATCH)).collect()
}

/// Returns a number that must be whole and fit 32 bits.
pub(crate) fn whole(number: f64) -> Result<i32, HResult> {
    if !number.is_finite() || number.fract() != 0.0 {
        return Err(HResult::DISP_E_TYPEMISMATCH);
    }
    if number < f64::from(i32::MIN) || number > f64::from(i32::MAX) {
        return Err(HResult::DISP_E_OVERFLOW);
    }
    Ok(number as i32)
}

/// The values that [`truth`] accepts.
pub(crate) const TRUTH: &str = "BOOL, or an integer: 0 is off";

pub(crate) fn truth(value: &Variant<'_>) -> Result<bool, HResult> {
    value.flatten().as_bool().ok_or(HResult::E_INVALIDARGTYPE)
}

/// Reads a parameter that is exactly one whole number.
pub(crate) fn one_int(value: &Variant<'_>) -> Result<i32, HResult> {
    match numbers(value)?.as_slice() {
        [n] => whole(*n),
        _ => Err(HResult::E_INVALIDARG),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::VariantBuf;

    fn parse(value: &impl Encode) -> Result<Vec<f64>, HResult> {
        numbers(&VariantBuf::<128>::new(value).unwrap().as_variant())
    }

    #[test]
    fn parameters_come_as_numbers_arrays_or_text() {
        assert_eq!(parse(&()), Ok(vec![]));
        assert_eq!(parse(&1_i16), Ok(vec![1.0]));
        assert_eq!(parse(&[1, 0]), Ok(vec![1.0, 0.0]));
        assert_eq!(parse(&(1, 2.5_f64)), Ok(vec![1.0, 2.5]));
        assert_eq!(parse(&(10_i16, true)), Ok(vec![10.0, -1.0]));
        assert_eq!(parse(&((1_u8, false), 2.5_f32)), Err(HResult::E_INVALIDARGTYPE));
        assert_eq!(parse(&"1, 0"), Ok(vec![1.0, 0.0]));
        assert_eq!(parse(&""), Ok(vec![]));
        assert_eq!(parse(&"x"), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(parse(&["1"]), Err(HResult::E_INVALIDARGTYPE));
    }

    #[test]
    fn an_integer_that_would_lose_digits_is_refused() {
        assert_eq!(parse(&(1_i64 << 53)), Ok(vec![9_007_199_254_740_992.0]));
        assert_eq!(parse(&((1_i64 << 53) + 1)), Err(HResult::DISP_E_OVERFLOW));
        assert_eq!(parse(&i64::MAX), Err(HResult::DISP_E_OVERFLOW));
        assert_eq!(parse(&i64::MIN), Ok(vec![-9_223_372_036_854_775_808.0]));
    }

    #[test]
    fn kept_values_come_back_whole() {
        let long = "x".repeat(1000);
        let value = VariantBuf::<4096>::new(&(1, long.as_str(), [1.5_f64])).unwrap();
        assert_eq!(keep(&value.as_variant()).unwrap().as_bytes(), value.as_bytes());
    }

    #[test]
    fn a_value_above_4096_bytes_is_not_kept() {
        let bytes = |count: usize| owned(vec![7_u8; count]).unwrap();
        let largest = bytes(KEPT_MAX - 6);
        assert_eq!(keep(&largest.as_variant()), Ok(largest.clone()));
        assert_eq!(keep(&bytes(KEPT_MAX - 5).as_variant()), Err(HResult::E_OUTOFMEMORY));
    }

    #[test]
    fn whole_numbers_are_range_checked() {
        assert_eq!(whole(-3.0), Ok(-3));
        assert_eq!(whole(0.5), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(whole(f64::NAN), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(whole(3e9), Err(HResult::DISP_E_OVERFLOW));
    }
}
