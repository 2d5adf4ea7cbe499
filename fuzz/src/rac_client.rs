//! Fuzzes a RAC client: its peer, link and user perform arbitrary operations in any order.

use bcap_core::endpoint::Endpoint;
use std::collections::VecDeque;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::limits::{Limits, Strictness};
use bcap_core::rac::client::{Client, ClientError, Config, Event, Timeout};
use bcap_core::rac::{MAX_LINE, MAX_VALUE, Request, Response, Variable, VariableKind};
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_testkit::value::Value;

use crate::rac_line::split;

/// Bytes of the fixed memory; a larger value does not fit.
const ROOM: usize = 64;

/// An operation.
#[derive(Arbitrary, Debug)]
enum Op {
    Start {
        kind: u8,
        value: Option<Value>,
    },
    /// The link accepts this many bytes.
    Take(u8),
    TakeAll,
    /// A response arrives, sometimes without its end.
    Reply {
        code: i32,
        value: Option<Value>,
        cut: u8,
    },
    Line(Vec<u8>),
    Bytes(Vec<u8>),
    /// This many bytes of one line.
    Long(u16),
    Pass(u16),
    Timeout,
    Abandon,
    Reset,
}

/// The expected state of the client, derived only from the bytes on the wire.
#[derive(Default)]
struct Model {
    /// The request in flight, by the index of its variable, and its deadline.
    in_flight: Option<(u32, Instant)>,
    /// The index of the next request's variable; each request has another.
    next: u32,
    /// Completely sent lines without a reply.
    unanswered: VecDeque<u32>,
    /// Sent bytes of a partial line.
    sent: Vec<u8>,
    /// The request whose line was sent last, or is being sent.
    sent_last: Option<u32>,
    /// All received bytes, and the number of their lines that were reported.
    received: Vec<u8>,
    reported: usize,
    /// Whether a partial line had arrived when the last request was sent.
    early: bool,
    closed: bool,
}

/// Runs a client through the operations that the bytes encode; the first byte chooses its memory.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn rac_client(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let mut u = Unstructured::new(rest);
    if options & 1 == 0 {
        Run::new([0; ROOM]).run(&mut u);
    } else {
        Run::new(Vec::new()).run(&mut u);
    }
}

struct Run<V> {
    client: Client<V>,
    model: Model,
    now: Instant,
}

impl<V: Storage> Run<V> {
    fn new(value: V) -> Self {
        Self { client: Client::new(Config::TCP, value), model: Model::default(), now: Instant::from_millis(1) }
    }

    fn run(mut self, u: &mut Unstructured<'_>) {
        while let (false, Ok(op)) = (u.is_empty(), Op::arbitrary(u)) {
            match op {
                Op::Start { kind, value } => {
                    let kind = VariableKind::ALL[usize::from(kind) % VariableKind::ALL.len()];
                    self.start(kind, value.as_ref());
                }
                Op::Take(count) => self.take(usize::from(count)),
                Op::TakeAll => self.take(usize::MAX),
                Op::Reply { code, value, cut } => self.reply(code, value.as_ref(), cut),
                Op::Line(line) => self.receive(&[&line[..], b"\r"].concat()),
                Op::Bytes(bytes) => self.receive(&bytes),
                Op::Long(count) => self.receive(&vec![b'0'; usize::from(count % 1024)]),
                Op::Pass(millis) => self.pass(self.now + Duration::from_millis(u64::from(millis))),
                Op::Timeout => {
                    if let Some(deadline) = self.client.poll_timeout() {
                        self.pass(deadline.max(self.now));
                    }
                }
                Op::Abandon => {
                    self.client.abandon();
                    self.model.in_flight = None;
                }
                Op::Reset => {
                    self.client.reset();
                    self.model = Model { next: self.model.next, ..Model::default() };
                    assert!(self.client.transmit().is_empty() && !self.client.is_closed() && !self.client.is_owed());
                }
            }
            self.check();
        }
        self.finish();
    }

