//! Owned values, as the controller keeps and answers them; and the readers of parameters.

use bcap_core::error::EncodeError;
use bcap_core::handler::ReplyValue;
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Bstr, Encode, OleDate, Variant, Writer};

/// A value that owns its data; it is encoded as the VARTYPE of its name.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Empty,
    I2(i16),
    I4(i32),
    Ui1(u8),
    R4(f32),
    R8(f64),
    Bool(bool),
    Date(OleDate),
    Text(String),
    /// A client's string, as its UTF-16LE bytes, so that invalid UTF-16 is not lost.
    Bstr(Vec<u8>),
    Ui1s(Vec<u8>),
    I4s(Vec<i32>),
    R4s(Vec<f32>),
    R8s(Vec<f64>),
    Texts(Vec<String>),
    /// An array of VARIANT.
    List(Vec<Value>),
    /// A client's value of any type, as [`keep`] encoded it.
    Kept(Vec<u8>),
}

impl Encode for Value {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Empty => ().encode(out),
            Self::I2(n) => n.encode(out),
            Self::I4(n) => n.encode(out),
            Self::Ui1(n) => n.encode(out),
            Self::R4(n) => n.encode(out),
            Self::R8(n) => n.encode(out),
            Self::Bool(b) => b.encode(out),
            Self::Date(date) => date.encode(out),
            Self::Text(text) => text.as_str().encode(out),
            Self::Bstr(bytes) => Bstr::from_utf16le(bytes).unwrap_or_default().encode(out),
            Self::Ui1s(items) => items.as_slice().encode(out),
            Self::I4s(items) => items.as_slice().encode(out),
            Self::R4s(items) => items.as_slice().encode(out),
            Self::R8s(items) => items.as_slice().encode(out),
            Self::Texts(items) => items.iter().map(String::as_str).collect::<Vec<_>>().as_slice().encode(out),
            Self::List(items) => items.iter().map(|i| i as &dyn Encode).collect::<Vec<_>>().as_slice().encode(out),
            Self::Kept(bytes) => kept(bytes).encode(out),
        }
    }
}

impl Value {
    /// Returns its encoding; empty when it cannot be sent.
    pub(crate) fn encoded(&self) -> Vec<u8> {
        let mut size = 256;
        while size <= 16 << 20 {
            let mut buffer = vec![0; size];
            let mut copy = ReplyValue::new(&mut buffer);
            if copy.set(self as &dyn Encode).is_ok() {
                return copy.as_bytes().to_vec();
            }
            size *= 4;
        }
        Vec::new()
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

/// The largest encoding of a tag, an ID or the parameters of a command, in bytes. Every object may have them.
const KEPT_MAX: usize = 4096;

/// Encodes a client's value of any type.
pub(crate) fn keep(value: &Variant<'_>) -> Result<Vec<u8>, HResult> {
    let mut buffer = [0; KEPT_MAX];
    let mut copy = ReplyValue::new(&mut buffer);
    match copy.set(value) {
        Ok(()) => Ok(copy.as_bytes().to_vec()),
        Err(EncodeError::Full) => Err(HResult::E_OUTOFMEMORY),
        Err(_) => Err(HResult::E_INVALIDARGTYPE),
    }
}

/// Views a value that [`keep`] has encoded.
pub(crate) fn kept(bytes: &[u8]) -> Variant<'_> {
    let limits = Limits { depth: MAX_DEPTH, ..Limits::STREAM };
    Variant::decode(bytes, &limits, Strictness::Strict).unwrap_or(Variant::Empty)
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

/// Reads an array of numbers, also of VARIANT with different types, and nothing else.
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
        let bytes = keep(&value.as_variant()).unwrap();
        assert_eq!(bytes, value.as_bytes());
        assert_eq!(VariantBuf::<4096>::new(&Value::Kept(bytes)).unwrap(), value);
    }

    #[test]
    fn whole_numbers_are_range_checked() {
        assert_eq!(whole(-3.0), Ok(-3));
        assert_eq!(whole(0.5), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(whole(f64::NAN), Err(HResult::DISP_E_TYPEMISMATCH));
        assert_eq!(whole(3e9), Err(HResult::DISP_E_OVERFLOW));
    }
}
