//! The sans-IO server of b-CAP: one [`Session`] for each peer.
//!
//! ```text
//!   the link ─► receive_buffer, received ──► run(handler) ──► transmit ─► the link
//!                                             ▲    │
//!                                poll_timeout └────┘ S_EXECUTING, time limits, a waiting handler
//! ```
//!
//! A [`Session`] contains no socket and no clock. The caller moves the bytes, and calls [`run`](Session::run) after bytes
//! were received or sent, at [`poll_timeout`](Session::poll_timeout), and after any event that a waiting handler may wait
//! for. The session does the following for the handler:
//!
//! * **Frames** are validated. An invalid frame on a stream gets the reply E_INVALIDRCPACKET, and the session ends (RAC
//!   specification, Table 2-3). An invalid datagram gets a reply if it has a header. Noise on a serial line is skipped, and an
//!   incomplete frame is dropped after 100 ms of silence.
//! * **Arguments** are checked against the [function table](super::function): their number (E_INVALIDARG), their types
//!   (E_INVALIDARGTYPE), and that a handle was given to this peer (E_HANDLE).
//! * **Time**: with `WDT=ms` in Service_Start, the session sends S_EXECUTING at that interval while a call runs. A call that
//!   runs longer than `InvokeTimeout=ms` (180 s) gets the reply E_TIMEOUT and is abandoned.
//! * **Copies** of a call on lossy links are recognised by the reserved field and the function. For a copy of the last
//!   call, the session sends its reply again; for a copy of the running call, S_EXECUTING; it drops a late copy of an older
//!   call of the session. Without a session every request gets a reply (`docs/udp-sessions.md`).
//! * **Objects**: the session lists the handles given to the peer. At Service_Stop, and when the peer disconnects, it
//!   releases the remaining ones in reverse order. When the list is full, opening an object fails with E_MAX_OBJECT.

use core::time::Duration;

use crate::bcap::frame::{EOT, FrameWriter, crc16, renumber, seal};
use crate::bcap::header::{HEADER_LEN, Header};
use crate::bcap::link::{Inbox, InboxEvent, Link, Located, OnMalformed};
use crate::bcap::{Args, FunctionId, Kind, Object};
use crate::endpoint::{Endpoint, Serve, ServerEndpoint};
use crate::error::DecodeError;
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::limits::{Limits, Strictness};
use crate::num::to_u32;
use crate::outbox::Outbox;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::{Bstr, Variant};

mod open_objects;
mod options;
mod serials;

use self::open_objects::OpenObjects;
pub use self::options::{OptionError, StartOptions};
use self::serials::{Attempt, Serials, Verdict};

/// A request; the number and the types of its arguments agree with the function table.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Request<'a> {
    /// The function.
    pub function: FunctionId,
    /// The arguments.
    pub args: Args<'a>,
}

impl<'a> Request<'a> {
    /// Creates a request as a server passes it on, to test a [`Handler`].
    #[must_use]
    pub const fn new(function: FunctionId, args: Args<'a>) -> Self {
        Self { function, args }
    }

    /// Returns the handle that the function is called on: its first argument.
    #[must_use]
    pub fn handle(&self) -> i32 {
        match self.value(0) {
            Variant::Ui4(n) => n.cast_signed(),
            value => value.as_i32().unwrap_or(0),
        }
    }

    /// Returns an integer argument, counted from 0.
    #[must_use]
    pub fn int(&self, index: usize) -> i32 {
        self.value(index).as_i32().unwrap_or(0)
    }

    /// Returns a floating-point argument, counted from 0.
    #[must_use]
    pub fn float(&self, index: usize) -> f64 {
        self.value(index).as_f64().unwrap_or(0.0)
    }

    /// Returns a string argument, counted from 0.
    #[must_use]
    pub fn text(&self, index: usize) -> Bstr<'a> {
        self.value(index).as_bstr().unwrap_or_default()
    }

    /// Returns an argument of any type, counted from 0; EMPTY without one.
    #[must_use]
    pub fn value(&self, index: usize) -> Variant<'a> {
        self.args.get(index).unwrap_or(Variant::Empty)
    }
}

/// The application that executes the requests of a server.
pub trait Handler {
    /// Executes a request.
    ///
    /// It sets the value of the reply in `reply`. [`Outcome`] is the result of the request, or the time to resume it. The
    /// server has checked the arguments, and that their handle was given to this peer.
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome;

