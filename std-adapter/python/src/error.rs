//! Errors as exceptions, whose classes are in `bcap.errors`.

use bcap_std::core::hresult::HResult;
use bcap_std::{Error, Motion};
use pyo3::prelude::*;

/// Returns the exception for an error.
pub(crate) fn raise(py: Python<'_>, error: &Error) -> PyErr {
    let kind = match error {
        Error::Refused { .. } => "ControllerError",
        Error::NotRecovered(_) => "NotRecovered",
        Error::NotHalted(_) => "NotHalted",
        Error::NotConnected { .. } | Error::Connect(_) | Error::Closed | Error::ArmLost => "NotConnected",
        Error::NoReply { .. } => "NoReply",
        Error::NotMet { .. } => "NotMet",
        Error::Stream(_) => "StreamError",
        Error::Address(_) | Error::Path(_) | Error::Argument(_) | Error::StreamConfig(_) => "InvalidArgument",
        _ => "Error",
    };
    exception(py, kind, error.to_string(), error.code())
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
