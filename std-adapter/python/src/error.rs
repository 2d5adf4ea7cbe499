//! Errors as exceptions, whose classes are in `bcap.errors`.

use std::time::Duration;

use bcap_std::core::bcap::client::ClientError;
use bcap_std::core::hresult::HResult;
use bcap_std::core::slave::{Cause, StreamError};
use bcap_std::{CallError, Error, Motion};
use bcap_stream::steps::StepError;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Why a call of Python failed.
pub(crate) enum Failure {
    /// The session has failed.
    Session(Error),
    /// A stream ended without an error of the session.
    Stream(StepError),
    /// The arm was given back before the call was sent.
    ArmGiven,
    /// The arm was given back during the call. If that succeeded, the robot was halted.
    ArmGivenMeanwhile { succeeded: bool },
    /// An argument is invalid, for a reason.
    Argument(String),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Session(error)
    }
}

impl From<StepError> for Failure {
    fn from(error: StepError) -> Self {
        match error {
            StepError::Failed(error) => Self::Session(error),
            other => Self::Stream(other),
        }
    }
}

impl Failure {
    /// Returns the exception.
    pub(crate) fn raise(self, py: Python<'_>) -> PyErr {
        let (class, text) = match self {
            Self::Session(error) => return raise(py, &error),
            Self::Stream(error) => ("StreamError", error.to_string()),
            Self::ArmGiven => ("NotConnected", "the arm was given back; take it again".to_owned()),
            Self::ArmGivenMeanwhile { succeeded: true } => (
                "OutcomeUnknown",
                "the arm was given back; the robot was halted on its way, unless it had arrived; read its position"
                    .to_owned(),
            ),
            Self::ArmGivenMeanwhile { succeeded: false } => (
                "NoReply",
                "the arm was given back during the call, and no halt was confirmed: the robot may be moving".to_owned(),
            ),
            Self::Argument(text) => ("InvalidArgument", text),
        };
        exception(py, class, text, None)
    }
}

/// Returns the exception for an error.
pub(crate) fn raise(py: Python<'_>, error: &Error) -> PyErr {
    let class = match error {
        // the controller has abandoned the call, and may still execute it
        Error::Refused { code: HResult::E_TIMEOUT, .. } => "NoReply",
        Error::Refused { .. } => "ControllerError",
        Error::NotRecovered(_) => "NotRecovered",
        Error::NotHalted(_) => "NotHalted",
        Error::NotConnected { .. } | Error::Connect(_) | Error::Closed | Error::ArmLost => "NotConnected",
        Error::NoReply { source: CallError::Client(ClientError::TooLarge { .. }), .. } => "InvalidArgument",
        Error::NoReply { .. } if error.may_have_run() => "NoReply",
        Error::NotMet { .. } => "NotMet",
        Error::Stream(StreamError::Fault { cause: Cause::Failed(_), .. }) => {
            return exception(py, "NoReply", format!("{error}; the robot may be moving"), None);
        }
        Error::Stream(_) => "StreamError",
        Error::Address(_) | Error::Path(_) | Error::Argument(_) | Error::StreamConfig(_) => "InvalidArgument",
        _ => "Error",
    };
    let made = exception(py, class, error.to_string(), error.code());
    // its class has a default
    match made.value(py).setattr("may_have_run", error.may_have_run()) {
        Ok(()) => made,
        Err(error) => error,
    }
}

/// Returns the exception for a motion that did not arrive.
pub(crate) fn not_arrived(py: Python<'_>, ended: Motion) -> PyErr {
    let (kind, text, code) = match ended {
        Motion::Failed(code) => {
            let meaning = code.meaning().unwrap_or_default();
            ("MotionFailed", format!("the motion failed: {code}: {meaning}"), Some(code))
        }
        Motion::Halted => ("Halted", "the robot was halted, and rests elsewhere".to_owned(), None),
        Motion::TimedOut => ("MotionTimeout", "the time limit passed, and the robot was halted".to_owned(), None),
        _ => (
            "OutcomeUnknown",
            "the robot rests, and whether that is the destination is unknown; read its position".to_owned(),
            None,
        ),
    };
    exception(py, kind, text, code)
}

/// Returns an exception of a class of `bcap.errors`.
pub(crate) fn exception(py: Python<'_>, class: &str, text: String, code: Option<HResult>) -> PyErr {
    let make = || {
        let class = py.import("bcap.errors")?.getattr(class)?;
        let Some(code) = code else { return class.call1((text,)) };
        class.call1((text, code.to_u32(), code.name(), code.meaning(), code.hint().map(|hint| hint.to_string())))
    };
    make().map_or_else(|error| error, PyErr::from_value)
}

/// Returns a duration; `ValueError` unless the number is finite and not negative.
pub(crate) fn seconds(number: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(number).map_err(|_| PyValueError::new_err(format!("invalid time: {number} s")))
}

/// Returns the exception for a word that is not in a list.
pub(crate) fn unknown(what: &str, word: &str, known: &str) -> PyErr {
    PyValueError::new_err(format!("unknown {what} {word:?}; known are {known}"))
}
