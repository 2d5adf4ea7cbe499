//! A gateway between PLCs and a scripted robot, under a simulated clock.
#![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]
extern crate std;

use core::time::Duration;
use std::boxed::Box;
use std::collections::{BTreeMap, VecDeque};
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use super::*;
use crate::{Allow, Rate, Rules};
use bcap_core::bcap::{Decoder, Frame, FrameWriter, Progress};
use bcap_core::rac::VariableKind;
use bcap_core::variant::VariantBuf;

type Owned = VariantBuf<1024>;

const ROBOT_HANDLE: i32 = 78;

/// The question before each PUT.
const MODE: &str = "RobotExecute(I4(78), \"slvGetMode\", EMPTY)";

fn at(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

/// The reaction of the robot to a call.
enum Do {
    Reply(HResult, Option<Box<Owned>>),
    /// Replies S_EXECUTING only.
    Execute,
    Nothing,
}

/// Replies with a value.
fn ok(value: &dyn Encode) -> Do {
    Do::Reply(HResult::S_OK, Some(Box::new(Owned::new(value).unwrap())))
}

/// A robot that follows the protocol, except for scripted reactions.
#[derive(Default)]
struct Robot {
    received: Vec<u8>,
    /// Calls as `Function(arguments)`.
    calls: Vec<String>,
    /// Handles of this connection.
    handles: BTreeMap<i32, String>,
    next_handle: i32,
    values: BTreeMap<String, Owned>,
    /// The answer to slvGetMode.
    mode: i32,
    /// Scripted reactions to the next calls, instead of the normal ones.
    script: VecDeque<(FunctionId, Do)>,
    /// The serials of calls without a reply, and the replies they would get.
    unanswered: Vec<(u16, Vec<u8>)>,
}

impl Robot {
    fn set(&mut self, name: &str, value: &dyn Encode) {
        self.values.insert(name.to_string(), Owned::new(value).unwrap());
    }

    fn value(&self, name: &str) -> Variant<'_> {
        self.values[name].as_variant()
    }

    fn script(&mut self, function: FunctionId, what: Do) {
        self.script.push_back((function, what));
    }

    /// Drops the connection and its handles.
    fn reset(&mut self) {
        self.received.clear();
        self.handles.clear();
        self.unanswered.clear();
        // a handle of another connection is never valid by chance
        self.next_handle += 1000;
    }

    /// Receives bytes, and returns the bytes that it sends.
    fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.received.extend_from_slice(bytes);
        let received = core::mem::take(&mut self.received);
        let Progress::Complete(frame, used) = Decoder::TCP.decode(&received).unwrap() else {
            self.received = received;
            return Vec::new();
        };
        assert_eq!(used, received.len(), "one call at a time");
        let arguments: Vec<String> = frame.args.iter().map(|value| format!("{value:?}")).collect();
        self.calls.push(format!("{:?}({})", frame.function(), arguments.join(", ")));
        let what = match self.script.front() {
            Some((function, _)) if *function == frame.function() => self.script.pop_front().unwrap().1,
            _ => self.usual(&frame),
        };
        match what {
            Do::Reply(code, value) => reply(frame.serial, code, value.as_deref()),
            Do::Execute => {
                self.hold(&frame);
                reply(frame.serial, HResult::S_EXECUTING, None)
            }
            Do::Nothing => {
                self.hold(&frame);
                Vec::new()
            }
        }
    }

    /// Executes a call, and keeps the reply.
    fn hold(&mut self, frame: &Frame<'_>) {
        let late = match self.usual(frame) {
            Do::Reply(code, value) => reply(frame.serial, code, value.as_deref()),
            _ => Vec::new(),
        };
        self.unanswered.push((frame.serial, late));
    }

    fn usual(&mut self, frame: &Frame<'_>) -> Do {
        let argument = |at| frame.args.get(at).unwrap();
        let handle = frame.args.get(0).and_then(|value| value.as_i32());
        let named = handle.and_then(|handle| self.handles.get(&handle)).cloned();
        match (frame.function(), named) {
            (FunctionId::CONTROLLER_CONNECT, _) => ok(&77_i32),
            (FunctionId::CONTROLLER_GET_NAME, _) => ok(&"RC8"),
            (FunctionId::CONTROLLER_GET_ROBOT, _) => ok(&ROBOT_HANDLE),
            (FunctionId::ROBOT_EXECUTE, _) => {
                assert_eq!(handle, Some(ROBOT_HANDLE));
                assert_eq!(argument(1).as_bstr().unwrap().to_string(), "slvGetMode");
                ok(&self.mode)
            }
            (FunctionId::CONTROLLER_GET_VARIABLE, _) => {
                assert_eq!(handle, Some(77));
                self.next_handle += 1;
                self.handles.insert(self.next_handle, argument(1).as_bstr().unwrap().to_string());
                ok(&self.next_handle)
            }
            (FunctionId::SERVICE_START, _) => Do::Reply(HResult::S_OK, None),
            (_, None) => Do::Reply(HResult::E_HANDLE, None),
            (FunctionId::VARIABLE_RELEASE, Some(_)) => {
                self.handles.remove(&handle.unwrap());
                Do::Reply(HResult::S_OK, None)
            }
            (FunctionId::VARIABLE_GET_VALUE, Some(name)) => match self.values.get(&name) {
                Some(value) => Do::Reply(HResult::S_OK, Some(Box::new(value.clone()))),
                None => Do::Reply(HResult::DISP_E_BADINDEX, Some(Box::default())),
            },
            (FunctionId::VARIABLE_PUT_VALUE, Some(name)) => {
                self.set(&name, &argument(1));
                Do::Reply(HResult::S_OK, None)
            }
            (function, _) => panic!("{function:?}"),
        }
    }

    /// Takes the recorded calls.
    fn calls(&mut self) -> Vec<String> {
        core::mem::take(&mut self.calls)
    }
}

