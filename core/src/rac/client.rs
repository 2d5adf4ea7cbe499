//! The sans-IO client of RAC: one request at a time.
//!
//! ```text
//!   start ──► transmit ─► the link ─► receive_buffer, received ──► poll_event ──► reply
//!                                                                      │
//!             handle_timeout at poll_timeout ◄─────────────────────────┘
//! ```
//!
//! A [`Client`] contains no socket and no clock. The caller sends the bytes of [`transmit`](Client::transmit), copies received
//! bytes to [`receive_buffer`](Client::receive_buffer), passes the time, and reads events.
//!
//! RAC has no sequence numbers: a reply belongs to the oldest request without one. So the client counts replies.
//!
//! * After a timeout or [`abandon`](Client::abandon) the old reply is still expected. When it arrives, it is dropped
//!   and reported as [`Event::Stale`]. A request that is started before that is sent after it, because a session
//!   carries one request at a time (RAC specification, section 3.1). So a reply is never taken for the reply to another
//!   request.
//! * If the old reply does not arrive, the pending request ends with [`Timeout::Outstanding`]. It was not sent, and the caller
//!   must reconnect.
//! * A partly sent request is always sent to its end, so that the stream stays in sync. An abandoned request that was
//!   not even partly sent is dropped, and no reply is expected.
//! * An unsolicited line ends the session, because the count of replies is no longer reliable. A line is unsolicited if
//!   its first byte arrived before the last byte of the request was sent.
//! * An invalid reply ends its request, not the session.

use core::fmt;
use core::time::Duration;

use super::MAX_VALUE;
use super::line::{Framed, LineFramer, MAX_LINE};
use super::request::Request;
use super::response::{self, Response};
use crate::endpoint::Endpoint;
use crate::error::{TextError, TextErrorKind};
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::outbox::Outbox;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::text::complete;
use crate::variant::{Variant, Writer};

/// How a client behaves; every field is a run-time choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Time limit of a request, from its start to its reply.
    pub timeout: Duration,
}

impl Config {
    /// 3 s for a reply, the timeout of the vendor's b-CAP clients.
    pub const TCP: Self = Self { timeout: Duration::from_secs(3) };
}

impl Default for Config {
    fn default() -> Self {
        Self::TCP
    }
}

/// An event of a client. It borrows nothing, so it can be kept while the client is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
#[non_exhaustive]
pub enum Event {
    /// The reply arrived, with this result; [`Client::reply`] views it.
    Replied(HResult),
    /// The request ended without a valid reply.
    Failed(ClientError),
    /// The reply to a timed-out or abandoned request arrived and was dropped.
    Stale,
}

/// The reply that did not arrive in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Timeout {
    /// The reply to the request; the server may or may not have executed it.
    Reply,
    /// The reply to an earlier request; this one was not sent.
    Outstanding,
}

/// The reason why a request was not started or ended without a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ClientError {
    /// The value of the request has no text, or the line is over 256 bytes; the caller's fault, nothing was sent.
    Request(TextError),
    /// A request is in flight, or part of an abandoned one is still to be sent; the caller's fault, nothing was sent.
    Busy,
    /// A reply did not arrive in time.
    Timeout(Timeout),
    /// The reply is invalid; the session continues.
    Reply(TextError),
    /// The value of the reply does not fit the caller's memory; the session continues.
    ReplyTooLarge {
        /// The size of that memory in bytes.
        limit: u32,
    },
    /// The peer sent an unsolicited line; the session ended.
    Unsolicited,
    /// The session ended earlier.
    Closed,
}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Request(e) => write!(f, "the request cannot be sent: {e}"),
            Self::Busy => f.write_str("another request is in flight"),
            Self::Timeout(Timeout::Reply) => f.write_str("no reply within the timeout"),
            Self::Timeout(Timeout::Outstanding) => {
                f.write_str("not sent: the reply to an earlier request is still missing; connect again")
            }
            Self::Reply(e) => write!(f, "the peer's reply cannot be read: {e}"),
            Self::ReplyTooLarge { limit } => write!(f, "the value of the reply is over {limit} bytes"),
            Self::Unsolicited => f.write_str("the peer sent an unsolicited line"),
            Self::Closed => f.write_str("the session has ended"),
        }
    }
}

impl core::error::Error for ClientError {}