    fn check(&self) {
        assert_eq!(self.client.is_busy(), self.model.in_flight.is_some());
        assert_eq!(self.client.poll_timeout().is_some(), self.client.is_busy());
        assert_eq!(self.client.is_closed(), self.model.closed);
        if let Some((_, until)) = self.model.in_flight {
            assert!(self.now < until, "a request takes no longer than its timeout");
            assert!(self.client.poll_timeout() <= Some(until));
        }
        if !self.client.is_closed() {
            let owed = !self.model.unanswered.is_empty() || !self.model.sent.is_empty();
            let own = self.model.in_flight.is_some_and(|(index, _)| self.model.sent_last == Some(index));
            assert_eq!(self.client.is_owed(), owed && !own);
        }
        assert!(self.client.reply().is_none() || self.model.in_flight.is_none());
    }

    fn start(&mut self, kind: VariableKind, value: Option<&Value>) {
        let could = !self.client.is_busy() && (self.client.transmit().is_empty() || self.client.is_owed());
        let could = could && self.model.sent.is_empty();
        let variable = Variable::new(kind, self.model.next);
        let wire = value.map(Value::to_wire);
        let limits = Limits { depth: bcap_core::limits::MAX_DEPTH, ..Limits::STREAM };
        let value = wire.as_ref().map(|wire| Variant::decode(wire, &limits, Strictness::Strict).expect("canonical"));
        let request = value.map_or(Request::Get(variable), |value| Request::Put(variable, value));
        match self.client.start(&request, self.now) {
            Ok(()) => {
                assert!(could && !self.model.closed);
                assert!(
                    self.client.is_owed() || !self.has_begun(),
                    "a line that has begun to arrive cannot be its reply"
                );
                self.model.in_flight = Some((self.model.next, self.now + self.client.config().timeout));
                self.model.next += 1;
                assert!(self.client.transmit().is_empty() == self.client.is_owed(), "one request at a time");
            }
            Err(ClientError::Closed) => assert!(self.model.closed),
            Err(ClientError::Busy) => assert!(!could && !self.model.closed),
            Err(ClientError::Request(error)) => {
                assert!(could && value.is_some() && !error.to_string().is_empty());
                assert!(self.client.transmit().is_empty());
            }
            Err(ClientError::Unsolicited) => {
                assert!(could && self.has_begun() && !self.client.is_owed(), "no line has begun to arrive");
                self.model.closed = true;
            }
            Err(other) => panic!("{other}"),
        }
    }

    /// Returns the number of received bytes of a partial line.
    fn begun(&self) -> usize {
        let begun = self.model.received.rsplit(|b| *b == b'\r').next().unwrap_or_default();
        begun.iter().skip_while(|b| **b == b'\n').count()
    }

    /// Returns whether a partial line arrived that was not reported; an over-long line is reported before its end.
    fn has_begun(&self) -> bool {
        (1..MAX_LINE).contains(&self.begun())
    }

    /// Accepts bytes; they must be complete request lines in the order of their start.
    fn take(&mut self, count: usize) {
        let bytes = self.client.transmit();
        let count = count.min(bytes.len());
        if count > 0 && self.model.sent.is_empty() && !self.model.closed {
            let (index, _) = self.model.in_flight.expect("only a request in flight is sent");
            assert!(self.model.unanswered.is_empty(), "a session carries one request at a time");
            self.model.sent_last = Some(index);
        }
        self.model.sent.extend_from_slice(&bytes[..count]);
        self.client.transmitted(count);
        if let [line @ .., b'\r'] = &self.model.sent[..] {
            let mut memory = [0; MAX_VALUE];
            let request = Request::parse(line, &mut memory).expect("the client sends valid requests");
            assert!(line.len() < MAX_LINE);
            assert!(Some(request.variable().index) == self.model.sent_last || self.model.closed);
            self.model.unanswered.push_back(request.variable().index);
            self.model.sent.clear();
            self.model.early = self.has_begun();
            assert!(self.client.transmit().is_empty());
        }
    }

    /// Delivers a response; every fourth is truncated.
    fn reply(&mut self, code: i32, value: Option<&Value>, cut: u8) {
        let mut line = code.to_string().into_bytes();
        if let Some(value) = value {
            let mut buffer = [0; 2048];
            let text = VariantBuf::<8192>::new(value).ok();
            let text = text.as_ref().and_then(|value| value.as_variant().to_text(&mut buffer).ok());
            line.push(b',');
            line.extend(text.unwrap_or_default().bytes());
        }
        line.push(b'\r');
        let missing = if cut.is_multiple_of(4) { usize::from(cut).min(line.len()) } else { 0 };
        self.receive(&line[..line.len() - missing]);
    }