fn reply(serial: u16, code: HResult, value: Option<&Owned>) -> Vec<u8> {
    let mut buffer = [0; 2048];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    if let Some(value) = value {
        frame.argument(value).unwrap();
    }
    frame.finish(serial, 0, code.0).unwrap().to_vec()
}

/// A gateway, its robot, and the time.
struct Bench<'c> {
    gateway: Gateway<'c>,
    robot: Robot,
    now: Instant,
}

impl<'c> Bench<'c> {
    /// A gateway with S slots and H handles, whose memory lasts as long as the process.
    fn new<const S: usize, const H: usize>(config: Config<'c>) -> Self {
        let memory = Box::leak(Box::new(Memory::<S, H>::new()));
        Self { gateway: Gateway::new(config, memory), robot: Robot::default(), now: at(0) }
    }

    /// The same with a session.
    fn up<const S: usize, const H: usize>(config: Config<'c>) -> Self {
        let mut bench = Self::new::<S, H>(config);
        assert_eq!(bench.connect(), [Event::RobotUp]);
        bench.robot.calls();
        bench
    }

    /// The same with a session and a client.
    fn with_client<const S: usize, const H: usize>(config: Config<'c>) -> (Self, PeerId) {
        let mut bench = Self::up::<S, H>(config);
        let plc = bench.gateway.open().unwrap();
        (bench, plc)
    }

    fn connect(&mut self) -> Vec<Event> {
        assert!(self.gateway.robot_wanted());
        self.robot.reset();
        self.gateway.robot_opened(self.now);
        self.settle()
    }

    /// Polls the gateway, and checks that it skips no step when it is settled.
    fn events(&mut self) -> Vec<Event> {
        let events: Vec<_> = core::iter::from_fn(|| self.gateway.poll_event(self.now)).collect();
        let settled = (self.gateway.settled, self.gateway.poll_timeout(), self.gateway.robot_transmit().to_vec());
        self.gateway.settled = Instant::ZERO;
        assert_eq!(self.gateway.poll_event(self.now), None, "a settled gateway had an event");
        let again = (self.gateway.settled, self.gateway.poll_timeout(), self.gateway.robot_transmit().to_vec());
        assert_eq!(settled, again, "a settled gateway had a step to do");
        events
    }

    /// Moves bytes to the robot and back until none are left.
    fn settle(&mut self) -> Vec<Event> {
        let mut events = self.events();
        while !self.gateway.robot_transmit().is_empty() {
            let bytes = self.gateway.robot_transmit().to_vec();
            self.gateway.robot_transmitted(bytes.len());
            let reply = self.robot.receive(&bytes);
            events.extend(self.deliver(&reply));
        }
        events
    }

    /// Delivers bytes of the robot.
    fn deliver(&mut self, mut bytes: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        while !bytes.is_empty() {
            let room = self.gateway.robot_receive_buffer();
            let count = room.len().min(bytes.len());
            assert!(count > 0, "no room");
            room[..count].copy_from_slice(&bytes[..count]);
            self.gateway.robot_received(count);
            bytes = &bytes[count..];
            events.extend(self.events());
        }
        events
    }

    /// Delivers the delayed replies of the robot.
    fn answer_late(&mut self) -> Vec<Event> {
        let (_, late) = self.robot.unanswered.remove(0);
        let mut events = self.deliver(&late);
        events.extend(self.settle());
        events
    }

    /// Delivers other replies to the calls that have none.
    fn answer(&mut self, code: HResult, value: Option<&dyn Encode>) -> Vec<Event> {
        let (serial, _) = self.robot.unanswered.remove(0);
        let value = value.map(|value| Owned::new(value).unwrap());
        let mut events = self.deliver(&reply(serial, code, value.as_ref()));
        events.extend(self.settle());
        events
    }

    /// Delivers bytes of a PLC; bytes that do not fit wait until the line before them is answered.
    fn send(&mut self, plc: PeerId, line: &str) {
        let room = self.gateway.receive_buffer(plc);
        room[..line.len()].copy_from_slice(line.as_bytes());
        self.gateway.received(plc, line.len());
    }

    /// Takes the bytes for a PLC.
    fn take(&mut self, plc: PeerId) -> String {
        let text = String::from_utf8(self.gateway.transmit(plc).to_vec()).unwrap();
        self.gateway.transmitted(plc, text.len());
        text
    }

    /// Sends a line and returns its reply.
    fn ask(&mut self, plc: PeerId, line: &str) -> String {
        self.send(plc, line);
        self.settle();
        self.take(plc)
    }

    /// Advances the clock in one step.
    fn sleep(&mut self, millis: u64) -> Vec<Event> {
        self.now = self.now + Duration::from_millis(millis);
        self.settle()
    }
}

fn line(result: HResult) -> String {
    format!("{}\r", result.0)
}

fn asked(verb: bcap_core::rac::Verb, kind: VariableKind, index: u32) -> Asked {
    Asked { verb, variable: Variable::new(kind, index) }
}

fn get_i(index: u32) -> Asked {
    asked(bcap_core::rac::Verb::Get, VariableKind::I, index)
}

const WRITABLE: Config<'static> =
    Config { rules: Rules { put: &Allow::EVERYTHING, ..Rules::READ_ONLY }, ..Config::RC8 };

