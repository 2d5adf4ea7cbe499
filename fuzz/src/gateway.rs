//! Fuzzes a gateway between PLCs that send arbitrary lines and a robot that gives arbitrary answers.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::FunctionId;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::rac::{MAX_LINE, MAX_VALUE, Response, VariableKind};
use bcap_core::time::Instant;
use bcap_gateway::{Allow, Bounds, Config, Event, Gateway, Memory, Rate, Rules};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::Value;

const SLOTS: usize = 3;

/// The capacity of the gateway's handle cache.
const HANDLES: usize = 4;

/// The handle of the robot object.
const ROBOT: i32 = 1_000_000;

/// The allowed PUTs: some integers in a range, one float, short strings, positions with a figure, any output.
const PUT: [Allow<'static>; 5] = [
    Allow { values: &[Bounds { min: -100.0, max: 100.0 }], ..Allow::range(VariableKind::I, 2, 9) },
    Allow::range(VariableKind::F, 5, 5),
    Allow { values: &[Bounds { min: 0.0, max: 5.0 }], ..Allow::all(VariableKind::S) },
    Allow { values: &[Bounds { min: -500.0, max: 500.0 }], ..Allow::all(VariableKind::P) },
    Allow::all(VariableKind::Io),
];

/// An operation.
#[derive(Arbitrary, Debug)]
enum Op {
    Open,
    Close(u8),
    Line {
        slot: u8,
        put: bool,
        kind: u8,
        index: u8,
        value: Text,
    },
    Bytes {
        slot: u8,
        bytes: Vec<u8>,
    },
    /// A client's link accepts bytes.
    Take {
        slot: u8,
        count: u8,
    },
    RobotOpened,
    RobotClosed,
    /// The robot answers its call correctly.
    Obey,
    /// The robot answers several calls correctly.
    ObeyAll,
    /// The robot answers the call with this.
    Answer {
        code: i32,
        value: Option<Value>,
    },
    /// The robot answers an earlier call.
    Stray {
        behind: u8,
        code: i32,
        value: Option<Value>,
    },
    Executing,
    Garbage(Vec<u8>),
    Pass(u16),
    Timeout,
}

/// The value of a PUT.
#[derive(Arbitrary, Debug)]
enum Text {
    Int(i16),
    Float(f32),
    Letters(u8),
    Position([i16; 7]),
    Bool(bool),
    Any(Value),
    Raw(Vec<u8>),
}

impl Text {
    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Int(n) => format!("3,{n}").into_bytes(),
            Self::Float(x) => format!("4,{x:?}").into_bytes(),
            Self::Letters(count) => format!("8,{}", "x".repeat(usize::from(count % 16))).into_bytes(),
            Self::Position(numbers) => {
                let numbers: Vec<_> = numbers.iter().map(|n| (f32::from(*n) / 50.0).to_string()).collect();
                format!("8196,{}", numbers.join(",")).into_bytes()
            }
            Self::Bool(b) => format!("11,{}", -i32::from(*b)).into_bytes(),
            Self::Any(value) => {
                let wire = value.to_wire();
                let value = bcap_core::variant::Variant::decode(&wire, &Limits::STREAM, Strictness::Strict);
                let mut buffer = [0; 300];
                let text = value.ok().and_then(|value| value.to_text(&mut buffer).ok().map(str::to_owned));
                text.unwrap_or_default().into_bytes()
            }
            Self::Raw(bytes) => bytes.clone(),
        }
    }
}

/// Runs a gateway through the operations that the bytes encode.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn gateway(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let base = if options & 1 == 0 { Config::RC8 } else { Config::RC9 };
    let rate = if options & 2 == 0 { Rate::UNLIMITED } else { Rate { per_second: 5, burst: 3 } };
    let put = if options & 4 == 0 { &PUT[..] } else { &[] };
    let config = Config { rules: Rules { put, convert: options & 8 != 0, rate, ..Rules::READ_ONLY }, ..base };
    let mut memory = Memory::<SLOTS, HANDLES>::new();
    let mut run = Run {
        gateway: Gateway::new(config, &mut memory),
        plcs: Vec::new(),
        robot: Robot::default(),
        now: Instant::from_millis(1),
        read_only: put.is_empty(),
    };
    run.connect_plc();
    if options & 16 == 0 {
        run.open_robot();
        run.poll_until_idle();
        // Service_Start and Controller_Connect
        (0..2).for_each(|_| run.obey());
        assert!(run.gateway.is_up());
    }
    let mut u = Unstructured::new(rest);
    while let (false, Ok(op)) = (u.is_empty(), Op::arbitrary(&mut u)) {
        run.apply(op);
        run.poll_until_idle();
    }
    run.finish();
}

