//! The sans-IO client of b-CAP: one call at a time, over any link.
//!
//! ```text
//!   start ──► transmit ─► the link ─► receive_buffer, received ──► poll_event ──► reply
//!                ▲                                                     │
//!                └──────────── handle_timeout at poll_timeout ◄────────┘
//! ```
//!
//! A [`Client`] holds no socket and no clock. Whoever runs it carries the bytes of [`transmit`](Client::transmit) to the
//! link, puts what comes back into [`receive_buffer`](Client::receive_buffer), passes the time in, and reads events.
//!
//! * **Serials** run from 1 to 65535; each attempt takes a new one, and none is used again while a reply to it may come.
//! * **Retries** happen on lossy links only. The reserved field then carries the first attempt's serial, by which the
//!   server knows a repetition. A reply to any attempt of a call ends the call.
//! * **Time**: an *attempt* may be silent for so long; a *call* takes at most its deadline; S_EXECUTING restarts the
//!   attempt's time, but may not keep a call alive beyond its own budget. The error says which of the three it was.
//! * **Late replies** are matched by serial, reported as [`Event::Stale`] and dropped. Datagrams that are no frame are
//!   reported and dropped too; neither costs an attempt.
//! * **Early replies**, of which the first byte arrived before the first byte of the request left, are stale as well, and so is
//!   success before the whole request has left. An error is accepted then: a server may refuse a long request at its header.
//! * **Floods** end the session: a token bucket bounds the rate of S_EXECUTING, and on a stream that of stale replies.
//! * **Cancelling** is [`abandon`](Client::abandon), at any byte: what was begun to be sent is finished, its reply
//!   will be stale.

use core::fmt;
use core::time::Duration;

use crate::bcap::FunctionId;
use crate::bcap::call::{Call, Reply, ReplyError};
use crate::bcap::frame::{Frame, FrameWriter, MIN_FRAME, renumber};
use crate::bcap::header::Header;
use crate::bcap::link::{Inbox, Link, Located, OnMalformed, Received};
use crate::endpoint::Endpoint;
use crate::error::{DecodeError, EncodeError};
use crate::hresult::HResult;
use crate::limits::{Limits, Strictness};
use crate::outbox::Outbox;
use crate::storage::Storage;
use crate::time::Instant;

/// The time limits and the attempts of one call.
///
/// Each call has its own: they are an argument of [`Client::start`], so that dropping a call cannot leave them changed
/// for the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Timing {
    /// How long an attempt waits for a reply or a keep-alive.
    pub attempt_timeout: Duration,
    /// How often the call is sent at most, on lossy links; a stream sends it once.
    pub attempts: u8,
    /// How long the call may take altogether.
    pub deadline: Duration,
    /// How long S_EXECUTING may keep the call alive, from the first one on.
    pub keep_alive: Duration,
}

impl Timing {
    /// Defaults for TCP: 3 s for the reply or the next keep-alive, 180 s for a call, as long as a server runs one.
    pub const TCP: Self = Self {
        attempt_timeout: Duration::from_secs(3),
        attempts: 1,
        deadline: Duration::from_secs(180),
        keep_alive: Duration::from_secs(180),
    };
    /// Defaults for UDP and serial lines: five attempts of 500 ms (S2:1493).
    pub const UDP: Self = Self { attempt_timeout: Duration::from_millis(500), attempts: 5, ..Self::TCP };
    /// Defaults for serial lines, as for UDP.
    pub const SERIAL: Self = Self::UDP;
}

/// How a client behaves; every field can be changed at run time, before the client is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// What carries the frames.
    pub link: Link,
    /// What is accepted at most.
    pub limits: Limits,
    /// How forgiving the client is with replies.
    pub strictness: Strictness,
    /// What to do when the bytes of a stream are not a valid frame; such datagrams are always dropped.
    pub on_malformed: OnMalformed,
    /// The timing of calls that bring none of their own: those of [`Connection::call`](crate::io::blocking::Connection::call).
    pub timing: Timing,
}