#[test]
fn a_session_begins_as_configured_and_reads_with_one_handle() {
    let config = Config { name: "plc", machine: "10.0.0.1", option: "@IfNotMember", ..Config::RC9 };
    let mut bench = Bench::new::<2, 4>(config);
    assert_eq!(bench.connect(), [Event::RobotUp]);
    assert!(bench.gateway.is_up());
    assert_eq!(
        bench.robot.calls(),
        [
            "ServiceStart(\"WDT=400\")",
            "ControllerConnect(\"plc\", \"CaoProv.DENSO.VRC9\", \"10.0.0.1\", \"@IfNotMember\")",
            "ControllerGetRobot(I4(77), \"Arm\", \"\")",
        ]
    );
    let plc = bench.gateway.open().unwrap();
    bench.robot.set("I10", &-5_i32);
    assert_eq!(bench.ask(plc, "GET:RC8:10:I:\r"), "0,3,-5\r");
    assert_eq!(bench.ask(plc, "GET:RC8:10:I:\r"), "0,3,-5\r");
    assert_eq!(
        bench.robot.calls(),
        ["ControllerGetVariable(I4(77), \"I10\", \"\")", "VariableGetValue(I4(1001))", "VariableGetValue(I4(1001))"]
    );
}

#[test]
fn a_settled_gateway_waits_for_its_deadline_or_for_bytes() {
    let (mut bench, plc) = Bench::with_client::<1, 4>(Config::RC8);
    bench.robot.set("I1", &7_i32);
    assert_eq!(bench.events(), []);
    let heartbeat = bench.now + Config::RC8.heartbeat;
    assert_eq!((bench.gateway.settled, bench.gateway.poll_timeout()), (heartbeat, Some(heartbeat)));

    bench.send(plc, "GET:RC8:1:I:\r");
    assert_eq!(bench.gateway.settled, Instant::ZERO, "bytes of a client");
    assert_eq!(bench.settle().len(), 1);
    assert!(bench.gateway.settled > bench.now);
    assert_eq!(bench.take(plc), "0,3,7\r");
    assert!(bench.gateway.settled > bench.now, "no further line has arrived");

    bench.send(plc, "GET:RC8:1:I:\rGET:");
    assert_eq!(bench.settle().len(), 1);
    assert_eq!(bench.take(plc), "0,3,7\r");
    assert_eq!(bench.gateway.settled, Instant::ZERO, "a part of the next line has arrived");

    assert_eq!(bench.events(), []);
    bench.gateway.robot_closed(bench.now);
    assert_eq!(bench.gateway.settled, Instant::ZERO, "the end of the connection");
}

#[test]
fn all_kinds_are_read_and_written() {
    let (mut bench, plc) = Bench::with_client::<1, 4>(WRITABLE);
    for (part, name, value) in [
        ("4294967295:I", "I4294967295", "3,-5"),
        ("2:F", "F2", "4,1.5"),
        ("3:D", "D3", "5,0.1"),
        ("4:S", "S4", "8,hello, world"),
        ("5:V", "V5", "8196,1,2,3"),
        ("6:P", "P6", "8196,400,0,300.5,180,0,180,5"),
        ("7:J", "J7", "8196,1,2,3,4,5,6,7,8"),
        ("8:T", "T8", "8196,1,2,3,4,5,6,7,8,9,-1"),
        ("4294967295:IO", "IO4294967295", "11,-1"),
    ] {
        assert_eq!(bench.ask(plc, &format!("PUT:RC8:{part}:{value}\r")), "0\r", "{part}");
        assert!(bench.robot.values.contains_key(name));
        assert_eq!(bench.ask(plc, &format!("GET:RC8:{part}:\r")), format!("0,{value}\r"));
    }
    assert_eq!(bench.gateway.counters().served.count(), 18);
    assert_eq!(bench.gateway.counters().failed.count(), 0);
}

#[test]
fn values_are_converted_if_that_is_lossless() {
    let config = Config { rules: Rules { convert: true, ..WRITABLE.rules }, ..WRITABLE };
    let (mut bench, plc) = Bench::with_client::<1, 8>(config);
    assert_eq!(bench.ask(plc, "PUT:RC8:1:F:3,5\r"), "0\r");
    assert_eq!(bench.robot.value("F1"), Variant::R4(5.0));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:V:8197,1,2.5,3\r"), "0\r");
    assert!(VariableKind::V.fits(&bench.robot.value("V1")));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:F:5,0.1\r"), line(HResult::E_INVALIDARGTYPE));
    // from the robot: an array of R8, the type of system variables
    bench.robot.set("P1", &[1.0_f64, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0]);
    assert_eq!(bench.ask(plc, "GET:RC8:1:P:\r"), "0,8196,1,2,3,4,5,6,-1\r");
    bench.robot.set("F1", &0.1_f64);
    assert_eq!(bench.ask(plc, "GET:RC8:1:F:\r"), "0,5,0.1\r", "what would change goes as it is");
    bench.robot.set("I1", &());
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,0,\r");
}

#[test]
fn another_type_is_refused_by_default_without_a_call() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(WRITABLE);
    assert_eq!(bench.ask(plc, "PUT:RC8:1:F:3,5\r"), line(HResult::E_INVALIDARGTYPE));
    assert_eq!(bench.robot.calls(), Vec::<String>::new());
}

