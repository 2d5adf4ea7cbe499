//! Errors of captures, recordings and replays, and of texts that are converted.

use std::io;
use std::path::{Path, PathBuf};

use bcap_core::error::{DecodeError, EncodeError, TextError};
use thiserror::Error;

/// Why a capture cannot be read, recorded or replayed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be opened.
    #[error("cannot read {}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A file is not a capture, or is damaged.
    #[error("{}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// The file of a recording cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A capture that cannot be replayed, or that has calls which are not allowed.
    #[error("{0}")]
    Replay(String),
    /// A replay has ended, and may have left effects on the robot.
    #[error("IT IS UNKNOWN whether the robot rests, its motor is off and the arm is free: {0}")]
    NotEnded(String),
    /// The operating system refused a thread or a socket.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl Error {
    pub(crate) fn invalid(path: &Path, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), reason: reason.into() }
    }
}

/// Why a text or bytes cannot be converted.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{message}")]
pub struct ConvertError {
    /// The error, for people.
    pub message: String,
    /// The position in the bytes, or in the text if the text is wrong; 0 is the whole input.
    pub offset: usize,
}

impl ConvertError {
    /// Creates an error at a position.
    #[must_use]
    pub fn new(message: impl Into<String>, offset: usize) -> Self {
        Self { message: message.into(), offset }
    }
}

impl From<DecodeError> for ConvertError {
    fn from(error: DecodeError) -> Self {
        Self::new(error.to_string(), error.offset)
    }
}

impl From<EncodeError> for ConvertError {
    fn from(error: EncodeError) -> Self {
        Self::new(error.to_string(), 0)
    }
}

impl From<TextError> for ConvertError {
    fn from(error: TextError) -> Self {
        // columns count from 1; 0 is an error of the value as a whole
        let column = usize::try_from(error.column).unwrap_or(usize::MAX);
        Self::new(error.to_string(), column.saturating_sub(1))
    }
}
