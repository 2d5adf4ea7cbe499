//! The fault that ended a stream, and the state of the controller after it.

use core::fmt;

use super::call::Step;
use super::reply::MoveReplyError;
use crate::bcap::StreamState;
use crate::hresult::HResult;
use crate::procedure::Failure;
use crate::variant::{Bstr, Variant};

/// The maximum number of controller errors in a fault; it contains the earliest ones.
pub const ERRORS_MAX: usize = 4;
/// The maximum length of an error's text, in bytes.
const TEXT_MAX: usize = 160;
/// The end of a text that was cut.
const CUT: char = '…';

/// A failed call of the engine, with the errors that the controller reported.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// The call.
    pub step: Step,
    /// Why it failed.
    pub cause: Cause,
    /// Whether Slave Mode is off, as slvGetMode reported after the failure.
    pub released: Released,
    /// Whether the emergency stop is pressed; `None` without a reply to that query.
    pub emergency_stop: Option<bool>,
    errors: heapless::Vec<ControllerError, ERRORS_MAX>,
}

/// Why a call of the engine has failed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Cause {
    /// The controller refused it.
    Refused(HResult),
    /// It has no reply.
    Failed(Failure),
    /// The reply to slvMove does not have the layout of the receive format.
    Reply(MoveReplyError),
    /// The reply carries no valid position, mode or system state.
    NoValue,
    /// The robot is not at the start of the stream.
    NotAtStart {
        /// The first value of the pose that exceeds the tolerance, counted from 1.
        number: u8,
        /// The value of the robot's position.
        actual: f64,
        /// The value of the start.
        expected: f64,
    },
    /// A stream of Slave Mode already runs, or the controller does not report whether one runs. Nothing was changed: the calls
    /// that start a stream would end the other stream.
    Occupied(StreamState),
    /// The buffer stayed full for [`Config::stall`](super::Config::stall): the robot does not execute poses.
    Stalled,
    /// The emergency stop is pressed, so the recovery was not started.
    EmergencyStop,
}

/// Whether Slave Mode is off after a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Released {
    /// It is off.
    Yes,
    /// It is on: it could not be left, or the stream of another client runs.
    No,
    /// The controller did not reply to the query.
    Unknown,
}

/// An error in the controller's error list.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ControllerError {
    /// Its code.
    pub code: HResult,
    text: heapless::String<TEXT_MAX>,
}

impl ControllerError {
    /// Reads the reply to GetCurErrorInfo: the code and the text; further elements are ignored.
    pub(super) fn read(value: Variant<'_>) -> Option<Self> {
        let mut elements = value.as_array()?.iter();
        let code = match elements.next()? {
            Variant::I4(n) => n,
            Variant::Ui4(n) => n.cast_signed(),
            Variant::Error(code) => code.0,
            // some controllers send codes with 64 bits
            Variant::I8(n) => u32::try_from(n).map(u32::cast_signed).or_else(|_| i32::try_from(n)).ok()?,
            _ => return None,
        };
        let text = elements.next().and_then(|v| v.as_bstr()).unwrap_or_default();
        Some(Self { code: HResult(code), text: cut(text) })
    }

    /// Returns the controller's text, cut to 160 bytes and then with `…` at its end; empty without a text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }
}

/// Copies the part of a text that fits.
fn cut(text: Bstr<'_>) -> heapless::String<TEXT_MAX> {
    let mut out = heapless::String::new();
    for unit in text.chars() {
        if out.push(unit.unwrap_or(char::REPLACEMENT_CHARACTER)).is_err() {
            while out.push(CUT).is_err() && out.pop().is_some() {}
            break;
        }
    }
    out
}

impl Fault {
    pub(super) const fn new(step: Step, cause: Cause, released: Released) -> Self {
        Self { step, cause, released, emergency_stop: None, errors: heapless::Vec::new() }
    }

    pub(super) fn push(&mut self, error: ControllerError) {
        // the engine reads no more errors than fit
        let _ = self.errors.push(error);
    }

    /// Returns the controller's errors, oldest first.
    #[must_use]
    pub fn errors(&self) -> &[ControllerError] {
        &self.errors
    }

    /// Returns the code to report: the first error of the controller, or else the code with which it refused the call.
    ///
    /// The controller refuses a slvMove after an error with 0x83500121, which only says that Slave Mode is off.
    #[must_use]
    pub fn code(&self) -> Option<HResult> {
        let refused = match self.cause {
            Cause::Refused(code) => Some(code),
            _ => None,
        };
        self.errors.first().map(|error| error.code).or(refused)
    }

    /// Returns whether the controller's buffer ran empty while the robot moved.
    #[must_use]
    pub fn is_underflow(&self) -> bool {
        let empty = HResult::E_COMMAND_BUFFER_EMPTY;
        self.cause == Cause::Refused(empty) || self.errors.iter().any(|error| error.code == empty)
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(code) => write!(f, "refused with {code}"),
            Self::Failed(failure) => failure.fmt(f),
            Self::Reply(error) => error.fmt(f),
            Self::NoValue => f.write_str("the reply has no valid value"),
            Self::NotAtStart { number, actual, expected } => write!(
                f,
                "the robot is not at the start: number {number} of its pose is {actual}, the stream begins at {expected}"
            ),
            Self::Occupied(StreamState::Unknown(code)) => {
                write!(f, "refused with {code}, so the stream of another client may run")
            }
            Self::Occupied(_) => f.write_str("a stream of Slave Mode runs already"),
            Self::Stalled => f.write_str("the controller accepts no more poses: its buffer stays full"),
            Self::EmergencyStop => f.write_str("the emergency stop is pressed"),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.step.name(), self.cause)?;
        if let Some(first) = self.errors.first() {
            write!(f, "; the controller's first error is {} {}", first.code, first.text())?;
        }
        Ok(())
    }
}

impl core::error::Error for Fault {}

/// A recovery was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RecoverError {
    /// There is no fault, or the engine is still diagnosing it.
    NoFault,
    /// The emergency stop was pressed: an operator must check the robot, and a new engine is needed.
    EmergencyStop,
    /// The connection is lost: a new connection and a new engine are needed.
    Lost,
}

impl fmt::Display for RecoverError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoFault => "there is nothing to recover from",
            Self::EmergencyStop => "no recovery after an emergency stop: check the robot, then start a new stream",
            Self::Lost => "the connection is lost: connect again and start a new stream",
        })
    }
}

impl core::error::Error for RecoverError {}