/// A client and its expected state.
struct Plc {
    peer: PeerId,
    /// Complete lines received from the client.
    lines: usize,
    /// Received bytes of a partial line.
    partial_len: usize,
    /// Sent bytes of a partial answer.
    sent: Vec<u8>,
    /// Complete answers sent to the client.
    answers: usize,
}

#[derive(Default)]
struct Robot {
    open: bool,
    /// Received bytes of a partial frame.
    received: Vec<u8>,
    /// The unanswered call.
    call: Option<TestFrame>,
    last: u16,
    /// The handles that are not released, and the names of their variables.
    handles: BTreeMap<i32, BTreeSet<String>>,
    next_handle: i32,
}

struct Run<'m> {
    gateway: Gateway<'m>,
    plcs: Vec<Plc>,
    robot: Robot,
    now: Instant,
    read_only: bool,
}

impl Run<'_> {
    fn apply(&mut self, op: Op) {
        match op {
            Op::Open => self.connect_plc(),
            Op::Close(slot) => {
                if let Some(at) = self.slot(slot) {
                    let plc = self.plcs.remove(at);
                    self.gateway.close(plc.peer);
                    assert!(self.gateway.receive_buffer(plc.peer).is_empty() && !self.gateway.is_running(plc.peer));
                }
            }
            Op::Line { slot, put, kind, index, value } => {
                let kind = VariableKind::ALL[usize::from(kind) % VariableKind::ALL.len()];
                let verb = if put { "PUT" } else { "GET" };
                let mut line = format!("{verb}:RC8:{}:{kind}:", index % 16).into_bytes();
                if put {
                    line.extend(value.bytes());
                }
                line.push(b'\r');
                self.receive(slot, &line);
            }
            Op::Bytes { slot, bytes } => self.receive(slot, &bytes),
            Op::Take { slot, count } => {
                if let Some(at) = self.slot(slot) {
                    self.take(at, usize::from(count));
                }
            }
            Op::RobotOpened => self.open_robot(),
            Op::RobotClosed if self.robot.open => self.close_robot(),
            Op::RobotClosed => {}
            Op::Obey => self.obey(),
            Op::ObeyAll => (0..4).for_each(|_| self.obey()),
            Op::Answer { code, value } => self.answer(code, value),
            Op::Stray { behind, code, value } => {
                let serial = self.robot.last.wrapping_sub(u16::from(behind) + 1);
                self.send_reply(serial, code, value);
            }
            Op::Executing => self.send_reply(self.robot.last, HResult::S_EXECUTING.0, None),
            Op::Garbage(bytes) => self.send_from_robot(&bytes),
            Op::Pass(millis) => self.now = self.now + Duration::from_millis(u64::from(millis)),
            Op::Timeout => self.now = self.gateway.poll_timeout().unwrap_or(self.now).max(self.now),
        }
    }

    fn slot(&self, slot: u8) -> Option<usize> {
        usize::from(slot).checked_rem(self.plcs.len())
    }

    fn connect_plc(&mut self) {
        let opened = self.gateway.open();
        assert_eq!(opened.is_some(), self.plcs.len() < SLOTS);
        if let Some(peer) = opened {
            assert!(self.plcs.iter().all(|plc| plc.peer != peer));
            self.plcs.push(Plc { peer, lines: 0, partial_len: 0, sent: Vec::new(), answers: 0 });
        }
    }

    /// Delivers bytes from a client; a line that does not fit is dropped and not counted.
    fn receive(&mut self, slot: u8, bytes: &[u8]) {
        let Some(at) = self.slot(slot) else { return };
        let peer = self.plcs[at].peer;
        for byte in bytes {
            let room = self.gateway.receive_buffer(peer);
            let Some(first) = room.first_mut() else { return };
            *first = *byte;
            self.gateway.received(peer, 1);
            let plc = &mut self.plcs[at];
            match byte {
                b'\r' if plc.partial_len >= MAX_LINE => plc.partial_len = 0,
                b'\r' => {
                    plc.lines += 1;
                    plc.partial_len = 0;
                }
                b'\n' if plc.partial_len == 0 => {}
                _ => {
                    plc.partial_len += 1;
                    // an over-long line is answered before its end
                    plc.lines += usize::from(plc.partial_len == MAX_LINE);
                }
            }
            self.poll_until_idle();
        }
    }

    /// Accepts bytes for a client, and counts its complete answers.
    fn take(&mut self, at: usize, count: usize) {
        let plc = &mut self.plcs[at];
        let bytes = self.gateway.transmit(plc.peer);
        let count = count.min(bytes.len());
        plc.sent.extend_from_slice(&bytes[..count]);
        self.gateway.transmitted(plc.peer, count);
        while let Some(end) = plc.sent.iter().position(|b| *b == b'\r') {
            let mut memory = [0; MAX_VALUE];
            assert!(end < MAX_LINE && Response::parse(&plc.sent[..end], &mut memory).is_ok(), "{:02x?}", plc.sent);
            plc.sent.drain(..=end);
            plc.answers += 1;
            assert!(plc.answers <= plc.lines, "an answer without a line");
        }
    }

    fn open_robot(&mut self) {
        if self.gateway.robot_wanted() && !self.robot.open {
            let next_handle = self.robot.next_handle + 1000;
            self.robot = Robot { open: true, next_handle, ..Robot::default() };
            self.gateway.robot_opened(self.now);
        }
    }

    fn close_robot(&mut self) {
        self.robot.open = false;
        self.gateway.robot_closed(self.now);
    }

    /// Polls the gateway until it has no event.
    fn poll_until_idle(&mut self) {
        for _ in 0..200 {
            let event = self.gateway.poll_event(self.now);
            self.read_robot_bytes();
            if self.robot.open && !self.gateway.robot_wanted() {
                self.close_robot();
                continue;
            }
            let Some(event) = event else { return };
            if let Event::Served { peer, request, .. } = event {
                assert!(self.plcs.iter().any(|plc| plc.peer == peer));
                assert!(self.robot.open && !request.to_string().is_empty());
            }
        }
        panic!("the gateway does not stop producing events");
    }

    /// Reads the bytes that the gateway sends to the robot.
    fn read_robot_bytes(&mut self) {
        if !self.robot.open {
            return;
        }
        let bytes = self.gateway.robot_transmit();
        self.robot.received.extend_from_slice(bytes);
        self.gateway.robot_transmitted(self.gateway.robot_transmit().len());
        let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: false };
        match oracle.decode(&self.robot.received) {
            Verdict::Frame(frame, used) => {
                assert_eq!(used, self.robot.received.len(), "one call at a time");
                self.robot.received.clear();
                self.check_call(&frame);
                if let (true, [Value::I4(handle), ..]) = (frame.code == FunctionId::VARIABLE_RELEASE.0, &frame.args[..])
                {
                    assert!(self.robot.handles.remove(handle).is_some(), "handle {handle} is released twice");
                }
                self.robot.last = frame.serial;
                self.robot.call = Some(frame);
            }
            Verdict::Incomplete => {}
            Verdict::Refused => panic!("the gateway sends an invalid frame"),
        }
    }

    /// Checks that the rules allow a call to the robot.
    fn check_call(&self, frame: &TestFrame) {
        let known = [
            FunctionId::SERVICE_START,
            FunctionId::CONTROLLER_CONNECT,
            FunctionId::CONTROLLER_GET_NAME,
            FunctionId::CONTROLLER_GET_ROBOT,
            FunctionId::ROBOT_EXECUTE,
            FunctionId::CONTROLLER_GET_VARIABLE,
            FunctionId::VARIABLE_RELEASE,
            FunctionId::VARIABLE_GET_VALUE,
            FunctionId::VARIABLE_PUT_VALUE,
        ];
        assert!(known.contains(&FunctionId(frame.code)), "{frame:?}");
        if frame.code != FunctionId::VARIABLE_PUT_VALUE.0 {
            return;
        }
        assert!(!self.read_only, "the rules allow no PUT");
        let [Value::I4(handle), value] = &frame.args[..] else { panic!("{frame:?}") };
        let names = self.robot.handles.get(handle).expect("the handle belongs to this connection");
        assert!(names.iter().any(|name| may_write(name, value)), "{names:?} := {value:?}");
    }

    /// Answers the robot's call correctly.
    fn obey(&mut self) {
        let Some(call) = self.robot.call.clone() else { return };
        match FunctionId(call.code) {
            FunctionId::CONTROLLER_CONNECT | FunctionId::CONTROLLER_GET_VARIABLE => {
                self.robot.next_handle += 1;
                self.answer(0, Some(Value::I4(self.robot.next_handle)));
            }
            FunctionId::VARIABLE_GET_VALUE => self.answer(0, Some(Value::I4(7))),
            FunctionId::CONTROLLER_GET_ROBOT => self.answer(0, Some(Value::I4(ROBOT))),
            // no stream runs
            FunctionId::ROBOT_EXECUTE => self.answer(0, Some(Value::I4(0))),
            _ => self.answer(0, None),
        }
    }

    fn answer(&mut self, code: i32, value: Option<Value>) {
        let Some(call) = self.robot.call.take() else { return };
        if code == HResult::S_EXECUTING.0 {
            self.robot.call = Some(call);
            return self.send_reply(self.robot.last, code, value);
        }
        if code == HResult::E_HANDLE.0
            && let (true, Some(Value::I4(handle))) = (call.code != FunctionId::CONTROLLER_GET_NAME.0, call.args.first())
        {
            self.robot.handles.remove(handle);
        }
        if call.code == FunctionId::CONTROLLER_GET_VARIABLE.0
            && code >= 0
            && let (Some(handle), Some(Value::Bstr(name))) = (value.as_ref().and_then(handle_of), call.args.get(1))
        {
            self.robot.handles.entry(handle).or_default().insert(String::from_utf16_lossy(name));
            assert!(self.robot.handles.len() <= HANDLES, "the gateway requests a handle before it releases one");
        }
        self.send_reply(call.serial, code, value);
    }

    fn send_reply(&mut self, serial: u16, code: i32, value: Option<Value>) {
        let args = value.into_iter().collect();
        self.send_from_robot(&TestFrame { serial, reserved: 0, code, args }.to_wire(false));
    }

    fn send_from_robot(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() && self.robot.open {
            let room = self.gateway.robot_receive_buffer();
            assert!(!room.is_empty(), "everything was read, but the buffer is full");
            let count = rest.len().min(room.len());
            room[..count].copy_from_slice(&rest[..count]);
            self.gateway.robot_received(count);
            rest = &rest[count..];
            self.poll_until_idle();
        }
    }

    /// Checks that every complete line gets an answer within its deadline.
    fn finish(mut self) {
        for _ in 0..2000 {
            (0..self.plcs.len()).for_each(|at| self.take(at, usize::MAX));
            self.poll_until_idle();
            if self.plcs.iter().all(|plc| plc.answers == plc.lines) {
                return;
            }
            let busy = self.plcs.iter().any(|plc| self.gateway.is_running(plc.peer));
            assert!(!busy || self.gateway.poll_timeout().is_some(), "a request without a deadline");
            if busy && self.plcs.iter().all(|plc| self.gateway.transmit(plc.peer).is_empty()) {
                self.now = self.gateway.poll_timeout().unwrap_or(self.now).max(self.now);
            }
        }
        panic!("a line without an answer");
    }
}

