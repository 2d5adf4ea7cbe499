//! Runs steps against the device, and judges its reactions.

use std::collections::HashSet;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_core::limits::UDP_SEND_MAX;

use super::Error;
use super::channel::{Channel, Protocol};
use super::finding::{Finding, Kind};
use super::gate::{Gate, TAIL, call_reads};
use super::session::Session;
use crate::frame::{TestFrame, field};
use crate::judge::{self, Fault, TCP};
use crate::oracle::Verdict;
use crate::restart::Restarter;
use crate::step::{Argument, Call, Delivery, Step};
use crate::value::Value;
use crate::wire::{Link, Received, Recorder};

/// The maximum duration of a call with keep-alives, in time limits.
const KEPT_ALIVE: u32 = 10;
/// The number of retries for a refused object, because the device may still be releasing other objects.
const AGAIN: u32 = 4;
/// The wait before each of these attempts.
const RELEASING: Duration = Duration::from_millis(150);
/// The number of times that a datagram is sent before its reply counts as missing.
const ATTEMPTS: u32 = 5;
/// The time limit of a reply to an invalid datagram; a device may drop the datagram.
const DROPPED: Duration = Duration::from_millis(10);
/// The time between two checks for the end of the run.
const LOOK: Duration = Duration::from_millis(200);
/// The wait before a refused connection is tried again.
const SLOT: Duration = Duration::from_millis(20);
/// The wait between the parts of a split frame.
const SPLIT: Duration = Duration::from_millis(1);

/// The device, and the limits of its traffic.
pub struct Device<'a> {
    bcap: Vec<SocketAddr>,
    link: Link,
    rac: Option<Vec<SocketAddr>>,
    /// The packets that it may get.
    pub gate: Gate,
    /// The time limit of a reply.
    pub timeout: Duration,
    /// The time during which a refused connection is retried.
    pub reconnect: Duration,
    /// The minimum time between two packets.
    pub interval: Duration,
    /// Starts the device again.
    pub restarter: Option<Restarter>,
    next: Instant,
    packets: u64,
    is_ended: &'a dyn Fn() -> bool,
}

impl fmt::Debug for Device<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Device").field("bcap", &self.bcap).field("link", &self.link).finish_non_exhaustive()
    }
}

/// The next action of a run.
enum Next {
    Continue,
    /// The connection ended as expected.
    End,
    Found(Finding),
}

/// A run of steps.
struct Run<'a, 'd> {
    device: &'a mut Device<'d>,
    recorder: Option<&'a dyn Recorder>,
    wire: Option<Channel>,
    rac: Option<Channel>,
    session: Session,
    /// Calls that are written together with the next call.
    joined: Vec<TestFrame>,
    /// The last bytes that were sent on the connection, or that will be sent with the next call.
    tail: Vec<u8>,
    /// Openings that succeeded.
    opened: HashSet<String>,
    /// The last reply.
    last: Option<TestFrame>,
}

impl<'d> Device<'d> {
    /// Creates a device with the addresses of one port of b-CAP. The run ends when `is_ended` returns true.
    pub fn new(
        bcap: Vec<SocketAddr>,
        link: Link,
        gate: Gate,
        timeout: Duration,
        is_ended: &'d dyn Fn() -> bool,
    ) -> Self {
        let (reconnect, interval) = (Duration::ZERO, Duration::ZERO);
        let (next, packets) = (Instant::now(), 0);
        let (rac, restarter) = (None, None);
        Self { bcap, link, rac, gate, timeout, reconnect, interval, restarter, next, packets, is_ended }
    }

    /// Fuzzes RAC too.
    ///
    /// # Errors
    ///
    /// When the port accepts no connection.
    pub fn with_rac(&mut self, addresses: Vec<SocketAddr>) -> io::Result<()> {
        Channel::connect(&addresses, Protocol::Rac, self.timeout, None)?;
        self.rac = Some(addresses);
        Ok(())
    }

    /// Returns the number of packets until now.
    #[must_use]
    pub const fn packets(&self) -> u64 {
        self.packets
    }

    /// Returns whether packets are datagrams.
    #[must_use]
    pub const fn is_datagrams(&self) -> bool {
        matches!(self.link, Link::Udp)
    }

    pub(super) const fn has_rac(&self) -> bool {
        self.rac.is_some()
    }

