//! The sans-IO server of RAC: one [`Session`] for each connection.
//!
//! ```text
//!   the link ─► receive_buffer, received ──► run(handler) ──► transmit ─► the link
//!                                             ▲    │
//!                                poll_timeout └────┘ the time limit, a handler that waits
//! ```
//!
//! A [`Session`] contains no socket and no clock. The caller moves the bytes, and calls [`run`](Session::run) after bytes
//! were received or sent, at [`poll_timeout`](Session::poll_timeout), and after any event that a waiting handler may wait
//! for.
//!
//! An asynchronous gateway needs no handler: [`poll`](Session::poll) reports a request, [`request`](Session::request)
//! views it until its reply, and [`respond`](Session::respond) or [`respond_with`](Session::respond_with) replies.
//!
//! The specification does not define most of a server's behaviour. This one does the following:
//!
//! * **Every line gets one response**, in the order of the lines; a client may send several without waiting. An invalid
//!   line gets the code of [`TextError::hresult`] and no value, and the session continues: E_INVALIDCOMMAND for an unknown
//!   verb, part or variable type, E_INVALIDARG for an invalid index or form, E_INVALIDARGTYPE for an invalid value,
//!   E_PACKETSIZEOVER for an over-long line, E_ARGSIZEOVER for a value that exceeds the session's memory.
//! * **Types**: the value of a PUT is well-formed, but is not compared with the variable's type. Conversions are up to the
//!   handler; [`VariableKind::fits`](super::VariableKind::fits) returns which values need none.
//! * **Replies** have a value only if a GET succeeded. If the value has no text, or does not fit the 256 bytes of a line,
//!   the reply is E_INVALIDSNDPACKET; values are never cut.
//! * **Time**: a request that runs longer than [`Config::invoke_timeout`] gets the reply E_TIMEOUT and is abandoned.

use core::time::Duration;

use super::MAX_VALUE;
use super::line::{Framed, LineFramer, MAX_LINE};
use super::request::{Request, Variable, Verb, read};
use super::response::Response;
use crate::endpoint::{Endpoint, Serve, ServerEndpoint};
use crate::error::{TextError, TextErrorKind};
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::outbox::Outbox;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::text::complete;
use crate::variant::{Encode, Variant, Writer};

/// The application that executes the requests of a server.
pub trait Handler {
    /// Executes a request.
    ///
    /// It sets the value of a GET in `reply`. [`Outcome`] is the result of the request, or the time to resume it.
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome;

    /// Resumes a request that returned [`Outcome::Wait`]; the default is to call it again.
    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.call(peer, request, reply, now)
    }

    /// Called when a waiting request is not resumed: it timed out, or the peer disconnected.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }

    /// Called when a peer disconnected.
    fn left(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }
}

/// How a session behaves; every field is a run-time choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Time limit of a request.
    pub invoke_timeout: Duration,
}

impl Config {
    /// 180 s for a request, as in b-CAP.
    pub const TCP: Self = Self { invoke_timeout: Duration::from_secs(180) };
}

impl Default for Config {
    fn default() -> Self {
        Self::TCP
    }
}

/// An event of a session, for logs, counters and gateways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
#[non_exhaustive]
pub enum Event {
    /// A request arrived; [`Session::request`] views it. Only [`Session::poll`] reports this.
    Requested(Variable),
    /// A request got its reply, from the handler or by its time limit.
    Served {
        /// The requested variable.
        variable: Variable,
        /// The result in the reply.
        result: HResult,
    },
    /// An invalid line; its reply is the error's [code](TextError::hresult).
    Malformed(TextError),
}

/// The server side of one connection: two lines of 256 bytes, and the caller's memory for values.
///
/// That memory holds the value of a PUT, or of the reply to a GET. 64 bytes are enough for every kind of variable but
/// strings, [`MAX_VALUE`] for any value that fits a line.
///
/// # Examples
///
/// A gateway that replies later:
///
/// ```
/// use bcap_core::endpoint::Endpoint;
/// use bcap_core::hresult::HResult;
/// use bcap_core::rac::server::{Config, Event, Session};
/// use bcap_core::rac::{Request, Variable, VariableKind};
/// use bcap_core::time::Instant;
///
/// let mut session = Session::new(Config::TCP, [0; 64]);
/// session.receive_buffer()[..14].copy_from_slice(b"GET:RC8:10:I:\r");
/// session.received(14);
///
/// let variable = Variable::new(VariableKind::I, 10);
/// assert_eq!(session.poll(Instant::ZERO), Some(Event::Requested(variable)));
/// assert_eq!(session.request(), Some(Request::Get(variable)));
/// // ... awaits something ...
/// session.respond_with(HResult::S_OK, &123_i32);
/// assert_eq!(session.transmit(), b"0,3,123\r");
/// ```
#[derive(Debug)]
pub struct Session<V> {
    value: V,
    state: State,
}