/// A client with its memory: two lines of 256 bytes, and the caller's memory for the value of a reply.
///
/// 64 bytes are enough for every kind of variable but strings, [`MAX_VALUE`] for any value that fits a line.
///
/// # Examples
///
/// ```
/// use bcap_core::endpoint::Endpoint;
/// use bcap_core::rac::client::{Client, Config, Event};
/// use bcap_core::rac::{Request, Variable, VariableKind};
/// use bcap_core::time::Instant;
/// use bcap_core::variant::Variant;
///
/// let mut client = Client::new(Config::TCP, [0; 64]);
/// client.start(&Request::Get(Variable::new(VariableKind::F, 10)), Instant::ZERO)?;
/// assert_eq!(client.transmit(), b"GET:RC8:10:F:\r"); // to be sent
/// client.transmitted(14);
///
/// client.receive_buffer()[..13].copy_from_slice(b"0, 4, 123.01\r");
/// client.received(13);
/// assert!(matches!(client.poll_event(Instant::ZERO), Some(Event::Replied(result)) if result.is_ok()));
/// assert_eq!(client.reply().and_then(|reply| reply.value), Some(Variant::R4(123.01)));
/// # Ok::<(), bcap_core::rac::client::ClientError>(())
/// ```
#[derive(Debug)]
pub struct Client<V> {
    value: V,
    state: State,
}

/// The part of a client that does not depend on the type of the caller's memory.
#[derive(Debug)]
struct State {
    config: Config,
    framer: LineFramer,
    tx: [u8; MAX_LINE],
    /// The unsent part of the request in `tx`.
    outbox: Outbox,
    /// The deadline of the request in flight.
    until: Option<Instant>,
    /// The reply to an earlier request is still expected; at most one, because no request is sent before it arrives.
    owed: bool,
    /// The line that is arriving had begun before the request in flight had left.
    is_early: bool,
    reply: Option<StoredReply>,
    closed: bool,
}

/// The reply to the last request; its value is in the caller's memory.
#[derive(Clone, Copy, Debug)]
struct StoredReply {
    result: HResult,
    /// Bytes of the value; 0 without a value.
    len: usize,
}

impl<V: Storage> Client<V> {
    /// Creates a client; `value` takes the values of replies.
    #[must_use]
    pub const fn new(config: Config, value: V) -> Self {
        Self { value, state: State::new(config) }
    }

    /// Returns the configuration.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.state.config
    }

    /// Changes the configuration, from the next request on.
    pub const fn set_config(&mut self, config: Config) {
        self.state.config = config;
    }

    /// Starts a request; the caller then sends its line.
    ///
    /// # Errors
    ///
    /// [`ClientError::Busy`] while a request is in flight or part of an abandoned one is unsent,
    /// [`ClientError::Closed`] after the session ended, [`ClientError::Request`] when the request has no line,
    /// [`ClientError::Unsolicited`] if an unsolicited line arrived, which ends the session.
    pub fn start(&mut self, request: &Request<'_>, now: Instant) -> Result<(), ClientError> {
        self.state.start(request, now)
    }

    /// Returns the event in the received bytes; `None` when more are needed. A new line replaces the previous reply.
    pub fn poll_event(&mut self, now: Instant) -> Option<Event> {
        // the time is not used: a reply that arrived counts, even after its deadline
        let _ = now;
        if self.state.closed {
            return None;
        }
        let framed = self.state.framer.poll()?;
        // grow memory that can grow, once
        self.value.grow(MAX_VALUE);
        Some(self.state.handle_line(framed, self.value.bytes_mut()))
    }

    /// Returns the reply of [`Event::Replied`], until the next line arrives or a request is started.
    #[must_use]
    pub fn reply(&self) -> Option<Response<'_>> {
        let StoredReply { result, len } = self.state.reply?;
        let bytes = self.value.bytes().get(..len)?;
        Some(Response { result, value: (!bytes.is_empty()).then(|| Variant::from_checked(bytes)) })
    }

    /// Handles a timeout: ends a request without a reply. Does nothing before its deadline.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Event> {
        if now < self.state.until? {
            return None;
        }
        let timeout = if self.state.owed { Timeout::Outstanding } else { Timeout::Reply };
        self.state.give_up();
        Some(Event::Failed(ClientError::Timeout(timeout)))
    }

    /// Abandons the request in flight, if there is one. Its reply will be stale.
    pub fn abandon(&mut self) {
        self.state.give_up();
    }

    /// Returns whether a request is in flight.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.state.until.is_some()
    }

    /// Returns whether the reply to an earlier request is still expected, which delays a new one.
    #[must_use]
    pub const fn is_owed(&self) -> bool {
        self.state.owed
    }

    /// Returns whether an unsolicited line ended the session.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.state.closed
    }

    /// Starts a new session over a new connection: discards the request in flight and everything received.
    pub const fn reset(&mut self) {
        self.state = State::new(self.state.config);
    }
}