impl Config {
    /// Defaults for TCP.
    pub const TCP: Self = Self {
        link: Link::Stream,
        limits: Limits::STREAM,
        strictness: Strictness::Strict,
        on_malformed: OnMalformed::Close,
        timing: Timing::TCP,
    };
    /// Defaults for UDP.
    pub const UDP: Self = Self {
        link: Link::Datagram,
        limits: Limits::DATAGRAM,
        on_malformed: OnMalformed::Resync,
        timing: Timing::UDP,
        ..Self::TCP
    };
    /// Defaults for serial lines.
    pub const SERIAL: Self = Self { link: Link::Serial, limits: Limits::SERIAL, timing: Timing::SERIAL, ..Self::UDP };
}

/// What has happened; nothing is borrowed, so an event can be kept while the client goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Event {
    /// The call has its reply, with this result; [`Client::reply`] views it.
    Replied(HResult),
    /// The call has ended without a reply.
    Failed(ClientError),
    /// The server is still at work (S_EXECUTING); the attempt's time starts again.
    Executing,
    /// The call is sent again.
    Retried {
        /// The number of the attempt that begins, the first being 1.
        attempt: u8,
    },
    /// A reply came that belongs to no call in flight; it was dropped.
    Stale {
        /// Its serial.
        serial: u16,
    },
    /// Bytes came that are no frame; they were dropped.
    Malformed(DecodeError),
}

/// Which of a call's time limits has passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Timeout {
    /// The last attempt was neither answered nor kept alive.
    Attempt,
    /// The call was kept alive, but took longer than it may altogether.
    Deadline,
    /// The server sent S_EXECUTING for longer than it may.
    KeepAlive,
}

/// Why a call could not be made or has ended without a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ClientError {
    /// The call cannot be encoded; the caller's fault, nothing was sent.
    Encode(EncodeError),
    /// The call is over the largest frame of the link or the buffer; the caller's fault, nothing was sent.
    TooLarge {
        /// The largest frame, in bytes.
        limit: usize,
    },
    /// A call is in flight, or part of an abandoned one is still to be sent; the caller's fault, nothing was sent.
    Busy,
    /// A time limit has passed.
    Timeout(Timeout),
    /// The peer sent bytes that are no frame; the session has ended.
    Malformed(DecodeError),
    /// The peer sent far more keep-alives than a server does, or replies to no call; the session has ended.
    Flooded,
    /// The reply is larger than the receive buffer; the session goes on.
    ReplyTooLarge {
        /// The reply's length, in bytes.
        length: u32,
    },
    /// The reply carries another value than the function gives; the peer's fault.
    Reply(ReplyError),
    /// The session had ended before.
    Closed,
}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Encode(e) => write!(f, "the call cannot be sent: {e}"),
            Self::TooLarge { limit } => write!(f, "the call does not fit a frame of {limit} bytes"),
            Self::Busy => f.write_str("another call is in flight"),
            Self::Timeout(Timeout::Attempt) => f.write_str("no reply within the timeout"),
            Self::Timeout(Timeout::Deadline) => f.write_str("the call took longer than its deadline"),
            Self::Timeout(Timeout::KeepAlive) => f.write_str("the server kept the call alive for too long"),
            Self::Malformed(e) => write!(f, "the peer sent no valid frame: {e}"),
            Self::Flooded => f.write_str("the peer floods this client with keep-alives or replies to no call"),
            Self::ReplyTooLarge { length } => write!(f, "the reply of {length} bytes does not fit the receive buffer"),
            Self::Reply(e) => e.fmt(f),
            Self::Closed => f.write_str("the session has ended"),
        }
    }
}

impl core::error::Error for ClientError {}

/// A client with its two buffers: `tx` holds the request, `rx` what comes back.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call::{self, VariableHandle};
/// use bcap_core::bcap::client::{Client, Config, Event, Timing};
/// use bcap_core::endpoint::Endpoint;
/// use bcap_core::time::Instant;
/// use bcap_core::variant::Variant;
///
/// let mut client = Client::new(Config::TCP, [0; 512], [0; 512]);
/// let get = call::variable_get_value(VariableHandle(3));
/// client.start(&get, Timing::TCP, Instant::ZERO)?;
/// let request = client.transmit(); // to be sent
/// # assert_eq!(request.len(), 30);
/// # let sent = request.len();
/// client.transmitted(sent);
///
/// // ... and a reply comes: I4 7
/// let reply = b"\x01\x1e\0\0\0\x01\0\0\0\0\0\0\0\x01\0\x0a\0\0\0\x03\0\x01\0\0\0\x07\0\0\0\x04";
/// client.receive_buffer()[..reply.len()].copy_from_slice(reply);
/// client.received(reply.len());
/// assert!(matches!(client.poll_event(Instant::ZERO), Some(Event::Replied(result)) if result.is_ok()));
/// assert_eq!(client.reply().and_then(|frame| frame.value()), Some(Variant::I4(7)));
/// # Ok::<(), bcap_core::bcap::client::ClientError>(())
/// ```
#[derive(Debug)]
pub struct Client<T, R = T> {
    tx: T,
    rx: R,
    inbox: Inbox,
    /// The reply to the last call, while it is still in `rx`.
    reply: Option<Located>,
    state: State,
}

