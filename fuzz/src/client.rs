//! Fuzzes a client: its peer, link and user perform arbitrary operations in any order.

use bcap_core::endpoint::Endpoint;
use std::collections::VecDeque;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::bcap::client::{Client, ClientError, Config, Event, Timing};
use bcap_core::bcap::{Link, OnMalformed};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::Value;

/// The number of unanswered ranges of serials that a client stores.
const REMEMBERED: usize = 8;

/// An operation.
#[derive(Arbitrary, Debug)]
enum Op {
    Start(Value),
    /// The link accepts this many bytes.
    Take(u8),
    TakeAll,
    /// A frame arrives whose serial is this much below the last serial sent.
    Reply {
        behind: u8,
        executing: bool,
        code: i32,
        args: Vec<Value>,
        cut: u8,
    },
    /// The same, with a reply that is larger than the client's memory.
    TooLarge {
        behind: u8,
    },
    Bytes(Vec<u8>),
    Pass(u16),
    /// Time passes until the next timeout.
    Timeout,
    Abandon,
    Reset,
    /// Abandons calls before they are sent, until all but a few serials are used. Rare, because it is slow.
    SkipSerials(u8),
}

/// The expected state of the client.
struct Model {
    /// The serials of the call in flight; empty without a call.
    serials: Vec<u16>,
    /// Whether bytes of it were sent.
    sent: bool,
    first: u16,
    deadline: Instant,
    /// The serials of calls that ended without an answer, as far as the client stores them.
    unanswered: VecDeque<Vec<u16>>,
    /// Whether the arriving frame is the last for its serial, where that is known.
    is_final: Option<bool>,
    /// Whether `unanswered` is certain to equal the client's state.
    certain: bool,
    last: u16,
    /// Whether only complete frames arrived on the stream.
    clean: bool,
}

/// Runs a client through the operations that the bytes encode.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn client(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let base = [Config::TCP, Config::UDP, Config::SERIAL, Config::UDP][usize::from(options & 3)];
    let config = Config {
        strictness: if options & 4 == 0 { Strictness::Strict } else { Strictness::Lenient },
        on_malformed: if options & 8 == 0 { OnMalformed::Close } else { OnMalformed::Resync },
        timing: Timing {
            deadline: Duration::from_secs(20),
            keep_alive: Duration::from_secs(5),
            attempts: if options & 32 == 0 { 3 } else { 255 },
            ..base.timing
        },
        ..base
    };
    let mut u = Unstructured::new(rest);
    if options & 16 == 0 {
        Run::new(config, [0; 128]).run(&mut u);
    } else {
        Run::new(config, vec![0; 32]).run(&mut u);
    }
}

impl Model {
    /// Returns whether a reply to an earlier call may still arrive with this serial.
    fn is_unanswered(&self, serial: u16) -> bool {
        self.certain && self.unanswered.iter().flatten().any(|s| *s == serial)
    }
}

struct Run<R> {
    client: Client<[u8; 256], R>,
    model: Model,
    now: Instant,
}

impl<R: Storage> Run<R> {
    fn new(config: Config, rx: R) -> Self {
        let model = Model {
            serials: Vec::new(),
            sent: false,
            first: 0,
            deadline: Instant::ZERO,
            unanswered: VecDeque::new(),
            is_final: None,
            certain: true,
            last: 0,
            clean: true,
        };
        Self { client: Client::new(config, [0; 256], rx), model, now: Instant::from_millis(1) }
    }

    fn run(mut self, u: &mut Unstructured<'_>) {
        let mut skipped = false;
        while let (false, Ok(op)) = (u.is_empty(), Op::arbitrary(u)) {
            match op {
                Op::Start(value) => self.start(&value),
                Op::Take(count) => self.take(usize::from(count)),
                Op::TakeAll => self.take(usize::MAX),
                Op::Reply { behind, executing, code, args, cut } => self.reply(behind, executing, code, args, cut),
                Op::TooLarge { behind } => self.too_large(behind),
                Op::Bytes(bytes) => {
                    self.model.clean = false;
                    self.receive(&bytes);
                }
                Op::Pass(millis) => self.pass(self.now + Duration::from_millis(u64::from(millis))),
                Op::Timeout => {
                    if let Some(deadline) = self.client.poll_timeout() {
                        self.pass(deadline.max(self.now));
                    }
                }
                Op::Abandon => {
                    self.client.abandon();
                    self.ended(false);
                }
                Op::Reset => {
                    self.client.reset();
                    self.ended(false);
                    self.model.unanswered.clear();
                    (self.model.certain, self.model.clean) = (true, true);
                    assert!(self.client.transmit().is_empty() && !self.client.is_closed());
                }
                // at most once
                Op::SkipSerials(left @ 0xb0..0xb8) if !skipped => {
                    skipped = true;
                    self.skip_serials(u16::from(left) - 0xb0);
                }
                Op::SkipSerials(_) => {}
            }
            self.check();
        }
        self.finish();
    }

