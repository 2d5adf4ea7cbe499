//! The errors of procedures.

use core::fmt;

use crate::bcap::FunctionId;
use crate::bcap::call::ReplyError;
use crate::bcap::client::ClientError;
use crate::hresult::HResult;

/// The reason why a call has no reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Failure {
    /// A time limit has passed, or the call was dropped; the connection can still be used.
    Timeout,
    /// The call could not be sent; the connection can still be used.
    NotSent,
    /// The connection is lost. The controller may have executed the call.
    Lost,
    /// The connection was lost before the whole call was sent, so the controller has not executed it.
    Closed,
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        match error {
            ClientError::Timeout(_) | ClientError::ReplyTooLarge { .. } | ClientError::Reply(_) => Self::Timeout,
            ClientError::Encode(_) | ClientError::TooLarge { .. } | ClientError::Busy => Self::NotSent,
            ClientError::Malformed(_) | ClientError::Flooded | ClientError::Closed => Self::Lost,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Timeout => "no reply in time",
            Self::NotSent => "could not be sent",
            Self::Lost => "the connection is lost",
            Self::Closed => "the connection was lost before the call was sent",
        })
    }
}

/// A call of a procedure has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct StepError {
    /// The function that was called.
    pub function: FunctionId,
    /// Why it failed.
    pub cause: StepCause,
    /// Whether the procedure has undone its effects, as far as the controller allowed it. Over a lost connection it cannot: a
    /// motion may continue, and the arm may remain taken. Tasks that a halt stopped are not restarted.
    pub undone: bool,
    /// Whether a call that undoes an effect may not have been carried out, because it has no reply or was refused, or the
    /// connection is lost: a motion may continue, the motor may be on, the arm may be taken.
    pub unsettled: bool,
}

/// Why a call of a procedure has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StepCause {
    /// The controller refused it.
    Refused(HResult),
    /// The reply carries a value of another type than the function returns.
    Reply(ReplyError),
    /// It has no reply.
    Failed(Failure),
    /// The procedure has no room for the values of the reply.
    TooLarge,
    /// The call succeeded, and the procedure must not continue after it: the state does not permit that, or the caller has
    /// stopped it.
    Stopped,
}

impl StepCause {
    /// Returns whether the controller may have executed the call. Only a call that was not sent, and a refused one, certainly
    /// had no effect; E_TIMEOUT means that the controller abandoned the call, which may still run.
    pub(super) const fn may_have_run(&self) -> bool {
        match self {
            Self::Refused(code) => matches!(*code, HResult::E_TIMEOUT),
            Self::Failed(failure) => !matches!(failure, Failure::NotSent | Failure::Closed),
            _ => true,
        }
    }
}

impl StepError {
    /// Returns whether the procedure certainly has no lasting effect: no call with an effect was executed, or all such calls
    /// were undone.
    #[must_use]
    pub const fn had_no_effect(&self) -> bool {
        self.undone && !self.cause.may_have_run()
    }

    /// Returns the controller's code, if it refused the call.
    #[must_use]
    pub const fn hresult(&self) -> Option<HResult> {
        match self.cause {
            StepCause::Refused(code) => Some(code),
            _ => None,
        }
    }
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.function, self.cause)
    }
}

impl fmt::Display for StepCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(code) => write!(f, "the controller refused: {code}"),
            Self::Reply(error) => error.fmt(f),
            Self::Failed(failure) => failure.fmt(f),
            Self::TooLarge => f.write_str("the reply is longer than expected"),
            Self::Stopped => f.write_str("stopped"),
        }
    }
}

impl core::error::Error for StepError {}