/// Everything of a client that does not depend on its memory.
#[derive(Debug)]
struct State {
    link: Link,
    timing: Timing,
    /// The serial of the next attempt.
    next_serial: u16,
    call: Option<InFlight>,
    /// What of the request in `tx` is to be sent.
    outbox: Outbox,
    unanswered: Unanswered,
    flood: Flood,
    closed: bool,
}

/// A call that waits for its reply.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    /// The serials of the first and the last attempt.
    first: u16,
    last: u16,
    attempt: u8,
    /// The serial of the last attempt of which bytes have left; 0 before the first one has.
    sent: u16,
    /// What of its timing is still needed; times in microseconds.
    attempts: u8,
    attempt_timeout: u64,
    keep_alive: KeepAlive,
    attempt_until: Instant,
    deadline: Instant,
}

/// How long S_EXECUTING may keep a call alive.
#[derive(Clone, Copy, Debug)]
enum KeepAlive {
    /// For so many microseconds, from the first one on.
    For(u64),
    /// Until then: the first one has arrived.
    Until(Instant),
}

impl<T: Storage, R: Storage> Client<T, R> {
    /// Makes a client; a board does well with two buffers of 512 bytes.
    #[must_use]
    pub fn new(config: Config, tx: T, rx: R) -> Self {
        let inbox = Inbox::new(config.link, config.limits, config.strictness, config.on_malformed);
        Self { tx, rx, inbox, reply: None, state: State::new(config) }
    }

