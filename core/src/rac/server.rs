//! The sans-IO server of RAC: one [`Session`] for each connection.
//!
//! ```text
//!   the link ─► receive_buffer, received ──► run(handler) ──► transmit ─► the link
//!                                             ▲    │
//!                                poll_timeout └────┘ the time limit, a handler that waits
//! ```
//!
//! A [`Session`] holds no socket and no clock; whoever runs it moves the bytes, and calls [`run`](Session::run) when
//! bytes have come or left, when [`poll_timeout`](Session::poll_timeout) is due, and when something happened that a
//! waiting handler may be waiting for.
//!
//! An asynchronous gateway does without a handler: [`poll`](Session::poll) reports a request,
//! [`request`](Session::request) views it for as long as the gateway is busy with it, and
//! [`respond`](Session::respond) or [`respond_with`](Session::respond_with) answers it.
//!
//! The specification leaves open what a server does in most cases. Here:
//!
//! * **Every line gets one response**, in the order of the lines; a client may send several without waiting. Even a
//!   line that cannot be read is answered, with the code of [`TextError::hresult`] and no value, and the session goes
//!   on: E_INVALIDCOMMAND for an unknown verb, part or variable type, E_INVALIDARG for a bad index or shape,
//!   E_INVALIDARGTYPE for a bad value, E_PACKETSIZEOVER for an over-long line, E_ARGSIZEOVER for a value over the
//!   session's memory.
//! * **Types**: the value of a PUT is well-formed, but not compared with the variable's type; the handler knows what it
//!   can convert ([`VariableKind::fits`](super::VariableKind::fits) tells what needs no conversion).
//! * **Replies** carry a value only when a GET succeeded. A value that has no text, or does not fit the 256 bytes of a
//!   line, is answered with E_INVALIDSNDPACKET, never cut.
//! * **Time**: a request that runs longer than [`Config::invoke_timeout`] is answered with E_TIMEOUT and abandoned.

use core::time::Duration;

use super::MAX_VALUE;
use super::line::{Framed, LineFramer, MAX_LINE};
use super::request::{Request, Variable, Verb, read};
use super::response::Response;
use crate::error::{TextError, TextErrorKind};
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::text::complete;
use crate::variant::{Encode, Variant, Writer};

/// The application behind a server of RAC.
pub trait Handler {
    /// Carries a request out.
    ///
    /// The value of a GET is set in `reply`; [`Outcome`] says how the request ended, or when to go on with it.
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome;

    /// Goes on with a request that was answered with [`Outcome::Wait`]; unless told otherwise, the same as a new one.
    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.call(peer, request, reply, now)
    }

    /// Learns that a request that was to be asked about again will not be: it ran out of time, or the peer went.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }

    /// Learns that a peer has gone.
    fn left(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }
}

/// How a session behaves; every field is a run-time choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// How long a request may run.
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

/// What a session has done; for logs and counters, and for gateways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Event {
    /// A request has come that [`Session::request`] views; only [`Session::poll`] reports this.
    Requested(Variable),
    /// A request was answered, by the handler or for it.
    Served {
        /// The variable that was asked for.
        variable: Variable,
        /// What was answered.
        result: HResult,
    },
    /// A line came that is no request; it was answered with the error's [code](TextError::hresult).
    Malformed(TextError),
}

/// The server's side of one connection: two lines of 256 bytes, and the caller's memory for values.
///
/// That memory takes the value of a PUT, or of the reply to a GET. 64 bytes are enough for every kind of variable
/// but strings, [`MAX_VALUE`] for anything a line can carry.
///
/// # Examples
///
/// A gateway answers when it has asked elsewhere:
///
/// ```
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

/// Everything of a session that does not depend on the caller's memory.
#[derive(Debug)]
struct State {
    config: Config,
    framer: LineFramer,
    tx: [u8; MAX_LINE],
    /// Bytes of the response in `tx`, and how many of them the link has taken.
    tx_len: usize,
    tx_sent: usize,
    running: Option<Running>,
}

/// A request that has no response yet; its value is in the caller's memory.
#[derive(Clone, Copy, Debug)]
struct Running {
    verb: Verb,
    variable: Variable,
    /// Bytes of the value.
    len: usize,
    resumed: bool,
    wake: Instant,
    until: Instant,
}

/// How soon a handler that waits is asked again at the earliest, if nothing else happens.
const SOONEST: Duration = Duration::from_millis(1);

impl<V: Storage> Session<V> {
    /// Makes a session for a peer that has just come.
    #[must_use]
    pub const fn new(config: Config, value: V) -> Self {
        let state =
            State { config, framer: LineFramer::new(), tx: [0; MAX_LINE], tx_len: 0, tx_sent: 0, running: None };
        Self { value, state }
    }

    /// Returns memory for bytes that arrive.
    ///
    /// It is empty while a request runs, or a response has not left, and the buffer is full of what comes behind; then
    /// bytes must wait.
    #[must_use]
    pub fn receive_buffer(&mut self) -> &mut [u8] {
        self.state.framer.receive_buffer()
    }

    /// Takes note that `count` bytes have been put into [`receive_buffer`](Self::receive_buffer).
    pub fn received(&mut self, count: usize) {
        self.state.framer.received(count);
    }

    /// Returns the bytes that are to be sent.
    #[must_use]
    pub fn transmit(&self) -> &[u8] {
        self.state.tx.get(self.state.tx_sent..self.state.tx_len).unwrap_or_default()
    }

    /// Takes note that the link has taken `count` bytes of [`transmit`](Self::transmit).
    pub fn transmitted(&mut self, count: usize) {
        self.state.tx_sent = self.state.tx_sent.saturating_add(count).min(self.state.tx_len);
    }

