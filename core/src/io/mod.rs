//! Loops that run a client over a transport: [`blocking`] and [`asynch`].
//!
//! Both run the clients of [b-CAP](crate::bcap::Client) and [RAC](crate::rac::Client) in the same way: they send the
//! client's bytes, wait for bytes until the next deadline, and poll the client. `connection.rs` has the connections of both,
//! this file the steps of their loops. All progress is in the client, not on the stack of a loop: a dropped future or an early
//! return loses nothing.
//!
//! `Connection::run` runs any [`Procedure`], over one connection or over two.

/// Logs an event that a loop does not return to its caller.
macro_rules! log_event {
    ($protocol:literal, $event:expr) => {
        #[cfg(feature = "defmt")]
        defmt::debug!("{=str}: {}", $protocol, $event);
        #[cfg(feature = "log")]
        log::debug!("{}: {:?}", $protocol, $event);
    };
}

#[macro_use]
mod connection;

pub mod asynch;
pub mod blocking;

use core::fmt;

#[cfg(feature = "embedded-io")]
use embedded_io::ErrorKind;
#[cfg(all(feature = "embedded-io-async", not(feature = "embedded-io")))]
use embedded_io_async::ErrorKind;

use crate::bcap;
use crate::endpoint::Endpoint;
use crate::hresult::HResult;
use crate::procedure::{Failure, Procedure};
use crate::rac;
use crate::storage::Storage;
use crate::time::Instant;

/// The cause of a failed call, by the side that caused it; `E` is the error of the transport, `C` the error of the
/// client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum CallError<E, C = bcap::client::ClientError> {
    /// The transport failed.
    Io(E),
    /// The peer has closed the connection.
    Disconnected,
    /// No valid reply arrived, or the call could not be sent.
    Client(C),
    /// The controller refused the call.
    Refused(HResult),
}

/// Why a request over RAC failed.
pub type RacError<E> = CallError<E, rac::client::ClientError>;

impl<E, C> CallError<E, C> {
    /// Returns the controller's code, if it refused the call.
    #[must_use]
    pub const fn hresult(&self) -> Option<HResult> {
        match self {
            Self::Refused(code) => Some(*code),
            _ => None,
        }
    }
}

impl<E> CallError<E> {
    /// Returns whether the same connection can be used for another call.
    #[must_use]
    pub const fn is_recoverable(&self) -> bool {
        use bcap::client::ClientError::{Closed, Flooded, Malformed};
        !matches!(self, Self::Io(_) | Self::Disconnected | Self::Client(Malformed(_) | Flooded | Closed))
    }
}

impl<E> RacError<E> {
    /// Returns whether the same connection can be used for another request.
    ///
    /// It can after a timeout: the client waits for the old reply first. If the old reply does not arrive, the next request
    /// fails with [`Outstanding`](rac::client::Timeout::Outstanding), and a new connection is needed.
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
#[non_exhaustive]
pub struct RunError<P, E> {
    /// The error of the procedure.
    pub error: P,
    /// The error of its first call without a reply; `None` when all of its calls got a reply.
    pub call: Option<CallError<E>>,
}

impl<P, E> RunError<P, E> {
    /// Converts the error of the procedure.
    pub fn map<Q>(self, convert: impl FnOnce(P) -> Q) -> RunError<Q, E> {
        RunError { error: convert(self.error), call: self.call }
    }
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

/// Converts the error of a call without a reply to the failure that a procedure handles.
fn failure<E>(error: &CallError<E>) -> Failure {
    match error {
        CallError::Client(error) => (*error).into(),
        CallError::Io(_) | CallError::Disconnected => Failure::Lost,
        // not used: a refused call has a reply, which the procedure handles
        CallError::Refused(_) => Failure::Timeout,
    }
}

/// Passes the reply or failure of a call to its procedure; returns the error of a call without a reply.
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
            let failure = match failure(&error) {
                Failure::Lost if !client.was_sent() => Failure::Closed,
                failure => failure,
            };
            log_event!("b-CAP, a call of a procedure has no reply", failure);
            procedure.handle_failure(failure, now);
            return Some(error);
        }
    }
    None
}

/// The maximum number of reads before a call, which drop early bytes. The buffer of a socket contains fewer datagrams, and
/// a stream with more replies ends its session.
const MAX_EARLY: usize = 512;

/// Returns whether an error of a device ends its connection. Any other error, such as a framing error or an overrun of a UART,
/// lost bytes: it costs one attempt at most, and does not end the call.
#[cfg(any(feature = "embedded-io", feature = "embedded-io-async"))]
const fn ends_connection(kind: ErrorKind) -> bool {
    use ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, NotConnected};
    matches!(kind, BrokenPipe | ConnectionAborted | ConnectionReset | NotConnected)
}

/// The common interface of the clients for the loops.
trait Machine: Endpoint {
    type Error;

