//! The sans-IO client of b-CAP: one call at a time, over any link.
//!
//! ```text
//!   start ──► transmit ─► the link ─► receive_buffer, received ──► poll_event ──► reply
//!                ▲                                                     │
//!                └──────────── handle_timeout at poll_timeout ◄────────┘
//! ```
//!
//! A [`Client`] contains no socket and no clock. The caller sends the bytes of [`transmit`](Client::transmit), puts
//! received bytes into [`receive_buffer`](Client::receive_buffer), passes the time in, and reads events.
//!
//! * **Serials** run from 1 to 65535. Each attempt takes a new one; no serial is reused while a reply to it may arrive.
//! * **Retransmission** happens on lossy links only. The reserved field then carries the first attempt's serial, by which
//!   the server recognises a copy. A reply to any attempt of a call ends the call.
//! * **Timeouts**: an *attempt* waits for its timeout; a *call* takes at most its deadline; S_EXECUTING restarts the
//!   attempt's timeout, but only for the keep-alive time. The error says which of the three passed.
//! * **On serial lines** no attempt ends while a frame arrives; a silence inside a frame ends the frame.
//! * **Late replies** are recognised by their serial, reported as [`Event::Stale`] and dropped. Invalid datagrams are
//!   reported and dropped. Neither costs an attempt.
//! * **Early replies** are stale, too: a reply whose first byte arrived before the first byte of the request was sent, and
//!   a success before the whole request was sent. An error is accepted earlier, because a server may refuse a long request
//!   at its header.
//! * **Floods** end the session: a token bucket limits the rate of S_EXECUTING, and on a stream also the rate of stale
//!   replies.
//! * **Cancelling** with [`abandon`](Client::abandon) is possible at any byte: the client finishes a partly sent request,
//!   and its reply is stale.

use core::fmt;
use core::time::Duration;

use crate::bcap::FunctionId;
use crate::bcap::call::{Call, Reply, ReplyError};
use crate::bcap::frame::{Args, Frame, FrameWriter, MIN_FRAME, renumber};
use crate::bcap::header::Header;
use crate::bcap::link::{Inbox, InboxEvent, Link, Located, OnMalformed};
use crate::endpoint::Endpoint;
use crate::error::{DecodeError, EncodeError};
use crate::hresult::HResult;
use crate::limits::{Limits, Strictness};
use crate::outbox::Outbox;
use crate::storage::Storage;
use crate::time::{Instant, micros, micros_u32};

/// The time limits and the number of attempts of one call.
///
/// They are an argument of [`Client::start`], so a dropped call cannot leave them changed for the next call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Timing {
    /// How long an attempt waits for a reply or a keep-alive.
    pub attempt_timeout: Duration,
    /// The maximum number of attempts on lossy links; on a stream a call is sent once.
    pub attempts: u8,
    /// How long the call may take in total.
    pub deadline: Duration,
    /// How long S_EXECUTING may keep the call alive, counted from the first S_EXECUTING.
    pub keep_alive: Duration,
}

impl Timing {
    /// Defaults for TCP: 3 s for the reply or the next keep-alive, 180 s for a call, the default time limit of a server.
    pub const TCP: Self = Self {
        attempt_timeout: Duration::from_secs(3),
        attempts: 1,
        deadline: Duration::from_secs(180),
        keep_alive: Duration::from_secs(180),
    };
    /// Defaults for UDP and serial lines: five attempts of 500 ms (b-CAP specification, Table 6-1).
    pub const UDP: Self = Self { attempt_timeout: Duration::from_millis(500), attempts: 5, ..Self::TCP };
    /// Defaults for serial lines, as for UDP; [`serial`](Self::serial) derives them from the rate of the line.
    pub const SERIAL: Self = Self::UDP;

    /// Timing for a serial line with this rate, in bits per second: an attempt waits 500 ms and the time of the two longest
    /// frames. At 9600 baud a reply of 500 bytes takes 520 ms.
    #[must_use]
    pub const fn serial(baud: u32) -> Self {
        /// A request and a reply of `SERIAL_MAX` bytes.
        const FRAMES: u32 = 2 * 503;
        let attempt_timeout = Self::SERIAL.attempt_timeout.saturating_add(line_time(FRAMES, baud));
        Self { attempt_timeout, ..Self::SERIAL }
    }
}

