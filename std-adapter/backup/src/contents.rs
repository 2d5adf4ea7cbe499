//! The contents of a backup, in memory.

use std::collections::BTreeMap;

use bcap_core::rac::VariableKind;
use serde::{Deserialize, Serialize};

use bcap_capture::value::named::Entry;

/// The controller of a backup; a text that the controller refuses is empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// `@TYPE`.
    #[serde(rename = "type")]
    pub kind: String,
    /// `@VERSION`.
    pub version: String,
    /// `@SERIAL_NO`.
    pub serial: String,
}

impl About {
    /// Returns whether both are of the same controller, whose software may have been updated. Without a serial number that is
    /// unknown.
    pub fn is_same_controller(&self, other: &Self) -> bool {
        !self.serial.is_empty() && (&self.kind, &self.serial) == (&other.kind, &other.serial)
    }

    /// Describes the controller for people.
    pub fn describe(&self) -> String {
        let part = |name: &str, text: &str| if text.is_empty() { String::new() } else { format!("{name}{text}") };
        let kind = if self.kind.is_empty() { "a controller of unknown type" } else { &self.kind };
        let serial = if self.serial.is_empty() { " with unknown serial number" } else { " with serial number " };
        format!("{kind}{serial}{}{}", self.serial, part(", version ", &self.version))
    }
}

/// A part that could not be listed or read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Omission {
    /// The part.
    pub part: Part,
    /// Why, in words.
    pub reason: String,
}

/// The omitted part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Part {
    /// All variables of a kind; `I` in backup.json.
    Variables(VariableKind),
    /// Some system variables; `system`.
    System,
    /// A file, or a folder with everything in it; `file:Sub`, and `file:` for all files.
    Files(String),
}

impl Part {
    /// Returns whether the part has a file, or may have it.
    pub fn has_file(&self, path: &str) -> bool {
        let Self::Files(omitted) = self else { return false };
        let below = path.strip_prefix(omitted.as_str());
        omitted.is_empty() || below.is_some_and(|below| below.is_empty() || below.starts_with('/'))
    }

    /// Returns whether the part has a variable, or may have it.
    pub fn has_variable(&self, variable: UserVariable) -> bool {
        *self == Self::Variables(variable.kind())
    }
}

impl From<Part> for String {
    fn from(part: Part) -> Self {
        match part {
            Part::Variables(kind) => kind.name().into(),
            Part::System => "system".into(),
            Part::Files(path) => format!("file:{path}"),
        }
    }
}

impl TryFrom<String> for Part {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        if let Some(path) = text.strip_prefix("file:") {
            return Ok(Self::Files(path.into()));
        }
        if text == "system" {
            return Ok(Self::System);
        }
        let kind = VariableKind::ALL.into_iter().find(|kind| kind.name() == text);
        kind.map(Self::Variables).ok_or_else(|| format!("{text:?} is no part of a backup"))
    }
}

/// A user variable; they are ordered by kind, then by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct UserVariable {
    /// The place of the kind in [`VariableKind::ALL`].
    place: usize,
    index: u32,
}

impl UserVariable {
    /// Creates the variable of a kind with an index.
    pub fn new(kind: VariableKind, index: u32) -> Self {
        let place = VariableKind::ALL.iter().position(|other| *other == kind).unwrap_or_default();
        Self { place, index }
    }

    /// Returns the kind.
    pub fn kind(self) -> VariableKind {
        VariableKind::ALL[self.place]
    }

    /// Returns the name, such as `I5`.
    pub fn name(self) -> String {
        format!("{}{}", self.kind().name(), self.index)
    }
}

/// All variables and files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// The controller.
    pub about: About,
    /// The user variables.
    pub variables: BTreeMap<UserVariable, Entry>,
    /// By name, such as `@MODE` and `robot:Arm0/@SERVO_ON`.
    pub system: BTreeMap<String, Entry>,
    /// By path, with `/` between its parts.
    pub files: BTreeMap<String, Vec<u8>>,
    /// The parts that could not be listed or read. Refused variables are separate entries.
    pub omitted: Vec<Omission>,
}

impl Contents {
    /// Returns whether a part that `is_meant` selects is omitted.
    pub fn omits(&self, is_meant: impl Fn(&Part) -> bool) -> bool {
        self.omitted.iter().any(|omission| is_meant(&omission.part))
    }

    /// Describes the sizes: `40 variables, 12 system variables and 3 files`.
    #[must_use]
    pub fn summary(&self) -> String {
        let [variables, system, files] = [self.variables.len(), self.system.len(), self.files.len()];
        format!("{variables} variables, {system} system variables and {files} files")
    }

    /// Counts the user variables that could not be read. System variables that can only be written do not count.
    pub fn refused(&self) -> usize {
        self.variables.values().filter(|entry| matches!(entry, Entry::Refused(_))).count()
    }
}