    /// Returns whether the caller has ended the run.
    pub(super) fn is_ended(&self) -> bool {
        (self.is_ended)()
    }

    /// Waits; ends when the run does.
    pub(super) fn sleep(&self, time: Duration) -> Result<(), Error> {
        let until = Instant::now() + time;
        loop {
            if (self.is_ended)() {
                return Err(Error::Ended);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(());
            }
            std::thread::sleep(left.min(LOOK));
        }
    }

    /// Runs steps on a new connection, and then checks whether a new client is served.
    ///
    /// # Errors
    ///
    /// When the run is ended.
    pub fn run(&mut self, steps: &[Step], recorder: Option<&dyn Recorder>) -> Result<Option<Finding>, Error> {
        let mut run = Run {
            device: self,
            recorder,
            wire: None,
            rac: None,
            session: Session::default(),
            joined: Vec::new(),
            tail: Vec::new(),
            opened: HashSet::new(),
            last: None,
        };
        let found = run.steps(steps)?;
        let Run { wire, rac, .. } = run;
        let is_closed =
            [wire, rac].into_iter().flatten().fold(false, |is_closed, wire| wire.close(&self.gate) | is_closed);
        let found = found.or_else(|| is_closed.then(closed_port));
        // a fault seen by every later client outranks one on this connection
        Ok(self.probe(recorder)?.or(found))
    }

    /// Checks whether a new client is served.
    ///
    /// # Errors
    ///
    /// When the run is ended.
    pub fn probe(&mut self, recorder: Option<&dyn Recorder>) -> Result<Option<Finding>, Error> {
        let until = Instant::now() + self.reconnect;
        loop {
            let found = self.probe_once(recorder)?;
            if found.as_ref().is_none_or(|found| !matches!(found.kind, Kind::Crash | Kind::Leak))
                || Instant::now() >= until
            {
                return Ok(found);
            }
            self.sleep(SLOT)?;
        }
    }

    fn probe_once(&mut self, recorder: Option<&dyn Recorder>) -> Result<Option<Finding>, Error> {
        const SUBJECT: &str = "a new client";
        let mut wire = match self.connect(recorder) {
            Ok(wire) => wire,
            Err(error) => return Ok(Some(Finding::new(Kind::Crash, SUBJECT, format!("cannot connect: {error}")))),
        };
        let text = Argument::Value(Value::text(""));
        let mut session = Session::default();
        for (function, arguments) in [(FunctionId::SERVICE_START, vec![text]), (FunctionId::SERVICE_STOP, vec![])] {
            let frame = session.frame(&Call::new(function, arguments));
            self.pace()?;
            wire.send(&frame.to_wire(false));
            let found = match self.await_reply(&mut wire, &mut session, &frame, true)? {
                Ok(reply) if HResult(reply.code).is_err() => {
                    Finding::new(Kind::Leak, SUBJECT, format!("{function} is refused with {}", HResult(reply.code)))
                }
                Ok(_) => continue,
                Err(finding) => match finding.kind {
                    Kind::Reset => Finding::new(Kind::Crash, SUBJECT, "the device closes the connection"),
                    kind => Finding::new(kind, SUBJECT, finding.detail),
                },
            };
            return Ok(Some(found));
        }
        wire.close(&self.gate);
        if let Some(addresses) = &self.rac
            && let Err(error) = Channel::connect(addresses, Protocol::Rac, self.timeout, recorder)
        {
            return Ok(Some(Finding::new(Kind::Crash, SUBJECT, format!("cannot connect to RAC: {error}"))));
        }
        Ok(None)
    }

    fn connect(&self, recorder: Option<&dyn Recorder>) -> io::Result<Channel> {
        Channel::connect(&self.bcap, Protocol::Bcap(self.link), self.timeout, recorder)
    }

    /// Waits until the next packet may be sent; ends on a signal.
    fn pace(&mut self) -> Result<(), Error> {
        self.packets += 1;
        let now = Instant::now();
        self.sleep(self.next.saturating_duration_since(now))?;
        self.next = self.next.max(now) + self.interval;
        Ok(())
    }