    fn check(&self) {
        assert_eq!(self.client.is_busy(), !self.model.serials.is_empty());
        assert_eq!(self.client.poll_timeout().is_some(), self.client.is_busy());
        assert!(!self.client.is_busy() || self.now < self.model.deadline, "a call takes no longer than its deadline");
        assert!(self.client.reply().is_none_or(|frame| frame.hresult() != HResult::S_EXECUTING));
    }

    fn start(&mut self, value: &Value) {
        let could = !self.client.is_closed() && !self.client.is_busy() && self.client.transmit().is_empty();
        let call = call::controller_execute(ControllerHandle(7), "x", value);
        match self.client.start(&call, self.client.timing(), self.now) {
            Ok(()) => {
                assert!(could);
                self.model.serials.clear();
                self.model.sent = false;
                self.model.deadline = self.now + self.client.timing().deadline;
                self.attempt();
            }
            Err(ClientError::Busy | ClientError::Closed) => assert!(!could),
            Err(ClientError::TooLarge { limit }) => assert!(could && limit == 256 && value.to_wire().len() > 100),
            Err(other) => panic!("{other}"),
        }
    }

    /// Checks that the client sends a new attempt: a complete frame with a new serial.
    fn attempt(&mut self) {
        let link = self.client.link();
        let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: link == Link::Serial };
        let Verdict::Frame(frame, used) = oracle.decode(self.client.transmit()) else {
            panic!("the client sends an invalid frame")
        };
        assert_eq!(used, self.client.transmit().len());
        assert!(used <= link.send_max());
        assert_ne!(frame.serial, 0);
        if self.model.serials.is_empty() {
            self.model.first = frame.serial;
        }
        assert_eq!(frame.reserved, if link.is_lossy() { self.model.first } else { 0 });
        assert!(!self.model.serials.contains(&frame.serial));
        assert!(!self.model.is_unanswered(frame.serial), "a late reply may still arrive with this serial");
        self.model.serials.push(frame.serial);
        self.model.last = frame.serial;
    }

    /// The link accepts bytes; a datagram as a whole.
    fn take(&mut self, count: usize) {
        let len = self.client.transmit().len();
        let count = if self.client.link() == Link::Datagram { len } else { count.min(len) };
        self.client.transmitted(count);
        self.model.sent |= count > 0;
    }

    /// Delivers a frame, on a stream without its last `cut` bytes.
    fn reply(&mut self, behind: u8, executing: bool, code: i32, args: Vec<Value>, cut: u8) {
        let serial = self.model.last.wrapping_sub(u16::from(behind));
        let code = if executing { HResult::S_EXECUTING.0 } else { code };
        let args = args.into_iter().take(2).collect();
        let wire = TestFrame { serial, reserved: 0, code, args }.to_wire(self.client.link() == Link::Serial);
        let missing = if cut.is_multiple_of(4) { usize::from(cut).min(wire.len()) } else { 0 };
        // on a serial line, a receiver searches a frame that is too long for other frames
        self.model.clean &= missing == 0 && wire.len() <= self.client.link().send_max();
        self.model.is_final = self.model.clean.then_some(code != HResult::S_EXECUTING.0);
        self.receive(&wire[..wire.len() - missing]);
        self.model.is_final = None;
    }

    fn too_large(&mut self, behind: u8) {
        let serial = self.model.last.wrapping_sub(u16::from(behind));
        let mut wire = vec![0; 600];
        crate::frame::fix_frame(&mut wire, false);
        wire[field::SERIAL].copy_from_slice(&serial.to_le_bytes());
        self.model.clean = false;
        self.receive(&wire);
    }

    fn receive(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() && !self.client.is_closed() {
            let room = self.client.receive_buffer();
            assert!(!room.is_empty(), "everything was read, but the buffer is full");
            let count = rest.len().min(room.len());
            room[..count].copy_from_slice(&rest[..count]);
            self.client.received(count);
            rest = if self.client.link() == Link::Datagram { &[] } else { &rest[count..] };
            while let Some(event) = self.client.poll_event(self.now) {
                self.check_event(event);
            }
        }
    }

    /// Compares an event with the model.
    fn check_event(&mut self, event: Event) {
        match event {
            Event::Replied(code) => {
                let frame = self.client.reply().expect("the reply is valid");
                assert!(code == frame.hresult() && code != HResult::S_EXECUTING);
                assert!(self.model.sent && self.model.serials.contains(&frame.serial), "a reply to another call");
                assert!(!self.model.is_unanswered(frame.serial), "a late reply");
                let _ = self.client.value::<call::Int>();
                let _ = self.client.value::<call::Text>();
                assert!(self.client.value::<call::Any>().is_ok());
                self.ended(true);
            }
            Event::Failed(error) => {
                assert!(!error.to_string().is_empty());
                let ends_the_session = matches!(error, ClientError::Malformed(_) | ClientError::Flooded);
                assert_eq!(self.client.is_closed(), ends_the_session);
                assert!(!self.model.serials.is_empty() || ends_the_session, "{error}");
                self.ended(matches!(error, ClientError::ReplyTooLarge { .. }));
            }
            Event::Executing => assert!(self.model.sent && !self.model.serials.is_empty()),
            Event::Retried { attempt } => {
                assert!(self.client.link().is_lossy() && attempt <= self.client.timing().attempts);
                self.attempt();
                assert_eq!(usize::from(attempt), self.model.serials.len());
            }
            // S_EXECUTING is not an answer
            Event::Stale { .. } if self.model.is_final == Some(false) => {}
            Event::Stale { serial } => {
                self.model.certain &= self.model.is_final.is_some();
                for serials in &mut self.model.unanswered {
                    if serials.len() == 1 {
                        serials.retain(|s| *s != serial);
                    }
                }
                self.model.unanswered.retain(|serials| !serials.is_empty());
            }
            Event::Malformed(error) => assert!(!error.to_string().is_empty()),
            event => panic!("the model does not know {event:?}"),
        }
    }

    /// Updates the model at the end of the call in flight, if there is one.
    fn ended(&mut self, answered: bool) {
        let serials = std::mem::take(&mut self.model.serials);
        if self.model.sent && (serials.len() > 1 || (!answered && !serials.is_empty())) {
            if self.model.unanswered.len() == REMEMBERED {
                self.model.unanswered.pop_front();
            }
            self.model.unanswered.push_back(serials);
        }
    }

    /// Moves the time to `to` and handles its timeouts.
    fn pass(&mut self, to: Instant) {
        self.now = to;
        for _ in 0..4 {
            match self.client.handle_timeout(self.now) {
                Some(event) => self.check_event(event),
                None => return,
            }
        }
        panic!("the timeouts of one instant do not end");
    }

    fn skip_serials(&mut self, left: u16) {
        for _ in left..u16::MAX {
            if self.client.start(&call::service_stop(), self.client.timing(), self.now).is_err() {
                return;
            }
            let serial = field::serial(self.client.transmit()).unwrap_or(0);
            assert!(serial != 0 && !self.model.is_unanswered(serial));
            self.model.last = serial;
            self.client.abandon();
        }
    }

    /// Checks that the call ends, and that the next call gets its reply if the stream is still valid.
    fn finish(mut self) {
        for _ in 0..600 {
            let Some(deadline) = self.client.poll_timeout() else { break };
            self.take(usize::MAX);
            self.pass(deadline.max(self.now));
            self.check();
        }
        assert!(!self.client.is_busy());
        self.take(usize::MAX);
        if self.client.is_closed() {
            return;
        }
        self.start(&Value::I4(1));
        assert!(self.client.is_busy());
        self.take(usize::MAX);
        if self.model.clean || self.client.link() == Link::Datagram {
            self.reply(0, false, 5, vec![Value::Ui1(9)], 1);
            assert!(!self.client.is_busy());
        }
    }
}