    /// Returns what carries the frames.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.state.link
    }

    /// Sets the serial of the next call, which is 1 at first and must not be 0.
    ///
    /// A client over UDP begins with a random one: replies to an earlier client on the same port are stale then, a forger
    /// has to guess, and a server does not take its Service_Start for a copy of that client's.
    pub const fn set_next_serial(&mut self, serial: u16) {
        self.state.next_serial = if serial == 0 { 1 } else { serial };
    }

    /// Returns [`Config::timing`], the timing of calls that bring none of their own.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        self.state.timing
    }

    /// Sets [`Config::timing`], the timing of calls that bring none of their own.
    pub const fn set_timing(&mut self, timing: Timing) {
        self.state.timing = timing;
    }

    /// Begins a call with its timing; its frame is then to be sent.
    ///
    /// # Errors
    ///
    /// [`ClientError::Busy`] while a call is in flight or part of an abandoned one is unsent, [`ClientError::Closed`]
    /// after the session ended, [`ClientError::TooLarge`] before anything over the link's limit is sent.
    pub fn start<C: Call + ?Sized>(&mut self, call: &C, timing: Timing, now: Instant) -> Result<(), ClientError> {
        self.start_any(call.prepared(), call.function(), &|frame| call.arguments(frame), timing, now)
    }

    /// Begins a call of any kind; there is one copy of this in an image, however many kinds of calls it makes.
    fn start_any(
        &mut self,
        prepared: Option<&[u8]>,
        function: FunctionId,
        arguments: Arguments<'_>,
        timing: Timing,
        now: Instant,
    ) -> Result<(), ClientError> {
        self.state.check_idle()?;
        self.reply = None;
        let (link, serial) = (self.state.link, self.state.take_serial());
        let reserved = if link.is_lossy() { serial } else { 0 };
        let max = link.send_max();
        let len = loop {
            let room = self.tx.bytes().len().min(max);
            let memory = self.tx.bytes_mut().get_mut(..room).unwrap_or_default();
            let encoded = match prepared.filter(|_| link != Link::Serial) {
                Some(prepared) => encode_prepared(prepared, memory, serial, reserved),
                None => encode(function, arguments, memory, link, serial, reserved),
            };
            match encoded {
                Ok(len) => break len,
                // memory that can grow does so, up to the link's limit
                Err(EncodeError::Full) if room < max && self.tx.grow(room.saturating_mul(2).clamp(MIN_FRAME, max)) => {}
                Err(EncodeError::Full) => return Err(ClientError::TooLarge { limit: room }),
                Err(other) => return Err(ClientError::Encode(other)),
            }
        };
        self.state.begin(serial, len, timing, now);
        Ok(())
    }

    /// Returns what the received bytes mean; `None` when more are needed.
    pub fn poll_event(&mut self, now: Instant) -> Option<Event> {
        if self.state.closed {
            return None;
        }
        Some(match self.inbox.poll(&mut self.rx)? {
            Received::Frame(frame) => {
                let event = self.state.handle_frame(&frame.header, self.inbox.is_early(frame), now);
                if matches!(event, Event::Replied(_)) {
                    self.reply = Some(frame);
                }
                event
            }
            Received::TooLarge(frame) => self.state.handle_too_large(&frame.header, self.inbox.is_early(frame)),
            Received::Malformed(error) => Event::Malformed(error),
            Received::Broken(error) => self.state.close(ClientError::Malformed(error)),
        })
    }

    /// Returns the reply that [`Event::Replied`] has announced, until bytes are received or a call is started.
    #[must_use]
    pub fn reply(&self) -> Option<Frame<'_>> {
        self.inbox.frame(self.rx.bytes(), self.reply?)
    }

    /// Reads the value of the reply as that of a call.
    ///
    /// # Errors
    ///
    /// [`ClientError::Reply`] when it is of another type.
    pub fn value<V: Reply>(&self) -> Result<V::Value<'_>, ClientError> {
        let args = self.reply().map_or(crate::bcap::Args::NONE, |frame| frame.args);
        V::read(args).map_err(ClientError::Reply)
    }

    /// Acts on the time: sends a call again, or ends it. Nothing happens before the time is due.
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Event> {
        let call = self.state.call?;
        if now >= call.deadline {
            return Some(self.state.fail(Timeout::Deadline));
        }
        if now >= call.keep_alive_until() {
            return Some(self.state.fail(Timeout::KeepAlive));
        }
        if now < call.attempt_until {
            return None;
        }
        if self.state.link == Link::Serial {
            if self.state.outbox.is_partial() {
                // a slow line: the attempt has not really begun
                self.state.call = Some(InFlight { attempt_until: call.attempt_end(now), ..call });
                return None;
            }
            // the line was silent for a whole attempt, so the rest of a frame will not come
            self.inbox.forget_partial();
        }
        if !self.state.link.is_lossy() || call.attempt >= call.attempts {
            return Some(self.state.fail(Timeout::Attempt));
        }
        let serial = self.state.retry(call, now);
        let frame = self.state.outbox.whole(self.tx.bytes_mut());
        renumber(frame, serial, call.first, self.state.link == Link::Serial);
        Some(Event::Retried { attempt: call.attempt.saturating_add(1) })
    }

    /// Gives the call in flight up, if there is one. A reply that comes later will be stale.
    pub fn abandon(&mut self) {
        self.state.end_call(None);
    }

    /// Tells whether a call is in flight.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.state.call.is_some()
    }

    /// Tells whether the session has ended because the peer sent no valid frame.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.state.closed
    }

    /// Begins a new session over a new connection: forgets the call in flight and everything received. Serials go on.
    pub fn reset(&mut self) {
        self.inbox.reset();
        self.reply = None;
        self.state.end_call(None);
        self.state.closed = false;
        self.state.outbox = Outbox::EMPTY;
        self.state.unanswered = Unanswered::default();
        self.state.flood = Flood::default();
    }
}

impl<T: Storage, R: Storage> Endpoint for Client<T, R> {
    fn transmit(&self) -> &[u8] {
        self.state.outbox.unsent(self.tx.bytes())
    }

    fn transmitted(&mut self, count: usize) {
        if self.state.outbox.transmitted(count)
            && let Some(call) = &mut self.state.call
        {
            if call.sent == 0 {
                self.inbox.mark();
            }
            call.sent = call.last;
        }
    }

    fn receive_buffer(&mut self) -> &mut [u8] {
        self.reply = None;
        self.inbox.free(&mut self.rx)
    }