    /// Waits for the reply to a request. Over UDP a call that only reads is repeated while no reply arrives.
    ///
    /// A device may drop an unusual datagram, so the wait for its reply is short.
    fn await_reply(
        &self,
        wire: &mut Channel,
        session: &mut Session,
        request: &TestFrame,
        is_usual: bool,
    ) -> Result<Result<TestFrame, Finding>, Error> {
        let found = |kind, detail: String| Ok(Err(Finding::of_function(kind, request.code, detail)));
        let (limit, longest) = (self.timeout, self.timeout.saturating_mul(KEPT_ALIVE));
        // a lost datagram is not a fault of the device, but a device that is only slow must not move or write twice
        let (mut left, wait) = match (wire.is_datagrams(), is_usual) {
            (true, true) if call_reads(request) => (ATTEMPTS - 1, limit / ATTEMPTS),
            (true, false) => (0, DROPPED.saturating_mul(ATTEMPTS)),
            _ => (0, limit),
        };
        let mut attempts = vec![request.clone()];
        let began = Instant::now();
        let mut until = began + wait;
        loop {
            if (self.is_ended)() {
                return Err(Error::Ended);
            }
            let rest = until.saturating_duration_since(Instant::now());
            match wire.receive(if wire.is_datagrams() { rest.min(LOOK) } else { rest }) {
                Received::Silence if wire.is_datagrams() && Instant::now() < until => {}
                Received::Closed if wire.is_datagrams() => return Ok(Err(closed_port())),
                Received::Closed => {
                    return found(Kind::Reset, "the device closes the connection after a valid frame".into());
                }
                Received::Silence if left > 0 => {
                    left -= 1;
                    until = Instant::now() + wait;
                    let reserved = if request.reserved == 0 { request.serial } else { request.reserved };
                    let again = TestFrame { serial: session.next_serial(), reserved, ..request.clone() };
                    let bytes = again.to_wire(false);
                    if self.gate.has_joint(wire.tail(), &bytes) {
                        wire.send(&bytes);
                        attempts.push(again);
                    }
                }
                Received::Silence => return found(Kind::Hang, format!("no reply within {} ms", limit.as_millis())),
                Received::Packet(bytes) => {
                    let serial = field::serial(&bytes);
                    let attempt = attempts.iter().find(|attempt| Some(attempt.serial) == serial).unwrap_or(request);
                    match judge::reply(attempt, &bytes) {
                        // to a datagram before
                        Err(Fault::Serial(_, late)) if wire.takes_reply(late, is_executing(&bytes)) => {}
                        Err(fault) => return found(Kind::WrongReply, fault.to_string()),
                        Ok(reply) if HResult(reply.code) != HResult::S_EXECUTING => {
                            wire.takes_reply(reply.serial, false);
                            return Ok(Ok(TestFrame { serial: request.serial, ..reply }));
                        }
                        Ok(_) if began.elapsed() > longest => {
                            return found(Kind::Hang, format!("S_EXECUTING for {} ms", longest.as_millis()));
                        }
                        // the device has the call, so it is not sent again
                        Ok(_) => (left, until) = (0, Instant::now() + limit),
                    }
                }
            }
        }
    }
}

impl Run<'_, '_> {
    fn steps(&mut self, steps: &[Step]) -> Result<Option<Finding>, Error> {
        for (place, step) in steps.iter().enumerate() {
            let next = match step {
                Step::Call(call) => {
                    // the last call cannot wait for a further call
                    let is_joined = !self.device.is_datagrams()
                        && call.delivery == Delivery::Joined
                        && matches!(steps.get(place + 1), Some(Step::Call(_)));
                    self.call(call, is_joined)?
                }
                Step::Bytes(bytes) => self.bytes(bytes)?,
                Step::Line(lines) => self.retried(|run| &mut run.rac, |run| run.lines(lines))?,
                Step::Reconnect => {
                    // the probe after the session also detects a closed port
                    let _ = self.wire.take().map(|wire| wire.close(&self.device.gate));
                    (self.session, self.joined, self.tail) = (Session::default(), Vec::new(), Vec::new());
                    Next::Continue
                }
            };
            match next {
                Next::Continue => {}
                Next::End => return Ok(None),
                Next::Found(finding) => return Ok(Some(finding)),
            }
        }
        Ok(None)
    }

