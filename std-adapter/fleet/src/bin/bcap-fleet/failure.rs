//! Failures of the program: their messages, hints and exit codes.

use std::io;
use std::process::ExitCode;

use bcap_fleet::Error;
use bcap_terminal::{escape, report};
use serde::Serialize;
use thiserror::Error;

use crate::output::print_json;

/// A reason to end with an exit code other than 0.
#[derive(Debug, Error)]
pub(crate) enum Failure {
    /// The arguments, or the terminal for a screen.
    #[error("{0}")]
    Usage(String),
    /// The fleet cannot start.
    #[error("{0}")]
    Fleet(#[from] Error),
    /// Rows of the check failed; each was printed.
    #[error("{failed} of {total} checks failed")]
    Checks {
        /// The number of failed rows.
        failed: usize,
        /// The number of all rows.
        total: usize,
    },
    /// The standard input or output failed.
    #[error("standard input or output: {0}")]
    Stdio(#[from] io::Error),
}

/// A failure as a line of the output.
#[derive(Serialize)]
struct FailureLine<'a> {
    error: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    hint: Option<&'a str>,
}

impl Failure {
    const fn code(&self) -> u8 {
        match self {
            Self::Fleet(Error::Listen { .. }) | Self::Checks { .. } => 3,
            Self::Usage(_) | Self::Fleet(_) | Self::Stdio(_) => 2,
        }
    }

    /// Returns advice for the user.
    const fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Fleet(Error::Listen { .. }) => Some("choose another port in [metrics]; port 0 takes a free one"),
            Self::Checks { .. } => Some(
                "the lines above say which, and why; an address or name in the configuration may be wrong, or the device is \
                 not reachable from here",
            ),
            _ => None,
        }
    }

    /// Prints the message and the hint, and returns the exit code.
    pub(crate) fn report(&self, json: bool) -> ExitCode {
        if let Self::Stdio(error) = self
            && error.kind() == io::ErrorKind::BrokenPipe
        {
            // the reader, such as `head`, closed the pipe: not an error
            return ExitCode::SUCCESS;
        }
        if json {
            // an error of printing cannot be reported
            let _ = print_json(&FailureLine { error: escape::cut(self), hint: self.hint() });
        }
        report::error(self, &Vec::from_iter(self.hint().map(|hint| ("hint", hint))));
        ExitCode::from(self.code())
    }
}