    fn received(&mut self, count: usize) {
        self.inbox.received(self.rx.bytes(), count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.state.call.map(|call| call.attempt_until.min(call.deadline).min(call.keep_alive_until()))
    }
}

/// What appends the arguments of a call.
type Arguments<'a> = &'a dyn Fn(&mut FrameWriter<'_>) -> Result<(), EncodeError>;

fn encode(
    function: FunctionId,
    arguments: Arguments<'_>,
    memory: &mut [u8],
    link: Link,
    serial: u16,
    reserved: u16,
) -> Result<usize, EncodeError> {
    let mut frame = FrameWriter::new(memory)?.with_crc(link == Link::Serial);
    arguments(&mut frame)?;
    frame.finish(serial, reserved, function.0).map(<[u8]>::len)
}

/// Copies a frame that was made before.
fn encode_prepared(prepared: &[u8], memory: &mut [u8], serial: u16, reserved: u16) -> Result<usize, EncodeError> {
    let frame = memory.get_mut(..prepared.len()).ok_or(EncodeError::Full)?;
    frame.copy_from_slice(prepared);
    renumber(frame, serial, reserved, false);
    Ok(prepared.len())
}

impl State {
    fn new(config: Config) -> Self {
        Self {
            link: config.link,
            timing: config.timing,
            next_serial: 1,
            call: None,
            outbox: Outbox::EMPTY,
            unanswered: Unanswered::default(),
            flood: Flood::default(),
            closed: false,
        }
    }

    fn check_idle(&self) -> Result<(), ClientError> {
        if self.closed {
            return Err(ClientError::Closed);
        }
        if self.call.is_some() || self.outbox.is_sending() {
            return Err(ClientError::Busy);
        }
        Ok(())
    }

    /// Returns the next serial that no reply is outstanding for.
    fn take_serial(&mut self) -> u16 {
        // the loop ends: fewer serials are remembered than there are
        loop {
            let serial = self.next_serial;
            self.next_serial = if serial == u16::MAX { 1 } else { serial.wrapping_add(1) };
            let in_flight = self.call.is_some_and(|call| within(serial, call.first, call.last));
            if !in_flight && !self.unanswered.contains(serial) {
                return serial;
            }
        }
    }

    fn begin(&mut self, serial: u16, len: usize, timing: Timing, now: Instant) {
        self.outbox = Outbox::new(len);
        self.call = Some(InFlight {
            first: serial,
            last: serial,
            attempt: 1,
            sent: 0,
            attempts: timing.attempts,
            attempt_timeout: Instant::ZERO.saturating_add(timing.attempt_timeout).as_micros(),
            keep_alive: KeepAlive::For(Instant::ZERO.saturating_add(timing.keep_alive).as_micros()),
            attempt_until: now.saturating_add(timing.attempt_timeout),
            deadline: now.saturating_add(timing.deadline),
        });
    }

    fn retry(&mut self, call: InFlight, now: Instant) -> u16 {
        let serial = self.take_serial();
        self.outbox.rewind();
        self.call = Some(InFlight {
            last: serial,
            attempt: call.attempt.saturating_add(1),
            attempt_until: call.attempt_end(now),
            ..call
        });
        serial
    }

    fn handle_frame(&mut self, header: &Header, is_early: bool, now: Instant) -> Event {
        let (serial, result) = (header.serial, HResult(header.code));
        let is_answer = !is_early && self.is_awaited(serial) && (result.is_err() || self.is_sent());
        // over UDP anybody can send stale replies, so those end no session
        let is_useless = if is_answer { result == HResult::S_EXECUTING } else { self.link == Link::Stream };
        if is_useless && self.flood.is_over(now) {
            return self.close(ClientError::Flooded);
        }
        if !is_answer {
            if result != HResult::S_EXECUTING {
                self.unanswered.answered(serial);
            }
            return Event::Stale { serial };
        }
        if result == HResult::S_EXECUTING {
            self.keep_alive(now);
            return Event::Executing;
        }
        self.end_call(Some(serial));
        Event::Replied(result)
    }

    /// Restarts the time of the attempt.
    fn keep_alive(&mut self, now: Instant) {
        if let Some(call) = &mut self.call {
            call.attempt_until = call.attempt_end(now);
            if let KeepAlive::For(micros) = call.keep_alive {
                call.keep_alive = KeepAlive::Until(later(now, micros));
            }
        }
    }

    fn handle_too_large(&mut self, header: &Header, is_early: bool) -> Event {
        let Header { serial, length, .. } = *header;
        if is_early || !self.is_awaited(serial) {
            return Event::Stale { serial };
        }
        self.end_call(Some(serial));
        Event::Failed(ClientError::ReplyTooLarge { length })
    }

    /// Tells whether an attempt of the call in flight has left with this serial.
    fn is_awaited(&self, serial: u16) -> bool {
        let sent = self.call.map(|call| (call.first, call.sent)).filter(|(_, sent)| *sent != 0);
        // an old serial may lie in the range of a call whose attempts had to step over it
        sent.is_some_and(|(first, sent)| within(serial, first, sent)) && !self.unanswered.contains(serial)
    }

    /// Tells whether an attempt of the call in flight has left wholly.
    fn is_sent(&self) -> bool {
        !self.outbox.is_sending() || self.call.is_some_and(|call| call.attempt > 1)
    }

    fn fail(&mut self, timeout: Timeout) -> Event {
        self.end_call(None);
        Event::Failed(ClientError::Timeout(timeout))
    }

    fn close(&mut self, error: ClientError) -> Event {
        self.closed = true;
        self.end_call(None);
        Event::Failed(error)
    }

    /// Ends the call in flight, if there is one, and remembers its attempts that were sent but not answered.
    fn end_call(&mut self, answered: Option<u16>) {
        let Some(call) = self.call.take() else { return };
        if call.sent != 0 && (answered.is_none() || call.attempt > 1) {
            self.unanswered.push(call.first, call.last);
        }
        if !self.outbox.is_partial() || self.link == Link::Datagram {
            // nothing of the frame has left, or all of it has
            self.outbox = Outbox::EMPTY;
        }
    }
}

impl InFlight {
    const fn keep_alive_until(&self) -> Instant {
        match self.keep_alive {
            KeepAlive::For(_) => Instant::FAR_FUTURE,
            KeepAlive::Until(until) => until,
        }
    }

    /// Returns when an attempt that begins now, or that is kept alive now, times out.
    const fn attempt_end(&self, now: Instant) -> Instant {
        later(now, self.attempt_timeout)
    }
}

const fn later(now: Instant, micros: u64) -> Instant {
    Instant::from_micros(now.as_micros().saturating_add(micros))
}

/// Tells whether `serial` lies in a range that may wrap.
const fn within(serial: u16, first: u16, last: u16) -> bool {
    serial != 0 && serial.wrapping_sub(first) <= last.wrapping_sub(first)
}

/// A token bucket for frames that bring a call no further.
///
/// A server sends S_EXECUTING at most every 80 ms, the least WDT (S2:225). Four times that rate is allowed, and bursts of
/// 256 frames, as a network that stalls delivers them.
#[derive(Clone, Copy, Debug, Default)]
struct Flood {
    /// When the bucket is full again.
    full_at: Instant,
}

impl Flood {
    const INTERVAL: Duration = Duration::from_millis(20);
    const BURST: Duration = Duration::from_millis(20 * 256);

    /// Takes a token; tells whether there was none.
    fn is_over(&mut self, now: Instant) -> bool {
        let full_at = self.full_at.max(now).saturating_add(Self::INTERVAL);
        if full_at.saturating_since(now) > Self::BURST {
            return true;
        }
        self.full_at = full_at;
        false
    }
}

/// Serials whose replies may still arrive, as ranges; when there are more than this holds, the oldest are forgotten.
#[derive(Debug, Default)]
struct Unanswered {
    ranges: heapless::Vec<(u16, u16), 8>,
}

impl Unanswered {
    fn push(&mut self, first: u16, last: u16) {
        if self.ranges.is_full() {
            self.ranges.remove(0);
        }
        // there is room: one was just removed
        let _ = self.ranges.push((first, last));
    }

    fn contains(&self, serial: u16) -> bool {
        self.ranges.iter().any(|(first, last)| within(serial, *first, *last))
    }

    /// Forgets a range of one serial that has been answered; of retried calls more replies may arrive.
    fn answered(&mut self, serial: u16) {
        self.ranges.retain(|range| *range != (serial, serial));
    }
}

#[cfg(test)]
mod tests;