    /// Returns the connection for b-CAP, which is opened when it is first used.
    fn wire(&mut self) -> Result<Channel, Finding> {
        if let Some(wire) = self.wire.take() {
            return Ok(wire);
        }
        self.device
            .connect(self.recorder)
            .map_err(|error| Finding::new(Kind::Crash, "a new client", format!("cannot connect: {error}")))
    }

    /// Returns whether the bytes may follow those sent before, and records that they do.
    fn follows(&mut self, bytes: &[u8]) -> bool {
        if let Some(wire) = self.wire.as_ref().filter(|wire| wire.is_datagrams()) {
            // retransmissions too
            self.tail = wire.tail().to_vec();
        }
        let is_allowed = self.device.gate.has_joint(&self.tail, bytes);
        if is_allowed {
            self.tail.extend_from_slice(bytes);
            self.tail.drain(..self.tail.len().saturating_sub(TAIL));
        }
        is_allowed
    }

    fn call(&mut self, call: &Call, is_joined: bool) -> Result<Next, Error> {
        let frame = self.session.frame(call);
        // a joined call may release the handle or reassign it to another variable
        let is_blind = !self.joined.is_empty() && frame.code == FunctionId::VARIABLE_PUT_VALUE.0;
        if is_blind
            || !self.device.gate.has_call(&frame, self.session.variable(&frame))
            || !self.follows(&frame.to_wire(false))
        {
            return Ok(Next::Continue);
        }
        if is_joined {
            self.joined.push(frame);
            return Ok(Next::Continue);
        }
        let mut frames = std::mem::take(&mut self.joined);
        frames.push(frame);
        self.retried(|run| &mut run.wire, |run| run.exchange(call, &frames))
    }

    /// Sends again while the device has no slot for a new connection.
    fn retried(
        &mut self,
        wire: fn(&mut Self) -> &mut Option<Channel>,
        mut send: impl FnMut(&mut Self) -> Result<Next, Error>,
    ) -> Result<Next, Error> {
        let until = Instant::now() + self.device.reconnect;
        loop {
            let is_new = wire(self).is_none();
            let next = send(self)?;
            let is_refused = is_new
                && wire(self).as_ref().is_none_or(|wire| !wire.has_received())
                && matches!(&next, Next::Found(found) if matches!(found.kind, Kind::Reset | Kind::Crash));
            if !is_refused || Instant::now() >= until {
                return Ok(next);
            }
            *wire(self) = None;
            self.device.sleep(SLOT)?;
        }
    }

    /// Sends frames together, and awaits their replies.
    fn exchange(&mut self, call: &Call, frames: &[TestFrame]) -> Result<Next, Error> {
        let mut wire = match self.wire() {
            Ok(wire) => wire,
            Err(finding) => return Ok(Next::Found(finding)),
        };
        self.device.pace()?;
        let bytes = frames.iter().flat_map(|frame| frame.to_wire(false)).collect::<Vec<_>>();
        match call.delivery {
            Delivery::Split(count)
                if usize::from(count) < bytes.len()
                    && self.may_split(&wire, bytes.get(..usize::from(count)).unwrap_or_default(), &bytes) =>
            {
                let (first, rest) = bytes.split_at(usize::from(count));
                wire.send(first);
                // otherwise the operating system would send one segment
                std::thread::sleep(SPLIT);
                wire.send(if wire.is_datagrams() { &bytes } else { rest });
            }
            _ => wire.send(&bytes),
        }
        // a device may mistake an unusual serial number for an old call's serial, and may not receive a long datagram
        let is_usual = call.serial.is_none() && !call.is_retry && bytes.len() <= UDP_SEND_MAX;
        let mut next = Next::Continue;
        for frame in frames {
            next = self.reply(&mut wire, frame, is_usual)?;
            if matches!(next, Next::Continue) && wire.is_datagrams() && is_usual && call.delivery == Delivery::Again {
                next = self.retransmit(&mut wire, frame)?;
            }
            if !matches!(next, Next::Continue) {
                break;
            }
        }
        if wire.is_datagrams() && !is_usual {
            next = match next {
                Next::Found(finding) if finding.kind != Kind::Hang => Next::Found(finding),
                _ => Next::End,
            };
        }
        self.wire = Some(wire);
        Ok(next)
    }