    /// Resumes a request that returned [`Outcome::Wait`]; the default is to call it again.
    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.call(peer, request, reply, now)
    }

    /// Executes a request of the server itself, which releases an object that the peer left open; the default is to
    /// [`call`](Self::call) it. Its outcome is ignored.
    ///
    /// When a session ends, the server releases all open objects in reverse order, ending with the service, by Service_Stop.
    /// After that it calls the Service_Stop of the peer, if the peer has sent one.
    fn release(&mut self, peer: PeerId, request: &Request<'_>, now: Instant) {
        let _ = self.call(peer, request, &mut ReplyValue::new(&mut []), now);
    }

    /// Called when a waiting request is not resumed: it timed out, or the peer disconnected.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }

    /// Called when the server refuses a request: the function, the arguments, their handle or the options of a
    /// Service_Start are wrong, or the list of objects is full. The server replies `code`. The arguments of `request`
    /// are unchecked.
    ///
    /// It is not called for a request that is too large, nor for one that arrives while another request of the peer runs.
    fn refused(&mut self, peer: PeerId, request: &Request<'_>, code: HResult, now: Instant) {
        let _ = (peer, request, code, now);
    }

    /// Called when a peer disconnected, after its objects were released.
    fn left(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }
}

/// Configuration of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// The kind of link.
    pub link: Link,
    /// The limits on received frames.
    pub limits: Limits,
    /// Whether requests are decoded strictly or leniently.
    pub strictness: Strictness,
    /// The reaction to bytes of a stream that are not a valid frame.
    pub on_malformed: OnMalformed,
    /// How long a call may run, unless Service_Start sets another time.
    pub invoke_timeout: Duration,
    /// The maximum of that time, which also limits Service_Start.
    pub invoke_timeout_max: Duration,
}

impl Config {
    /// Defaults for TCP.
    pub const TCP: Self = Self {
        link: Link::Stream,
        limits: Limits::STREAM,
        strictness: Strictness::Strict,
        on_malformed: OnMalformed::Close,
        invoke_timeout: Duration::from_secs(180),
        invoke_timeout_max: Duration::from_secs(60 * 60),
    };
    /// Defaults for UDP.
    pub const UDP: Self =
        Self { link: Link::Datagram, limits: Limits::DATAGRAM, on_malformed: OnMalformed::Resync, ..Self::TCP };
    /// Defaults for serial lines.
    pub const SERIAL: Self =
        Self { link: Link::Serial, limits: Limits::SERIAL, on_malformed: OnMalformed::Resync, ..Self::TCP };
}

/// An event of a session, for logs and counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Event {
    /// A request got its reply, from the handler or from the session.
    Served {
        /// The function.
        function: FunctionId,
        /// The result in the reply.
        result: HResult,
    },
    /// S_EXECUTING was sent.
    KeptAlive,
    /// A copy of a call was recognised; nothing was executed.
    Repeated {
        /// The serial of the call's first attempt.
        first: u16,
    },
    /// Invalid bytes arrived.
    Malformed(DecodeError),
}

/// The server's side of one peer, with two buffers and memory for `OBJECTS` handles.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::server::{Config, Event, Handler, Request, Session};
/// use bcap_core::bcap::{FunctionId, HEADER_LEN};
/// use bcap_core::endpoint::{Endpoint, Serve};
/// use bcap_core::handler::{Outcome, PeerId, ReplyValue};
/// use bcap_core::hresult::HResult;
/// use bcap_core::time::Instant;
///
/// /// A controller without objects.
/// struct Empty;
///
/// impl Handler for Empty {
///     fn call(&mut self, _: PeerId, request: &Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
///         match request.function {
///             FunctionId::SERVICE_START | FunctionId::SERVICE_STOP => HResult::S_OK.into(),
///             _ => HResult::E_NOTIMPL.into(),
///         }
///     }
/// }
///
/// let mut session = Session::<_, _, 8>::new(Config::TCP, [0; 512], [0; 512]);
/// let request = b"\x01\x10\0\0\0\x05\0\0\0\x01\0\0\0\0\0\x04"; // Service_Start
/// session.receive_buffer()[..16].copy_from_slice(request);
/// session.received(16);
/// let event = session.run(&mut Empty, PeerId(0), Instant::ZERO);
/// assert_eq!(event, Some(Event::Served { function: FunctionId::SERVICE_START, result: HResult::S_OK }));
/// assert_eq!(session.transmit(), b"\x01\x10\0\0\0\x05\0\0\0\0\0\0\0\0\0\x04");
/// ```
#[derive(Debug)]
pub struct Session<T, R = T, const OBJECTS: usize = 32> {
    tx: T,
    rx: R,
    inbox: Inbox,
    state: State,
    objects: OpenObjects<OBJECTS>,
}

