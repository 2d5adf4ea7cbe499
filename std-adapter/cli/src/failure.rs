//! Failures of commands: their messages, hints and exit codes.
//!
//! | code | meaning                                                                      |
//! |------|------------------------------------------------------------------------------|
//! | 0    | done                                                                         |
//! | 1    | refused, or `diff`, `conform` or `fuzz` has a finding                     |
//! | 2    | wrong usage, input that cannot be read, or `bcap diff` could not compare all |
//! | 3    | no connection, or a connection that broke, or an unexpected reply            |
//! | 4    | the controller did not answer in time                                        |
//! | 130  | interrupted by a signal                                                      |
//!
//! With `--json` a failure is also written to the output as a line: `{"error":...}`, with `offset` for malformed input, `code`
//! and `hresult` for a refusal, `name` for the refused variable, and `hint`.

use std::borrow::Cow;
use std::io;
use std::path::Path;
use std::process::ExitCode;

use bcap_capture::ConvertError;
use bcap_capture::value::selection::SelectionError;
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_std::{DestinationError, ObjectPathError};
use bcap_terminal::{escape, report};
use serde::Serialize;
use thiserror::Error;

use crate::output::print_json;

/// Why a command failed.
#[derive(Debug, Error)]
pub(crate) enum Failure {
    /// The arguments or a file of the user are invalid.
    #[error("{0}")]
    Input(String),
    /// The item on the command line cannot be converted.
    #[error("{0}")]
    Item(ConvertError),
    /// Some lines could not be converted; each has been reported in the output.
    #[error("{0} of the lines could not be converted; the output has an error in place of each")]
    BadLines(usize),
    /// The controller answered with an error.
    #[error("{doing}: the controller refused with {code}{}", meaning(*code))]
    Refused {
        /// The refused call or command.
        doing: String,
        /// The controller's code.
        code: HResult,
    },
    /// Some of several variables were refused; each has been reported.
    #[error("{refused} of {total} were refused")]
    SomeRefused {
        /// The number of refused variables.
        refused: usize,
        /// The number of all variables.
        total: usize,
    },
    /// Replies that differ, failed cases, findings or refused lists; each has been reported.
    #[error("{0}")]
    Reported(String),
    /// The connection failed, or the peer sent an invalid or unexpected reply.
    #[error("{message}")]
    Connection {
        /// The event.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// The controller answered with a value that does not fit the call; the connection works.
    #[error("{message}")]
    Unexpected {
        /// The value of the reply.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// No answer arrived in time.
    #[error("{message}")]
    Timeout {
        /// Which answer is missing.
        message: String,
        /// The remedy.
        hint: String,
    },
    /// The controller is not in the required state, or has ended a stream of Slave Mode.
    #[error("{message}")]
    Unfit {
        /// The fault, including the controller's first error.
        message: String,
        /// The code of that error.
        code: Option<HResult>,
        /// The remedy.
        hint: Option<String>,
    },
    /// Two backups differ; the output has the differences.
    #[error("there are differences")]
    Different,
    /// Two backups could not be compared, or not completely.
    #[error("{0}")]
    NotCompared(Box<Failure>),
    /// A line of a script failed.
    #[error("{place}: {failure}")]
    Script {
        /// The file and the line.
        place: String,
        /// Why.
        failure: Box<Failure>,
    },
    /// A signal ended the command.
    #[error("{0}")]
    Interrupted(String),
    /// The standard input or output failed.
    #[error("standard input or output: {0}")]
    Stdio(#[from] io::Error),
}

/// Returns the line of the output in place of an item that cannot be converted.
pub(crate) fn item_to_json(error: ConvertError) -> String {
    // serializing a string and a number cannot fail
    escape::json(&Failure::Item(error).to_json(None).unwrap_or_default())
}

impl From<bcap_capture::Error> for Failure {
    fn from(error: bcap_capture::Error) -> Self {
        match error {
            bcap_capture::Error::Io(error) => Self::Stdio(error),
            error @ bcap_capture::Error::NotEnded(_) => {
                Self::unfit(error.to_string(), "look at the robot; if it moves, use the emergency stop")
            }
            error => Self::Input(error.to_string()),
        }
    }
}

/// Adds what a command has found to how its work ended. A finding is not hidden by a reader, such as `head`, that has closed the
/// output.
pub(crate) fn with_finding(done: Result<(), Failure>, found: Result<(), Failure>) -> Result<(), Failure> {
    match done {
        Err(closed) if closed.is_closed_output() => found.and(Err(closed)),
        done => done.and(found),
    }
}

/// Returns the failure of a file operation.
pub(crate) fn of_file(path: &Path) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Input(format!("{}: {error}", path.display()))
}

/// Returns the failure of a file operation, with the operation: `write`.
pub(crate) fn cannot(doing: &str, path: &Path) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Input(format!("cannot {doing} {}: {error}", path.display()))
}

impl From<bcap_provision::Error> for Failure {
    fn from(error: bcap_provision::Error) -> Self {
        match error {
            bcap_provision::Error::Refused { message, hint } => Self::unfit(message, hint),
            bcap_provision::Error::Connection { message, hint } => Self::Connection { message, hint },
            bcap_provision::Error::Timeout { message, hint } => Self::Timeout { message, hint },
            error => Self::Input(error.to_string()),
        }
    }
}

impl From<bcap_backup::Error> for Failure {
    fn from(error: bcap_backup::Error) -> Self {
        match error {
            bcap_backup::Error::Unfit(message) => Self::Unfit { message, code: None, hint: None },
            error @ bcap_backup::Error::OtherController { .. } => {
                Self::unfit(error.to_string(), "give --other-controller if that is intended")
            }
            error => Self::Input(error.to_string()),
        }
    }
}

/// Errors of the user's input, such as a value that is too large to encode.
macro_rules! input {
    ($($error:ty)*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Input(error.to_string())
            }
        }
    )*};
}

