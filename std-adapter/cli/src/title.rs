//! The names of calls on the command line and in reports.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap::FunctionId;

/// A function, and the command that it executes: `Robot_Execute/slvMove`, `Variable_GetValue`, `GET`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Title {
    pub(crate) function: String,
    pub(crate) command: Option<String>,
}

impl FromStr for Title {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, command) = match text.split_once('/') {
            Some((name, command)) => (name, Some(command.to_owned())),
            None => (text, None),
        };
        let verb = ["GET", "PUT"].into_iter().find(|verb| name.eq_ignore_ascii_case(verb)).map(str::to_owned);
        let function = verb.or_else(|| FunctionId::parse(name).map(|function| function.to_string()));
        let function = function
            .ok_or_else(|| format!("no function is named {name:?}; write a name of `bcap call --list`, GET or PUT"))?;
        Ok(Self { function, command })
    }
}

impl Title {
    /// Returns whether a call has this function and, if one is given, this command.
    pub(crate) fn has(&self, title: &Self) -> bool {
        self.function == title.function && (self.command.is_none() || self.command == title.command)
    }
}

impl fmt::Display for Title {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.command {
            Some(command) => write!(f, "{}/{command}", self.function),
            None => f.write_str(&self.function),
        }
    }
}
