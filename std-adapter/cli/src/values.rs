//! Arguments of calls as owned values.

pub(crate) use bcap_core::variant::OwnedVariant as Value;

use crate::failure::Failure;

/// Encodes a string argument.
pub(crate) fn text(text: &str) -> Result<Value, Failure> {
    Ok(Value::new(text)?)
}

/// Encodes an I4 argument, such as a handle.
pub(crate) fn integer(number: i32) -> Result<Value, Failure> {
    Ok(Value::new(&number)?)
}
