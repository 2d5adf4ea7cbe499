//! Why a line of the settings is invalid.

use core::fmt;

use bcap_core::gateway::RuleError;

/// Why a line of the settings is invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum SettingError {
    /// The line is not `KEY=VALUE`, or there is no such key.
    Key,
    /// The value does not have the form that its key asks for.
    Value,
    /// The rule of a `get` or `put` is invalid; columns count from its first character.
    Rule(RuleError),
    /// A `get` has ranges of values, which only a `put` has.
    GetWithValues,
    /// There are more `allow` lines than the board has memory for.
    TooManyNetworks,
    /// There are more rules, or ranges of values in them, than the board has memory for.
    TooManyRules,
}

impl From<RuleError> for SettingError {
    fn from(error: RuleError) -> Self {
        Self::Rule(error)
    }
}

impl fmt::Display for SettingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rule(error) => return error.fmt(f),
            Self::Key => "expected KEY=VALUE with a known key",
            Self::Value => "invalid value for this key",
            Self::GetWithValues => "a get has no ranges of values; only a put has",
            Self::TooManyNetworks => "too many networks: a board has memory for 16 allow lines",
            Self::TooManyRules => "too many rules: a board has memory for 32 rules with 64 ranges of values",
        })
    }
}

impl core::error::Error for SettingError {}