input! { DestinationError EncodeError ObjectPathError SelectionError }

impl Failure {
    fn code(&self) -> u8 {
        match self {
            Self::Refused { .. }
            | Self::SomeRefused { .. }
            | Self::Reported(_)
            | Self::Unfit { .. }
            | Self::Different => 1,
            Self::Input(_) | Self::Item(_) | Self::BadLines(_) | Self::Stdio(_) => 2,
            Self::Connection { .. } | Self::Unexpected { .. } => 3,
            Self::Timeout { .. } => 4,
            // the convention of shells: 128 plus the number of SIGINT
            Self::Interrupted(_) => 130,
            // 1 is the code for a difference
            Self::NotCompared(failure) => failure.code().max(2),
            Self::Script { failure, .. } => failure.code(),
        }
    }

    /// Returns the code of the controller.
    fn result_code(&self) -> Option<HResult> {
        match self {
            Self::Refused { code, .. } => Some(*code),
            Self::Unfit { code, .. } => *code,
            Self::NotCompared(failure) => failure.result_code(),
            _ => None,
        }
    }

    /// Returns the hint for the user.
    pub(crate) fn hint(&self) -> Option<Cow<'_, str>> {
        let of = |code: HResult| hint_of(code).map(Cow::Owned);
        match self {
            Self::Refused { code, .. } => of(*code),
            Self::Connection { hint, .. } | Self::Unexpected { hint, .. } | Self::Timeout { hint, .. } => {
                Some(hint.as_str().into())
            }
            Self::Unfit { code, hint, .. } => hint.as_deref().map(Cow::from).or_else(|| code.and_then(of)),
            Self::Script { failure, .. } | Self::NotCompared(failure) => failure.hint(),
            _ => None,
        }
    }

    /// Returns whether the command can make another call: the controller answered, or no call was made, and no signal arrived.
    pub(crate) fn leaves_the_session_alive(&self) -> bool {
        match self {
            Self::Connection { .. } | Self::Timeout { .. } | Self::Interrupted(_) => false,
            Self::Script { failure, .. } | Self::NotCompared(failure) => failure.leaves_the_session_alive(),
            _ => true,
        }
    }

    /// Returns whether the reader of the output, such as `head`, has closed it.
    pub(crate) fn is_closed_output(&self) -> bool {
        matches!(self, Self::Stdio(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }

    /// Prints the message and the hint, and returns the exit code.
    pub(crate) fn report(&self, json: bool) -> ExitCode {
        self.print(json, None);
        ExitCode::from(self.code())
    }

    /// Prints the message and the hint on stderr; with `json` also as a line of the output, with `name` if given.
    pub(crate) fn print(&self, json: bool, name: Option<&str>) {
        if matches!(self, Self::SomeRefused { total: 1, .. } | Self::Different) {
            // the refusal itself, or the differences, have been printed
            return;
        }
        // an error of printing cannot be reported
        if json && let Some(line) = self.to_json(name) {
            let _ = print_json(&line);
        }
        let code = self.result_code().filter(|code| code.meaning().is_some());
        let explain = code.map(|code| match code.name() {
            Some(name) => format!("bcap explain {name}"),
            None => format!("bcap explain {code}"),
        });
        let hint = self.hint();
        let hint = hint.as_deref().map(|hint| ("hint", hint));
        let more = explain.as_deref().map(|explain| ("more", explain));
        report::error(self, &Vec::from_iter(hint.into_iter().chain(more)));
    }

    /// Returns a failure without a code, with a remedy.
    pub(crate) fn unfit(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Unfit { message: message.into(), code: None, hint: Some(hint.into()) }
    }

    /// Adds to the hint of a library how the command line does that.
    pub(crate) fn hinting(mut self, how: &str) -> Self {
        if let Self::Unfit { hint: Some(hint), .. } = &mut self {
            hint.push_str(how);
        }
        self
    }

    /// Returns the failure as a line of JSON; `None` if its parts have been printed already.
    fn to_json(&self, name: Option<&str>) -> Option<String> {
        let (offset, code) = match self {
            Self::BadLines(_) | Self::SomeRefused { .. } | Self::Reported(_) => return None,
            Self::Item(item) => (Some(item.offset), None),
            Self::Script { failure, .. } => (None, failure.result_code()),
            _ => (None, self.result_code()),
        };
        let (error, hint, hresult) = (escape::cut(self), self.hint(), code.and_then(HResult::name));
        serde_json::to_string(&FailureLine { name, error, offset, code: code.map(|code| code.0), hresult, hint }).ok()
    }
}

/// A failure as a line of the output.
#[derive(Serialize)]
struct FailureLine<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<&'a str>,
    error: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<i32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hresult: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hint: Option<Cow<'a, str>>,
}