/// The part of a session that does not depend on the types of its buffers.
#[derive(Debug)]
struct State {
    config: Config,
    invoke_timeout: Duration,
    /// The interval of S_EXECUTING.
    watchdog: Option<Duration>,
    running: Option<RunningRequest>,
    /// The unsent part of the last reply in `tx`.
    outbox: Outbox,
    /// Recognises copies of calls on a lossy link.
    serials: Serials,
    /// When the rest of an incomplete frame on a serial line is lost.
    partial_until: Instant,
    /// No more frames are read; after `tx` is sent, the link must be closed.
    closing: bool,
}

/// A request that the handler has not answered yet.
#[derive(Clone, Copy, Debug)]
struct RunningRequest {
    frame: Located,
    function: FunctionId,
    /// The serial of the call's first attempt.
    marker: u16,
    /// The serial of the last attempt, which the reply carries.
    serial: u16,
    resumed: bool,
    wake: Instant,
    until: Instant,
    keep_alive_at: Instant,
}

/// Minimum interval between two polls of a waiting handler without other events.
const SOONEST: Duration = Duration::from_millis(1);

/// The silence inside a frame on a serial line after which its rest is lost.
const CHARACTER_TIMEOUT: Duration = Duration::from_millis(100);

/// The bytes before the value of a reply: the header and the argument's length.
const VALUE_AT: usize = HEADER_LEN + 4;

impl<T: Storage, R: Storage, const OBJECTS: usize> Session<T, R, OBJECTS> {
    /// Creates a session for a new peer.
    #[must_use]
    pub fn new(config: Config, tx: T, rx: R) -> Self {
        let inbox = Inbox::new(config.link, config.limits, config.strictness, config.on_malformed);
        Self { tx, rx, inbox, state: State::new(config), objects: OpenObjects::new() }
    }

    /// Returns the number of handles that the peer has open.
    #[must_use]
    pub fn open_objects(&self) -> usize {
        self.objects.len()
    }

    /// Reads the next received frame. Invalid bytes are an event; [`malformed`](Self::malformed) determines whether they get a
    /// reply.
    fn next_frame(&mut self) -> Option<Result<Located, Event>> {
        Some(match self.inbox.poll(&mut self.rx)? {
            InboxEvent::Frame(frame) => Ok(frame),
            InboxEvent::TooLarge(frame) => {
                Err(self.refuse(frame.header.serial, FunctionId(0), HResult::E_PACKETSIZEOVER))
            }
            InboxEvent::Malformed(error) => Err(self.malformed(error, false)),
            InboxEvent::Broken(error) => Err(self.malformed(error, true)),
        })
    }

    /// Drops an incomplete frame on a serial line that is silent: later requests would otherwise complete it.
    fn watch_frame(&mut self, now: Instant) {
        if self.state.config.link != Link::Serial {
            return;
        }
        if self.inbox.take_received() {
            let until = now.saturating_add(CHARACTER_TIMEOUT);
            self.state.partial_until = if self.inbox.is_partial() { until } else { Instant::FAR_FUTURE };
        } else if now >= self.state.partial_until {
            self.inbox.forget_partial();
            self.state.partial_until = Instant::FAR_FUTURE;
        }
    }

    /// Starts a received request, or handles it as a copy.
    fn begin<H: Handler + ?Sized>(
        &mut self,
        frame: Located,
        handler: &mut H,
        peer: PeerId,
        now: Instant,
    ) -> Option<Event> {
        let attempt = self.attempt(frame)?;
        match self.state.judge(&attempt, now) {
            Verdict::New => self.execute(frame, attempt, handler, peer, now),
            Verdict::Begin => {
                if self.check(frame).is_err() {
                    return self.execute(frame, attempt, handler, peer, now);
                }
                self.end_service(handler, peer, now);
                let frame = self.inbox.move_to_front(self.rx.bytes_mut(), frame);
                self.execute(frame, attempt, handler, peer, now)
            }
            Verdict::Repeat => Some(self.repeat(&attempt)),
            Verdict::Executing => Some(self.executing(&attempt)),
            Verdict::Drop => Some(Event::Repeated { first: attempt.marker }),
        }
    }

