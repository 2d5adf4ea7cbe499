//! Two short loops that run a client over a transport: [`blocking`] and [`asynch`].
//!
//! Both do the same with the same [`Client`](crate::bcap::Client): send what it has to send, wait for bytes until its
//! next deadline, let it think. All progress lives in the client, never on the stack of a loop: to drop a future, or to
//! return early with an error, loses nothing.

pub mod asynch;
pub mod blocking;

use core::fmt;

use crate::bcap::client::{ClientError, Event};
use crate::hresult::HResult;

/// Why a call has failed, by whose fault it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CallError<E> {
    /// The transport failed.
    Io(E),
    /// The peer has closed the connection.
    Disconnected,
    /// No reply came, or none that is one; or the call could not be sent.
    Client(ClientError),
    /// The controller has refused the call.
    Refused(HResult),
}

impl<E> CallError<E> {
    /// Returns the controller's code, when it has refused.
    #[must_use]
    pub const fn hresult(&self) -> Option<HResult> {
        match self {
            Self::Refused(code) => Some(*code),
            _ => None,
        }
    }

    /// Tells whether the same connection can be used for another call.
    #[must_use]
    pub const fn is_recoverable(&self) -> bool {
        !matches!(
            self,
            Self::Io(_) | Self::Disconnected | Self::Client(ClientError::Malformed(_) | ClientError::Closed)
        )
    }
}

impl<E> From<ClientError> for CallError<E> {
    fn from(error: ClientError) -> Self {
        Self::Client(error)
    }
}

impl<E: fmt::Display> fmt::Display for CallError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "the connection failed: {error}"),
            Self::Disconnected => f.write_str("the peer has closed the connection"),
            Self::Client(error) => error.fmt(f),
            Self::Refused(code) => write!(f, "the controller refused: {code}"),
        }
    }
}

impl<E: core::error::Error + 'static> core::error::Error for CallError<E> {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            Self::Client(error) => Some(error),
            Self::Disconnected | Self::Refused(_) => None,
        }
    }
}

/// Says whether an event ends the call, and how.
fn ends<E>(event: Event) -> Option<Result<(), CallError<E>>> {
    match event {
        Event::Replied(code) if code.is_err() => Some(Err(CallError::Refused(code))),
        Event::Replied(_) => Some(Ok(())),
        Event::Failed(error) => Some(Err(CallError::Client(error))),
        Event::Executing | Event::Retried { .. } | Event::Stale { .. } | Event::Malformed(_) => {
            note(event);
            None
        }
    }
}

/// Tells the log about what the caller will not see.
#[cfg_attr(not(any(feature = "defmt", feature = "log")), expect(unused_variables, reason = "there is no log"))]
fn note(event: Event) {
    #[cfg(feature = "defmt")]
    defmt::debug!("b-CAP: {}", event);
    #[cfg(feature = "log")]
    log::debug!("b-CAP: {event:?}");
}
