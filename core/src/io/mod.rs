//! Two short loops that run a client over a transport: [`blocking`] and [`asynch`].
//!
//! Both do the same with the clients of [b-CAP](crate::bcap::Client) and [RAC](crate::rac::client::Client): send what
//! there is to send, wait for bytes until the next deadline, let the client think. All progress lives in the client,
//! never on the stack of a loop: to drop a future, or to return early with an error, loses nothing.

/// Tells the log about an event that the caller of a loop will not see.
macro_rules! note {
    ($protocol:literal, $event:expr) => {
        #[cfg(feature = "defmt")]
        defmt::debug!("{=str}: {}", $protocol, $event);
        #[cfg(feature = "log")]
        log::debug!("{}: {:?}", $protocol, $event);
    };
}

pub mod asynch;
pub mod blocking;

use core::fmt;

use crate::bcap;
use crate::bcap::slave::Failure;
use crate::hresult::HResult;
use crate::rac;
use crate::storage::Storage;
use crate::time::Instant;

/// Why a call has failed, by whose fault it is: `E` is the transport's error, `C` that of the client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CallError<E, C = bcap::client::ClientError> {
    /// The transport failed.
    Io(E),
    /// The peer has closed the connection.
    Disconnected,
    /// No reply came, or none that is one; or the call could not be sent.
    Client(C),
    /// The controller has refused the call.
    Refused(HResult),
}

/// Why a request over RAC has failed.
pub type RacError<E> = CallError<E, rac::client::ClientError>;

impl<E, C> CallError<E, C> {
    /// Returns the controller's code, when it has refused.
    #[must_use]
    pub const fn hresult(&self) -> Option<HResult> {
        match self {
            Self::Refused(code) => Some(*code),
            _ => None,
        }
    }
}

impl<E> CallError<E> {
    /// Tells whether the same connection can be used for another call.
    #[must_use]
    pub const fn is_recoverable(&self) -> bool {
        use bcap::client::ClientError::{Closed, Flooded, Malformed};
        !matches!(self, Self::Io(_) | Self::Disconnected | Self::Client(Malformed(_) | Flooded | Closed))
    }
}

impl<E> RacError<E> {
    /// Tells whether the same connection can be used for another request.
    ///
    /// After a timeout it can: the client waits for the old reply first. If that never comes,
    /// [`Outstanding`](rac::client::Timeout::Outstanding) says that only a new connection helps.
    #[must_use]
    pub const fn is_recoverable(&self) -> bool {
        use rac::client::ClientError::{Closed, Timeout, Unsolicited};
        use rac::client::Timeout::Outstanding;
        !matches!(self, Self::Io(_) | Self::Disconnected | Self::Client(Closed | Unsolicited | Timeout(Outstanding)))
    }
}

impl<E, C> From<C> for CallError<E, C> {
    fn from(error: C) -> Self {
        Self::Client(error)
    }
}

impl<E: fmt::Display, C: fmt::Display> fmt::Display for CallError<E, C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "the connection failed: {error}"),
            Self::Disconnected => f.write_str("the peer has closed the connection"),
            Self::Client(error) => error.fmt(f),
            Self::Refused(code) => write!(f, "the controller refused: {code}"),
        }
    }
}

impl<E, C> core::error::Error for CallError<E, C>
where
    E: core::error::Error + 'static,
    C: core::error::Error + 'static,
{
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            Self::Client(error) => Some(error),
            Self::Disconnected | Self::Refused(_) => None,
        }
    }
}

/// Says what an engine of Slave Mode must know of a call without a reply.
fn failure<E>(error: Option<&CallError<E>>) -> Failure {
    match error {
        Some(CallError::Client(error)) => (*error).into(),
        Some(CallError::Io(_) | CallError::Disconnected) => Failure::Lost,
        Some(CallError::Refused(_)) | None => Failure::Timeout,
    }
}

/// How often a loop reads at most what arrived before a call. A socket's buffer holds fewer datagrams, and a stream that sends
/// more ends its session.
const MAX_EARLY: usize = 512;

/// A sans-IO client, as the loops see it.
trait Machine {
    type Error;

    /// What to say when part of an abandoned call cannot be sent, and when there is no call to wait for.
    const BUSY: Self::Error;
    const CLOSED: Self::Error;