    /// Reads the parts of a request that identify copies.
    fn attempt(&self, frame: Located) -> Option<Attempt> {
        let Header { serial, reserved, code, .. } = frame.header;
        let function = FunctionId(code);
        let marker = if reserved == 0 { serial } else { reserved };
        let arguments = if function == FunctionId::SERVICE_START {
            crc16(self.inbox.frame(self.rx.bytes(), frame)?.args.as_bytes())
        } else {
            0
        };
        Some(Attempt { function, marker, serial, arguments })
    }

    /// Checks a request and calls the handler.
    fn execute<H: Handler + ?Sized>(
        &mut self,
        frame: Located,
        attempt: Attempt,
        handler: &mut H,
        peer: PeerId,
        now: Instant,
    ) -> Option<Event> {
        let function = attempt.function;
        let is_full = function.opens().is_some() && self.objects.is_full();
        let checked = self.check(frame).and(if is_full { Err(HResult::E_MAX_OBJECT) } else { Ok(()) });
        if let Err(result) = checked {
            if let Some(frame) = self.inbox.frame(self.rx.bytes(), frame) {
                handler.refused(peer, &Request { function, args: frame.args }, result, now);
            }
            return Some(self.refuse_attempt(&attempt, result));
        }
        if function == FunctionId::SERVICE_STOP {
            self.end_service(handler, peer, now);
        }
        self.state.serials.began(&attempt, now);
        let running = self.state.begin(frame, &attempt, now);
        self.call(running, handler, peer, now)
    }

    /// Ends the peer's service: abandons the running call, and releases the objects in reverse order.
    fn end_service<H: Handler + ?Sized>(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        if self.state.running.take().is_some() {
            handler.abandoned(peer, now);
        }
        self.release_objects(handler, peer, now);
        self.state.serials.end_service();
    }