#[test]
fn refusals_are_reported_with_their_line_and_the_session_continues() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(Config::RC8);
    bench.robot.set("I1", &1_i32);
    let long = format!("GET:RC8:1:I:{}\r", " ".repeat(300));
    for (text, result) in [
        ("PUT:RC8:1:I:3,5\r", HResult::E_ACCESSDENIED),
        ("HELLO\r", HResult::E_INVALIDCOMMAND),
        ("GET:RC9:1:I:\r", HResult::E_INVALIDCOMMAND),
        ("GET:RC8:x:I:\r", HResult::E_INVALIDARG),
        ("PUT:RC8:1:I:3,x\r", HResult::E_INVALIDARGTYPE),
        (long.as_str(), HResult::E_PACKETSIZEOVER),
    ] {
        // in pieces: a line may be longer than the memory
        let mut events = Vec::new();
        let mut lines = Vec::new();
        for piece in text.as_bytes().chunks(32) {
            bench.send(plc, core::str::from_utf8(piece).unwrap());
            while let Some(event) = bench.gateway.poll_event(bench.now) {
                events.push(event);
                lines.push(bench.gateway.line(plc).to_vec());
            }
        }
        let [Event::Refused { peer, refusal }] = events[..] else { panic!("{text}: {events:?}") };
        assert_eq!((peer, refusal.hresult()), (plc, result), "{text}");
        assert_eq!(lines, [&text.as_bytes()[..(text.len() - 1).min(256)]]);
        assert_eq!(bench.take(plc), line(result));
        assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,1\r");
    }
    let counters = bench.gateway.counters();
    assert_eq!((counters.refused, counters.served.count(), counters.failed.count()), (6, 6, 0));
}

#[test]
fn results_of_the_robot_are_passed_on() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(WRITABLE);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), line(HResult::DISP_E_BADINDEX));
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Reply(HResult::E_CAO_OBJECT_NOTFOUND, None));
    bench.send(plc, "GET:RC8:2:I:\r");
    let failed =
        Event::Failed { peer: plc, request: get_i(2), result: HResult::E_CAO_OBJECT_NOTFOUND, time: Duration::ZERO };
    assert_eq!(bench.settle(), [failed]);
    assert_eq!(bench.take(plc), line(HResult::E_CAO_OBJECT_NOTFOUND));
    bench.robot.script(FunctionId::VARIABLE_PUT_VALUE, Do::Reply(HResult::from_u32(0x8150_1033), None));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), line(HResult::from_u32(0x8150_1033)));
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Reply(HResult::S_FALSE, None));
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "1,0,\r", "another success passes too");
    assert_eq!(bench.gateway.counters().failed.count(), 3);
}

#[test]
fn the_least_recently_used_handle_is_released() {
    let (mut bench, plc) = Bench::with_client::<1, 2>(Config::RC8);
    for index in 1..=3 {
        bench.robot.set(&format!("I{index}"), &index);
    }
    for index in [1, 2, 1, 3] {
        assert_eq!(bench.ask(plc, &format!("GET:RC8:{index}:I:\r")), format!("0,3,{index}\r"));
    }
    assert_eq!(bench.robot.handles.values().collect::<Vec<_>>(), ["I1", "I3"]);
    let released = "VariableRelease(I4(1002))".to_string();
    assert_eq!(bench.robot.calls().iter().filter(|call| call.contains("Release")).collect::<Vec<_>>(), [&released]);
    // a handle that cannot be released is removed nevertheless
    bench.robot.script(FunctionId::VARIABLE_RELEASE, Do::Reply(HResult::E_FAIL, None));
    assert_eq!(bench.ask(plc, "GET:RC8:2:I:\r"), "0,3,2\r");
}

#[test]
fn an_invalid_handle_is_replaced_once() {
    let (mut bench, plc) = Bench::with_client::<1, 2>(WRITABLE);
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,1\r"), "0\r");
    bench.robot.handles.clear();
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,2\r"), "0\r");
    assert_eq!(bench.robot.value("I1"), Variant::I4(2));
    bench.robot.calls();
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Reply(HResult::E_HANDLE, None));
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Reply(HResult::E_HANDLE, None));
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), line(HResult::E_HANDLE));
    assert_eq!(bench.robot.calls().len(), 3);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,2\r");
}

/// Over UDP a session can end without a sign, such as by a restart of the robot between two heartbeats.
#[test]
fn a_session_that_the_robot_no_longer_knows_is_replaced() {
    for code in [HResult::E_HANDLE, HResult::E_NOT_CONNECTED] {
        let down = |function| Event::RobotDown {
            error: RobotError::Refused { function, result: code },
            pause: Duration::from_millis(500),
        };
        let (mut bench, plc) = Bench::with_client::<1, 4>(Config::RC8);
        bench.robot.set("I1", &11_i32);
        assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,11\r");
        bench.robot.handles.clear();
        bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Reply(code, None));
        bench.send(plc, "GET:RC8:1:I:\r");
        let failed =
            Event::Failed { peer: plc, request: get_i(1), result: HResult::E_NOT_CONNECTED, time: Duration::ZERO };
        assert_eq!(bench.settle(), [down(FunctionId::CONTROLLER_GET_VARIABLE), failed]);
        assert_eq!(bench.take(plc), line(HResult::E_NOT_CONNECTED));
        bench.gateway.robot_closed(bench.now);
        assert_eq!(bench.sleep(500), []);
        assert_eq!(bench.connect(), [Event::RobotUp]);
        assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,11\r");
        // without a request, the heartbeat detects it
        for (mode, function) in [
            (HResult::E_HANDLE, FunctionId::CONTROLLER_GET_ROBOT),
            (HResult::E_NO_LICENSE, FunctionId::CONTROLLER_GET_NAME),
        ] {
            let mut bench = Bench::up::<1, 4>(Config::RC8);
            bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Reply(mode, None));
            bench.robot.script(function, Do::Reply(code, None));
            let mut events = bench.sleep(2000);
            events.extend(bench.sleep(2000));
            assert_eq!(events, [down(function)], "{function}");
        }
    }
}

