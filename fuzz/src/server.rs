//! Fuzzes a server's session: its peer, link and handler perform arbitrary operations in any order.

use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::server::{Config, Event, Handler, Request, Session};
use bcap_core::bcap::{FunctionId, Kind, Link, Object, OnMalformed};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::Value;

const PEER: PeerId = PeerId(3);
const OBJECTS: usize = 5;
/// The initial memory in each direction of a session that can grow.
const ROOM: usize = 64;

/// An operation.
#[derive(Arbitrary, Debug)]
enum Op {
    /// A request arrives; most of its handles are valid.
    Call {
        function: u8,
        retry: u8,
        values: Vec<Value>,
        wrong_handle: bool,
        cut: u8,
    },
    Start(Options),
    Bytes(Vec<u8>),
    /// The link accepts this many bytes.
    Take(u8),
    Pass(u16),
    Timeout,
    /// Polls the handler, as after a change by another client; in every other run, releases memory before.
    Poll,
}

/// Options of Service_Start.
#[derive(Arbitrary, Debug)]
enum Options {
    None,
    Watchdog(u16),
    InvokeTimeout(u16),
    Text(String),
}

/// The handler's result for a call.
#[derive(Arbitrary, Clone, Debug)]
enum Plan {
    Succeed,
    Answer(Value),
    Refuse(i32),
    Wait(u16),
    /// Requests to be polled at a time in the past.
    WaitForPast,
    /// Answers with a value that is far too large.
    Flood,
}

/// The application, with the expected state of the session.
struct Application {
    plans: Vec<Plan>,
    next_plan: usize,
    open: Vec<(Object, i32)>,
    next_handle: i32,
    /// The function of the waiting request.
    waiting: Option<FunctionId>,
    left: u32,
    /// On datagrams, by first serial and function: the last received call, and the last started call.
    current: Option<(u16, FunctionId)>,
    begun: Option<(u16, FunctionId)>,
    /// Whether the reply to the last call was replaced by one to an invalid datagram.
    is_replaced: bool,
}

/// Runs a session through the operations that the bytes encode.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn server(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let base = [Config::TCP, Config::UDP, Config::SERIAL, Config::TCP][usize::from(options & 3)];
    let config = Config {
        strictness: if options & 4 == 0 { Strictness::Strict } else { Strictness::Lenient },
        on_malformed: if options & 8 == 0 { OnMalformed::Close } else { OnMalformed::Resync },
        invoke_timeout: Duration::from_secs(2),
        ..base
    };
    let mut u = Unstructured::new(rest);
    let plans = (0..8).map_while(|_| u.arbitrary().ok()).collect();
    if options & 16 == 0 {
        Run::new(config, [0; 128], [0; 128], plans).run(&mut u);
    } else {
        let mut run = Run::new(config, vec![0; ROOM], vec![0; ROOM], plans);
        run.shrinks = options & 32 != 0;
        run.run(&mut u);
    }
}

impl Handler for Application {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        assert_eq!(peer, PEER);
        self.check(request);
        let function = request.function;
        if let Some(object) = function.releases() {
            let handle = if object == Object::Service { 0 } else { request.handle() };
            let before = self.open.len();
            self.open.retain(|open| *open != (object, handle));
            assert!(self.open.len() < before || object == Object::Service);
            self.waiting = None;
            return HResult::S_OK.into();
        }
        assert!(self.waiting.is_none());
        if self.current.is_some() {
            // without a session no call is a copy, unless its reply can be sent again
            let may_repeat = self.is_replaced && !self.open.contains(&(Object::Service, 0));
            assert!(
                self.begun != self.current || function == FunctionId::SERVICE_START || may_repeat,
                "a retransmission was executed"
            );
            (self.begun, self.is_replaced) = (self.current, false);
        }
        self.carry_out(function, reply, now)
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        assert_eq!(peer, PEER);
        self.check(request);
        assert_eq!(self.waiting, Some(request.function));
        self.carry_out(request.function, reply, now)
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        assert!(self.waiting.take().is_some());
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        assert!(self.open.is_empty() && self.waiting.is_none());
        self.left += 1;
    }
}