    /// The errors for an abandoned call that cannot be sent completely, and for a session that has ended.
    const BUSY: Self::Error;
    const CLOSED: Self::Error;

    /// Returns whether a read of 0 bytes is a datagram, not the end of a stream.
    fn has_datagrams(&self) -> bool;
    /// Returns the time limit for sending the rest of an abandoned call.
    fn flush_timeout(&self) -> core::time::Duration;
    fn is_over(&self) -> bool;
    fn give_up(&mut self);
    /// Handles received bytes, and reads the clock only if it must.
    fn poll(&mut self, now: &dyn Fn() -> Instant) -> Option<CallProgress<Self::Error>>;
    /// Handles a timeout.
    fn time_out(&mut self, now: Instant) -> Option<CallProgress<Self::Error>>;
}

/// The effect of an event on the call in flight.
enum CallProgress<C> {
    /// None.
    Going,
    /// The call got its reply.
    Replied(HResult),
    /// The call ended without a reply.
    Failed(C),
}

impl<C> CallProgress<C> {
    /// Returns the result of the call, if it has ended.
    fn end<E>(self) -> Option<Result<(), CallError<E, C>>> {
        match self {
            Self::Going => None,
            Self::Replied(code) if code.is_err() => Some(Err(CallError::Refused(code))),
            Self::Replied(_) => Some(Ok(())),
            Self::Failed(error) => Some(Err(CallError::Client(error))),
        }
    }
}

/// The next operation of a loop on the link.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    Send,
    Receive,
}

/// Returns the next operation for the call in flight, and its deadline; `None` when no call is in flight.
fn next<M: Machine>(client: &M) -> Option<(Direction, Instant)> {
    let direction = if client.transmit().is_empty() { Direction::Receive } else { Direction::Send };
    client.poll_timeout().map(|until| (direction, until))
}

/// Records `count` sent bytes, or a timeout as `None`; returns whether the request is sent.
///
/// A sent request has no event before the next receive, which ends at the same time, so its loop does not read the clock.
fn sent<M: Machine>(client: &mut M, count: Option<usize>) -> bool {
    client.transmitted(count.unwrap_or(0));
    count.is_some() && client.transmit().is_empty()
}

/// Records `count` received bytes, or a timeout as `None`; returns the result of the call, if it has ended.
fn moved<M: Machine, E>(
    client: &mut M,
    direction: Direction,
    count: Option<usize>,
    until: Instant,
    now: &dyn Fn() -> Instant,
) -> Option<Result<(), CallError<E, M::Error>>> {
    match (direction, count) {
        (Direction::Send, _) | (_, None) => {}
        (Direction::Receive, Some(0)) if !client.has_datagrams() => return Some(Err(CallError::Disconnected)),
        (Direction::Receive, Some(count)) => client.received(count),
    }
    while let Some(progress) = client.poll(now) {
        if let Some(end) = progress.end() {
            return Some(end);
        }
    }
    let now = now();
    // after the events, so that a reply that arrived in time counts
    if count.is_some() && now < until {
        return None;
    }
    client.time_out(now).and_then(CallProgress::end)
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

    fn poll(&mut self, now: &dyn Fn() -> Instant) -> Option<CallProgress<Self::Error>> {
        self.next_event(now).map(CallProgress::from)
    }

    fn time_out(&mut self, now: Instant) -> Option<CallProgress<Self::Error>> {
        self.handle_timeout(now).map(CallProgress::from)
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

    fn poll(&mut self, now: &dyn Fn() -> Instant) -> Option<CallProgress<Self::Error>> {
        self.poll_event(now()).map(CallProgress::from)
    }

    fn time_out(&mut self, now: Instant) -> Option<CallProgress<Self::Error>> {
        self.handle_timeout(now).map(CallProgress::from)
    }
}

impl From<bcap::client::Event> for CallProgress<bcap::client::ClientError> {
    fn from(event: bcap::client::Event) -> Self {
        use bcap::client::Event::{Executing, Failed, Malformed, Replied, Retried, Stale};
        match event {
            Replied(code) => Self::Replied(code),
            Failed(error) => Self::Failed(error),
            Executing | Retried { .. } | Stale { .. } | Malformed(_) => {
                log_event!("b-CAP", event);
                Self::Going
            }
        }
    }
}

impl From<rac::client::Event> for CallProgress<rac::client::ClientError> {
    fn from(event: rac::client::Event) -> Self {
        use rac::client::Event::{Failed, Replied, Stale};
        match event {
            Replied(code) => Self::Replied(code),
            Failed(error) => Self::Failed(error),
            Stale => {
                log_event!("RAC", event);
                Self::Going
            }
        }
    }
}

#[cfg(test)]
#[cfg(all(feature = "embedded-io", feature = "embedded-io-async"))]
mod tests;
