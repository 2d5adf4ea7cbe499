//! Why a line of the settings is invalid.

use core::fmt;

use bcap_gateway::RuleError;
#[cfg(feature = "modbus")]
use bcap_gateway::modbus::EntryError;

/// Why a line of the settings is invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum SettingError {
    /// The line is not `KEY=VALUE`, or there is no such key.
    Key,
    /// The line contains NUL, which ends the settings.
    Nul,
    /// The value does not have the form that its key requires.
    Value,
    /// Another service of the board has the port.
    Port,
    /// The network before the rule of a `put@` is invalid.
    Clients,
    /// The rule of a `get` or `put` is invalid; its column counts from the first character of the rule.
    Rule(RuleError),
    /// A `get` has ranges of values, which only a `put` has.
    GetWithValues,
    /// There are more `allow` lines than the board has memory for.
    TooManyNetworks,
    /// There are more rules, or ranges of values in them, than the board has memory for.
    TooManyRules,
    /// An entry of the map of Modbus is invalid.
    #[cfg(feature = "modbus")]
    Entry(EntryError),
    /// An entry of the map of Modbus overlaps another entry.
    #[cfg(feature = "modbus")]
    Overlap,
    /// There are more entries than the board has memory for.
    #[cfg(feature = "modbus")]
    TooManyEntries,
}

#[cfg(feature = "modbus")]
impl From<EntryError> for SettingError {
    fn from(error: EntryError) -> Self {
        Self::Entry(error)
    }
}

impl From<RuleError> for SettingError {
    fn from(error: RuleError) -> Self {
        Self::Rule(error)
    }
}

impl fmt::Display for SettingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rule(error) => return error.kind.fmt(f),
            Self::Clients => "invalid network: expected put@ADDRESS[/PREFIX]=RULE",
            Self::Key => "expected KEY=VALUE with a known key",
            Self::Nul => "a setting cannot contain NUL",
            Self::Value => "invalid value for this key",
            Self::Port => "this port is in use: RAC has 5006, and modbus, health and echo need a port each",
            Self::GetWithValues => "a get has no ranges of values; only a put has",
            Self::TooManyNetworks => "too many networks: a board has memory for 16 allow lines",
            Self::TooManyRules => "too many rules: a board has memory for 32 rules with 64 ranges of values",
            #[cfg(feature = "modbus")]
            Self::Entry(error) => return error.fmt(f),
            #[cfg(feature = "modbus")]
            Self::Overlap => "some of these addresses are in another line, too",
            #[cfg(feature = "modbus")]
            Self::TooManyEntries => "too many entries: a board has memory for 32 register and coil lines",
        })
    }
}

impl core::error::Error for SettingError {}

impl SettingError {
    /// Returns the column of the line at which the error is, in bytes counted from 1.
    fn column(self, line: &[u8]) -> usize {
        let after =
            |count| line.iter().enumerate().filter(|(_, byte)| **byte == b'=').nth(count).map_or(1, |(at, _)| at + 2);
        match self {
            Self::Key | Self::TooManyNetworks | Self::TooManyRules => 1,
            Self::Nul => line.iter().position(|byte| *byte == 0).map_or(1, |at| at + 1),
            Self::Value | Self::Port => after(0),
            #[cfg(feature = "modbus")]
            Self::Entry(_) | Self::Overlap => after(0),
            #[cfg(feature = "modbus")]
            Self::TooManyEntries => 1,
            Self::Clients => "put@".len() + 1,
            Self::GetWithValues => after(1),
            Self::Rule(error) => after(0) + usize::try_from(error.column.saturating_sub(1)).unwrap_or_default(),
        }
    }
}

/// An invalid line of the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InvalidLine<'a> {
    /// The line.
    pub line: &'a [u8],
    /// The fault in the setting.
    pub error: SettingError,
}

impl InvalidLine<'_> {
    /// Returns the column of the line at which the error is, in bytes counted from 1.
    #[must_use]
    pub fn column(&self) -> usize {
        self.error.column(self.line)
    }
}

impl fmt::Display for InvalidLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "invalid setting \"{}\": {}, at column {}", self.line.escape_ascii(), self.error, self.column())
    }
}

impl core::error::Error for InvalidLine<'_> {}