/// Returns how long a serial line takes for some characters; a character has at most eleven bits.
const fn line_time(characters: u32, baud: u32) -> Duration {
    match Duration::from_secs(11).checked_div(baud) {
        Some(character) => character.saturating_mul(characters),
        None => Duration::MAX,
    }
}

/// Configuration of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// The transport of the frames.
    pub link: Link,
    /// The limits on received frames.
    pub limits: Limits,
    /// Whether replies are decoded strictly or leniently.
    pub strictness: Strictness,
    /// The reaction to bytes of a stream that are not a valid frame. Invalid datagrams are always dropped.
    pub on_malformed: OnMalformed,
    /// The timing of calls without their own, such as [`Connection::call`](crate::io::blocking::Connection::call).
    pub timing: Timing,
    /// On serial lines, the silence inside a frame after which its rest is lost: rounded up to milliseconds, at most 65 s.
    /// While a frame arrives, no attempt ends.
    pub character_timeout: Duration,
}

impl Config {
    /// Defaults for TCP.
    pub const TCP: Self = Self {
        link: Link::Stream,
        limits: Limits::STREAM,
        strictness: Strictness::Strict,
        on_malformed: OnMalformed::Close,
        timing: Timing::TCP,
        character_timeout: Duration::from_millis(100),
    };
    /// Defaults for UDP.
    pub const UDP: Self = Self {
        link: Link::Datagram,
        limits: Limits::DATAGRAM,
        on_malformed: OnMalformed::Resync,
        timing: Timing::UDP,
        ..Self::TCP
    };
    /// Defaults for serial lines of at least 19200 baud.
    pub const SERIAL: Self = Self { link: Link::Serial, limits: Limits::SERIAL, timing: Timing::SERIAL, ..Self::UDP };

    /// Configuration for a serial line with this rate, in bits per second: the timing of [`Timing::serial`], and 50 ms and
    /// ten characters of silence inside a frame.
    #[must_use]
    pub const fn serial(baud: u32) -> Self {
        let character_timeout = Duration::from_millis(50).saturating_add(line_time(10, baud));
        Self { timing: Timing::serial(baud), character_timeout, ..Self::SERIAL }
    }
}

/// An event of a client. It borrows nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
#[non_exhaustive]
pub enum Event {
    /// The reply arrived, with this result; [`Client::reply`] views it.
    Replied(HResult),
    /// The call ended without a reply.
    Failed(ClientError),
    /// The server still executes the call (S_EXECUTING); the attempt's timeout restarts.
    Executing,
    /// The client sends the call again.
    Retried {
        /// The number of the new attempt; the first attempt of a call is 1.
        attempt: u8,
    },
    /// A reply that belongs to no call in flight was dropped.
    Stale {
        /// Its serial.
        serial: u16,
    },
    /// Invalid bytes were dropped.
    Malformed(DecodeError),
}

/// Which of a call's time limits has passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Timeout {
    /// The last attempt got neither a reply nor S_EXECUTING.
    Attempt,
    /// The call took longer than [`Timing::deadline`].
    Deadline,
    /// The server sent S_EXECUTING for longer than [`Timing::keep_alive`].
    KeepAlive,
}

/// Why a call could not be sent, or ended without a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ClientError {
    /// The call cannot be encoded; the caller's fault, nothing was sent.
    Encode(EncodeError),
    /// The call exceeds the largest frame of the link, or the buffer; the caller's fault, nothing was sent.
    TooLarge {
        /// The largest frame, in bytes.
        limit: usize,
    },
    /// A call is in flight, or part of an abandoned one is unsent; the caller's fault, nothing was sent.
    Busy,
    /// A time limit has passed.
    Timeout(Timeout),
    /// The peer sent invalid bytes; the session has ended.
    Malformed(DecodeError),
    /// The peer sent far more keep-alives than a server does, or replies to no call; the session has ended.
    Flooded,
    /// The reply is larger than the receive buffer; the session continues.
    ReplyTooLarge {
        /// The reply's length, in bytes.
        length: u32,
    },
    /// The reply carries a value of another type than the function returns; the peer's fault.
    Reply(ReplyError),
    /// The session has already ended.
    Closed,
}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Encode(e) => write!(f, "the call cannot be sent: {e}"),
            Self::TooLarge { limit } => write!(f, "the call does not fit a frame of {limit} bytes"),
            Self::Busy => f.write_str("another call is in flight"),
            Self::Timeout(Timeout::Attempt) => f.write_str(
                "no reply and no keep-alive within the timeout; if the call takes long: was the service started with a \
                 watchdog (WDT=400)?",
            ),
            Self::Timeout(Timeout::Deadline) => f.write_str("the call took longer than its deadline"),
            Self::Timeout(Timeout::KeepAlive) => f.write_str("the server kept the call alive for too long"),
            Self::Malformed(e) => write!(f, "the peer sent no valid frame: {e}"),
            Self::Flooded => f.write_str("the peer floods this client with keep-alives or unrequested replies"),
            Self::ReplyTooLarge { length } => write!(f, "the reply of {length} bytes does not fit the receive buffer"),
            Self::Reply(e) => e.fmt(f),
            Self::Closed => f.write_str("the session has ended"),
        }
    }
}