    /// Whether an empty read is a datagram and not the end.
    fn has_datagrams(&self) -> bool;
    /// How long the rest of an abandoned call may take to be sent.
    fn patience(&self) -> core::time::Duration;
    fn transmit(&self) -> &[u8];
    fn transmitted(&mut self, count: usize);
    fn receive_buffer(&mut self) -> &mut [u8];
    fn received(&mut self, count: usize);
    fn poll_timeout(&self) -> Option<Instant>;
    fn is_closed(&self) -> bool;
    fn abandon(&mut self);
    /// Looks at what was received.
    fn poll(&mut self, now: Instant) -> Option<Step<Self::Error>>;
    fn handle_timeout(&mut self, now: Instant) -> Option<Step<Self::Error>>;
}

/// What an event means for the call that a loop waits for.
enum Step<C> {
    /// Nothing.
    Going,
    /// It has its reply.
    Replied(HResult),
    /// It has ended without one.
    Failed(C),
}

impl<C> Step<C> {
    /// Says whether the call has ended, and how.
    fn end<E>(self) -> Option<Result<(), CallError<E, C>>> {
        match self {
            Self::Going => None,
            Self::Replied(code) if code.is_err() => Some(Err(CallError::Refused(code))),
            Self::Replied(_) => Some(Ok(())),
            Self::Failed(error) => Some(Err(CallError::Client(error))),
        }
    }
}

/// The methods that both clients have under the same names.
macro_rules! machine {
    ($client:path) => {
        fn transmit(&self) -> &[u8] {
            <$client>::transmit(self)
        }

        fn transmitted(&mut self, count: usize) {
            <$client>::transmitted(self, count);
        }

        fn receive_buffer(&mut self) -> &mut [u8] {
            <$client>::receive_buffer(self)
        }

        fn received(&mut self, count: usize) {
            <$client>::received(self, count);
        }

        fn poll_timeout(&self) -> Option<Instant> {
            <$client>::poll_timeout(self)
        }

        fn is_closed(&self) -> bool {
            <$client>::is_closed(self)
        }

        fn abandon(&mut self) {
            <$client>::abandon(self);
        }

        fn poll(&mut self, now: Instant) -> Option<Step<Self::Error>> {
            self.poll_event(now).map(Step::from)
        }

        fn handle_timeout(&mut self, now: Instant) -> Option<Step<Self::Error>> {
            <$client>::handle_timeout(self, now).map(Step::from)
        }
    };
}

impl<T: Storage, R: Storage> Machine for bcap::Client<T, R> {
    type Error = bcap::client::ClientError;

    const BUSY: Self::Error = bcap::client::ClientError::Busy;
    const CLOSED: Self::Error = bcap::client::ClientError::Closed;

    fn has_datagrams(&self) -> bool {
        self.config().link == bcap::Link::Datagram
    }

    fn patience(&self) -> core::time::Duration {
        self.config().attempt_timeout
    }

    machine!(bcap::Client<T, R>);
}

impl<V: Storage> Machine for rac::client::Client<V> {
    type Error = rac::client::ClientError;

    const BUSY: Self::Error = rac::client::ClientError::Busy;
    const CLOSED: Self::Error = rac::client::ClientError::Closed;

    fn has_datagrams(&self) -> bool {
        false
    }

    fn patience(&self) -> core::time::Duration {
        self.config().timeout
    }

    machine!(rac::client::Client<V>);
}

impl From<bcap::client::Event> for Step<bcap::client::ClientError> {
    fn from(event: bcap::client::Event) -> Self {
        use bcap::client::Event::{Executing, Failed, Malformed, Replied, Retried, Stale};
        match event {
            Replied(code) => Self::Replied(code),
            Failed(error) => Self::Failed(error),
            Executing | Retried { .. } | Stale { .. } | Malformed(_) => {
                note!("b-CAP", event);
                Self::Going
            }
        }
    }
}

impl From<rac::client::Event> for Step<rac::client::ClientError> {
    fn from(event: rac::client::Event) -> Self {
        use rac::client::Event::{Failed, Replied, Stale};
        match event {
            Replied(code) => Self::Replied(code),
            Failed(error) => Self::Failed(error),
            Stale => {
                note!("RAC", event);
                Self::Going
            }
        }
    }
}