/// Returns the handle in a reply, as a client reads it.
fn handle_of(value: &Value) -> Option<i32> {
    match *value {
        Value::I2(n) => Some(n.into()),
        Value::I4(n) => Some(n),
        Value::Ui1(n) => Some(n.into()),
        Value::Ui2(n) => Some(n.into()),
        Value::Ui4(n) => Some(n as i32),
        Value::I8(n) => i32::try_from(n).ok(),
        Value::Ui8(n) => i32::try_from(n).ok(),
        _ => None,
    }
}

/// An independent implementation of the rules in [`PUT`].
fn may_write(name: &str, value: &Value) -> bool {
    let letters = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let Ok(index) = name[letters.len()..].parse::<u32>() else { return false };
    match (letters, value) {
        ("I", Value::I4(n)) => (2..=9).contains(&index) && (-100..=100).contains(n),
        ("F", Value::R4(_)) => index == 5,
        ("S", Value::Bstr(units)) => units.len() <= 5,
        ("P", Value::Array(4, items)) => {
            let inside = |item: &Value| matches!(item, Value::R4(n) if f32::from_bits(*n).abs() <= 500.0);
            items.len() == 7 && items.iter().all(inside)
        }
        ("IO", Value::Bool(_)) => true,
        _ => false,
    }
}