#[test]
fn without_a_robot_the_reply_is_immediate() {
    let mut bench = Bench::new::<2, 2>(WRITABLE);
    let plc = bench.gateway.open().unwrap();
    let not_connected = line(HResult::E_NOT_CONNECTED);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), not_connected);
    // the connection could not be opened
    bench.gateway.robot_closed(bench.now);
    let down = |pause| Event::RobotDown { error: RobotError::Closed, pause: Duration::from_millis(pause) };
    assert_eq!(bench.events(), [down(500)]);
    assert!(!bench.gateway.robot_wanted());
    assert_eq!(bench.gateway.poll_timeout(), Some(at(500)));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,1\r"), not_connected);
    bench.now = at(500);
    assert_eq!(bench.events(), []);
    assert!(bench.gateway.robot_wanted());
    // even while a session starts
    bench.robot.script(FunctionId::CONTROLLER_CONNECT, Do::Nothing);
    assert_eq!(bench.connect(), []);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), not_connected);
    assert_eq!(bench.answer(HResult::S_OK, Some(&77_i32)), [Event::RobotUp]);
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,1\r"), "0\r");
    assert_eq!(bench.gateway.counters().failed.count(), 3);
}

#[test]
fn pauses_double_while_the_robot_refuses_and_a_session_resets_them() {
    let mut bench = Bench::new::<1, 2>(Config::RC8);
    let refused = |function, pause| {
        let error = RobotError::Refused { function, result: HResult::E_CAO_PROV_INVALID };
        Event::RobotDown { error, pause: Duration::from_millis(pause) }
    };
    for (function, pause) in [
        (FunctionId::SERVICE_START, 500),
        (FunctionId::CONTROLLER_CONNECT, 1000),
        (FunctionId::CONTROLLER_CONNECT, 2000),
    ] {
        bench.robot.script(function, Do::Reply(HResult::E_CAO_PROV_INVALID, None));
        assert_eq!(bench.connect(), [refused(function, pause)]);
        assert!(!bench.gateway.robot_wanted(), "it is to be closed");
        assert_eq!(bench.sleep(60_000), [], "and nothing happens before it is");
        assert!(!bench.gateway.robot_wanted());
        bench.gateway.robot_closed(bench.now);
        assert_eq!(bench.sleep(pause - 1), []);
        assert!(!bench.gateway.robot_wanted());
        assert_eq!(bench.sleep(1), []);
    }
    assert_eq!(bench.connect(), [Event::RobotUp]);
    bench.gateway.robot_closed(bench.now);
    let down = Event::RobotDown { error: RobotError::Closed, pause: Duration::from_millis(500) };
    assert_eq!(bench.events(), [down]);
    assert_eq!(bench.gateway.counters().connected, 1);
}

#[test]
fn when_the_robot_disconnects_every_request_is_answered_and_handles_are_removed() {
    let mut bench = Bench::up::<3, 4>(WRITABLE);
    let plcs = [(); 3].map(|()| bench.gateway.open().unwrap());
    bench.robot.set("I1", &11_i32);
    assert_eq!(bench.ask(plcs[0], "GET:RC8:1:I:\r"), "0,3,11\r");
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Nothing);
    for plc in plcs {
        bench.send(plc, "GET:RC8:1:I:\r");
    }
    assert_eq!(bench.settle(), []);
    bench.gateway.robot_closed(bench.now);
    let events = bench.events();
    assert!(matches!(events[0], Event::RobotDown { error: RobotError::Closed, .. }), "{events:?}");
    assert_eq!(events.len(), 4);
    for plc in plcs {
        assert_eq!(bench.take(plc), line(HResult::E_NOT_CONNECTED));
    }
    bench.sleep(500);
    bench.robot.calls();
    assert_eq!(bench.connect(), [Event::RobotUp]);
    assert_eq!(bench.ask(plcs[2], "GET:RC8:1:I:\r"), "0,3,11\r");
    let calls = bench.robot.calls();
    assert_eq!(calls[3], "ControllerGetVariable(I4(77), \"I1\", \"\")", "the old handle was not used: {calls:?}");
}

#[test]
fn a_put_that_the_robot_may_have_executed_times_out_when_the_robot_disconnects() {
    for (stalled, reply) in [
        (FunctionId::VARIABLE_PUT_VALUE, HResult::E_TIMEOUT),
        (FunctionId::CONTROLLER_GET_VARIABLE, HResult::E_NOT_CONNECTED),
    ] {
        let mut bench = Bench::up::<1, 4>(WRITABLE);
        let plc = bench.gateway.open().unwrap();
        bench.robot.script(stalled, Do::Nothing);
        bench.send(plc, "PUT:RC8:1:I:3,1\r");
        assert_eq!(bench.settle(), []);
        bench.gateway.robot_closed(bench.now);
        bench.events();
        assert_eq!(bench.take(plc), line(reply), "{stalled}");
    }
}

#[test]
fn a_robot_that_stops_responding_ends_the_connection_and_the_request_in_flight() {
    let mut bench = Bench::up::<2, 4>(WRITABLE);
    let [first, second] = [(); 2].map(|()| bench.gateway.open().unwrap());
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Nothing);
    bench.send(first, "PUT:RC8:1:I:3,1\r");
    bench.send(second, "GET:RC8:2:I:\r");
    assert_eq!(bench.settle(), []);
    assert_eq!(bench.gateway.poll_timeout(), Some(at(3000)));
    assert_eq!(bench.sleep(2999), []);
    let events = bench.sleep(1);
    assert!(matches!(events[0], Event::RobotDown { error: RobotError::Call(ClientError::Timeout(_)), .. }));
    assert_eq!(bench.take(first), line(HResult::E_TIMEOUT));
    assert_eq!(bench.take(second), line(HResult::E_NOT_CONNECTED));
    assert!(!bench.gateway.robot_wanted());
    assert_eq!(bench.ask(first, "GET:RC8:1:I:\r"), line(HResult::E_NOT_CONNECTED));
    // a late reply belongs to no request
    assert_eq!(bench.answer(HResult::S_OK, Some(&5_i32)), []);
    assert!(bench.gateway.transmit(first).is_empty());
}

