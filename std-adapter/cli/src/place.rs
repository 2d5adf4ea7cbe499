//! A file of this machine or of the controller, as the user writes it.

use std::path::PathBuf;

use crate::remote;

/// A path; `robot:` marks one of the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    Local(PathBuf),
    /// From the root, without a `/` at its beginning and end.
    Remote(String),
}

impl Place {
    /// Parses `robot:/Folder/Name`, or the path of a file of this machine.
    pub(crate) fn parse(word: &str) -> Self {
        match word.split_once(':') {
            Some((robot, path)) if robot.eq_ignore_ascii_case("robot") => Self::Remote(remote::normal(path)),
            _ => Self::Local(word.into()),
        }
    }
}