    /// Resumes the running request.
    fn resume<H: Handler + ?Sized>(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Event> {
        if let Some(event) = self.called_while_running(handler, peer, now) {
            return Some(event);
        }
        // a Service_Start may have ended the call
        let running = self.state.running?;
        let RunningRequest { function, serial, marker, .. } = running;
        if now >= running.until {
            self.state.running = None;
            handler.abandoned(peer, now);
            let event = self.refuse(serial, function, HResult::E_TIMEOUT);
            self.state.serials.answered(marker, function, false);
            return Some(event);
        }
        if now >= running.keep_alive_at {
            let keep_alive_at = self.state.next_keep_alive(now);
            self.state.running = Some(RunningRequest { keep_alive_at, ..running });
            self.send_code(serial, HResult::S_EXECUTING, false);
            return Some(Event::KeptAlive);
        }
        self.call(running, handler, peer, now)
    }

    /// Handles a request that arrives while another request runs. On a stream it stays in the buffer.
    fn called_while_running<H: Handler + ?Sized>(
        &mut self,
        handler: &mut H,
        peer: PeerId,
        now: Instant,
    ) -> Option<Event> {
        if !self.state.config.link.is_lossy() {
            return None;
        }
        let frame = match self.next_frame()? {
            Ok(frame) => frame,
            // reported immediately, so that the frame after it is read
            Err(event) => return Some(event),
        };
        let attempt = self.attempt(frame)?;
        let refused = match self.state.judge(&attempt, now) {
            Verdict::New => Err(HResult::E_BUSY_PROC),
            // a client that begins a session does not wait for an earlier client's call
            Verdict::Begin => self.check(frame),
            Verdict::Executing | Verdict::Repeat | Verdict::Drop => Ok(()),
        };
        match refused {
            Err(result) => Some(self.refuse(attempt.serial, attempt.function, result)),
            Ok(()) => self.begin(frame, handler, peer, now),
        }
    }

    /// Calls the handler.
    fn call<H: Handler + ?Sized>(
        &mut self,
        running: RunningRequest,
        handler: &mut H,
        peer: PeerId,
        now: Instant,
    ) -> Option<Event> {
        let RunningRequest { frame, function, marker, serial, resumed, .. } = running;
        let args = self.inbox.frame(self.rx.bytes(), frame)?.args;
        let tail = self.state.tail();
        let max = self.state.config.link.send_max().saturating_sub(VALUE_AT).saturating_sub(tail);
        let mut reply = ReplyValue::within(&mut self.tx, VALUE_AT, max, tail);
        let request = Request { function, args };
        let outcome = match resumed {
            false => handler.call(peer, &request, &mut reply, now),
            true => handler.resume(peer, &request, &mut reply, now),
        };
        let result = match outcome {
            Outcome::Wait(wake) => {
                // a time in the past must not make the server loop
                let wake = wake.max(now.saturating_add(SOONEST));
                self.state.running = Some(RunningRequest { resumed: true, wake, ..running });
                return None;
            }
            Outcome::Done(_) if reply.is_overflow() => HResult::E_TOO_MUCH_DATA,
            Outcome::Done(result) => result,
        };
        let (len, value) = (reply.as_bytes().len(), reply.get());
        let handle = value.and_then(|value| handle_of(&value));
        self.state.running = None;
        if result.is_ok() {
            // a Service_Start that the handler refuses changes no options; `check` has refused invalid ones
            if function == FunctionId::SERVICE_START
                && let Ok(options) = StartOptions::read(args.get(0))
            {
                self.state.set_options(options);
            }
            let released = args.get(0).and_then(|value| handle_of(&value)).unwrap_or(0);
            self.update_objects(function, handle, released);
        }
        let len = if result == HResult::E_TOO_MUCH_DATA { 0 } else { len };
        self.send_reply(serial, function, result, len);
        self.state.serials.answered(marker, function, result.is_ok());
        Some(Event::Served { function, result })
    }

    /// Adds the object that a successful call opened to the list, or removes the one that it released.
    fn update_objects(&mut self, function: FunctionId, opened: Option<i32>, released: i32) {
        if let Some(object) = function.opens() {
            let handle = if object == Object::Service { Some(0) } else { opened };
            if let Some(handle) = handle {
                // `execute` has refused the call if the list is full
                self.objects.insert(object, handle);
            }
        }
        if let Some(object) = function.releases() {
            let handle = if object == Object::Service { 0 } else { released };
            self.objects.remove(object, handle);
        }
    }

    /// Releases all objects in reverse order, through the handler.
    fn release_objects<H: Handler + ?Sized>(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        while let Some((object, handle)) = self.objects.pop() {
            let mut argument = [10, 0, 0, 0, 3, 0, 1, 0, 0, 0, 0, 0, 0, 0];
            if let Some(slot) = argument.last_chunk_mut::<4>() {
                *slot = handle.to_le_bytes();
            }
            let args = match object {
                Object::Service => Args::NONE,
                _ => Args::from_checked(1, &argument, Strictness::Strict),
            };
            handler.release(peer, &Request { function: object.released_by(), args }, now);
        }
    }

    /// Checks a request against the function table and the peer's objects, and the options of a Service_Start.
    fn check(&self, frame: Located) -> Result<(), HResult> {
        let frame = self.inbox.frame(self.rx.bytes(), frame).ok_or(HResult::E_INVALIDRCPACKET)?;
        let function = frame.function();
        let Some(signature) = function.signature() else { return Err(HResult::E_INVALIDARG) };
        let (given, taken) = (frame.args.len(), signature.arguments.len());
        if given > taken || (given < taken && function != FunctionId::SERVICE_START) {
            return Err(HResult::E_INVALIDARG);
        }
        for (value, kind) in frame.args.iter().zip(signature.arguments) {
            if !kind.accepts(&value) {
                return Err(HResult::E_INVALIDARGTYPE);
            }
            if let Kind::Handle(object) = kind
                && !handle_of(&value).is_some_and(|handle| self.objects.contains(*object, handle))
            {
                return Err(HResult::E_HANDLE);
            }
        }
        if function != FunctionId::SERVICE_START {
            return Ok(());
        }
        StartOptions::read(frame.args.get(0)).map(drop).map_err(|_| HResult::E_INVALIDARG)
    }

    /// Replies without calling the handler.
    fn refuse(&mut self, serial: u16, function: FunctionId, result: HResult) -> Event {
        self.send_reply(serial, function, result, 0);
        Event::Served { function, result }
    }

    /// Replies without calling the handler, and keeps the reply for further attempts.
    fn refuse_attempt(&mut self, attempt: &Attempt, result: HResult) -> Event {
        let event = self.refuse(attempt.serial, attempt.function, result);
        self.state.serials.answered(attempt.marker, attempt.function, false);
        event
    }

    /// Sends the last reply again, with the serial of another attempt of its call.
    fn repeat(&mut self, attempt: &Attempt) -> Event {
        let frame = self.state.outbox.whole(self.tx.bytes_mut());
        renumber(frame, attempt.serial, 0, self.state.config.link == Link::Serial);
        self.state.outbox.rewind();
        Event::Repeated { first: attempt.marker }
    }

    /// Replies to another attempt of the running call with S_EXECUTING.
    fn executing(&mut self, attempt: &Attempt) -> Event {
        let mut serial = attempt.serial;
        if let Some(running) = &mut self.state.running {
            // the network may have reordered the attempts: the reply carries the serial of the last attempt
            if serial.wrapping_sub(running.serial) >= 0x8000 {
                serial = running.serial;
            }
            running.serial = serial;
        }
        self.send_code(serial, HResult::S_EXECUTING, false);
        Event::Repeated { first: attempt.marker }
    }

    /// Reports invalid bytes, and sends a reply if the link and the bytes allow it.
    fn malformed(&mut self, error: DecodeError, close: bool) -> Event {
        let header = self.inbox.malformed_header(self.rx.bytes());
        let answer = match self.state.config.link {
            Link::Stream => close,
            // without a reply to short datagrams, a forged sender address gains no amplification
            Link::Datagram => header.is_some(),
            Link::Serial => false,
        };
        if answer {
            self.send_code(header.map_or(0, |header| header.serial), error.hresult(), false);
        }
        self.state.closing |= close;
        Event::Malformed(error)
    }

    /// Writes a frame with a code, and EMPTY as its value if `empty`, into `tx`. It replaces the last reply.
    fn send_code(&mut self, serial: u16, code: HResult, empty: bool) {
        self.state.serials.forget_reply();
        self.tx.grow(64);
        let crc = self.state.config.link == Link::Serial;
        let frame = FrameWriter::new(self.tx.bytes_mut()).and_then(|frame| {
            let mut frame = frame.with_crc(crc);
            if empty {
                frame.argument(&())?;
            }
            frame.finish(serial, 0, code.0)
        });
        self.state.outbox = Outbox::new(frame.map_or(0, <[u8]>::len));
    }

    /// Writes the frame around the value of `len` bytes that the handler has set in `tx`.
    fn send_reply(&mut self, serial: u16, function: FunctionId, result: HResult, len: usize) {
        let kind = function.signature().map_or(Kind::Nothing, |signature| signature.result);
        if len == 0 || kind == Kind::Nothing {
            // peers expect EMPTY from a function with a result, even after an error
            return self.send_code(serial, result, !matches!(kind, Kind::Nothing | Kind::Maybe));
        }
        let total = VALUE_AT.saturating_add(len).saturating_add(self.state.tail());
        self.tx.grow(total);
        self.state.outbox = Outbox::new(total);
        let Some(frame) = self.tx.bytes_mut().get_mut(..total) else {
            return self.send_code(serial, HResult::E_TOO_MUCH_DATA, false);
        };
        let header = Header { length: to_u32(total), serial, reserved: 0, code: result.0, count: 1 };
        if let Some((head, rest)) = frame.split_first_chunk_mut::<HEADER_LEN>() {
            *head = header.to_bytes();
            if let Some(length) = rest.first_chunk_mut::<4>() {
                *length = to_u32(len).to_le_bytes();
            }
        }
        if self.state.config.link == Link::Serial {
            seal(frame);
        }
        if let Some(last) = frame.last_mut() {
            *last = EOT;
        }
    }
}

impl<T: Storage, R: Storage, const OBJECTS: usize> Endpoint for Session<T, R, OBJECTS> {
    fn transmit(&self) -> &[u8] {
        self.state.outbox.unsent(self.tx.bytes())
    }