#[test]
fn invalid_bytes_end_the_connection() {
    let (mut bench, plc) = Bench::with_client::<1, 4>(Config::RC8);
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Nothing);
    bench.send(plc, "GET:RC8:2:I:\r");
    bench.settle();
    let events = bench.deliver(b"HTTP/1.1 400 Bad Request\r\n\r\n");
    assert!(matches!(events[0], Event::RobotDown { error: RobotError::Call(ClientError::Malformed(_)), .. }));
    assert_eq!(bench.take(plc), line(HResult::E_NOT_CONNECTED));
    // the same for a reply without a valid handle
    bench.gateway.robot_closed(bench.now);
    bench.sleep(500);
    assert_eq!(bench.connect(), [Event::RobotUp]);
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, ok(&"handle"));
    bench.send(plc, "GET:RC8:2:I:\r");
    let events = bench.settle();
    assert!(matches!(events[0], Event::RobotDown { error: RobotError::Call(ClientError::Reply(_)), .. }));
}

#[test]
fn the_reply_to_a_request_that_timed_out_does_not_answer_the_next() {
    let config = Config { request_timeout: Duration::from_secs(1), ..WRITABLE };
    let (mut bench, plc) = Bench::with_client::<1, 4>(config);
    bench.robot.set("I1", &1_i32);
    bench.robot.set("I2", &2_i32);
    bench.ask(plc, "GET:RC8:1:I:\r");
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Execute);
    bench.send(plc, "GET:RC8:1:I:\r");
    assert_eq!(bench.settle(), []);
    assert_eq!(bench.gateway.poll_timeout(), Some(at(1000)));
    assert!(bench.gateway.receive_buffer(plc).is_empty());
    let failed =
        Event::Failed { peer: plc, request: get_i(1), result: HResult::E_TIMEOUT, time: Duration::from_secs(1) };
    assert_eq!(bench.sleep(1000), [failed]);
    assert_eq!(bench.take(plc), line(HResult::E_TIMEOUT));
    bench.send(plc, "GET:RC8:2:I:\r");
    assert_eq!(bench.settle(), []);
    let events = bench.answer(HResult::S_OK, Some(&1_i32));
    assert!(matches!(events[..], [Event::Served { request, .. }] if request == get_i(2)), "{events:?}");
    assert_eq!(bench.take(plc), "0,3,2\r");
    // a PUT that times out in the queue is not executed
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Execute);
    bench.send(plc, "PUT:RC8:3:I:3,3\r");
    bench.settle();
    bench.sleep(1000);
    assert_eq!(bench.take(plc), line(HResult::E_TIMEOUT));
    bench.robot.handles.insert(9, "I3".to_string());
    bench.answer(HResult::S_OK, Some(&9_i32));
    assert!(!bench.robot.values.contains_key("I3"));
    assert_eq!(bench.ask(plc, "PUT:RC8:3:I:3,4\r"), "0\r", "its handle is kept");
    assert_eq!(bench.robot.value("I3"), Variant::I4(4));
}

#[test]
fn a_new_client_does_not_get_the_reply_of_the_former_client_of_its_slot() {
    let mut bench = Bench::up::<1, 4>(Config::RC8);
    let gone = bench.gateway.open().unwrap();
    assert_eq!(bench.gateway.open(), None, "there is one slot");
    bench.robot.set("I2", &2_i32);
    bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Nothing);
    bench.send(gone, "GET:RC8:1:I:\r");
    bench.settle();
    bench.gateway.close(gone);
    let plc = bench.gateway.open().unwrap();
    assert_ne!(plc, gone);
    bench.send(plc, "GET:RC8:2:I:\r");
    assert_eq!(bench.settle(), []);
    let events = bench.answer(HResult::S_OK, Some(&1_i32));
    assert!(matches!(events[..], [Event::Served { peer, .. }] if peer == plc), "{events:?}");
    assert_eq!(bench.take(plc), "0,3,2\r");
    // the former client has no bytes and no buffer
    assert!(bench.gateway.receive_buffer(gone).is_empty());
    bench.gateway.received(gone, 5);
    bench.gateway.transmitted(gone, 5);
    bench.gateway.close(gone);
    assert!(bench.gateway.transmit(gone).is_empty() && bench.gateway.line(gone).is_empty());
    assert_eq!(bench.ask(plc, "GET:RC8:2:I:\r"), "0,3,2\r");
}

#[test]
fn requests_are_served_in_the_order_of_arrival() {
    let mut bench = Bench::up::<3, 8>(Config::RC8);
    let plcs = [(); 3].map(|()| bench.gateway.open().unwrap());
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Nothing);
    for (plc, index) in [(plcs[2], 12), (plcs[0], 10), (plcs[1], 11)] {
        bench.send(plc, &format!("GET:RC8:{index}:I:\r"));
        assert_eq!(bench.settle(), []);
    }
    let order: Vec<_> = bench.answer(HResult::E_FAIL, None).iter().filter_map(Event::peer).collect();
    assert_eq!(order, [plcs[2], plcs[0], plcs[1]]);
}

#[test]
fn lines_without_a_pause_are_answered_in_order() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(WRITABLE);
    bench.send(plc, "PUT:RC8:1:I:3,7\rGET:RC8:1:I:\rNONSENSE\rGET:RC8:1:I:\r");
    let mut answers = Vec::new();
    for _ in 0..4 {
        bench.settle();
        answers.push(bench.take(plc));
    }
    assert_eq!(answers, ["0\r", "0,3,7\r", &line(HResult::E_INVALIDCOMMAND), "0,3,7\r"]);
}