/// The part of a session that does not depend on the type of the caller's memory.
#[derive(Debug)]
struct State {
    config: Config,
    framer: LineFramer,
    tx: [u8; MAX_LINE],
    /// The unsent part of the response in `tx`.
    outbox: Outbox,
    running: Option<RunningRequest>,
}

/// A request without a response; its value is in the caller's memory.
#[derive(Clone, Copy, Debug)]
struct RunningRequest {
    verb: Verb,
    variable: Variable,
    /// Bytes of the value.
    len: usize,
    turn: Turn,
    wake: Instant,
    until: Instant,
}

/// Whether the handler has been called for a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    // from 1, as in `Verb`
    First = 1,
    Later,
}

/// Minimum interval between two polls of a waiting handler without other events.
const SOONEST: Duration = Duration::from_millis(1);

impl<V: Storage> Session<V> {
    /// Creates a session for a new peer.
    #[must_use]
    pub const fn new(config: Config, value: V) -> Self {
        let state =
            State { config, framer: LineFramer::new(), tx: [0; MAX_LINE], outbox: Outbox::EMPTY, running: None };
        Self { value, state }
    }

    /// Takes the next line if no request is pending, and returns its content; the gateway's side of [`run`](Self::run).
    ///
    /// Each request is reported once, as [`Event::Requested`]. After its time limit it gets the reply E_TIMEOUT and is
    /// reported as [`Event::Served`].
    pub fn poll(&mut self, now: Instant) -> Option<Event> {
        match self.state.running {
            Some(running) if now >= running.until => Some(self.state.expire(running)),
            Some(_) => None,
            None => {
                let event = self.next_line(now)?;
                if let Some(running) = &mut self.state.running {
                    // without a handler only the time limit matters
                    running.wake = running.until;
                }
                Some(event)
            }
        }
    }

    /// Views the running request.
    #[must_use]
    pub fn request(&self) -> Option<Request<'_>> {
        let running = self.state.running?;
        Some(running.request(self.value.bytes().get(..running.len)?))
    }

    /// Views the last line without its CR, until the next call of [`receive_buffer`](Self::receive_buffer); of an over-long
    /// line the first 256 bytes.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        self.state.framer.line()
    }

    /// Replies without a value, and returns the event; `None` without a running request.
    pub fn respond(&mut self, result: HResult) -> Option<Event> {
        let running = self.state.running?;
        Some(self.state.answer(running, result, None))
    }

    /// Replies with a value, which is sent if the request is a GET and `result` a success.
    ///
    /// [`Event::Served`] has the result that was sent: E_INVALIDSNDPACKET if the value has no text or does not fit.
    pub fn respond_with<T: Encode + ?Sized>(&mut self, result: HResult, value: &T) -> Option<Event> {
        let running = self.state.running?;
        let mut reply = ReplyValue::new(self.value.bytes_mut());
        let result = match reply.set(value) {
            Err(_) if result.is_ok() => HResult::E_INVALIDSNDPACKET,
            _ => result,
        };
        Some(self.state.answer(running, result, reply.get()))
    }

    /// Reads the next line, once the previous response was sent.
    fn next_line(&mut self, now: Instant) -> Option<Event> {
        if self.state.outbox.is_sending() {
            return None;
        }
        let framed = self.state.framer.poll()?;
        // grow memory that can grow, once: for the value of a request and of its reply
        self.value.grow(MAX_VALUE.saturating_mul(2));
        Some(self.state.handle_line(framed, self.value.bytes_mut(), now))
    }
}

impl<V: Storage> Endpoint for Session<V> {
    fn transmit(&self) -> &[u8] {
        self.state.outbox.unsent(&self.state.tx)
    }

    fn transmitted(&mut self, count: usize) {
        self.state.outbox.transmitted(count);
    }

    fn receive_buffer(&mut self) -> &mut [u8] {
        self.state.framer.receive_buffer()
    }