impl core::error::Error for ClientError {}

/// A client with two buffers: `tx` for the request, `rx` for received bytes.
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
/// // ... the reply arrives: I4 7
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

/// The part of a client that does not depend on the types of its buffers.
#[derive(Debug)]
struct State {
    link: Link,
    timing: Timing,
    /// The serial of the next attempt.
    next_serial: u16,
    call: Option<InFlight>,
    /// The unsent part of the request in `tx`.
    outbox: Outbox,
    /// Whether the whole request of the last call was sent at least once.
    was_sent: bool,
    unanswered: Unanswered,
    flood: Flood,
    closed: bool,
    /// [`Config::character_timeout`] in milliseconds.
    character_timeout: u16,
    /// On a serial line, when the rest of a partly received frame is lost; [`Instant::FAR_FUTURE`] while there is no such
    /// frame.
    partial_until: Instant,
}

/// A call that waits for its reply.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    /// The serials of the first and the last attempt.
    first: u16,
    last: u16,
    attempt: u8,
    /// The serial of the last attempt that was at least partly sent; 0 before any were.
    sent: u16,
    /// The parts of the timing that later events need; in microseconds.
    attempts: u8,
    attempt_timeout: u64,
    keep_alive: KeepAlive,
    attempt_until: Instant,
    deadline: Instant,
}

/// How long S_EXECUTING may keep a call alive.
#[derive(Clone, Copy, Debug)]
enum KeepAlive {
    /// For this many microseconds from the first S_EXECUTING, which has not arrived.
    For(u64),
    /// Until this time: the first S_EXECUTING has arrived.
    Until(Instant),
}

impl<T: Storage, R: Storage> Client<T, R> {
    /// Creates a client; two buffers of 512 bytes suit most boards.
    #[must_use]
    pub fn new(config: Config, tx: T, rx: R) -> Self {
        let inbox = Inbox::new(config.link, config.limits, config.strictness, config.on_malformed);
        Self { tx, rx, inbox, reply: None, state: State::new(config) }
    }