    /// Returns whether the beginning of a frame may be sent first. Over UDP the whole frame follows, and a device may join both.
    fn may_split(&self, wire: &Channel, first: &[u8], whole: &[u8]) -> bool {
        let tail = [wire.tail(), first].concat();
        !wire.is_datagrams()
            || (self.device.gate.has_joint(wire.tail(), first) && self.device.gate.has_joint(&tail, whole))
    }

    /// Sends a call again as a retransmission: with the next serial number, and the first attempt's serial in the reserved
    /// field. The device must not execute it, but send its reply again.
    fn retransmit(&mut self, wire: &mut Channel, request: &TestFrame) -> Result<Next, Error> {
        let Some(first) = self.last.take().filter(|_| request.reserved == 0) else { return Ok(Next::Continue) };
        let copy = TestFrame { serial: self.session.next_serial(), reserved: request.serial, ..request.clone() };
        let bytes = copy.to_wire(false);
        if !self.device.gate.has_joint(wire.tail(), &bytes) {
            return Ok(Next::Continue);
        }
        self.device.pace()?;
        wire.send(&bytes);
        let again = match self.device.await_reply(wire, &mut self.session, &copy, true)? {
            Ok(reply) => reply,
            Err(finding) => return Ok(Next::Found(finding)),
        };
        if (first.code, &first.args) == (again.code, &again.args) {
            return Ok(Next::Continue);
        }
        let shown = |reply: &TestFrame| format!("{} {:?}", HResult(reply.code), reply.args);
        let detail = format!("a call is answered with {}, its retransmission with {}", shown(&first), shown(&again));
        Ok(Next::Found(Finding::of_function(Kind::WrongReply, request.code, detail)))
    }

    fn reply(&mut self, wire: &mut Channel, request: &TestFrame, is_usual: bool) -> Result<Next, Error> {
        let mut again = AGAIN;
        let (first, mut request) = (request.serial, request.clone());
        loop {
            let reply = match self.device.await_reply(wire, &mut self.session, &request, is_usual)? {
                Ok(reply) => reply,
                Err(finding) if finding.kind == Kind::Reset && self.session.is_stopped => return Ok(Next::End),
                Err(finding) => return Ok(Next::Found(finding)),
            };
            let opening = self.session.opening(&request);
            match opening {
                Some(opening) if HResult(reply.code).is_ok() => drop(self.opened.insert(opening)),
                Some(opening) if self.opened.contains(&opening) => {
                    if again == 0 {
                        let detail = format!("refused with {}, but succeeded before", HResult(reply.code));
                        return Ok(Next::Found(Finding::of_function(Kind::Leak, request.code, detail)));
                    }
                    again -= 1;
                    if wire.is_datagrams() {
                        // a new call, because a copy would only get the same reply
                        request.serial = self.session.next_serial();
                    }
                    let bytes = request.to_wire(false);
                    let is_allowed = match wire.is_datagrams() {
                        true => self.device.gate.has_joint(wire.tail(), &bytes),
                        false => self.follows(&bytes),
                    };
                    if !is_allowed {
                        return Ok(Next::End);
                    }
                    self.device.sleep(RELEASING)?;
                    self.device.pace()?;
                    wire.send(&bytes);
                    continue;
                }
                _ => {}
            }
            let found = self.session.replied(&request, &reply);
            // a call with another serial number is not retransmitted
            self.last = (request.serial == first).then_some(reply);
            return Ok(found.map_or(Next::Continue, Next::Found));
        }
    }

