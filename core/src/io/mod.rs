//! Two short loops that run a client over a transport: [`blocking`] and [`asynch`].
//!
//! Both do the same with the clients of [b-CAP](crate::bcap::Client) and [RAC](crate::rac::Client): send what
//! there is to send, wait for bytes until the next deadline, and poll the client. What a step means is decided here, once
//! for both. All progress lives in the client, never on the stack of a loop: dropping a future, or returning early with an
//! error, loses nothing.
//!
//! `Connection::run` runs any [`Procedure`](crate::procedure::Procedure), over one connection or over two.

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
use crate::endpoint::Endpoint;
use crate::hresult::HResult;
use crate::procedure::{Failure, Procedure};
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

/// A procedure has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RunError<P, E> {
    /// Why, as the procedure tells it.
    pub error: P,
    /// The first of its calls that has no reply, with the transport's error; `None` when all of them were answered.
    pub call: Option<CallError<E>>,
}

impl<P: fmt::Display, E: fmt::Display> fmt::Display for RunError<P, E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)?;
        match &self.call {
            Some(call) => write!(f, ": {call}"),
            None => Ok(()),
        }
    }
}

impl<P, E> core::error::Error for RunError<P, E>
where
    P: core::error::Error + 'static,
    E: core::error::Error + 'static,
{
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        let call = self.call.as_ref()?;
        Some(call)
    }
}

/// Says what a procedure must know of a call without a reply.
fn failure<E>(error: &CallError<E>) -> Failure {
    match error {
        CallError::Client(error) => (*error).into(),
        CallError::Io(_) | CallError::Disconnected => Failure::Lost,
        // the code is in the reply, which is handed in instead
        CallError::Refused(_) => Failure::Timeout,
    }
}

/// Hands the end of a call to the procedure that wanted it, and returns why there is no reply.
fn hand_in<P: Procedure, T: Storage, R: Storage, E>(
    procedure: &mut P,
    client: &bcap::Client<T, R>,
    ended: Result<(), CallError<E>>,
    now: Instant,
) -> Option<CallError<E>> {
    match (ended, client.reply()) {
        (Ok(()) | Err(CallError::Refused(_)), Some(reply)) => procedure.handle_reply(&reply, now),
        (Ok(()), None) => procedure.handle_failure(Failure::Timeout, now),
        (Err(error), _) => {
            let failure = failure(&error);
            note!("b-CAP, a call of a procedure has no reply", failure);
            procedure.handle_failure(failure, now);
            return Some(error);
        }
    }
    None
}

/// How often a loop reads at most what arrived before a call. A socket's buffer holds fewer datagrams, and a stream that sends
/// more ends its session.
const MAX_EARLY: usize = 512;

/// A sans-IO client, as the loops see it.
trait Machine: Endpoint {
    type Error;

    /// What to say when part of an abandoned call cannot be sent, and when there is no call to wait for.
    const BUSY: Self::Error;
    const CLOSED: Self::Error;

    /// Whether an empty read is a datagram and not the end.
    fn has_datagrams(&self) -> bool;
    /// How long the rest of an abandoned call may take to be sent.
    fn flush_timeout(&self) -> core::time::Duration;
    fn is_over(&self) -> bool;
    fn give_up(&mut self);
    /// Returns what the received bytes mean.
    fn poll(&mut self, now: Instant) -> Option<Step<Self::Error>>;
    /// Returns what the time means.
    fn time_out(&mut self, now: Instant) -> Option<Step<Self::Error>>;
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

/// What a loop does next to the link.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    Send,
    Receive,
}

/// Returns what a loop does next for the call in flight, and until when; `None` when no call is in flight.
fn next<M: Machine>(client: &M) -> Option<(Direction, Instant)> {
    let direction = if client.transmit().is_empty() { Direction::Receive } else { Direction::Send };
    client.poll_timeout().map(|until| (direction, until))
}

/// Records bytes that were sent or received, `None` when the time was over first, and returns the end of the call.
fn moved<M: Machine, E>(
    client: &mut M,
    direction: Direction,
    count: Option<usize>,
    until: Instant,
    now: Instant,
) -> Option<Result<(), CallError<E, M::Error>>> {
    match (direction, count) {
        (_, None) => {}
        (Direction::Send, Some(count)) => client.transmitted(count),
        (Direction::Receive, Some(0)) if !client.has_datagrams() => return Some(Err(CallError::Disconnected)),
        (Direction::Receive, Some(count)) => client.received(count),
    }
    while let Some(step) = client.poll(now) {
        if let Some(end) = step.end() {
            return Some(end);
        }
    }
    // after the events, so that a reply that has just arrived counts
    if count.is_some() && now < until {
        return None;
    }
    client.time_out(now).and_then(Step::end)
}

impl<T: Storage, R: Storage> Machine for bcap::Client<T, R> {
    type Error = bcap::client::ClientError;

    const BUSY: Self::Error = bcap::client::ClientError::Busy;
    const CLOSED: Self::Error = bcap::client::ClientError::Closed;

    fn has_datagrams(&self) -> bool {
        self.link() == bcap::Link::Datagram
    }

    fn flush_timeout(&self) -> core::time::Duration {
        self.timing().attempt_timeout
    }

    fn is_over(&self) -> bool {
        self.is_closed()
    }

    fn give_up(&mut self) {
        self.abandon();
    }

    fn poll(&mut self, now: Instant) -> Option<Step<Self::Error>> {
        self.poll_event(now).map(Step::from)
    }

    fn time_out(&mut self, now: Instant) -> Option<Step<Self::Error>> {
        self.handle_timeout(now).map(Step::from)
    }
}

impl<V: Storage> Machine for rac::Client<V> {
    type Error = rac::client::ClientError;

    const BUSY: Self::Error = rac::client::ClientError::Busy;
    const CLOSED: Self::Error = rac::client::ClientError::Closed;

    fn has_datagrams(&self) -> bool {
        false
    }

    fn flush_timeout(&self) -> core::time::Duration {
        self.config().timeout
    }

    fn is_over(&self) -> bool {
        self.is_closed()
    }

    fn give_up(&mut self) {
        self.abandon();
    }

    fn poll(&mut self, now: Instant) -> Option<Step<Self::Error>> {
        self.poll_event(now).map(Step::from)
    }

    fn time_out(&mut self, now: Instant) -> Option<Step<Self::Error>> {
        self.handle_timeout(now).map(Step::from)
    }
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