impl Application {
    fn check(&self, request: &Request<'_>) {
        let signature = request.function.signature().expect("only known functions are called");
        let (given, taken) = (request.args.len(), signature.arguments.len());
        assert!(given == taken || (request.function == FunctionId::SERVICE_START && given < taken));
        for (value, kind) in request.args.iter().zip(signature.arguments) {
            assert!(kind.accepts(&value));
        }
        if let Some(Kind::Handle(object)) = signature.arguments.first() {
            assert!(self.open.contains(&(*object, request.handle())), "handle {} was not issued", request.handle());
        }
    }

    fn carry_out(&mut self, function: FunctionId, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let plan = self.plans.get(self.next_plan).cloned().unwrap_or(Plan::Succeed);
        self.next_plan = (self.next_plan + 1) % self.plans.len().max(1);
        self.waiting = None;
        match (plan, function.opens()) {
            (Plan::Wait(millis), _) => {
                self.waiting = Some(function);
                Outcome::Wait(now + Duration::from_millis(u64::from(millis)))
            }
            (Plan::WaitForPast, _) => {
                self.waiting = Some(function);
                Outcome::Wait(Instant::ZERO)
            }
            (Plan::Refuse(code), _) => HResult((code | i32::MIN).wrapping_add(1) | i32::MIN).into(),
            (_, Some(Object::Service)) => {
                if !self.open.contains(&(Object::Service, 0)) {
                    self.open.push((Object::Service, 0));
                }
                HResult::S_OK.into()
            }
            (_, Some(object)) => {
                self.next_handle += 1;
                reply.set(&self.next_handle).expect("a handle fits");
                self.open.push((object, self.next_handle));
                HResult::S_OK.into()
            }
            (Plan::Answer(value), None) => {
                let _ = reply.set(&value);
                HResult(function.0).into()
            }
            (Plan::Flood, None) => {
                let _ = reply.set(&[7.0_f64; 3000]);
                HResult::S_OK.into()
            }
            (Plan::Succeed, None) => HResult::S_OK.into(),
        }
    }
}

struct Run<T> {
    session: Session<T, T, OBJECTS>,
    application: Application,
    link: Link,
    now: Instant,
    serial: u16,
    /// The last request, which may be retransmitted.
    last: Option<TestFrame>,
    /// Serials of requests that may be answered.
    requested: Vec<u16>,
    /// Whether only complete frames arrived; otherwise a reply may have any serial.
    clean: bool,
    /// Whether noise that does not begin a frame is skipped.
    skips_noise: bool,
    /// Whether the session will decode the next complete frame: no received byte may begin another frame.
    synchronized: bool,
    /// The running request, by first serial and function, where that is certain.
    running: Option<(u16, FunctionId)>,
    /// Sent bytes of a partial frame.
    sent: Vec<u8>,
    /// Whether [`Op::Poll`] releases memory.
    shrinks: bool,
}

impl<T: Storage> Run<T> {
    fn new(config: Config, tx: T, rx: T, plans: Vec<Plan>) -> Self {
        let application = Application {
            plans,
            next_plan: 0,
            open: Vec::new(),
            next_handle: 100,
            waiting: None,
            left: 0,
            current: None,
            begun: None,
            is_replaced: false,
        };
        Self {
            session: Session::new(config, tx, rx),
            application,
            link: config.link,
            now: Instant::from_millis(1),
            serial: 0,
            last: None,
            requested: Vec::new(),
            clean: true,
            skips_noise: config.on_malformed == OnMalformed::Resync,
            synchronized: true,
            running: None,
            sent: Vec::new(),
            shrinks: false,
        }
    }

    fn run(mut self, u: &mut Unstructured<'_>) {
        while let (false, Ok(op)) = (u.is_empty(), Op::arbitrary(u)) {
            match op {
                Op::Call { function, retry, values, wrong_handle, cut } => {
                    self.request(FunctionId(i32::from(function % 140)), retry, values, wrong_handle, cut);
                }
                Op::Start(options) => {
                    let text = match options {
                        Options::None => String::new(),
                        Options::Watchdog(millis) => format!("WDT={millis}"),
                        Options::InvokeTimeout(millis) => format!("x, InvokeTimeout = <{millis}>"),
                        Options::Text(text) => text,
                    };
                    let value = Value::text(&text);
                    self.request(FunctionId::SERVICE_START, 0, vec![value], false, 1);
                }
                Op::Bytes(bytes) => {
                    self.clean = false;
                    self.synchronized &= self.skips_noise && (self.link == Link::Datagram || !bytes.contains(&1));
                    self.receive(&bytes, None);
                }
                Op::Take(count) => self.take(usize::from(count)),
                Op::Pass(millis) => self.now = self.now + Duration::from_millis(u64::from(millis)),
                Op::Timeout => self.now = self.session.poll_timeout().unwrap_or(self.now).max(self.now),
                Op::Poll if self.shrinks => self.shrink(),
                Op::Poll => {}
            }
            self.serve();
        }
        self.finish();
    }