/// The hint for a command that would end a stream.
pub(crate) const AFTER_STREAM: &str =
    "wait for the end of the stream; `bcap get @ERROR_CODE` reads the latest error and does not end it";

impl bcap_live::calls::Failure for Failure {
    fn code(&self) -> Option<HResult> {
        if let Self::Refused { code, .. } = self { Some(*code) } else { None }
    }

    fn is_lost(&self) -> bool {
        !self.leaves_the_session_alive()
    }

    fn skipped(message: String) -> Self {
        Self::Unfit { message, code: Some(HResult::E_SLVMODE_ON), hint: Some(AFTER_STREAM.into()) }
    }

    fn is_skipped(&self) -> bool {
        matches!(self, Self::Unfit { .. })
    }

    fn unexpected(message: String) -> Self {
        Self::Unexpected { message, hint: "use `bcap call` to see the reply: it prints any value".into() }
    }

    fn invalid(message: String) -> Self {
        Self::Input(message)
    }

    fn unfit(message: String) -> Self {
        Self::Unfit { message, code: None, hint: None }
    }

    fn with_hint(mut self, text: &str) -> Self {
        match &mut self {
            Self::Unfit { hint, .. } => *hint = Some(text.into()),
            Self::Unexpected { hint, .. } => text.clone_into(hint),
            _ => {}
        }
        self
    }

    fn omission(&self) -> Option<String> {
        match self {
            Self::Refused { doing, code } => Some(format!("{doing}: {code}")),
            Self::Unexpected { message, .. } => Some(message.clone()),
            _ => None,
        }
    }
}

/// Returns the hint of a code, with the commands of `bcap` in place of the functions of the protocol.
pub(crate) fn hint_of(code: HResult) -> Option<String> {
    const COMMANDS: [(&str, &str); 3] = [
        ("GetCurErrorInfo", "`bcap errors`"),
        ("ClearError", "`bcap errors --clear`"),
        ("the matching Get...Names function lists", "`bcap names` lists"),
    ];
    let hint = code.hint()?.to_string();
    Some(COMMANDS.iter().fold(hint, |hint, (function, command)| hint.replace(function, command)))
}

/// Returns the meaning of a code as the end of a message.
fn meaning(code: HResult) -> String {
    let meaning = code.meaning().map(|meaning| meaning.trim_end_matches('.'));
    meaning.map(|meaning| format!(": {meaning}")).unwrap_or_default()
}
