//! The errors of provisioning.

use std::fmt;
use std::path::Path;

use thiserror::Error;

/// Why a board was not found or changed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, a setting or a key is invalid. Nothing was sent.
    #[error("{0}")]
    Invalid(String),
    /// The board or the drive refused a request, or is the wrong one.
    #[error("{message}")]
    Refused {
        /// The request and the reason.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// There is no board, or the connection to it broke.
    #[error("{message}")]
    Connection {
        /// The event.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// A board did not answer in time.
    #[error("{message}")]
    Timeout {
        /// Which answer is missing.
        message: String,
        /// The remedy.
        hint: String,
    },
}

impl Error {
    /// Returns the error of a file.
    pub(crate) fn at(path: &Path, reason: impl fmt::Display) -> Self {
        Self::Invalid(format!("{}: {reason}", path.display()))
    }

    pub(crate) fn refused(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Refused { message: message.into(), hint: hint.into() }
    }
}