    fn transmitted(&mut self, count: usize) {
        self.state.outbox.transmitted(count);
    }

    fn receive_buffer(&mut self) -> &mut [u8] {
        if let Some(running) = &self.state.running {
            // the handler reads its request again, so it must not move
            return self.inbox.free_after(self.rx.bytes_mut(), running.frame);
        }
        self.inbox.free(&mut self.rx)
    }

    fn received(&mut self, count: usize) {
        self.inbox.received(self.rx.bytes(), count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.state.running {
            Some(running) => Some(running.wake.min(running.until).min(running.keep_alive_at)),
            None => Some(self.state.partial_until)
                .filter(|at| *at < Instant::FAR_FUTURE && self.inbox.is_partial() && self.state.is_reading()),
        }
    }
}

impl<T: Storage, R: Storage, const OBJECTS: usize> ServerEndpoint for Session<T, R, OBJECTS> {
    fn is_running(&self) -> bool {
        self.state.running.is_some()
    }

    fn is_receiving(&self) -> bool {
        self.state.running.is_none() && self.inbox.is_partial()
    }

    fn next_request(&self) -> usize {
        if !self.state.is_reading() {
            return 0;
        }
        self.inbox.next_frame(self.rx.bytes())
    }

    fn is_finished(&self) -> bool {
        self.state.closing && !self.state.outbox.is_sending()
    }