#[test]
fn a_value_that_does_not_fit_a_line_is_an_error() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(WRITABLE);
    for (length, fits) in [(251, true), (252, false), (300, false), (500, false), (10_000, false)] {
        let text = "x".repeat(length);
        let mut big = Vec::new();
        bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Nothing);
        bench.send(plc, "GET:RC8:1:S:\r");
        bench.settle();
        big.resize(length * 2 + 100, 0);
        let mut frame = FrameWriter::new(&mut big).unwrap();
        frame.argument(text.as_str()).unwrap();
        let bytes = frame.finish(bench.robot.unanswered.remove(0).0, 0, 0).unwrap().to_vec();
        bench.deliver(&bytes);
        let expected = if fits { format!("0,8,{text}\r") } else { line(HResult::E_INVALIDSNDPACKET) };
        assert_eq!(bench.take(plc), expected, "{length}");
    }
    bench.robot.set("S1", &"two\rlines");
    assert_eq!(bench.ask(plc, "GET:RC8:1:S:\r"), line(HResult::E_INVALIDSNDPACKET));
    // the longest string that fits a line
    let longest = "y".repeat(256 - "PUT:RC8:1:S:8,\r".len());
    assert_eq!(bench.ask(plc, &format!("PUT:RC8:1:S:8,{longest}\r")), "0\r");
    assert_eq!(bench.robot.value("S1").as_bstr().unwrap(), longest.as_str());
}

#[test]
fn the_heartbeat_detects_a_robot_that_does_not_respond() {
    let mut bench = Bench::up::<1, 8>(Config::RC8);
    assert_eq!(bench.gateway.poll_timeout(), Some(at(2000)));
    assert_eq!(bench.sleep(2000), []);
    assert_eq!(bench.robot.calls(), [MODE]);
    assert_eq!(bench.gateway.poll_timeout(), Some(at(4000)));
    bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Reply(HResult::E_FAIL, None));
    assert_eq!(bench.sleep(2000), [], "any answer is a sign of life");
    bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Nothing);
    assert_eq!(bench.sleep(2000), []);
    let events = bench.sleep(3000);
    assert!(matches!(events[..], [Event::RobotDown { .. }]), "{events:?}");
}

#[test]
fn a_put_is_refused_while_a_stream_runs_or_may_run() {
    let mut bench = Bench::up::<1, 8>(WRITABLE);
    bench.robot.set("I1", &11_i32);
    let plc = bench.gateway.open().unwrap();
    bench.robot.mode = 0x202;
    bench.send(plc, "PUT:RC8:1:I:3,5\r");
    assert_eq!(bench.settle(), [Event::Refused { peer: plc, refusal: Refusal::SlaveMode }]);
    assert_eq!(bench.take(plc), line(HResult::E_SLVMODE_ON));
    assert_eq!(bench.robot.calls(), ["ControllerGetVariable(I4(77), \"I1\", \"\")", MODE]);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,11\r", "a GET needs no question");
    assert!(!bench.robot.calls().iter().any(|call| call == MODE));
    // without an answer it is unknown
    bench.robot.mode = 0;
    bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Reply(HResult::E_FAIL, None));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), line(HResult::E_SLVMODE_ON));
    bench.robot.calls();
    // each PUT repeats the query
    for number in [5, 6] {
        assert_eq!(bench.ask(plc, &format!("PUT:RC8:1:I:3,{number}\r")), "0\r");
        assert_eq!(bench.robot.calls()[0], MODE);
        assert_eq!(bench.robot.value("I1").as_i32(), Some(number));
    }
}

#[test]
fn a_robot_without_slave_mode_is_asked_once() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(WRITABLE);
    bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Reply(HResult::E_NO_LICENSE, None));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), "0\r");
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,6\r"), "0\r");
    bench.sleep(2000);
    let calls = bench.robot.calls();
    assert_eq!(calls.iter().filter(|call| *call == MODE).count(), 1, "{calls:?}");
    assert_eq!(calls.last().unwrap(), "ControllerGetName(I4(77))");
}

#[test]
fn without_the_robot_object_nothing_is_written() {
    let mut bench = Bench::new::<1, 8>(WRITABLE);
    bench.robot.mode = 0x202;
    bench.robot.script.push_back((FunctionId::CONTROLLER_GET_ROBOT, Do::Reply(HResult::E_FAIL, None)));
    assert_eq!(bench.connect(), [Event::RobotUp]);
    let plc = bench.gateway.open().unwrap();
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), line(HResult::E_SLVMODE_ON));
    bench.robot.calls();
    // the heartbeat opens it
    bench.sleep(2000);
    assert_eq!(bench.robot.calls(), ["ControllerGetRobot(I4(77), \"Arm\", \"\")"]);
    // a handle that is no longer valid on the robot is replaced
    bench.robot.script(FunctionId::ROBOT_EXECUTE, Do::Reply(HResult::E_HANDLE, None));
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), line(HResult::E_SLVMODE_ON));
    bench.robot.mode = 0;
    assert_eq!(bench.ask(plc, "PUT:RC8:1:I:3,5\r"), "0\r");
}

#[test]
fn the_robot_object_is_opened_again_while_a_plc_polls() {
    let mut bench = Bench::new::<1, 8>(WRITABLE);
    for _ in 0..2 {
        bench.robot.script(FunctionId::CONTROLLER_GET_ROBOT, Do::Reply(HResult::E_FAIL, None));
    }
    assert_eq!(bench.connect(), [Event::RobotUp]);
    bench.robot.set("I1", &11_i32);
    let plc = bench.gateway.open().unwrap();
    bench.robot.calls();
    // one attempt every 2 s, and none after it succeeded
    for (opened, reply) in [(1, line(HResult::E_SLVMODE_ON)), (1, "0\r".into()), (0, "0\r".into())] {
        for _ in 0..4 {
            bench.sleep(500);
            assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,11\r");
        }
        let calls = bench.robot.calls();
        assert_eq!(calls.iter().filter(|call| call.starts_with("ControllerGetRobot")).count(), opened, "{calls:?}");
        assert_eq!(bench.ask(plc, "PUT:RC8:2:I:3,5\r"), reply);
    }
}