    /// Returns the kind of link.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.state.link
    }

    /// Sets the serial of the next call; it is 1 for a new client. 0 sets 1.
    ///
    /// A client over UDP should begin with a random serial: replies to an earlier client on the same port are then stale, a
    /// forged reply has to guess the serial, and the server does not mistake the Service_Start for a copy of the earlier
    /// client's.
    pub const fn set_next_serial(&mut self, serial: u16) {
        self.state.next_serial = if serial == 0 { 1 } else { serial };
    }

    /// Returns the serial of the next call.
    #[must_use]
    pub const fn next_serial(&self) -> u16 {
        self.state.next_serial
    }

    /// Returns [`Config::timing`], the timing of calls without their own.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        self.state.timing
    }

    /// Sets [`Config::timing`], the timing of calls without their own.
    pub const fn set_timing(&mut self, timing: Timing) {
        self.state.timing = timing;
    }

    /// Starts a call; [`transmit`](Endpoint::transmit) then returns its frame.
    ///
    /// # Errors
    ///
    /// [`ClientError::Busy`] while a call is in flight or part of an abandoned one is unsent, [`ClientError::Closed`]
    /// after the session ended, [`ClientError::TooLarge`] for a frame above the limit of the link or the buffer.
    pub fn start<C: Call + ?Sized>(&mut self, call: &C, timing: Timing, now: Instant) -> Result<(), ClientError> {
        self.start_any(call.prepared(), call.function(), &|frame| call.arguments(frame), Some(&timing), now)
    }

    /// Starts a call with [`Config::timing`], of which it makes no copy.
    pub(crate) fn start_as_configured<C: Call + ?Sized>(&mut self, call: &C, now: Instant) -> Result<(), ClientError> {
        self.start_any(call.prepared(), call.function(), &|frame| call.arguments(frame), None, now)
    }

    /// Starts a call of any type. It is not generic over the call, so an image contains one copy of it.
    fn start_any(
        &mut self,
        prepared: Option<&[u8]>,
        function: FunctionId,
        arguments: ArgumentWriter<'_>,
        timing: Option<&Timing>,
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
                // grow memory that can grow, up to the link's limit
                Err(EncodeError::Full) if room < max && self.tx.grow(room.saturating_mul(2).clamp(MIN_FRAME, max)) => {}
                Err(EncodeError::Full) => return Err(ClientError::TooLarge { limit: room }),
                Err(other) => return Err(ClientError::Encode(other)),
            }
        };
        self.state.begin(serial, len, timing, now);
        Ok(())
    }

    /// Returns the next event of the received bytes; `None` when more bytes are needed.
    pub fn poll_event(&mut self, now: Instant) -> Option<Event> {
        self.next_event(&|| now)
    }

    /// Like [`poll_event`](Self::poll_event), but reads the clock only for an event that depends on the time. The reply that
    /// ends a call does not.
    pub(crate) fn next_event(&mut self, now: &dyn Fn() -> Instant) -> Option<Event> {
        if self.state.closed {
            return None;
        }
        let polled = self.inbox.poll(&mut self.rx);
        if polled.is_none() && self.state.link == Link::Serial && self.inbox.take_received() {
            self.state.watch_frame(self.inbox.is_partial(), now());
        }
        Some(match polled? {
            InboxEvent::Frame(frame) => {
                let event = self.state.handle_frame(&frame.header, self.inbox.is_early(frame), now);
                if matches!(event, Event::Replied(_)) {
                    self.reply = Some(frame);
                }
                event
            }
            InboxEvent::TooLarge(frame) => self.state.handle_too_large(&frame.header, self.inbox.is_early(frame)),
            InboxEvent::Malformed(error) => Event::Malformed(error),
            InboxEvent::Broken(error) => self.state.close(ClientError::Malformed(error)),
        })
    }

    /// Returns the reply that [`Event::Replied`] reported, until the next `receive_buffer` or `start`.
    #[must_use]
    pub fn reply(&self) -> Option<Frame<'_>> {
        self.inbox.frame(self.rx.bytes(), self.reply?)
    }

    /// Reads the value of the reply.
    ///
    /// # Errors
    ///
    /// [`ClientError::Reply`] when it has another type.
    pub fn value<V: Reply>(&self) -> Result<V::Value<'_>, ClientError> {
        V::read(self.args()).map_err(ClientError::Reply)
    }

    /// Returns the arguments of the reply, or no arguments. It is not generic over the value, so an image contains one copy.
    #[cfg_attr(target_os = "none", inline(never))]
    fn args(&self) -> Args<'_> {
        self.reply().map_or(Args::NONE, |frame| frame.args)
    }

    /// Handles a timeout: sends the call again, or ends it. Does nothing before [`poll_timeout`](Endpoint::poll_timeout).
    pub fn handle_timeout(&mut self, now: Instant) -> Option<Event> {
        let call = self.state.call?;
        if now >= call.deadline {
            return Some(self.state.fail(Timeout::Deadline));
        }
        if now >= call.keep_alive_until() {
            return Some(self.state.fail(Timeout::KeepAlive));
        }
        if self.state.is_receiving() {
            if now < self.state.partial_until {
                return None;
            }
            // the line was silent inside a frame, so the rest of the frame will not arrive
            self.inbox.forget_partial();
            self.state.partial_until = Instant::FAR_FUTURE;
        }
        if now < call.attempt_until {
            return None;
        }
        if self.state.link == Link::Serial {
            if self.state.outbox.is_partial() {
                // a slow line: the attempt's timeout starts when its frame is sent
                self.state.call = Some(InFlight { attempt_until: call.attempt_end(now), ..call });
                return None;
            }
            // the line was silent for a whole attempt, so the rest of a frame will not arrive
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

    /// Abandons the call in flight, if any. Its reply is then stale.
    pub fn abandon(&mut self) {
        self.state.end_call(None);
        self.state.was_sent = false;
    }

    /// Returns whether the whole request of the last call was sent, so that the peer may have executed it. Otherwise, a call
    /// over a lost connection was certainly not executed.
    #[must_use]
    pub const fn was_sent(&self) -> bool {
        self.state.was_sent
    }

    /// Returns whether a call is in flight.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.state.call.is_some()
    }

    /// Returns whether the session has ended, because the peer sent invalid bytes or a flood of replies.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.state.closed
    }

    /// Prepares for a new connection: discards the call in flight and all received bytes. Serials continue.
    pub fn reset(&mut self) {
        self.inbox.reset();
        self.reply = None;
        self.state.end_call(None);
        self.state.closed = false;
        self.state.outbox = Outbox::EMPTY;
        self.state.unanswered = Unanswered::default();
        self.state.flood = Flood::default();
        self.state.partial_until = Instant::FAR_FUTURE;
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
            self.state.was_sent |= !self.state.outbox.is_sending();
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
        let end =
            |call: InFlight| if self.state.is_receiving() { self.state.partial_until } else { call.attempt_until };
        self.state.call.map(|call| end(call).min(call.deadline).min(call.keep_alive_until()))
    }
}