    /// Returns when [`run`](Self::run), or [`poll`](Self::poll), is to be called even if no bytes come; `None` while no
    /// request runs.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.state.running.map(|running| running.wake.min(running.until))
    }

    /// Tells whether a request runs that has not been answered.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        self.state.running.is_some()
    }

    /// Tells whether part of a request has come and its rest has not.
    #[must_use]
    pub const fn is_receiving(&self) -> bool {
        self.state.running.is_none() && self.state.framer.is_partial()
    }

    /// Returns the bytes of memory that it has for values.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.value.bytes().len()
    }

    /// Gives back memory over `room` bytes, unless a request's value is in it.
    pub fn shrink(&mut self, room: usize) {
        if self.state.running.is_none() {
            self.value.shrink(room);
        }
    }

    /// Goes on as far as it can, and says what was done; `None` when bytes must come, leave, or time pass.
    ///
    /// It is to be called until it returns `None`.
    pub fn run<H: Handler + ?Sized>(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Event> {
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
        let outcome = match running.resumed {
            false => handler.call(peer, &request, &mut reply, now),
            true => handler.resume(peer, &request, &mut reply, now),
        };
        let result = match outcome {
            Outcome::Wait(wake) => {
                // a handler that asks for a time that has passed must not keep its server spinning
                let wake = wake.max(now.saturating_add(SOONEST));
                self.state.running = Some(Running { resumed: true, wake, ..running });
                return None;
            }
            Outcome::Done(result) if result.is_ok() && reply.is_overflow() => HResult::E_INVALIDSNDPACKET,
            Outcome::Done(result) => result,
        };
        Some(self.state.answer(running, result, reply.get()))
    }

    /// Takes the next line if nothing is being answered, and says what it is; the gateway's side of [`run`](Self::run).
    ///
    /// A request is reported once, as [`Event::Requested`]. One that is not answered in time is answered with E_TIMEOUT
    /// here, and reported as [`Event::Served`].
    pub fn poll(&mut self, now: Instant) -> Option<Event> {
        match self.state.running {
            Some(running) if now >= running.until => Some(self.state.expire(running)),
            Some(_) => None,
            None => {
                let event = self.next_line(now)?;
                if let Some(running) = &mut self.state.running {
                    // nobody is to be asked again, so only the time limit counts
                    running.wake = running.until;
                }
                Some(event)
            }
        }
    }

    /// Views the request that is to be answered.
    #[must_use]
    pub fn request(&self) -> Option<Request<'_>> {
        let running = self.state.running?;
        Some(running.request(self.value.bytes().get(..running.len)?))
    }

    /// Views the line that was taken last, without its CR, until memory is asked for bytes that arrive; of an over-long
    /// one the first 256 bytes.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        self.state.framer.line()
    }

    /// Answers the request without a value, and returns what was done; `None` when there is no request to answer.
    pub fn respond(&mut self, result: HResult) -> Option<Event> {
        let running = self.state.running?;
        Some(self.state.answer(running, result, None))
    }

    /// Answers the request with a value, which goes out if the request is a GET and `result` a success.
    ///
    /// [`Event::Served`] tells what was answered: E_INVALIDSNDPACKET for a value that has no text or does not fit.
    pub fn respond_with<T: Encode + ?Sized>(&mut self, result: HResult, value: &T) -> Option<Event> {
        let running = self.state.running?;
        let mut reply = ReplyValue::new(self.value.bytes_mut());
        let result = match reply.set(value) {
            Err(_) if result.is_ok() => HResult::E_INVALIDSNDPACKET,
            _ => result,
        };
        Some(self.state.answer(running, result, reply.get()))
    }

    /// Ends the session: abandons what runs and tells the handler.
    pub fn close<H: Handler + ?Sized>(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        if self.state.running.take().is_some() {
            handler.abandoned(peer, now);
        }
        handler.left(peer, now);
    }

    /// Reads the next line, when the response before it has left.
    fn next_line(&mut self, now: Instant) -> Option<Event> {
        if self.state.tx_sent < self.state.tx_len {
            return None;
        }
        let framed = self.state.framer.poll()?;
        // memory that can grow does, once: for the value of a request and that of its reply
        self.value.grow(MAX_VALUE.saturating_mul(2));
        Some(self.state.handle_line(framed, self.value.bytes_mut(), now))
    }
}

impl Running {
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
                self.running = Some(Running { verb, variable, len: out.len(), resumed: false, wake: now, until });
                Event::Requested(variable)
            }
            Err(error) => {
                self.send(error.hresult(), None);
                Event::Malformed(error)
            }
        }
    }

    /// Answers a request that ran out of time.
    fn expire(&mut self, running: Running) -> Event {
        self.answer(running, HResult::E_TIMEOUT, None)
    }

    fn answer(&mut self, running: Running, result: HResult, value: Option<Variant<'_>>) -> Event {
        self.running = None;
        let value = value.filter(|_| running.verb == Verb::Get && result.is_ok());
        Event::Served { variable: running.variable, result: self.send(result, value) }
    }

    /// Puts a response into `tx` and returns its result.
    fn send(&mut self, result: HResult, value: Option<Variant<'_>>) -> HResult {
        let mut out = Writer::new(&mut self.tx);
        let sent = Response { result, value }.write_line(&mut out);
        self.tx_len = out.len();
        self.tx_sent = 0;
        match sent {
            Ok(()) => result,
            // a result alone always fits, so this ends here
            Err(_) if value.is_some() => self.send(HResult::E_INVALIDSNDPACKET, None),
            Err(_) => result,
        }
    }
}
