//! How a command fails: whose fault it was decides the exit code, and every failure says what to do about it.
//!
//! | code | meaning                                                |
//! |------|--------------------------------------------------------|
//! | 0    | done                                                   |
//! | 1    | the controller refused                                 |
//! | 2    | wrong usage, or input that cannot be read              |
//! | 3    | no connection, or a connection that broke              |
//! | 4    | the controller did not answer in time                  |

use std::io::{self, Write};
use std::process::ExitCode;

use anstyle::{AnsiColor, Style};
use thiserror::Error;

const RED: Style = AnsiColor::Red.on_default().bold();
const CYAN: Style = AnsiColor::Cyan.on_default();

/// Why a command failed.
#[derive(Debug, Error)]
pub(crate) enum Failure {
    /// What the user gave cannot be read, or does not make sense.
    #[error("{0}")]
    Input(String),
    /// Some lines could not be converted; each has been reported in its place.
    #[error("{0} of the lines could not be converted; the output has an error in place of each")]
    BadLines(usize),
    /// The standard input or output broke.
    #[error("standard input or output: {0}")]
    Stdio(#[from] io::Error),
}

impl Failure {
    fn code(&self) -> u8 {
        match self {
            Self::Input(_) | Self::BadLines(_) | Self::Stdio(_) => 2,
        }
    }

    /// Returns what a person can do about it.
    fn hint(&self) -> Option<String> {
        match self {
            Self::Input(_) | Self::BadLines(_) | Self::Stdio(_) => None,
        }
    }

    /// Prints what went wrong and what to do, and returns the code to exit with.
    pub(crate) fn report(&self) -> ExitCode {
        if let Self::Stdio(error) = self
            && error.kind() == io::ErrorKind::BrokenPipe
        {
            // whoever read the output, such as `head`, has seen enough
            return ExitCode::SUCCESS;
        }
        let mut err = anstream::stderr().lock();
        // nobody is left to be told when even this fails
        let _ = writeln!(err, "{RED}error:{RED:#} {self}");
        if let Some(hint) = self.hint() {
            let _ = writeln!(err, " {CYAN}hint:{CYAN:#} {hint}");
        }
        ExitCode::from(self.code())
    }
}
