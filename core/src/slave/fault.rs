//! Why a stream has ended, and what is known of the controller since.

use core::fmt;

use super::reply::MoveReplyError;
use super::request::Step;
use crate::hresult::HResult;
use crate::procedure::Failure;
use crate::variant::{Bstr, Variant};

/// How many of the controller's errors a fault keeps, the earliest ones.
pub const ERRORS_MAX: usize = 4;
/// How many bytes of an error's text are kept.
const TEXT_MAX: usize = 80;

/// A call of the engine has failed, and what the controller said about it.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// The call.
    pub step: Step,
    /// Why it failed.
    pub cause: Cause,
    /// Whether Slave Mode is off, as slvGetMode told afterwards.
    pub released: Released,
    /// Whether the emergency stop is pressed; `None` when the controller did not say.
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
    /// It had no answer.
    Failed(Failure),
    /// The answer to slvMove is not what the formats say.
    Reply(MoveReplyError),
    /// The answer carries no position, mode or state of the system.
    NoValue,
    /// The robot does not stand where the stream begins.
    NotAtStart {
        /// The number of the pose, counted from 1, that is off the most.
        number: u8,
        /// Where the robot stands.
        actual: f64,
        /// Where the stream begins.
        expected: f64,
    },
    /// The buffer stayed full for [`Config::stall`](super::Config::stall): the robot takes no poses.
    Stalled,
    /// The emergency stop is pressed, so the recovery was not begun.
    EmergencyStop,
}

/// Whether Slave Mode is off after a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Released {
    /// It is off.
    Yes,
    /// It is on, and could not be left.
    No,
    /// The controller could not be asked.
    Unknown,
}

/// An error that is present in the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ControllerError {
    /// Its code.
    pub code: HResult,
    text: heapless::String<TEXT_MAX>,
}

impl ControllerError {
    /// Reads what GetCurErrorInfo answers: the code, the text, and more that is not kept.
    pub(super) fn read(value: Variant<'_>) -> Option<Self> {
        let mut elements = value.as_array()?.iter();
        let code = match elements.next()? {
            Variant::I4(n) => n,
            Variant::Ui4(n) => n.cast_signed(),
            Variant::Error(code) => code.0,
            // some controllers keep codes in 64 bits
            Variant::I8(n) => u32::try_from(n).map(u32::cast_signed).or_else(|_| i32::try_from(n)).ok()?,
            _ => return None,
        };
        let text = elements.next().and_then(|v| v.as_bstr()).unwrap_or_default();
        Some(Self { code: HResult(code), text: cut(text) })
    }

    /// Returns the controller's text, cut after 80 bytes; empty when there was none.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }
}

/// Copies as much of a text as fits.
fn cut(text: Bstr<'_>) -> heapless::String<TEXT_MAX> {
    let mut out = heapless::String::new();
    for unit in text.chars() {
        if out.push(unit.unwrap_or(char::REPLACEMENT_CHARACTER)).is_err() {
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
        // no more are asked for than fit
        let _ = self.errors.push(error);
    }

    /// Returns the controller's errors, the first cause first.
    #[must_use]
    pub fn errors(&self) -> &[ControllerError] {
        &self.errors
    }

    /// Returns the code to report: the first error of the controller, or else the code with which it refused the call.
    ///
    /// A slvMove after an error is refused with 0x83500121, which says no more than that Slave Mode is off.
    #[must_use]
    pub fn code(&self) -> Option<HResult> {
        let refused = match self.cause {
            Cause::Refused(code) => Some(code),
            _ => None,
        };
        self.errors.first().map(|error| error.code).or(refused)
    }

    /// Tells whether the controller's buffer ran empty while the robot moved.
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
            Self::NoValue => f.write_str("the reply has no such value"),
            Self::NotAtStart { number, actual, expected } => write!(
                f,
                "the robot is not at the start: number {number} of its pose is {actual}, the stream begins at {expected}"
            ),
            Self::Stalled => f.write_str("the controller takes no more poses"),
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
    /// There is no fault, or it is still being looked into.
    NoFault,
    /// The emergency stop was pressed: a person has to look at the robot, and a new engine be made.
    EmergencyStop,
    /// The connection is lost: make a new one, and a new engine.
    Lost,
}

impl fmt::Display for RecoverError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoFault => "there is nothing to recover from",
            Self::EmergencyStop => "no recovery after an emergency stop: look at the robot, then start anew",
            Self::Lost => "the connection is lost: connect and start anew",
        })
    }
}

impl core::error::Error for RecoverError {}
