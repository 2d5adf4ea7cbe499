//! Procedures: sequences of calls as values, without socket, clock or allocation.
//!
//! ```text
//!             poll ──► Call ──► make request() over its channel ──► handle_reply, or handle_failure ──┐
//!              ▲  ├──► Wait ──► until then ───────────────────────────────────────────────────────────┤
//!              │  │                                                                                   │
//!              │  └──► Done(result)                                                                   │
//!              └──────────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! A job that takes several calls is written once, as a [`Procedure`]: it says which call comes next and takes the reply.
//! [`io::blocking::Connection::run`](crate::io::blocking::Connection::run) and
//! [`io::asynch::Connection::run`](crate::io::asynch::Connection::run) run any of them.
//!
//! | procedure                                          | what it does                                                 |
//! |----------------------------------------------------|--------------------------------------------------------------|
//! | [`open`]                                           | starts the service and connects to the controller            |
//! | [`open_robot`]                                     | the same, and gets a robot                                   |
//! | [`open_path`]                                      | opens an object and the objects on the way to it             |
//! | [`release`], [`release_controller`], [`release_robot`] | releases in reverse order and stops the service          |
//! | [`read_variable`], [`write_variable`]              | opens a variable, reads or writes it, releases it            |
//! | [`prepare_robot`], [`give_arm`]                    | takes the arm and switches the motor on; gives the arm back  |
//! | [`move_and_wait`]                                  | starts a motion and waits for its end                        |
//! | [`slave::Stream`](crate::bcap::slave::Stream)      | streams poses in Slave Mode                                  |
//!
//! A procedure that fails undoes what it did before it reports the failure, as far as the connection still works: it
//! releases handles, gives the arm back, halts a motion.

mod motion;
mod open;
mod path;
mod release;
mod robot;
mod sequence;
mod variable;

use core::fmt;

use crate::bcap::call::{Call, ReplyError};
use crate::bcap::client::{ClientError, Timing};
use crate::bcap::{Frame, FunctionId, Link};
use crate::hresult::HResult;
use crate::time::Instant;

pub use self::motion::{Motion, MotionConfig, Move, move_and_wait};
pub use self::open::{Handles, Provider, open, open_robot};
pub use self::path::{Opened, Owner, PATH_MAX, PathError, PathStep, open_path};
pub use self::release::{release, release_controller, release_robot};
pub use self::robot::{give_arm, prepare_robot};
pub use self::variable::{read_variable, write_variable};

/// A sequence of calls.
pub trait Procedure {
    /// What it returns when it is done.
    type Output;
    /// Why it fails.
    type Error;

    /// Returns what to do next. The time counts as that of sending when this is a call.
    ///
    /// [`Action::Done`] is returned once; a procedure that is polled after that may return anything.
    fn poll(&mut self, now: Instant) -> Action<Result<Self::Output, Self::Error>>;

    /// Returns the call that [`poll`](Self::poll) has asked for, until its reply or failure is handed in.
    fn request(&self) -> Option<impl Call>;

    /// Returns the timing of that call, given the usual timing of the connection.
    fn timing(&self, link: Link, usual: Timing) -> Timing {
        let _ = link;
        usual
    }

    /// Takes the reply to the call, whatever its code.
    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant);

    /// Records that the call has no reply. Whether the controller has executed it is unknown, except after
    /// [`Failure::NotSent`].
    fn handle_failure(&mut self, failure: Failure, now: Instant);
}

impl<P: Procedure + ?Sized> Procedure for &mut P {
    type Output = P::Output;
    type Error = P::Error;

    fn poll(&mut self, now: Instant) -> Action<Result<Self::Output, Self::Error>> {
        (**self).poll(now)
    }

    fn request(&self) -> Option<impl Call> {
        (**self).request()
    }

    fn timing(&self, link: Link, usual: Timing) -> Timing {
        (**self).timing(link, usual)
    }

    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant) {
        (**self).handle_reply(reply, now);
    }

    fn handle_failure(&mut self, failure: Failure, now: Instant) {
        (**self).handle_failure(failure, now);
    }
}

/// What a procedure wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Action<T> {
    /// Make the call of [`Procedure::request`], and hand its reply or failure in. Until then this is repeated.
    Call(Channel),
    /// Poll again at this time.
    Wait(Instant),
    /// The procedure has ended.
    Done(T),
}

/// Which connection a call goes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Channel {
    /// The first one; most procedures use no other.
    Motion,
    /// A second one, which watches while the first is busy. Without one, the call goes over the first.
    Watch,
}

/// Why a call has no reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Failure {
    /// A time limit has passed, or the call was dropped; the connection can still be used.
    Timeout,
    /// The call could not be sent; the connection can still be used.
    NotSent,
    /// The connection is lost.
    Lost,
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
        })
    }
}

/// A call of a procedure has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StepError {
    /// The function that was called.
    pub function: FunctionId,
    /// Why it failed.
    pub cause: StepCause,
}

/// Why a call of a procedure has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StepCause {
    /// The controller refused it.
    Refused(HResult),
    /// The reply carries another value than the function gives.
    Reply(ReplyError),
    /// It has no reply.
    Failed(Failure),
    /// The procedure has no room for what the reply carries.
    TooLarge,
}

impl StepCause {
    /// Tells whether the controller may have executed the call all the same: only a refused call, and one that was never
    /// sent, are certain to have had no effect.
    pub(super) const fn may_have_run(&self) -> bool {
        !matches!(self, Self::Refused(_) | Self::Failed(Failure::NotSent))
    }
}

impl StepError {
    /// Returns the controller's code, when it has refused the call.
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
        }
    }
}

impl core::error::Error for StepError {}

#[cfg(test)]
mod tests;
