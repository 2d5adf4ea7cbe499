//! The errors of backups.

use std::fmt;
use std::io;
use std::path::Path;

use thiserror::Error;

/// Why a backup cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or a folder cannot be read or written, or its content is invalid.
    #[error("{0}")]
    Invalid(String),
    /// The controller does not match the backup, so nothing is written to it.
    #[error("{0}")]
    Unfit(String),
    /// The backup is of another controller, or a serial number is unknown, so nothing is written.
    /// [`Options::other_controller`](crate::restore::Options::other_controller) allows it.
    #[error("the backup is of {backup}, and this is {controller}. Nothing was written")]
    OtherController {
        /// The controller of the backup.
        backup: String,
        /// This controller.
        controller: String,
    },
}

impl Error {
    /// Returns the error of a file or a folder.
    pub(crate) fn at(path: &Path, reason: impl fmt::Display) -> Self {
        Self::Invalid(format!("{}: {reason}", path.display()))
    }

    /// Returns the error of a restore that has written nothing.
    #[must_use]
    pub fn unfit(reason: impl fmt::Display) -> Self {
        Self::Unfit(format!("{reason}. Nothing was written"))
    }
}

impl From<Error> for bcap_live::link::Error {
    fn from(error: Error) -> Self {
        Self::Unexpected(error.to_string())
    }
}

/// Returns the error of a file operation.
pub(crate) fn failed(path: &Path) -> impl Fn(io::Error) -> Error {
    move |error| Error::at(path, error)
}
