#![allow(clippy::arithmetic_side_effects, reason = "counters of a test")]

extern crate std;

use std::vec::Vec;

use super::*;
use crate::bcap::call::{self, Call, ControllerHandle, RawCall, RobotHandle, VariableHandle};
use crate::bcap::{Decoder, Progress};
use crate::error::DecodeErrorKind;
use crate::handler::tests::Capped;
use crate::variant::VariantBuf;

mod cells;

/// A handler that records its calls, returns handles, and delays Robot_Halt until `wait_until`; with `start` also
/// Service_Start, which then gets that result.
#[derive(Default)]
struct Recorder {
    calls: Vec<(i32, i32)>,
    next_handle: i32,
    wait_until: Option<Instant>,
    start: Option<HResult>,
    abandoned: usize,
    left: usize,
    /// The refused requests: function, number of arguments, code.
    refused: Vec<(i32, usize, HResult)>,
    value: Vec<u8>,
}

impl Handler for Recorder {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let start = self.start.filter(|_| request.function == FunctionId::SERVICE_START);
        let waits = request.function == FunctionId::ROBOT_HALT || start.is_some();
        if waits && self.wait_until.is_some_and(|until| now < until) {
            return Outcome::Wait(self.wait_until.unwrap_or(now));
        }
        self.calls.push((request.function.0, request.handle()));
        if let Some(result) = start {
            return result.into();
        }
        if request.function.opens().is_some_and(|object| object != Object::Service) {
            self.next_handle += 1;
            reply.set(&self.next_handle).unwrap();
        } else if request.function == FunctionId::VARIABLE_GET_VALUE {
            let _ = reply.set(&self.value[..]);
        }
        HResult::S_OK.into()
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        self.abandoned += 1;
    }

    fn refused(&mut self, _: PeerId, request: &Request<'_>, code: HResult, _: Instant) {
        self.refused.push((request.function.0, request.args.len(), code));
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

struct Bench {
    session: Session<[u8; 512], [u8; 1024], 4>,
    handler: Recorder,
    decoder: Decoder,
    events: Vec<Event>,
}

fn at(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

fn frame(call: &impl Call, serial: u16, reserved: u16, crc: bool) -> Vec<u8> {
    let mut buffer = [0; 2048];
    let mut frame = FrameWriter::new(&mut buffer).unwrap().with_crc(crc);
    call.arguments(&mut frame).unwrap();
    frame.finish(serial, reserved, call.function().0).unwrap().to_vec()
}

impl Bench {
    fn new(config: Config) -> Self {
        let session = Session::new(config, [0; 512], [0; 1024]);
        Self { session, handler: Recorder::default(), decoder: config.link.decoder(), events: Vec::new() }
    }

    /// Delivers bytes, runs the session, and returns the sent frames as (serial, code, value).
    fn bytes(&mut self, bytes: &[u8], now: Instant) -> Vec<(u16, HResult, Option<VariantBuf<512>>)> {
        let mut rest = bytes;
        let mut out = Vec::new();
        loop {
            let free = self.session.receive_buffer();
            let count = free.len().min(rest.len());
            free[..count].copy_from_slice(&rest[..count]);
            self.session.received(count);
            rest = &rest[count..];
            out.extend(self.run(now));
            if count == 0 || rest.is_empty() {
                return out;
            }
        }
    }

    fn run(&mut self, now: Instant) -> Vec<(u16, HResult, Option<VariantBuf<512>>)> {
        let mut out = Vec::new();
        loop {
            let event = self.session.run(&mut self.handler, PeerId(1), now);
            let bytes = self.session.transmit().to_vec();
            self.session.transmitted(bytes.len());
            if !bytes.is_empty() {
                let Progress::Complete(frame, used) = self.decoder.decode(&bytes).unwrap() else { panic!() };
                assert_eq!((used, frame.reserved), (bytes.len(), 0));
                out.push((frame.serial, frame.hresult(), frame.value().map(|v| VariantBuf::new(&v).unwrap())));
            }
            match event {
                Some(event) => self.events.push(event),
                None if bytes.is_empty() => return out,
                None => {}
            }
        }
    }

    fn call(&mut self, call: impl Call, serial: u16, now: Instant) -> Vec<(u16, HResult)> {
        self.attempt(&call, serial, if self.session.state.config.link.is_lossy() { serial } else { 0 }, now)
    }

    fn attempt(&mut self, call: &impl Call, serial: u16, first: u16, now: Instant) -> Vec<(u16, HResult)> {
        let bytes = frame(call, serial, first, self.decoder.crc);
        self.bytes(&bytes, now).into_iter().map(|(serial, code, _)| (serial, code)).collect()
    }

    /// Starts the service with options, and opens controller 1 and robot 2.
    fn connected(config: Config, options: &str) -> Self {
        let mut bench = Self::new(config);
        assert_eq!(bench.call(call::service_start(options), 1, at(0)), [(1, HResult::S_OK)]);
        assert_eq!(bench.call(call::controller_connect("", "", "", ""), 2, at(0)), [(2, HResult::S_OK)]);
        assert_eq!(
            bench.call(call::controller_get_robot(ControllerHandle(1), "Arm", ""), 3, at(0)),
            [(3, HResult::S_OK)]
        );
        bench.handler.calls.clear();
        bench
    }
}

fn halt() -> impl Call {
    call::robot_halt(RobotHandle(2), "")
}

#[test]
fn requests_are_answered_in_order_for_any_chunk_size() {
    let requests: Vec<u8> = [
        frame(&call::service_start(""), 1, 0, false),
        frame(&call::controller_connect("a", "b", "c", ""), 2, 0, false),
        frame(&call::controller_get_name(ControllerHandle(1)), 3, 0, false),
        frame(&call::service_stop(), 4, 0, false),
    ]
    .concat();
    for chunk in [1, 2, 7, 30, requests.len()] {
        let mut bench = Bench::new(Config::TCP);
        let replies: Vec<_> = requests.chunks(chunk).flat_map(|part| bench.bytes(part, at(0))).collect();
        let codes: Vec<_> = replies.iter().map(|(serial, code, _)| (*serial, code.0)).collect();
        assert_eq!(codes, [(1, 0), (2, 0), (3, 0), (4, 0)], "chunks of {chunk}");
        assert_eq!(replies[1].2.as_ref().unwrap().as_variant(), Variant::I4(1));
        // the value of a function with a result is EMPTY if the handler sets none
        assert_eq!(replies[2].2.as_ref().unwrap().as_variant(), Variant::Empty);
        assert!(replies[3].2.is_none());
        // Service_Stop has released the controller first
        assert_eq!(bench.handler.calls, [(1, 0), (3, 0), (21, 1), (4, 1), (2, 0), (2, 0)]);
    }
}

#[test]
fn arguments_are_checked_before_the_handler() {
    let mut bench = Bench::connected(Config::TCP, "");
    let raw = |function, arguments| RawCall { function: FunctionId(function), arguments };
    let cases: [(RawCall<'_>, HResult); 9] = [
        (raw(0, &[]), HResult::E_INVALIDARG),
        (raw(138, &[]), HResult::E_INVALIDARG),
        (raw(-1, &[]), HResult::E_INVALIDARG),
        (raw(4, &[]), HResult::E_INVALIDARG),
        (raw(70, &[&2_i32, &"", &""]), HResult::E_INVALIDARG),
        (raw(70, &[&2_i32, &5_i32]), HResult::E_INVALIDARGTYPE),
        (raw(70, &[&"2", &""]), HResult::E_INVALIDARGTYPE),
        (raw(70, &[&9_i32, &""]), HResult::E_HANDLE),
        // the handle of the controller is not a handle of a robot
        (raw(70, &[&1_i32, &""]), HResult::E_HANDLE),
    ];
    for (serial, (call, expected)) in (4..).zip(cases) {
        assert_eq!(bench.call(call, serial, at(0)), [(serial, expected)], "{call:?}");
        let told = (call.function.0, call.arguments.len(), expected);
        assert_eq!(bench.handler.refused.pop(), Some(told), "{call:?}");
    }
    assert_eq!(bench.handler.calls, []);
    assert_eq!(bench.call(raw(70, &[&2_u32, &()]), 20, at(0)), [(20, HResult::S_OK)]);
}

#[test]
fn objects_are_released_in_reverse_order_and_limited() {
    let mut bench = Bench::connected(Config::TCP, "");
    let variable = || call::controller_get_variable(ControllerHandle(1), "I1", "");
    assert_eq!(bench.call(variable(), 4, at(0)), [(4, HResult::S_OK)]);
    assert_eq!(bench.call(variable(), 5, at(0)), [(5, HResult::E_MAX_OBJECT)]);
    assert_eq!(bench.handler.refused.pop().map(|(_, _, code)| code), Some(HResult::E_MAX_OBJECT));
    assert_eq!(bench.call(call::robot_release(RobotHandle(2)), 6, at(0)), [(6, HResult::S_OK)]);
    assert_eq!(bench.call(halt(), 7, at(0)), [(7, HResult::E_HANDLE)]);
    assert_eq!(bench.call(variable(), 8, at(0)), [(8, HResult::S_OK)]);
    bench.handler.calls.clear();
    bench.session.close(&mut bench.handler, PeerId(1), at(0));
    assert_eq!(bench.handler.calls, [(111, 4), (111, 3), (4, 1), (2, 0)]);
    assert_eq!((bench.handler.left, bench.session.open_objects()), (1, 0));
}

#[test]
fn an_invalid_frame_is_answered_and_ends_a_stream() {
    for (bytes, serial, code) in [
        (b"GET / HTTP/1.1\r\n\r\n".to_vec(), 0, HResult::E_INVALIDRCPACKET),
        (b"\x01\xff\xff\xff\xff\x07\0\0\0\0\0\0\0\0\0\0".to_vec(), 7, HResult::E_PACKETSIZEOVER),
        (b"\x01\x10\0\0\0\x05\0\0\0\x01\0\0\0\0\0\x05".to_vec(), 5, HResult::E_INVALIDRCPACKET),
    ] {
        let mut bench = Bench::new(Config::TCP);
        let replies = bench.bytes(&bytes, at(0));
        assert_eq!((replies[0].0, replies[0].1), (serial, code));
        assert!(bench.session.is_finished());
        assert_eq!(bench.call(call::service_start(""), 1, at(0)), []);
    }
}

#[test]
fn an_invalid_datagram_is_answered_only_if_it_has_a_header() {
    let mut bench = Bench::connected(Config::UDP, "");
    for garbage in [&b""[..], b"\x01", b"hello, this is no frame"] {
        assert_eq!(bench.bytes(garbage, at(0)).len(), 0);
    }
    let mut bad = frame(&halt(), 9, 9, false);
    *bad.last_mut().unwrap() = 5;
    let reply = &bench.bytes(&bad, at(0))[0];
    assert_eq!((reply.0, reply.1), (9, HResult::E_INVALIDRCPACKET));
    assert_eq!(bench.call(halt(), 10, at(0)), [(10, HResult::S_OK)]);
    assert!(bench.events.iter().any(|e| matches!(e, Event::Malformed(m) if m.kind == DecodeErrorKind::Eot(5))));
}

#[test]
fn keep_alives_are_sent_at_the_watchdog_interval() {
    let mut bench = Bench::connected(Config::TCP, "WDT=100");
    bench.handler.wait_until = Some(at(350));
    assert_eq!(bench.call(halt(), 4, at(0)), []);
    let mut sent = Vec::new();
    for _ in 0..4 {
        let deadline = bench.session.poll_timeout().unwrap();
        sent.extend(bench.run(deadline).iter().map(|(_, code, _)| (deadline, *code)));
    }
    let executing = HResult::S_EXECUTING;
    assert_eq!(sent, [(at(100), executing), (at(200), executing), (at(300), executing), (at(350), HResult::S_OK)]);
    assert_eq!(bench.session.poll_timeout(), None);
    assert_eq!(bench.handler.calls, [(70, 2)]);
}

#[test]
fn a_call_that_times_out_is_answered_and_abandoned() {
    let mut bench = Bench::connected(Config::TCP, "InvokeTimeout=200");
    bench.handler.wait_until = Some(Instant::FAR_FUTURE);
    assert_eq!(bench.call(halt(), 4, at(0)), []);
    assert_eq!(bench.session.poll_timeout(), Some(at(200)));
    assert_eq!(bench.run(at(199)).len(), 0);
    assert_eq!(bench.run(at(200))[0].1, HResult::E_TIMEOUT);
    assert_eq!(bench.handler.abandoned, 1);
    // the session continues
    bench.handler.wait_until = None;
    assert_eq!(bench.call(halt(), 5, at(201)), [(5, HResult::S_OK)]);
}

#[test]
fn every_copy_of_a_running_call_gets_s_executing() {
    for config in [Config::UDP, Config::SERIAL] {
        let mut bench = Bench::connected(config, "");
        bench.handler.wait_until = Some(at(5000));
        assert_eq!(bench.call(halt(), 4, at(0)), []);
        for serial in 5..200 {
            assert_eq!(bench.attempt(&halt(), serial, 4, at(1)), [(serial, HResult::S_EXECUTING)]);
        }
        // the handler resumes its own request
        assert_eq!(
            bench.run(at(5000)).iter().map(|reply| (reply.0, reply.1)).collect::<Vec<_>>(),
            [(199, HResult::S_OK)]
        );
        assert_eq!(bench.handler.calls, [(70, 2)]);
    }
}

#[test]
fn no_client_option_exceeds_the_maximum_of_the_server() {
    for options in ["", "InvokeTimeout=4294967295", "InvokeTimeout=3000", "InvokeTimeout=80"] {
        let mut bench = Bench::connected(Config { invoke_timeout_max: Duration::from_secs(2), ..Config::TCP }, options);
        bench.handler.wait_until = Some(Instant::FAR_FUTURE);
        assert_eq!(bench.call(halt(), 4, at(0)), []);
        let until = if options.ends_with("=80") { at(80) } else { at(2000) };
        assert_eq!(bench.session.poll_timeout(), Some(until), "{options}");
        assert_eq!(bench.run(until)[0].1, HResult::E_TIMEOUT);
    }
}

#[test]
fn the_options_of_a_service_start_that_the_handler_refuses_do_not_apply() {
    let refused = HResult::E_ACCESSDENIED;
    for config in [Config::TCP, Config::UDP] {
        let mut bench = Bench::connected(config, "WDT=300,InvokeTimeout=2000");
        let options = |bench: &Bench| (bench.session.state.watchdog, bench.session.state.invoke_timeout);
        let [before, after] =
            [(300, 2000), (90, 95)].map(|(a, b)| (Some(Duration::from_millis(a)), Duration::from_millis(b)));
        bench.handler.start = Some(refused);
        assert_eq!(bench.call(call::service_start("WDT=80,InvokeTimeout=80"), 10, at(0)), [(10, refused)]);
        assert_eq!(options(&bench), before, "refused at once");
        for (serial, result, expected) in [(11, refused, before), (12, HResult::S_OK, after)] {
            bench.handler.start = Some(result);
            bench.handler.wait_until = Some(at(5));
            assert_eq!(bench.call(call::service_start("WDT=90,InvokeTimeout=95"), serial, at(0)), []);
            assert_eq!(options(&bench), before, "not answered yet");
            assert_eq!(bench.run(at(5))[0].1, result);
            assert_eq!(options(&bench), expected, "answered later");
        }
    }
}

#[test]
fn invalid_options_are_refused_with_a_reply() {
    let mut bench = Bench::new(Config::TCP);
    for (serial, options) in (1..).zip(["WDT=79", "InvokeTimeout=abc", "WDT=(100"]) {
        assert_eq!(bench.call(call::service_start(options), serial, at(0)), [(serial, HResult::E_INVALIDARG)]);
    }
    assert_eq!(bench.handler.calls, []);
}

#[test]
fn a_repeated_call_is_answered_again_and_not_executed_again() {
    for config in [Config::UDP, Config::SERIAL] {
        let mut bench = Bench::connected(config, "");
        assert_eq!(bench.attempt(&halt(), 4, 4, at(0)), [(4, HResult::S_OK)]);
        assert_eq!(bench.attempt(&halt(), 5, 4, at(500)), [(5, HResult::S_OK)]);
        assert_eq!(bench.attempt(&halt(), 4, 4, at(600)), [(4, HResult::S_OK)]);
        assert_eq!(bench.handler.calls, [(70, 2)]);
        assert_eq!(bench.attempt(&halt(), 6, 6, at(700)), [(6, HResult::S_OK)]);
        assert_eq!(bench.handler.calls.len(), 2);
        // the network delivers an attempt of the first call late
        assert_eq!(bench.attempt(&halt(), 5, 4, at(800)), []);
        assert_eq!(bench.handler.calls.len(), 2);
    }
}

#[test]
fn another_function_under_the_same_marker_is_another_call() {
    let mut bench = Bench::connected(Config::UDP, "");
    assert_eq!(bench.attempt(&halt(), 4, 4, at(0)), [(4, HResult::S_OK)]);
    let other = call::robot_hold(RobotHandle(2), "");
    assert_eq!(bench.attempt(&other, 4, 4, at(0)), [(4, HResult::S_OK)]);
    assert_eq!(bench.handler.calls, [(70, 2), (71, 2)]);
}

#[test]
fn a_first_request_with_serial_zero_is_not_a_copy() {
    let mut bench = Bench::new(Config::UDP);
    let start = call::service_start("");
    assert_eq!(bench.attempt(&start, 0, 0, at(0)), [(0, HResult::S_OK)]);
    assert_eq!(bench.handler.calls, [(1, 0)]);
}

#[test]
fn a_copy_of_a_running_call_gets_s_executing_and_then_the_reply() {
    let mut bench = Bench::connected(Config::UDP, "");
    bench.handler.wait_until = Some(at(800));
    assert_eq!(bench.attempt(&halt(), 4, 4, at(0)), []);
    assert_eq!(bench.attempt(&halt(), 5, 4, at(500)), [(5, HResult::S_EXECUTING)]);
    // a late copy does not move the reply to an older attempt
    assert_eq!(bench.attempt(&halt(), 4, 4, at(510)), [(5, HResult::S_EXECUTING)]);
    assert_eq!(bench.call(call::controller_get_name(ControllerHandle(1)), 6, at(520)), [(6, HResult::E_BUSY_PROC)]);
    let replies = bench.run(at(800));
    assert_eq!((replies[0].0, replies[0].1), (5, HResult::S_OK));
    assert_eq!(bench.handler.calls, [(70, 2)]);
}

#[test]
fn noise_while_a_call_runs_does_not_hide_the_frame_after_it() {
    let mut bench = Bench::connected(Config::SERIAL, "");
    bench.handler.wait_until = Some(Instant::FAR_FUTURE);
    assert_eq!(bench.attempt(&halt(), 4, 4, at(0)), []);
    let mut bytes = std::vec![0xff];
    bytes.extend(frame(&halt(), 5, 4, true));
    assert_eq!(bench.bytes(&bytes, at(500)), [(5, HResult::S_EXECUTING, None)]);
    assert!(matches!(bench.events.as_slice(), [.., Event::Malformed(_), Event::Repeated { first: 4 }]));
}

/// Otherwise noise that announces a long frame takes in the next requests, and executes them much later.
#[test]
fn an_incomplete_frame_is_dropped_when_the_serial_line_is_silent() {
    let mut bench = Bench::connected(Config::SERIAL, "");
    assert_eq!(bench.session.poll_timeout(), None);
    // a frame of 496 bytes begins
    assert_eq!(bench.bytes(&[1, 0xf0, 1, 0, 0], at(0)), []);
    assert_eq!(bench.session.poll_timeout(), Some(at(100)));
    assert_eq!(bench.bytes(&[0], at(90)), []);
    assert_eq!(bench.run(at(189)), []);
    assert_eq!((bench.session.poll_timeout(), bench.session.is_receiving()), (Some(at(190)), true));
    assert_eq!(bench.run(at(190)), []);
    assert_eq!((bench.session.poll_timeout(), bench.session.is_receiving()), (None, false));
    assert_eq!(bench.call(halt(), 4, at(200)), [(4, HResult::S_OK)]);
    assert_eq!(bench.handler.calls, [(70, 2)]);
    // a frame that arrives slowly, without such a pause
    for (byte, time) in frame(&halt(), 5, 5, true).into_iter().zip((300..).step_by(99)) {
        bench.bytes(&[byte], at(time));
    }
    assert_eq!((bench.handler.calls.len(), bench.session.poll_timeout()), (2, None));
}

#[test]
fn a_new_client_at_a_known_address_starts_a_new_session() {
    let mut bench = Bench::connected(Config::UDP, "");
    // its first call has the same serial as the first call of the old client
    let start = call::service_start("");
    assert_eq!(bench.attempt(&start, 1, 1, at(1000)), [], "may be a late copy");
    assert_eq!(bench.attempt(&start, 2, 1, at(2500)), [(2, HResult::S_OK)]);
    assert_eq!(bench.handler.calls, [(84, 2), (4, 1), (2, 0), (1, 0)]);
    assert_eq!(bench.session.open_objects(), 1);
}

#[test]
fn a_late_attempt_of_service_start_does_not_end_the_session_that_it_began() {
    let mut bench = Bench::new(Config::UDP);
    // the replies to the first attempts are lost, so the next call is late
    assert_eq!(bench.attempt(&call::service_start(""), 1, 1, at(0)), [(1, HResult::S_OK)]);
    assert_eq!(bench.attempt(&call::service_start(""), 4, 1, at(1500)), [(4, HResult::S_OK)]);
    assert_eq!(bench.call(call::controller_connect("", "", "", ""), 6, at(1600)), [(6, HResult::S_OK)]);
    assert_eq!(bench.attempt(&call::service_start(""), 5, 1, at(2800)), []);
    assert_eq!(bench.session.open_objects(), 2);
}

#[test]
fn a_value_too_large_for_a_datagram_is_answered_with_a_code() {
    let mut bench = Bench::connected(Config::UDP, "");
    let get = || call::variable_get_value(VariableHandle(3));
    bench.call(call::controller_get_variable(ControllerHandle(1), "I1", ""), 4, at(0));
    bench.handler.value = std::vec![1; 462];
    let bytes = frame(&get(), 5, 5, false);
    let fits = &bench.bytes(&bytes, at(0))[0];
    assert_eq!(fits.1, HResult::S_OK);
    assert_eq!(fits.2.as_ref().unwrap().as_variant().as_array().unwrap().len(), 462);
    bench.handler.value = std::vec![1; 463];
    assert_eq!(bench.call(get(), 6, at(0)), [(6, HResult::E_TOO_MUCH_DATA)]);
}

#[cfg(feature = "alloc")]
#[test]
fn unused_memory_is_released() {
    type Growing = Session<Vec<u8>, Vec<u8>, 4>;

    fn deliver(session: &mut Growing, handler: &mut Recorder, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let free = session.receive_buffer();
            let (now, later) = rest.split_at(free.len().min(rest.len()));
            free[..now.len()].copy_from_slice(now);
            session.received(now.len());
            rest = later;
            while session.run(handler, PeerId(1), at(0)).is_some() {}
        }
    }

    fn taken(session: &mut Growing) -> usize {
        let count = session.transmit().len();
        session.transmitted(count);
        count
    }

    // a lossy link without datagrams
    let config = Config { limits: Limits::STREAM, ..Config::SERIAL };
    let mut session = Growing::new(config, Vec::new(), std::vec![0; 64]);
    let mut handler = Recorder { value: std::vec![7; 400], ..Recorder::default() };
    deliver(&mut session, &mut handler, &frame(&call::service_start(""), 1, 0, true));
    assert_eq!(taken(&mut session), 18);
    deliver(&mut session, &mut handler, &frame(&call::controller_connect("", "", "", ""), 2, 0, true));
    assert_eq!(taken(&mut session), 32);
    let open = call::controller_get_variable(ControllerHandle(1), "V1", "");
    deliver(&mut session, &mut handler, &frame(&open, 3, 0, true));
    assert_eq!(taken(&mut session), 32);
    session.shrink(64);
    assert_eq!(session.memory(), 128);

    let put = frame(&call::variable_put_value(VariableHandle(2), &[7_u8; 1000][..]), 4, 0, true);
    deliver(&mut session, &mut handler, &put[..900]);
    session.shrink(64);
    assert!(session.memory() >= 900, "it contains half a request");
    deliver(&mut session, &mut handler, &put[900..]);
    assert_eq!(taken(&mut session), 18);
    deliver(&mut session, &mut handler, &frame(&call::variable_get_value(VariableHandle(2)), 5, 0, true));
    session.shrink(64);
    assert!(session.memory() > 1400, "it contains a reply");
    let reply = taken(&mut session);
    assert!(reply > 400, "{reply}");

    // a copy is answered while the reply is kept
    let again = frame(&call::variable_get_value(VariableHandle(2)), 6, 5, true);
    deliver(&mut session, &mut handler, &again);
    assert_eq!(taken(&mut session), reply);
    session.shrink(64);
    assert_eq!(session.memory(), 128);
    let calls = handler.calls.len();
    deliver(&mut session, &mut handler, &again);
    assert_eq!((taken(&mut session), handler.calls.len()), (0, calls));

    // the next call works as before
    deliver(&mut session, &mut handler, &frame(&call::variable_get_value(VariableHandle(2)), 7, 0, true));
    assert_eq!((taken(&mut session), handler.calls.len()), (reply, calls + 1));
}

#[test]
fn a_reply_of_exactly_the_size_of_the_memory_is_sent() {
    for link in [Config::TCP, Config { limits: Limits::STREAM, ..Config::SERIAL }] {
        let crc = link.link == Link::Serial;
        for (missing, expected) in [(0, HResult::S_OK), (1, HResult::E_TOO_MUCH_DATA)] {
            let value = std::vec![7; if crc { 460 } else { 40_000 }];
            // the header, the argument's length, type and count, the value, and the end
            let frame_len = 15 + 4 + 6 + value.len() + if crc { 3 } else { 1 };
            let tx = Capped::new(64, frame_len - missing);
            let mut session = Session::<_, [u8; 256], 4>::new(link, tx, [0; 256]);
            let mut handler = Recorder { value, ..Recorder::default() };
            let mut sent = Vec::new();
            for request in [
                frame(&call::service_start(""), 1, 0, crc),
                frame(&call::controller_connect("", "", "", ""), 2, 0, crc),
                frame(&call::controller_get_variable(ControllerHandle(1), "V1", ""), 3, 0, crc),
                frame(&call::variable_get_value(VariableHandle(2)), 4, 0, crc),
            ] {
                session.receive_buffer()[..request.len()].copy_from_slice(&request);
                assert_eq!(session.next_request(), 0);
                session.received(request.len());
                assert_eq!(session.next_request(), request.len());
                while session.run(&mut handler, PeerId(1), at(0)).is_some() {}
                sent = session.transmit().to_vec();
                session.transmitted(sent.len());
            }
            let decoder = Decoder { limits: Limits::STREAM, ..link.link.decoder() };
            let Ok(Progress::Complete(reply, length)) = decoder.decode(&sent) else { panic!("{} bytes", sent.len()) };
            assert_eq!((HResult(reply.code), length), (expected, sent.len()));
            assert_eq!(sent.len() == frame_len, expected.is_ok());
        }
    }
}

#[test]
fn no_request_is_read_while_a_reply_is_unsent() {
    let mut bench = Bench::new(Config::TCP);
    let requests = [frame(&call::service_start(""), 1, 0, false), frame(&call::service_stop(), 2, 0, false)].concat();
    bench.session.receive_buffer()[..requests.len()].copy_from_slice(&requests);
    bench.session.received(requests.len());
    assert!(bench.session.run(&mut bench.handler, PeerId(1), at(0)).is_some());
    bench.session.transmitted(5);
    assert_eq!(bench.session.run(&mut bench.handler, PeerId(1), at(0)), None);
    assert_eq!((bench.session.transmit().len(), bench.handler.calls.len()), (11, 1));
    bench.session.transmitted(11);
    assert!(bench.session.run(&mut bench.handler, PeerId(1), at(0)).is_some());
}
