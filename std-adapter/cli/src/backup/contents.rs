//! What a backup holds, in memory.

use std::collections::BTreeMap;

use bcap_core::rac::VariableKind;
use serde::{Deserialize, Serialize};

use crate::named::Entry;

/// Which controller a backup is of; a text that the controller refuses is empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct About {
    /// `@TYPE`.
    #[serde(rename = "type")]
    pub(crate) kind: String,
    /// `@VERSION`.
    pub(crate) version: String,
    /// `@SERIAL_NO`.
    pub(crate) serial: String,
}

impl About {
    /// Returns whether both are of the same controller, whose software may have been updated.
    pub(crate) fn is_same_controller(&self, other: &Self) -> bool {
        (&self.kind, &self.serial) == (&other.kind, &other.serial)
    }

    pub(crate) fn describe(&self) -> String {
        let part = |name: &str, text: &str| if text.is_empty() { String::new() } else { format!("{name}{text}") };
        let kind = if self.kind.is_empty() { "a controller of unknown type" } else { &self.kind };
        format!("{kind}{}{}", part(" with serial number ", &self.serial), part(", version ", &self.version))
    }
}

/// A user variable; they are ordered by kind, then by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct UserVariable {
    /// The place of the kind in [`VariableKind::ALL`].
    place: usize,
    index: u32,
}

impl UserVariable {
    pub(crate) fn new(kind: VariableKind, index: u32) -> Self {
        let place = VariableKind::ALL.iter().position(|other| *other == kind).unwrap_or_default();
        Self { place, index }
    }

    pub(crate) fn kind(self) -> VariableKind {
        VariableKind::ALL[self.place]
    }

    pub(crate) fn name(self) -> String {
        format!("{}{}", self.kind().name(), self.index)
    }
}

/// All variables and files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Contents {
    pub(crate) about: About,
    pub(crate) variables: BTreeMap<UserVariable, Entry>,
    /// By name, such as `@MODE` and `robot:Arm0/@SERVO_ON`.
    pub(crate) system: BTreeMap<String, Entry>,
    /// By path, with `/` between its parts.
    pub(crate) files: BTreeMap<String, Vec<u8>>,
    /// What the controller refused to list or to read, in words; refused variables are entries of their own.
    pub(crate) omitted: Vec<String>,
}

impl Contents {
    /// Counts the user variables that could not be read. System variables that can only be written do not count.
    pub(crate) fn refused(&self) -> usize {
        self.variables.values().filter(|entry| matches!(entry, Entry::Refused(_))).count()
    }
}