/// Returns a duration in milliseconds, rounded up, at most 65 s.
fn millis(duration: Duration) -> u16 {
    // 32 bits, so that a board needs no division of 64 bits
    u16::try_from(micros_u32(duration).div_ceil(1000)).unwrap_or(u16::MAX)
}

/// Appends the arguments of a call.
type ArgumentWriter<'a> = &'a dyn Fn(&mut FrameWriter<'_>) -> Result<(), EncodeError>;

fn encode(
    function: FunctionId,
    arguments: ArgumentWriter<'_>,
    memory: &mut [u8],
    link: Link,
    serial: u16,
    reserved: u16,
) -> Result<usize, EncodeError> {
    let mut frame = FrameWriter::new(memory)?.with_crc(link == Link::Serial);
    arguments(&mut frame)?;
    frame.finish(serial, reserved, function.0).map(<[u8]>::len)
}

/// Copies a prepared frame and sets its serial.
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
            was_sent: false,
            unanswered: Unanswered::default(),
            flood: Flood::default(),
            closed: false,
            character_timeout: millis(config.character_timeout),
            partial_until: Instant::FAR_FUTURE,
        }
    }

    /// Sets when the rest of a frame is lost, after bytes were received from a serial line.
    fn watch_frame(&mut self, is_partial: bool, now: Instant) {
        let until = later(now, u64::from(self.character_timeout).saturating_mul(1000));
        self.partial_until = if is_partial { until } else { Instant::FAR_FUTURE };
    }

    /// Returns whether a frame on a serial line was received in part.
    fn is_receiving(&self) -> bool {
        self.partial_until != Instant::FAR_FUTURE
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

    /// Returns the next serial without an outstanding reply.
    fn take_serial(&mut self) -> u16 {
        // the loop ends, because the stored ranges cover fewer serials than exist
        loop {
            let serial = self.next_serial;
            self.next_serial = if serial == u16::MAX { 1 } else { serial.wrapping_add(1) };
            let in_flight = self.call.is_some_and(|call| within(serial, call.first, call.last));
            if !in_flight && !self.unanswered.contains(serial) {
                return serial;
            }
        }
    }

    fn begin(&mut self, serial: u16, len: usize, timing: Option<&Timing>, now: Instant) {
        let timing = timing.unwrap_or(&self.timing);
        let attempt_timeout = limit(timing.attempt_timeout);
        self.outbox = Outbox::new(len);
        self.was_sent = false;
        self.call = Some(InFlight {
            first: serial,
            last: serial,
            attempt: 1,
            sent: 0,
            attempts: timing.attempts,
            attempt_timeout,
            keep_alive: KeepAlive::For(limit(timing.keep_alive)),
            attempt_until: later(now, attempt_timeout),
            deadline: later(now, limit(timing.deadline)),
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

    fn handle_frame(&mut self, header: &Header, is_early: bool, now: &dyn Fn() -> Instant) -> Event {
        let (serial, result) = (header.serial, HResult(header.code));
        let is_answer = !is_early && self.is_awaited(serial) && (result.is_err() || self.is_sent());
        // over UDP any host can send stale replies, so those do not end the session
        let is_useless = if is_answer { result == HResult::S_EXECUTING } else { self.link == Link::Stream };
        if is_useless && self.flood.is_over(now()) {
            return self.close(ClientError::Flooded);
        }
        if !is_answer {
            if result != HResult::S_EXECUTING {
                self.unanswered.answered(serial);
            }
            return Event::Stale { serial };
        }
        if result == HResult::S_EXECUTING {
            self.keep_alive(now());
            return Event::Executing;
        }
        self.end_call(Some(serial));
        Event::Replied(result)
    }

    /// Restarts the attempt's timeout.
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

    /// Returns whether an attempt of the call in flight was sent with this serial, at least in part.
    fn is_awaited(&self, serial: u16) -> bool {
        let Some(InFlight { first, sent, .. }) = self.call else { return false };
        if serial == sent {
            return sent != 0;
        }
        // the range of a call may include an older serial that its attempts skipped
        within(serial, first, sent) && sent != 0 && !self.unanswered.contains(serial)
    }

    /// Returns whether an attempt of the call in flight was sent completely.
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

    /// Ends the call in flight, if any, and stores the serials of its sent attempts without a reply.
    fn end_call(&mut self, answered: Option<u16>) {
        let Some(call) = self.call.take() else { return };
        if call.sent != 0 && (answered.is_none() || call.attempt > 1) {
            self.unanswered.push(call.first, call.last);
        }
        if !self.outbox.is_partial() || self.link == Link::Datagram {
            // a partly sent frame must be finished on a stream
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

    /// Returns the timeout of an attempt that starts, or is kept alive, at `now`.
    const fn attempt_end(&self, now: Instant) -> Instant {
        later(now, self.attempt_timeout)
    }
}

/// Converts a time limit to microseconds.
// on a processor of 32 bits each inlined copy takes 80 bytes
#[cfg_attr(target_os = "none", inline(never))]
const fn limit(duration: Duration) -> u64 {
    micros(duration)
}

const fn later(now: Instant, micros: u64) -> Instant {
    Instant::from_micros(now.as_micros().saturating_add(micros))
}

/// Returns whether `serial` lies in a range, which may wrap.
const fn within(serial: u16, first: u16, last: u16) -> bool {
    serial != 0 && serial.wrapping_sub(first) <= last.wrapping_sub(first)
}

/// A token bucket for frames that do not end a call.
///
/// A server sends S_EXECUTING at most every 80 ms, the minimum of WDT (b-CAP specification, Table 4-1). Four times that
/// rate is allowed, and bursts of 256 frames, because a stalled network delivers its frames in a burst.
#[derive(Clone, Copy, Debug, Default)]
struct Flood {
    /// When the bucket is full again.
    full_at: Instant,
}

impl Flood {
    /// In microseconds, so that a board needs no division.
    const INTERVAL: u64 = 20_000;
    const BURST: u64 = 256 * Self::INTERVAL;

    /// Takes a token; returns `true` if the bucket is empty.
    fn is_over(&mut self, now: Instant) -> bool {
        let full_at = later(self.full_at.max(now), Self::INTERVAL);
        if full_at > later(now, Self::BURST) {
            return true;
        }
        self.full_at = full_at;
        false
    }
}

/// Ranges of serials whose replies may still arrive; each new range replaces the oldest.
// an array and not a `heapless::Vec`, whose shifting would link `memmove` on a board
#[derive(Debug, Default)]
struct Unanswered {
    /// In reverse order of the calls, followed by `(0, 0)`: no call has serial 0.
    ranges: [(u16, u16); 8],
}

impl Unanswered {
    fn push(&mut self, first: u16, last: u16) {
        let mut newer = (first, last);
        for range in &mut self.ranges {
            core::mem::swap(range, &mut newer);
        }
    }

    fn contains(&self, serial: u16) -> bool {
        self.ranges.iter().take_while(|(first, _)| *first != 0).any(|(first, last)| within(serial, *first, *last))
    }

    /// Removes a range of one serial whose reply arrived. A retried call may get further replies.
    fn answered(&mut self, serial: u16) {
        if let Some(at) = self.ranges.iter().position(|range| *range == (serial, serial)) {
            let mut older = (0, 0);
            for range in self.ranges.iter_mut().skip(at).rev() {
                core::mem::swap(range, &mut older);
            }
        }
    }
}

#[cfg(test)]
mod tests;