    /// Generates and delivers a request. Every eighth is a retransmission, every eighth is truncated, and every eighth
    /// follows noise on the line.
    fn request(&mut self, function: FunctionId, retry: u8, values: Vec<Value>, wrong_handle: bool, cut: u8) {
        let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
        let mut values = values.into_iter();
        let args: Vec<_> = kinds.iter().map(|kind| self.argument(*kind, wrong_handle, values.next())).collect();
        self.serial = self.serial.wrapping_add(1).max(1);
        let frame = match &self.last {
            Some(last) if retry % 8 == 7 => TestFrame { serial: self.serial, ..last.clone() },
            _ => TestFrame { serial: self.serial, reserved: self.serial, code: function.0, args },
        };
        let (first, function) = (frame.reserved, FunctionId(frame.code));
        self.last = Some(frame.clone());
        let mut wire = frame.to_wire(self.link == Link::Serial);
        if cut.is_multiple_of(8) {
            self.clean = false;
            wire.truncate(wire.len().saturating_sub(usize::from(cut)));
            self.synchronized &= cut == 0 || self.link == Link::Datagram;
        }
        // on a serial line, a receiver searches a frame that is too long for other frames
        let fits = wire.len() <= self.link.send_max();
        self.clean &= fits;
        self.synchronized &= fits || self.link == Link::Datagram;
        self.requested.push(self.serial);
        if cut % 8 == 7 && self.link == Link::Serial {
            self.clean = false;
            self.synchronized &= self.skips_noise;
            wire.insert(0, 0xff);
        }
        let certain = self.synchronized && fits && self.session.transmit().is_empty() && self.room(wire.len());
        let (was_running, complete) = (self.session.is_running(), !cut.is_multiple_of(8) || cut == 0);
        self.receive(&wire, Some((first, function)));
        if self.link.is_lossy() && certain && complete {
            if was_running && self.running == Some((first, function)) {
                self.expect_executing();
            } else if !was_running && self.session.is_running() {
                self.running = Some((first, function));
            }
        }
    }

    /// Returns whether `count` bytes together fit into the receive buffer.
    fn room(&mut self, count: usize) -> bool {
        count <= self.session.receive_buffer().len()
    }

