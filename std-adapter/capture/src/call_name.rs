//! The names of calls in options and reports.

use std::fmt;
use std::str::FromStr;

use crate::decode::function_name;

/// A function, and the command that it executes: `Robot_Execute/slvMove`, `Variable_GetValue`, `GET`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CallName {
    /// `Variable_GetValue`; `GET` or `PUT` of RAC.
    pub function: String,
    /// `slvMove`, for a function that executes commands.
    pub command: Option<String>,
}

impl FromStr for CallName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, command) = match text.split_once('/') {
            Some((name, command)) => (name, Some(command.to_owned())),
            None => (text, None),
        };
        let function = function_name(name)?;
        Ok(Self { function, command })
    }
}

impl CallName {
    /// Returns whether a call has this function and, if one is given, this command.
    #[must_use]
    pub fn has(&self, call: &Self) -> bool {
        self.function == call.function && (self.command.is_none() || self.command == call.command)
    }
}

impl fmt::Display for CallName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.command {
            Some(command) => write!(f, "{}/{command}", self.function),
            None => f.write_str(&self.function),
        }
    }
}