impl<V: Storage> Endpoint for Client<V> {
    fn transmit(&self) -> &[u8] {
        self.state.transmit()
    }

    fn transmitted(&mut self, count: usize) {
        // bytes that are held back cannot have been sent
        let count = count.min(self.state.transmit().len());
        if self.state.outbox.transmitted(count) && !self.state.outbox.is_sending() {
            self.state.is_early = self.state.framer.has_begun();
        }
    }

    fn receive_buffer(&mut self) -> &mut [u8] {
        self.state.framer.receive_buffer()
    }

    fn received(&mut self, count: usize) {
        self.state.framer.received(count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.state.until
    }
}

impl State {
    const fn new(config: Config) -> Self {
        Self {
            config,
            framer: LineFramer::new(),
            tx: [0; MAX_LINE],
            outbox: Outbox::EMPTY,
            until: None,
            owed: false,
            is_early: false,
            reply: None,
            closed: false,
        }
    }

    fn start(&mut self, request: &Request<'_>, now: Instant) -> Result<(), ClientError> {
        if self.closed {
            return Err(ClientError::Closed);
        }
        if self.until.is_some() || self.outbox.is_sending() {
            return Err(ClientError::Busy);
        }
        // bytes that arrived before the request cannot be its reply
        if !self.owed && (self.framer.poll().is_some() || self.framer.has_begun()) {
            self.closed = true;
            return Err(ClientError::Unsolicited);
        }
        self.reply = None;
        self.outbox = Outbox::EMPTY;
        let mut out = Writer::new(&mut self.tx);
        request.write_line(&mut out).map_err(ClientError::Request)?;
        self.outbox = Outbox::new(out.len());
        self.until = Some(now.saturating_add(self.config.timeout));
        Ok(())
    }

    fn transmit(&self) -> &[u8] {
        if self.owed && self.until.is_some() {
            // sent after the old reply; the rest of an abandoned request is sent with no request in flight
            return &[];
        }
        self.outbox.unsent(&self.tx)
    }

    /// Ends the request in flight without its reply.
    const fn give_up(&mut self) {
        if self.until.take().is_none() {
            return;
        }
        if self.outbox.is_unsent() {
            // no byte was sent, so no reply follows
            self.outbox = Outbox::EMPTY;
        } else {
            self.owed = true;
        }
    }

    fn handle_line(&mut self, framed: Framed, memory: &mut [u8]) -> Event {
        self.reply = None;
        let (in_flight, unsent) = (self.until.is_some(), self.outbox.is_sending());
        if self.owed && (in_flight || !unsent) && !self.is_early {
            self.owed = false;
            return Event::Stale;
        }
        if !in_flight || unsent || self.is_early {
            // a reply cannot begin before its request has ended
            self.closed = true;
            self.until = None;
            return Event::Failed(ClientError::Unsolicited);
        }
        self.until = None;
        let line = match framed {
            Framed::Line => self.framer.line(),
            Framed::TooLong => {
                let column = to_u32(MAX_LINE);
                return Event::Failed(ClientError::Reply(TextError { kind: TextErrorKind::LineTooLong, column }));
            }
        };
        let mut out = Writer::new(memory);
        match complete(line, |line| response::read(line, &mut out)) {
            Ok(result) => {
                self.reply = Some(StoredReply { result, len: out.len() });
                Event::Replied(result)
            }
            Err(TextError { kind: TextErrorKind::Full, .. }) => {
                Event::Failed(ClientError::ReplyTooLarge { limit: to_u32(memory.len()) })
            }
            Err(error) => Event::Failed(ClientError::Reply(error)),
        }
    }
}
