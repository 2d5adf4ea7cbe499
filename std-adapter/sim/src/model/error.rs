//! Errors in the file of a model or of an arm.

use toml::Spanned;

/// The error of an invalid model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// Invalid TOML, an unknown key or a missing one; the message says where.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A value is invalid.
    #[error("line {line}: {problem}")]
    Value {
        /// The line of the value, from 1.
        line: usize,
        /// The fault, and the accepted values.
        problem: String,
    },
}

/// A value that is wrong: its place in the file, and why.
pub(super) type Wrong = (usize, String);

/// Returns the error of a wrong value, with its line.
pub(super) fn located(text: &str, (place, problem): Wrong) -> ModelError {
    let before = text.get(..place).unwrap_or(text);
    ModelError::Value { line: before.matches('\n').count() + 1, problem }
}

/// Returns a text that is not empty.
pub(super) fn text(key: &str, value: Spanned<String>) -> Result<String, Wrong> {
    let place = value.span().start;
    let value = value.into_inner();
    if value.trim().is_empty() { Err((place, format!("`{key}` is empty"))) } else { Ok(value) }
}
