//! Values as text.

pub mod data;
pub mod named;
pub mod selection;

use bcap_core::error::TextError;
use bcap_core::variant::{OwnedVariant, Variant};

use crate::json;

/// Describes a value for an error: the value itself if it is short, otherwise its type and size.
#[must_use]
pub fn describe(value: Option<&OwnedVariant>) -> String {
    let Some(value) = value else { return "no value".into() };
    let bytes = value.as_bytes().len();
    match value.as_variant() {
        short if bytes <= 64 => format!("{short:?}"),
        Variant::Array(array) => format!("an array of {} {} in {bytes} bytes", array.len(), array.element()),
        long => format!("a {} of {bytes} bytes", long.vartype()),
    }
}

/// Returns a value as JSON, `{"vt":3,"v":100}`.
#[must_use]
pub fn to_json(value: Variant<'_>) -> String {
    let mut out = String::new();
    json::put_value(&mut out, value);
    out
}

/// Writes a value as `TYPE,DATA`.
///
/// # Errors
///
/// When the value has no text form, such as an empty array.
pub fn to_text(value: Variant<'_>) -> Result<String, TextError> {
    let bytes = OwnedVariant::new(&value)?;
    // the elements of a UI1 array need 4 characters per byte; no other type needs more
    let mut buffer = vec![0; bytes.as_bytes().len() * 4 + 64];
    value.to_text(&mut buffer).map(str::to_owned)
}
