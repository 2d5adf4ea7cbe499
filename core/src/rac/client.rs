//! The sans-IO client of RAC: one request at a time.
//!
//! ```text
//!   start ──► transmit ─► the link ─► receive_buffer, received ──► poll_event ──► reply
//!                                                                      │
//!             handle_timeout at poll_timeout ◄─────────────────────────┘
//! ```
//!
//! A [`Client`] holds no socket and no clock. Whoever runs it carries the bytes of [`transmit`](Client::transmit) to the
//! link, puts what comes back into [`receive_buffer`](Client::receive_buffer), passes the time in, and reads events.
//!
//! RAC has no serials: a reply belongs to the oldest request that has none. So the client keeps count.
//!
//! * After a timeout, or [`abandon`](Client::abandon), the server still owes a reply. It is awaited, reported as
//!   [`Event::Stale`] and dropped; a request that is started meanwhile is held back until then, because a session
//!   carries one request at a time (S0:189-193). A reply is never taken for that of another request.
//! * If the old reply does not come, the request that was held back ends with [`Timeout::Outstanding`]: it was never
//!   sent, and only a new connection helps.
//! * What was begun to be sent is finished, so that the stream stays in step; a request of which nothing has left when
//!   it is abandoned was never sent, and owes nothing.
//! * A line that nobody asked for ends the session: the count is not to be trusted any more.
//! * A reply that cannot be read is the end of its request and of nothing else.

use core::fmt;
use core::time::Duration;

use super::MAX_VALUE;
use super::line::{Framed, LineFramer, MAX_LINE};
use super::request::Request;
use super::response::{self, Response};
use crate::error::{TextError, TextErrorKind};
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::text::complete;
use crate::variant::{Variant, Writer};

/// How a client behaves; every field is a run-time choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// How long a request may take, from its start to its reply.
    pub timeout: Duration,
}

impl Config {
    /// 3 s for a reply, as the vendor's b-CAP clients wait.
    pub const TCP: Self = Self { timeout: Duration::from_secs(3) };
}

impl Default for Config {
    fn default() -> Self {
        Self::TCP
    }
}

/// What has happened; nothing is borrowed, so an event can be kept while the client goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Event {
    /// The request has its reply, with this result; [`Client::reply`] views it.
    Replied(HResult),
    /// The request has ended without a reply that can be used.
    Failed(ClientError),
    /// The reply to a request that had timed out or was abandoned has come; it was dropped.
    Stale,
}

/// What did not come in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Timeout {
    /// The reply to the request; whether the server carried it out is not known.
    Reply,
    /// The reply to an earlier request; this one was not sent.
    Outstanding,
}

/// Why a request could not be made or has ended without a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ClientError {
    /// The value of the request has no text, or the line is over 256 bytes; the caller's fault, nothing was sent.
    Request(TextError),
    /// A request is in flight, or part of an abandoned one is still to be sent; the caller's fault, nothing was sent.
    Busy,
    /// A time limit has passed.
    Timeout(Timeout),
    /// The peer's reply cannot be read; the session goes on.
    Reply(TextError),
    /// The value of the reply does not fit the caller's memory; the session goes on.
    ReplyTooLarge {
        /// How much memory there is, in bytes.
        limit: u32,
    },
    /// The peer sent a line that nobody asked for; the session has ended.
    Unsolicited,
    /// The session had ended before.
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
            Self::Unsolicited => f.write_str("the peer sent a line that nobody asked for"),
            Self::Closed => f.write_str("the session has ended"),
        }
    }
}

impl core::error::Error for ClientError {}

/// A client with its memory: two lines of 256 bytes, and what the caller gives for the value of a reply.
///
/// 64 bytes are enough for every kind of variable but strings, [`MAX_VALUE`] for anything a line can carry.
///
/// # Examples
///
/// ```
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

/// Everything of a client that does not depend on the caller's memory.
#[derive(Debug)]
struct State {
    config: Config,
    framer: LineFramer,
    tx: [u8; MAX_LINE],
    /// Bytes of the request in `tx`, and how many of them the link has taken.
    tx_len: usize,
    tx_sent: usize,
    /// Until when the request in flight waits.
    until: Option<Instant>,
    /// An earlier request has no reply yet; there is never more than one, because then nothing is sent.
    owed: bool,
    reply: Option<Reply>,
    closed: bool,
}

/// The reply to the last request; its value is in the caller's memory.
#[derive(Clone, Copy, Debug)]
struct Reply {
    result: HResult,
    /// Bytes of the value; 0 while there is none.
    len: usize,
}

impl<V: Storage> Client<V> {
    /// Makes a client; `value` takes the values of replies.
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

    /// Begins a request; its line is then to be sent.
    ///
    /// # Errors
    ///
    /// [`ClientError::Busy`] while a request is in flight or part of an abandoned one is unsent,
    /// [`ClientError::Closed`] after the session ended, [`ClientError::Request`] when the request has no line,
    /// [`ClientError::Unsolicited`] when something has come that no request asked for, which ends the session.
    pub fn start(&mut self, request: &Request<'_>, now: Instant) -> Result<(), ClientError> {
        self.state.start(request, now)
    }

    /// Returns the bytes that are to be sent.
    #[must_use]
    pub fn transmit(&self) -> &[u8] {
        self.state.transmit()
    }