    fn receive(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() && !self.client.is_closed() {
            let room = self.client.receive_buffer();
            assert!(!room.is_empty(), "everything was read, but the buffer is full");
            let count = rest.len().min(room.len());
            room[..count].copy_from_slice(&rest[..count]);
            self.client.received(count);
            self.model.received.extend_from_slice(&rest[..count]);
            rest = &rest[count..];
            let lines = split(&self.model.received);
            while let Some(event) = self.client.poll_event(self.now) {
                let line = lines.get(self.model.reported).expect("each event belongs to a line");
                self.model.reported += 1;
                self.check_event(event, line.as_deref());
            }
            assert!(self.model.closed || self.model.reported == lines.len(), "each line causes an event");
        }
    }

    /// Compares an event with the received line, which belongs to the oldest request without a reply.
    fn check_event(&mut self, event: Event, line: Option<&[u8]>) {
        let Some(index) = self.model.unanswered.pop_front().filter(|_| !self.model.early) else {
            assert_eq!(event, Event::Failed(ClientError::Unsolicited));
            self.model.closed = true;
            self.model.in_flight = None;
            return;
        };
        if self.model.in_flight.is_none_or(|(in_flight, _)| in_flight != index) {
            assert_eq!(event, Event::Stale, "the reply to an earlier request");
            return;
        }
        self.model.in_flight = None;
        let mut memory = [0; MAX_VALUE];
        let response = line.map(|line| Response::parse(line, &mut memory));
        match event {
            Event::Replied(result) => {
                assert_eq!(self.client.reply(), response.expect("a line").ok());
                assert_eq!(self.client.reply().map(|reply| reply.result), Some(result));
            }
            Event::Failed(ClientError::Reply(error)) => {
                assert!(response.is_none_or(|response| response.is_err_and(|e| e == error)));
                assert!(self.client.reply().is_none());
            }
            Event::Failed(ClientError::ReplyTooLarge { limit }) => {
                assert_eq!(limit as usize, ROOM);
                let value = response.expect("a line").ok().and_then(|response| response.value);
                assert!(value.is_none_or(|value| Value::read(value).to_wire().len() > ROOM));
            }
            other => panic!("{other:?} for its own reply"),
        }
    }

    /// Moves the time to `to` and handles its timeouts.
    fn pass(&mut self, to: Instant) {
        self.now = to;
        let Some(event) = self.client.handle_timeout(self.now) else { return };
        let (index, until) = self.model.in_flight.take().expect("a request ends once");
        assert!(self.now >= until);
        let sent = self.model.sent_last == Some(index);
        let held_back = !self.model.unanswered.is_empty() && !sent;
        let timeout = if held_back { Timeout::Outstanding } else { Timeout::Reply };
        assert_eq!(event, Event::Failed(ClientError::Timeout(timeout)));
        assert!(sent || self.client.transmit().is_empty(), "an unsent request is discarded at its end");
        assert_eq!(self.client.handle_timeout(self.now), None);
    }

    /// Checks that the request ends, and that the next request gets its own reply after the outstanding replies.
    fn finish(mut self) {
        self.take(usize::MAX);
        if let Some(deadline) = self.client.poll_timeout() {
            self.pass(deadline.max(self.now));
        }
        assert!(!self.client.is_busy());
        self.take(usize::MAX);
        if self.client.is_closed() {
            return;
        }
        if self.model.early {
            return;
        }
        if !self.model.unanswered.is_empty() {
            // an over-long line was the reply to an earlier request, so its end is not a reply
            self.receive(if self.begun() < MAX_LINE { b"7\r" } else { b"\r7\r" });
        } else if self.has_begun() {
            return;
        }
        assert!(!self.client.is_owed() && !self.client.is_closed());
        self.start(VariableKind::I, None);
        self.take(usize::MAX);
        assert!(self.client.is_busy());
        self.receive(if self.begun() < MAX_LINE { b"0,3,9\r" } else { b"\r0,3,9\r" });
        assert_eq!(self.client.reply().and_then(|reply| reply.value), Some(Variant::I4(9)));
        assert!(!self.client.is_busy() && !self.client.is_closed());
        self.check();
    }
}