    /// Checks that a retransmission of the running request is immediately answered with S_EXECUTING, even after noise.
    fn expect_executing(&self) {
        let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: self.link == Link::Serial };
        let Verdict::Frame(frame, _) = oracle.decode(self.session.transmit()) else {
            panic!("the retransmission was not answered")
        };
        assert_eq!((frame.serial, frame.code), (self.serial, HResult::S_EXECUTING.0));
    }

    fn argument(&self, kind: Kind, wrong_handle: bool, value: Option<Value>) -> Value {
        match (kind, value) {
            (Kind::Handle(object), _) if !wrong_handle => {
                let newest = self.application.open.iter().rev().find(|open| open.0 == object);
                Value::I4(newest.map_or(0, |open| open.1))
            }
            (Kind::Handle(_), _) => Value::I4(101),
            (_, Some(value)) => value,
            (Kind::Int, None) => Value::I4(1),
            (Kind::Float, None) => Value::R4(0),
            (_, None) => Value::text("x"),
        }
    }

    /// Delivers bytes. Bytes that do not fit are dropped on datagrams and wait on a stream.
    fn receive(&mut self, bytes: &[u8], call: Option<(u16, FunctionId)>) {
        let mut rest = bytes;
        for _ in 0..1000 {
            if rest.is_empty() || self.session.is_finished() {
                return;
            }
            let room = self.session.receive_buffer();
            let count = rest.len().min(room.len());
            if self.link == Link::Datagram && count < rest.len() {
                return;
            }
            if count == 0 {
                // the session does not read while a request runs or a reply is unsent
                assert!(
                    self.session.is_running() || !self.session.transmit().is_empty(),
                    "the buffer is full for no other reason"
                );
                self.take(usize::MAX);
                // a handler that waits for a past time is polled every millisecond, so the time must advance here
                let deadline = self.session.poll_timeout().unwrap_or(self.now).max(self.now);
                self.now = deadline + Duration::from_secs(1);
                self.serve();
                continue;
            }
            room[..count].copy_from_slice(&rest[..count]);
            self.session.received(count);
            if self.link == Link::Datagram {
                if !self.session.is_running() {
                    self.take(usize::MAX);
                    self.application.current = call;
                }
                self.serve();
                return;
            }
            rest = &rest[count..];
            self.serve();
        }
        panic!("the receive buffer stays full");
    }

    /// Runs the session until it makes no progress.
    fn serve(&mut self) {
        for _ in 0..2000 {
            let was_running = self.session.is_running();
            let event = self.session.run(&mut self.application, PEER, self.now);
            match event {
                Some(Event::Malformed(error)) => {
                    assert!(!error.to_string().is_empty());
                    self.application.is_replaced = true;
                }
                Some(Event::Repeated { .. } | Event::KeptAlive) => assert!(was_running || self.link.is_lossy()),
                Some(Event::Served { function, .. }) => {
                    assert!(!self.session.transmit().is_empty(), "the send buffer has room for a result code");
                    // a frame that is too long
                    self.application.is_replaced |= function == FunctionId(0);
                }
                _ => {}
            }
            assert_eq!(self.session.is_running(), self.application.waiting.is_some());
            // on a serial line it may wait for the rest of a frame
            let waits = self.link == Link::Serial && self.session.is_receiving();
            assert!(waits || self.session.poll_timeout().is_some() == self.session.is_running());
            assert_eq!(self.session.open_objects(), self.application.open.len());
            self.running = self.running.filter(|_| self.session.is_running());
            if event.is_none() {
                if self.session.transmit().is_empty() {
                    let deadline = self.session.poll_timeout();
                    assert!(
                        deadline.is_none_or(|deadline| deadline > self.now),
                        "a deadline in the past was not handled"
                    );
                }
                return;
            }
        }
        panic!("the session does not stop making progress");
    }

    /// Releases memory; unsent bytes, received bytes and the running request must not change.
    fn shrink(&mut self) {
        let (sending, partial) = (self.session.transmit().to_vec(), self.session.is_receiving());
        self.session.shrink(ROOM);
        assert_eq!((self.session.transmit(), self.session.is_receiving()), (&sending[..], partial));
        if sending.is_empty() && !partial && !self.session.is_running() {
            assert_eq!(self.session.memory(), 2 * ROOM);
        }
    }

    fn take(&mut self, count: usize) {
        let len = self.session.transmit().len();
        let count = if self.link == Link::Datagram { len } else { count.min(len) };
        self.sent.extend_from_slice(&self.session.transmit()[..count]);
        self.session.transmitted(count);
        let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: self.link == Link::Serial };
        match oracle.decode(&self.sent) {
            Verdict::Frame(frame, used) => {
                assert_eq!(used, self.sent.len(), "one frame at a time");
                assert!(frame.reserved == 0 && frame.args.len() <= 1 && used <= self.link.send_max());
                assert!(
                    !self.clean || self.requested.contains(&frame.serial),
                    "no request has the serial {}",
                    frame.serial
                );
                self.sent.clear();
            }
            Verdict::Incomplete => assert!(self.link != Link::Datagram || self.sent.is_empty()),
            Verdict::Refused => panic!("the session sends an invalid frame: {:02x?}", self.sent),
        }
    }

    /// Checks that the running request ends within its deadline, and that no object remains open.
    fn finish(mut self) {
        for _ in 0..4000 {
            self.take(usize::MAX);
            let Some(deadline) = self.session.poll_timeout() else { break };
            self.now = deadline.max(self.now);
            self.serve();
            self.now = self.now + Duration::from_millis(50);
        }
        self.session.close(&mut self.application, PEER, self.now);
        assert_eq!((self.application.left, self.session.open_objects()), (1, 0));
        assert!(self.session.is_finished() && !self.session.is_running());
        assert!(self.session.run(&mut self.application, PEER, self.now).is_none());
    }
}