    /// Takes note that the link has taken `count` bytes of [`transmit`](Self::transmit).
    pub fn transmitted(&mut self, count: usize) {
        let most = self.state.transmit().len();
        self.state.tx_sent = self.state.tx_sent.saturating_add(count.min(most));
    }

    /// Returns memory for bytes that arrive.
    #[must_use]
    pub fn receive_buffer(&mut self) -> &mut [u8] {
        self.state.framer.receive_buffer()
    }

    /// Takes note that `count` bytes have been put into [`receive_buffer`](Self::receive_buffer).
    ///
    /// [`poll_event`](Self::poll_event) is to be called next, until it returns `None`.
    pub fn received(&mut self, count: usize) {
        self.state.framer.received(count);
    }

    /// Returns what the received bytes mean; `None` when more are needed. The reply before is gone when a line has come.
    pub fn poll_event(&mut self, now: Instant) -> Option<Event> {
        // the time decides nothing here; a reply that came is a reply, even when its deadline is being missed
        let _ = now;
        if self.state.closed {
            return None;
        }
        let framed = self.state.framer.poll()?;
        // memory that can grow does, once
        self.value.grow(MAX_VALUE);
        Some(self.state.handle_line(framed, self.value.bytes_mut()))
    }

    /// Returns the reply that [`Event::Replied`] has announced, until another line comes or a request is started.
    #[must_use]
    pub fn reply(&self) -> Option<Response<'_>> {
        let Reply { result, len } = self.state.reply?;
        let bytes = self.value.bytes().get(..len)?;
        Some(Response { result, value: (!bytes.is_empty()).then(|| Variant::from_checked(bytes)) })
    }

    /// Returns when [`handle_timeout`](Self::handle_timeout) is to be called; `None` while no request is in flight.
    #[must_use]
    pub const fn poll_timeout(&self) -> Option<Instant> {
        self.state.until
    }

    /// Acts on the time: ends a request that has waited too long. Nothing happens before the time is due.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Event> {
        if now < self.state.until? {
            return None;
        }
        let timeout = if self.state.owed { Timeout::Outstanding } else { Timeout::Reply };
        self.state.give_up();
        Some(Event::Failed(ClientError::Timeout(timeout)))
    }

    /// Gives the request in flight up, if there is one. A reply that comes later will be stale.
    pub fn abandon(&mut self) {
        self.state.give_up();
    }

    /// Tells whether a request is in flight.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.state.until.is_some()
    }

    /// Tells whether the reply to an earlier request is still to come, so that a new one would be held back.
    #[must_use]
    pub const fn is_owed(&self) -> bool {
        self.state.owed
    }

    /// Tells whether the session has ended because the peer sent a line that nobody asked for.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.state.closed
    }

    /// Begins a new session over a new connection: forgets the request in flight and everything received.
    pub const fn reset(&mut self) {
        self.state = State::new(self.state.config);
    }
}

impl State {
    const fn new(config: Config) -> Self {
        Self {
            config,
            framer: LineFramer::new(),
            tx: [0; MAX_LINE],
            tx_len: 0,
            tx_sent: 0,
            until: None,
            owed: false,
            reply: None,
            closed: false,
        }
    }

    fn start(&mut self, request: &Request<'_>, now: Instant) -> Result<(), ClientError> {
        if self.closed {
            return Err(ClientError::Closed);
        }
        if self.until.is_some() || self.tx_sent < self.tx_len {
            return Err(ClientError::Busy);
        }
        // what has come before the request cannot be its reply
        if !self.owed && (self.framer.poll().is_some() || self.framer.has_begun()) {
            self.closed = true;
            return Err(ClientError::Unsolicited);
        }
        self.reply = None;
        self.tx_len = 0;
        self.tx_sent = 0;
        let mut out = Writer::new(&mut self.tx);
        request.write_line(&mut out).map_err(ClientError::Request)?;
        self.tx_len = out.len();
        self.until = Some(now.saturating_add(self.config.timeout));
        Ok(())
    }

    fn transmit(&self) -> &[u8] {
        if self.owed && self.until.is_some() {
            // held back; what is still to be sent of an abandoned request goes out with nothing in flight
            return &[];
        }
        self.tx.get(self.tx_sent..self.tx_len).unwrap_or_default()
    }

    /// Ends the request in flight without its reply.
    const fn give_up(&mut self) {
        if self.until.take().is_none() {
            return;
        }
        if self.tx_sent == 0 {
            // nothing has left, so nothing will be answered
            self.tx_len = 0;
        } else {
            self.owed = true;
        }
    }

    fn handle_line(&mut self, framed: Framed, memory: &mut [u8]) -> Event {
        self.reply = None;
        let (in_flight, unsent) = (self.until.is_some(), self.tx_sent < self.tx_len);
        if self.owed && (in_flight || !unsent) {
            self.owed = false;
            return Event::Stale;
        }
        if !in_flight || unsent {
            // a reply to a line that is not even sent is none
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
                self.reply = Some(Reply { result, len: out.len() });
                Event::Replied(result)
            }
            Err(TextError { kind: TextErrorKind::Full, .. }) => {
                Event::Failed(ClientError::ReplyTooLarge { limit: to_u32(memory.len()) })
            }
            Err(error) => Event::Failed(ClientError::Reply(error)),
        }
    }
}