    /// Sends hostile bytes, which end the connection.
    fn bytes(&mut self, bytes: &[u8]) -> Result<Next, Error> {
        const SUBJECT: &str = "bytes";
        // joined calls that no call followed were not sent, so the end of the sent bytes is unknown
        if !self.joined.is_empty() || !self.device.gate.has_bytes(bytes) || !self.follows(bytes) {
            return Ok(Next::End);
        }
        let mut wire = match self.wire() {
            Ok(wire) => wire,
            Err(finding) => return Ok(Next::Found(finding)),
        };
        self.device.pace()?;
        wire.send(bytes);
        let next = match TCP.decode(bytes) {
            // an odd frame may still be valid
            Verdict::Frame(frame, length) if length == bytes.len() && !wire.is_datagrams() => {
                match self.reply(&mut wire, &frame, true)? {
                    Next::Continue => Next::End,
                    next => next,
                }
            }
            _ if wire.is_datagrams() => match wire.receive(DROPPED) {
                Received::Packet(reply) if !is_frame(&reply) => {
                    Next::Found(Finding::new(Kind::WrongReply, SUBJECT, "the reply is malformed"))
                }
                Received::Closed => Next::Found(closed_port()),
                Received::Packet(_) | Received::Silence => Next::End,
            },
            Verdict::Refused if is_complete(bytes) => match wire.receive(self.device.timeout) {
                Received::Silence => {
                    let limit = self.device.timeout.as_millis();
                    let detail =
                        format!("neither a reply to an invalid frame nor the end of the connection within {limit} ms");
                    Next::Found(Finding::new(Kind::Hang, SUBJECT, detail))
                }
                Received::Packet(reply) if !is_frame(&reply) => {
                    Next::Found(Finding::new(Kind::WrongReply, SUBJECT, "the reply is malformed"))
                }
                Received::Packet(_) | Received::Closed => Next::End,
            },
            _ if wire.is_stuck() => Next::Found(Finding::new(Kind::Hang, SUBJECT, "the device takes no more bytes")),
            _ => Next::End,
        };
        Ok(if wire.close(&self.device.gate) { Next::Found(closed_port()) } else { next })
    }

    /// Sends lines of RAC.
    fn lines(&mut self, lines: &[u8]) -> Result<Next, Error> {
        const SUBJECT: &str = "RAC";
        let Some(addresses) = self.device.rac.as_deref().filter(|_| self.device.gate.has_lines(lines)) else {
            return Ok(Next::Continue);
        };
        let mut wire = match self.rac.take() {
            Some(wire) => wire,
            None => match Channel::connect(addresses, Protocol::Rac, self.device.timeout, self.recorder) {
                Ok(wire) => wire,
                Err(error) => {
                    return Ok(Next::Found(Finding::new(Kind::Crash, SUBJECT, format!("cannot connect: {error}"))));
                }
            },
        };
        self.device.pace()?;
        wire.send(lines);
        let found = |kind, detail: String| Ok(Next::Found(Finding::new(kind, SUBJECT, detail)));
        // bytes after the last CR are not a line
        let end = lines.iter().rposition(|byte| *byte == b'\r').unwrap_or(0);
        let lines = || lines.get(..end).unwrap_or_default().split(|byte| *byte == b'\r');
        if lines().any(|line| line.trim_ascii().is_empty()) {
            // whether a blank line is answered is not specified, so later responses could not be distinguished
            wire.close(&self.device.gate);
            return Ok(Next::Continue);
        }
        for line in lines() {
            let is_valid = line.len() < bcap_core::rac::MAX_LINE && line.is_ascii();
            match wire.receive(self.device.timeout) {
                // a server may cut off a client that sends no text or too much of it
                Received::Closed if !is_valid => return Ok(Next::Continue),
                Received::Closed => {
                    self.rac = Some(wire);
                    return found(Kind::Reset, "the device closes the connection after a line".into());
                }
                Received::Silence => {
                    return found(Kind::Hang, format!("no response within {} ms", self.device.timeout.as_millis()));
                }
                Received::Packet(response) => {
                    let response = response.strip_suffix(b"\r").unwrap_or(&response);
                    if let Err(fault) = judge::response(line, response) {
                        return found(Kind::WrongReply, fault.to_string());
                    }
                }
            }
        }
        self.rac = Some(wire);
        Ok(Next::Continue)
    }
}

/// A finding over UDP: the machine of the device reports that no program has the port.
fn closed_port() -> Finding {
    Finding::new(Kind::Crash, "UDP", "the device has closed its port")
}

/// Returns whether there are at least as many bytes as the length field says, so that a server waits for no more.
fn is_complete(bytes: &[u8]) -> bool {
    bytes.first() == Some(&1)
        && field::length(bytes)
            .is_some_and(|length| length >= 16 && usize::try_from(length).is_ok_and(|length| length <= bytes.len()))
}

fn is_executing(bytes: &[u8]) -> bool {
    matches!(TCP.decode(bytes), Verdict::Frame(frame, _) if HResult(frame.code) == HResult::S_EXECUTING)
}

fn is_frame(bytes: &[u8]) -> bool {
    TCP.decode_packet(bytes).is_some()
}