    fn received(&mut self, count: usize) {
        self.state.framer.received(count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.state.running.map(|running| running.wake.min(running.until))
    }
}

impl<V: Storage> ServerEndpoint for Session<V> {
    fn is_running(&self) -> bool {
        self.state.running.is_some()
    }

    fn is_receiving(&self) -> bool {
        self.state.running.is_none() && self.state.framer.is_partial()
    }

    fn next_request(&self) -> usize {
        // lines are short
        0
    }

    fn is_finished(&self) -> bool {
        // an invalid line is answered, and never ends the session
        false
    }

    fn memory(&self) -> usize {
        self.value.bytes().len()
    }

    fn shrink(&mut self, room: usize) {
        if self.state.running.is_none() {
            self.value.shrink(room);
        }
    }
}

impl<H: Handler + ?Sized, V: Storage> Serve<H> for Session<V> {
    type Event = Event;

    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Event> {
        if self.state.running.is_none() {
            match self.next_line(now)? {
                Event::Requested(_) => {}
                other => return Some(other),
            }
        }
        let running = self.state.running?;
        if now >= running.until {
            handler.abandoned(peer, now);
            return Some(self.state.expire(running));
        }
        let memory = self.value.bytes_mut();
        let (value, room) = memory.split_at_mut_checked(running.len)?;
        let request = running.request(value);
        let mut reply = ReplyValue::new(room);
        let outcome = match running.turn {
            Turn::First => handler.call(peer, &request, &mut reply, now),
            Turn::Later => handler.resume(peer, &request, &mut reply, now),
        };
        let result = match outcome {
            Outcome::Wait(wake) => {
                // a handler that requests a time in the past must not keep its server spinning
                let wake = wake.max(now.saturating_add(SOONEST));
                self.state.running = Some(RunningRequest { turn: Turn::Later, wake, ..running });
                return None;
            }
            Outcome::Done(result) if result.is_ok() && reply.is_overflow() => HResult::E_INVALIDSNDPACKET,
            Outcome::Done(result) => result,
        };
        Some(self.state.answer(running, result, reply.get()))
    }

    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        if self.state.running.take().is_some() {
            handler.abandoned(peer, now);
        }
        handler.left(peer, now);
    }
}

impl RunningRequest {
    fn request<'a>(&self, value: &'a [u8]) -> Request<'a> {
        match self.verb {
            Verb::Get => Request::Get(self.variable),
            Verb::Put => Request::Put(self.variable, Variant::from_checked(value)),
        }
    }
}

impl State {
    fn handle_line(&mut self, framed: Framed, memory: &mut [u8], now: Instant) -> Event {
        let mut out = Writer::new(memory);
        let line = self.framer.line();
        let read = match framed {
            Framed::Line => complete(line, |line| read(line, &mut out)),
            Framed::TooLong => Err(TextError { kind: TextErrorKind::LineTooLong, column: to_u32(MAX_LINE) }),
        };
        match read {
            Ok((verb, variable)) => {
                let until = now.saturating_add(self.config.invoke_timeout);
                self.running =
                    Some(RunningRequest { verb, variable, len: out.len(), turn: Turn::First, wake: now, until });
                Event::Requested(variable)
            }
            Err(error) => {
                self.send(error.hresult(), None);
                Event::Malformed(error)
            }
        }
    }

    /// Replies to a request whose time limit has passed.
    fn expire(&mut self, running: RunningRequest) -> Event {
        self.answer(running, HResult::E_TIMEOUT, None)
    }

    fn answer(&mut self, running: RunningRequest, result: HResult, value: Option<Variant<'_>>) -> Event {
        self.running = None;
        let value = value.filter(|_| running.verb == Verb::Get && result.is_ok());
        Event::Served { variable: running.variable, result: self.send(result, value) }
    }

    /// Puts a response into `tx` and returns its result.
    fn send(&mut self, result: HResult, value: Option<Variant<'_>>) -> HResult {
        let mut out = Writer::new(&mut self.tx);
        let sent = Response { result, value }.write_line(&mut out);
        self.outbox = Outbox::new(out.len());
        match sent {
            Ok(()) => result,
            // a result alone always fits, so this recurses once
            Err(_) if value.is_some() => self.send(HResult::E_INVALIDSNDPACKET, None),
            Err(_) => result,
        }
    }
}
