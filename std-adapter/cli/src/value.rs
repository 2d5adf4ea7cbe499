//! Owned values, of any size.

use bcap_core::error::{EncodeError, TextError, TextErrorKind};
use bcap_core::limits::Strictness;
use bcap_core::rac::MAX_VALUE;
use bcap_core::variant::{Encode, Variant, VariantBuf, Writer};

use crate::json::{self, LIMITS};

/// The largest value that is parsed from text. Values that fit a RAC line are parsed in a smaller buffer.
const TEXT_MAX: usize = 64 * 1024;

/// A value of any size that owns its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Value {
    /// The encoding of one value.
    bytes: Vec<u8>,
}

impl Value {
    /// Encodes a value.
    pub(crate) fn new(value: &(impl Encode + ?Sized)) -> Result<Self, EncodeError> {
        let mut bytes = vec![0; 256];
        loop {
            let mut out = Writer::new(&mut bytes);
            match value.encode(&mut out) {
                Ok(()) => {
                    let len = out.len();
                    bytes.truncate(len);
                    return Ok(Self { bytes });
                }
                // no peer accepts a frame above 16 MiB
                Err(EncodeError::Full) if bytes.len() < 32 * 1024 * 1024 => bytes = vec![0; bytes.len() * 4],
                Err(error) => return Err(error),
            }
        }
    }

    /// Parses `TYPE,DATA`, such as `3,100` or `8196,1,2.5,-3`.
    pub(crate) fn from_text(text: &str) -> Result<Self, TextError> {
        let bytes = match VariantBuf::<MAX_VALUE>::parse_text(text.as_bytes()) {
            Err(TextError { kind: TextErrorKind::Full, .. }) => {
                VariantBuf::<TEXT_MAX>::parse_text(text.as_bytes())?.as_bytes().to_vec()
            }
            value => value?.as_bytes().to_vec(),
        };
        Ok(Self { bytes })
    }

    /// Returns a view of the value.
    pub(crate) fn as_variant(&self) -> Variant<'_> {
        // the bytes were encoded by `new` or by the parser, so decoding them succeeds
        Variant::decode(&self.bytes, &LIMITS, Strictness::Strict).unwrap_or(Variant::Empty)
    }

    /// Returns the value's encoding.
    pub(crate) fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Describes the value for an error: the value itself if it is short, otherwise its type and size.
    pub(crate) fn described(&self) -> String {
        let value = self.as_variant();
        match value {
            _ if self.bytes.len() <= 64 => format!("{value:?}"),
            Variant::Array(array) => {
                format!("an array of {} {} in {} bytes", array.len(), array.element(), self.bytes.len())
            }
            value => format!("a {} of {} bytes", value.vartype(), self.bytes.len()),
        }
    }

    /// Returns the value as JSON, `{"vt":3,"v":100}`.
    pub(crate) fn to_json(&self) -> String {
        let mut out = String::new();
        json::put_value(&mut out, self.as_variant());
        out
    }
}

impl Encode for Value {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.as_variant().encode(out)
    }
}

/// Writes a value as `TYPE,DATA`.
pub(crate) fn to_text(value: Variant<'_>) -> Result<String, TextError> {
    let bytes = Value::new(&value)?;
    // the elements of a UI1 array need 4 characters per byte; no other type needs more
    let mut buffer = vec![0; bytes.as_bytes().len() * 4 + 64];
    value.to_text(&mut buffer).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_values_are_not_truncated() {
        let numbers: Vec<f64> = (0..100_000).map(f64::from).collect();
        let value = Value::new(numbers.as_slice()).unwrap();
        assert_eq!(value.as_bytes().len(), 6 + 8 * numbers.len());
        assert_eq!(value.as_variant().as_array().unwrap().items::<f64>().unwrap().get(99_999), Some(99_999.0));
        let text = format!("8194{}", ",7".repeat(30_000));
        assert_eq!(Value::from_text(&text).unwrap().as_bytes().len(), 6 + 2 * 30_000);
        assert_eq!(Value::from_text(&format!("{text}{}", &text[4..])).unwrap_err().kind, TextErrorKind::Full);
    }
}
