//! Owned values, and how the command shows them.

use bcap_core::error::TextError;
pub(crate) use bcap_core::variant::OwnedVariant as Value;
use bcap_core::variant::Variant;

use crate::error::Failure;
use crate::json;

/// Encodes a string argument.
pub(crate) fn text(text: &str) -> Result<Value, Failure> {
    Ok(Value::new(text)?)
}

/// Encodes an I4 argument, such as a handle.
pub(crate) fn integer(number: i32) -> Result<Value, Failure> {
    Ok(Value::new(&number)?)
}

/// Describes a value for an error: the value itself if it is short, otherwise its type and size.
pub(crate) fn described(value: Option<&Value>) -> String {
    let Some(value) = value else { return "no value".into() };
    let bytes = value.as_bytes().len();
    match value.as_variant() {
        short if bytes <= 64 => format!("{short:?}"),
        Variant::Array(array) => format!("an array of {} {} in {bytes} bytes", array.len(), array.element()),
        long => format!("a {} of {bytes} bytes", long.vartype()),
    }
}

/// Returns a value as JSON, `{"vt":3,"v":100}`.
pub(crate) fn to_json(value: &Value) -> String {
    let mut out = String::new();
    json::put_value(&mut out, value.as_variant());
    out
}

/// Writes a value as `TYPE,DATA`.
pub(crate) fn to_text(value: Variant<'_>) -> Result<String, TextError> {
    let bytes = Value::new(&value)?;
    // the elements of a UI1 array need 4 characters per byte; no other type needs more
    let mut buffer = vec![0; bytes.as_bytes().len() * 4 + 64];
    value.to_text(&mut buffer).map(str::to_owned)
}