    fn memory(&self) -> usize {
        self.tx.bytes().len().saturating_add(self.rx.bytes().len())
    }

    fn shrink(&mut self, room: usize) {
        if self.state.running.is_some() || self.state.outbox.is_sending() || self.inbox.is_partial() {
            return;
        }
        if self.state.outbox.len() > room {
            self.state.serials.forget_reply();
            self.state.outbox = Outbox::EMPTY;
        }
        // drops the frames that were read, so that the buffer is empty
        let _ = self.inbox.free(&mut self.rx);
        self.tx.shrink(room);
        self.rx.shrink(room);
    }
}

impl<H, T, R, const OBJECTS: usize> Serve<H> for Session<T, R, OBJECTS>
where
    H: Handler + ?Sized,
    T: Storage,
    R: Storage,
{
    type Event = Event;

    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Event> {
        if self.state.outbox.is_sending() {
            return None;
        }
        if self.state.running.is_some() {
            return self.resume(handler, peer, now);
        }
        if self.state.closing {
            return None;
        }
        match self.next_frame() {
            Some(Ok(frame)) => self.begin(frame, handler, peer, now),
            Some(Err(event)) => Some(event),
            None => {
                self.watch_frame(now);
                None
            }
        }
    }

    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        if self.state.running.take().is_some() {
            handler.abandoned(peer, now);
        }
        self.release_objects(handler, peer, now);
        handler.left(peer, now);
        self.state.closing = true;
        self.state.outbox.skip();
    }
}

/// Reads a handle from an argument or a reply.
fn handle_of(value: &Variant<'_>) -> Option<i32> {
    match *value {
        Variant::Ui4(n) => Some(n.cast_signed()),
        _ => value.as_i32(),
    }
}

impl State {
    const fn new(config: Config) -> Self {
        Self {
            config,
            invoke_timeout: config.invoke_timeout,
            watchdog: None,
            running: None,
            outbox: Outbox::EMPTY,
            serials: Serials::new(matches!(config.link, Link::Serial)),
            partial_until: Instant::FAR_FUTURE,
            closing: false,
        }
    }

    /// Returns whether the next frame is read: no request runs, and no reply is unsent.
    fn is_reading(&self) -> bool {
        self.running.is_none() && !self.outbox.is_sending() && !self.closing
    }

    /// Returns the number of bytes after the arguments: EOT, and the CRC on serial lines.
    const fn tail(&self) -> usize {
        if matches!(self.config.link, Link::Serial) { 3 } else { 1 }
    }

    fn set_options(&mut self, options: StartOptions) {
        self.watchdog = options.watchdog;
        self.invoke_timeout = options.invoke_timeout.unwrap_or(self.config.invoke_timeout);
    }

    fn begin(&self, frame: Located, attempt: &Attempt, now: Instant) -> RunningRequest {
        RunningRequest {
            frame,
            function: attempt.function,
            marker: attempt.marker,
            serial: attempt.serial,
            resumed: false,
            wake: now,
            until: now.saturating_add(self.invoke_timeout.min(self.config.invoke_timeout_max)),
            keep_alive_at: self.next_keep_alive(now),
        }
    }

    fn next_keep_alive(&self, now: Instant) -> Instant {
        self.watchdog.map_or(Instant::FAR_FUTURE, |interval| now.saturating_add(interval))
    }

    /// Classifies a request by its serials. A stream neither loses nor duplicates requests.
    fn judge(&self, attempt: &Attempt, now: Instant) -> Verdict {
        if !self.config.link.is_lossy() {
            return Verdict::New;
        }
        let running = self.running.map(|running| (running.marker, running.function));
        self.serials.judge(attempt, running, now)
    }
}

#[cfg(test)]
mod tests;