#[test]
fn each_slot_has_a_token_bucket() {
    let rate = Rate { per_second: 1, burst: 2 };
    let config = Config { rules: Rules { rate, ..Rules::READ_ONLY }, ..Config::RC8 };
    let mut bench = Bench::up::<1, 8>(config);
    bench.robot.set("I1", &1_i32);
    for _ in 0..2 {
        let plc = bench.gateway.open().unwrap();
        assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,1\r");
        bench.gateway.close(plc);
    }
    let plc = bench.gateway.open().unwrap();
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), line(HResult::E_BUSY_PROC));
    bench.sleep(1000);
    assert_eq!(bench.ask(plc, "GET:RC8:1:I:\r"), "0,3,1\r");
}

#[test]
fn times_are_counted_from_the_line_to_the_reply() {
    let (mut bench, plc) = Bench::with_client::<1, 8>(Config::RC8);
    bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Nothing);
    bench.send(plc, "GET:RC8:1:I:\r");
    bench.settle();
    bench.sleep(40);
    bench.robot.set("I1", &1_i32);
    bench.robot.handles.insert(5, "I1".to_string());
    let events = bench.answer(HResult::S_OK, Some(&5_i32));
    assert!(matches!(events[..], [Event::Served { time, .. }] if time == Duration::from_millis(40)), "{events:?}");
    let served = bench.gateway.counters().served;
    assert_eq!(
        (served.count(), served.mean(), served.max()),
        (1, Duration::from_millis(40), Duration::from_millis(40))
    );
}

/// A deterministic pseudo-random number generator.
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        u32::try_from(self.0 >> 33).unwrap() % limit
    }
}

/// Clients connect and disconnect; the robot is slow, refuses, stops responding, and restarts. Every reply with a value
/// carries the number of its own request, and every request ends before its timeout.
#[test]
fn no_request_gets_the_reply_of_another() {
    for seed in 0..8 {
        let mut dice = Dice(seed);
        let mut bench = Bench::new::<4, 3>(Config { request_timeout: Duration::from_secs(4), ..WRITABLE });
        // a client, the reply it expects, and the time of its request
        let mut clients: Vec<(PeerId, Option<(String, Instant)>)> = Vec::new();
        let (mut answered, mut number) = (0, 0);
        for _ in 0..2000 {
            let pass = dice.below(300);
            bench.now = bench.now + Duration::from_millis(pass.into());
            match dice.below(400) {
                0 => bench.gateway.robot_closed(bench.now),
                1 => bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Nothing),
                2 => bench.robot.script(FunctionId::CONTROLLER_GET_VARIABLE, Do::Nothing),
                3 => bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Reply(HResult::E_HANDLE, None)),
                4..10 => bench.robot.script(FunctionId::VARIABLE_GET_VALUE, Do::Execute),
                10 => bench.robot.handles.clear(),
                11..20 if !clients.is_empty() => bench.gateway.close(clients.remove(0).0),
                20..60 => clients.extend(bench.gateway.open().map(|plc| (plc, None))),
                60..80 if !bench.robot.unanswered.is_empty() => {
                    // possibly to a request that has ended
                    bench.answer_late();
                }
                _ => {}
            }
            if !bench.gateway.robot_wanted() {
                bench.gateway.robot_closed(bench.now);
            } else if bench.gateway.link.phase == Phase::Opening {
                bench.robot.reset();
                bench.gateway.robot_opened(bench.now);
            }
            for (plc, request) in &mut clients {
                if request.is_none() && dice.below(3) == 0 {
                    number += 1;
                    // some variables are requested repeatedly, others once
                    let index = if dice.below(2) == 0 { dice.below(4) } else { number + 100 };
                    bench.robot.set(&format!("I{index}"), &index);
                    let line = format!("GET:RC8:{index}:I:\r");
                    let room = bench.gateway.receive_buffer(*plc);
                    room[..line.len()].copy_from_slice(line.as_bytes());
                    bench.gateway.received(*plc, line.len());
                    *request = Some((format!("0,3,{index}\r"), bench.now));
                }
            }
            bench.settle();
            for (plc, request) in &mut clients {
                let text = String::from_utf8(bench.gateway.transmit(*plc).to_vec()).unwrap();
                bench.gateway.transmitted(*plc, text.len());
                if text.is_empty() {
                    let since = request.as_ref().map_or(bench.now, |(_, since)| *since);
                    assert!(bench.now.saturating_since(since) < Duration::from_millis(4300), "it waits too long");
                    continue;
                }
                let (value, _) = request.take().expect("an answer to nothing");
                answered += 1;
                let errors = [HResult::E_NOT_CONNECTED, HResult::E_TIMEOUT, HResult::E_HANDLE];
                assert!(text == value || errors.iter().any(|error| text == line(*error)), "{text} for {value}");
            }
        }
        let counters = bench.gateway.counters();
        assert!(number > 500 && answered > number * 8 / 10, "{number} {answered}");
        assert!(counters.served.count() > 100 && counters.failed.count() > 10, "{counters:?}");
        assert!(counters.connected > 3, "{counters:?}");
    }
}

#[test]
fn the_memory_fits_a_board() {
    assert!(size_of::<Memory<4, 32>>() <= 7 * 1024, "{}", size_of::<Memory<4, 32>>());
    assert!(size_of::<Gateway<'_>>() <= 1024, "{}", size_of::<Gateway<'_>>());
    assert!(size_of::<Event>() <= 48, "{}", size_of::<Event>());
}
