//! Broken devices: every planted fault is caught by the case named with it.

use std::collections::{BTreeSet, HashMap};
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::relay;
use crate::common::relay::{Hooks, Relay};
use crate::common::{assert_restored, rc8, state};
use bcap_conform::{Group, Level, Link, Options, Verdict, run};
use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_sim::Controller;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::judge::TCP;
use bcap_testkit::value::Value;
use bcap_tests::served::Served;

/// A fault and the case that catches it.
struct Fault {
    name: &'static str,
    hooks: Hooks,
    link: Link,
    case: &'static str,
}

const fn of_reply(name: &'static str, case: &'static str, reply: relay::OnReply) -> Fault {
    Fault { name, hooks: Hooks { reply, ..Hooks::HONEST }, link: Link::Tcp, case }
}

const fn of_request(name: &'static str, link: Link, case: &'static str, request: relay::OnRequest) -> Fault {
    Fault { name, hooks: Hooks { request, ..Hooks::HONEST }, link, case }
}

const fn of_line(name: &'static str, case: &'static str, line: fn(&str) -> String) -> Fault {
    Fault { name, hooks: Hooks { line, ..Hooks::HONEST }, link: Link::Tcp, case }
}

const fn of_bytes(
    name: &'static str,
    link: Link,
    case: &'static str,
    bytes: fn(&mut relay::Memory, Vec<u8>) -> Vec<u8>,
) -> Fault {
    Fault { name, hooks: Hooks { bytes, ..Hooks::HONEST }, link, case }
}

/// Replaces the value of a reply if it is of this kind.
fn with_value(mut frame: TestFrame, change: impl Fn(&Value) -> Option<Value>) -> Vec<u8> {
    if let Some(value) = frame.args.first_mut() {
        *value = change(value).unwrap_or(value.clone());
    }
    frame.to_wire(false)
}

/// Replaces a code.
fn with_code(frame: TestFrame, from: HResult, to: HResult) -> Vec<u8> {
    let code = if frame.code == from.0 { to.0 } else { frame.code };
    TestFrame { code, ..frame }.to_wire(false)
}

fn is_command(request: &TestFrame, name: &str) -> bool {
    F(request.code) == F::ROBOT_EXECUTE && request.args.get(1) == Some(&Value::text(name))
}

/// Changes bytes of the encoded reply.
fn patched(frame: &TestFrame, change: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = frame.to_wire(false);
    change(&mut bytes);
    bytes
}

/// Whether a motion runs on the device that serves one client at a time.
static IS_MOVING: AtomicBool = AtomicBool::new(false);

/// Locked by the device while it waits for the rest of a frame; it serves no other client during that time.
static HALF_FRAME: Mutex<()> = Mutex::new(());

/// Waits until the motion runs, or has ended.
fn wait_for_motion(is_moving: bool) {
    let until = Instant::now() + Duration::from_secs(10);
    while IS_MOVING.load(Ordering::SeqCst) != is_moving && Instant::now() < until {
        thread::sleep(Duration::from_millis(5));
    }
}

/// A motion of one client delays the call 65999 of another client.
const ONE_CLIENT_AT_A_TIME: Hooks = Hooks {
    request: |_, frame| {
        if is_command(&frame, "DriveEx") {
            IS_MOVING.store(true, Ordering::SeqCst);
        }
        if F(frame.code) == F(65_999) {
            wait_for_motion(true);
            wait_for_motion(false);
            // the relay sends the reply to the motion first
            thread::sleep(Duration::from_millis(20));
        }
        Some(frame)
    },
    reply: |_, request, frame| {
        if is_command(request, "DriveEx") && HResult(frame.code) != HResult::S_EXECUTING {
            IS_MOVING.store(false, Ordering::SeqCst);
        }
        frame.to_wire(false)
    },
    ..Hooks::HONEST
};

const FAULTS: &[Fault] = &[
    Fault {
        name: "a motion delays another client",
        hooks: ONE_CLIENT_AT_A_TIME,
        link: Link::Tcp,
        case: "timeouts/others-during-a-motion",
    },
    of_bytes("half a frame delays another client", Link::Tcp, "timeouts/pause-of-another-client", |_, bytes| {
        let _others_wait = HALF_FRAME.lock().unwrap();
        if bytes.len() == 6 {
            thread::sleep(Duration::from_secs(1));
        }
        bytes
    }),
    of_request("keep-alives without WDT", Link::Tcp, "timeouts/no-keep-alive-without-wdt", |_, mut frame| {
        if F(frame.code) == F::SERVICE_START {
            frame.args = vec![Value::text("WDT=500")];
        }
        Some(frame)
    }),
    of_reply("serial plus one", "frames/minimal-request", |_, _, frame| {
        TestFrame { serial: frame.serial.wrapping_add(1), ..frame }.to_wire(false)
    }),
    of_reply("serial of 8 bits", "frames/serial-256", |_, _, frame| {
        TestFrame { serial: frame.serial & 0xff, ..frame }.to_wire(false)
    }),
    of_reply("serial is big-endian", "frames/serial-4660", |_, _, frame| {
        TestFrame { serial: frame.serial.swap_bytes(), ..frame }.to_wire(false)
    }),
    of_reply("serial of 15 bits", "frames/serial-65535", |_, _, frame| {
        TestFrame { serial: frame.serial & 0x7fff, ..frame }.to_wire(false)
    }),
    of_reply("reserved field is the serial", "frames/minimal-request", |_, _, frame| {
        TestFrame { reserved: frame.serial, ..frame }.to_wire(false)
    }),
    of_reply("length one too large", "frames/minimal-request", |_, _, frame| {
        patched(&frame, |bytes| bytes[field::LENGTH.start] += 1)
    }),
    of_reply("length one too small", "frames/minimal-request", |_, _, frame| {
        patched(&frame, |bytes| bytes[field::LENGTH.start] -= 1)
    }),
    of_reply("wrong last byte", "frames/minimal-request", |_, _, frame| {
        patched(&frame, |bytes| *bytes.last_mut().unwrap() = 3)
    }),
    of_reply("a checksum, as on serial lines", "frames/minimal-request", |_, _, frame| {
        patched(&frame, |bytes| {
            let end = bytes.len() - 1;
            bytes.splice(end..end, [0x12, 0x34]);
            bytes[field::LENGTH.start] += 2;
        })
    }),
    of_reply("wrong number of arguments", "sessions/connect-and-disconnect", |_, _, frame| {
        patched(&frame, |bytes| bytes[field::COUNT.start] += 1)
    }),
    of_reply("argument length one too large", "variables/type-of-i", |_, request, frame| match F(request.code) {
        F::VARIABLE_GET_VALUE => patched(&frame, |bytes| bytes[field::ARGUMENT.start] += 1),
        _ => frame.to_wire(false),
    }),
    of_reply("a value with a void reply", "frames/minimal-request", |_, request, frame| match F(request.code) {
        F::SERVICE_START => TestFrame { args: vec![Value::I4(1)], ..frame }.to_wire(false),
        _ => frame.to_wire(false),
    }),
    of_reply("handle as BSTR", "sessions/connect-and-disconnect", |_, request, frame| match F(request.code) {
        F::CONTROLLER_CONNECT => with_value(frame, |_| Some(Value::text("2"))),
        _ => frame.to_wire(false),
    }),
    of_reply("I as I2", "variables/type-of-i", |_, request, frame| match F(request.code) {
        F::VARIABLE_GET_VALUE => with_value(frame, |value| matches!(value, Value::I4(_)).then_some(Value::I2(1))),
        _ => frame.to_wire(false),
    }),
    of_reply("F as R8", "variables/type-of-f", |_, request, frame| match F(request.code) {
        F::VARIABLE_GET_VALUE => with_value(frame, |value| value.as_f64().map(|number| Value::R8(number.to_bits()))),
        _ => frame.to_wire(false),
    }),
    of_reply("P with 6 elements", "variables/type-of-p", |_, _, frame| {
        with_value(frame, |value| match value {
            Value::Array(4, items) if items.len() == 7 => Some(Value::Array(4, items[..6].to_vec())),
            _ => None,
        })
    }),
    of_reply("letters above 127 are lost", "types/bstr-kanji", |_, _, frame| {
        with_value(frame, |value| match value {
            Value::Bstr(units) => Some(Value::Bstr(units.iter().map(|unit| (*unit).min(0x7f)).collect())),
            _ => None,
        })
    }),
    of_reply("I4 without sign", "types/i4-minus-1", |_, request, frame| match F(request.code) {
        F::VARIABLE_GET_VALUE => with_value(frame, |value| match value {
            Value::I4(number) => Some(Value::I4(number & 0x7fff_ffff)),
            _ => None,
        }),
        _ => frame.to_wire(false),
    }),
    of_reply("never S_EXECUTING", "timeouts/keep-alives-of-a-motion", |_, _, frame| match HResult(frame.code) {
        HResult::S_EXECUTING => Vec::new(),
        _ => frame.to_wire(false),
    }),
    of_reply("S_EXECUTING with the serial 0", "timeouts/keep-alives-of-a-motion", |_, _, frame| {
        match HResult(frame.code) {
            HResult::S_EXECUTING => TestFrame { serial: 0, ..frame }.to_wire(false),
            _ => frame.to_wire(false),
        }
    }),
    of_reply("S_EXECUTING before each reply", "timeouts/quick-call-without-keep-alive", |_, _, frame| {
        let executing = TestFrame { code: HResult::S_EXECUTING.0, args: Vec::new(), ..frame.clone() };
        [executing.to_wire(false), frame.to_wire(false)].concat()
    }),
    of_reply("every reply twice", "timeouts/silence-after-a-reply", |_, _, frame| {
        [frame.to_wire(false), frame.to_wire(false)].concat()
    }),
    of_reply("E_FAIL for an invalid handle", "handles/zero", |_, _, frame| {
        with_code(frame, HResult::E_HANDLE, HResult::E_FAIL)
    }),
    of_reply("success for an invalid handle", "handles/use-after-release", |_, _, frame| {
        with_code(frame, HResult::E_HANDLE, HResult::S_OK)
    }),
    of_reply("success without arguments", "arguments/missing/Controller_GetVariable", |_, _, frame| {
        with_code(frame, HResult::E_INVALIDARG, HResult::S_OK)
    }),
    of_reply("success with an argument of another type", "arguments/variable-name-is-number", |_, _, frame| {
        with_code(frame, HResult::E_INVALIDARGTYPE, HResult::S_OK)
    }),
    of_reply("success of an unknown function", "frames/function-65536", |_, request, frame| match F(request.code) {
        F(65_536) => TestFrame { code: 0, ..frame }.to_wire(false),
        _ => frame.to_wire(false),
    }),
    of_reply("a short WDT is accepted", "sessions/option-wdt-79", |_, request, frame| match F(request.code) {
        F::SERVICE_START => TestFrame { code: 0, ..frame }.to_wire(false),
        _ => frame.to_wire(false),
    }),
    of_reply("handle of an open object is given again", "handles/two-of-one-name", |memory, request, frame| {
        match F(request.code) {
            F::CONTROLLER_GET_VARIABLE => {
                memory.handle = memory.handle.clone().or(frame.args.first().cloned());
                let first = memory.handle.clone();
                with_value(frame, |_| first.clone())
            }
            _ => frame.to_wire(false),
        }
    }),
    of_reply("slvGetMode is always 0", "slave/enter-2-j", |_, request, frame| {
        match is_command(request, "slvGetMode") {
            true => with_value(frame, |_| Some(Value::I4(0))),
            false => frame.to_wire(false),
        }
    }),
    of_reply("never S_BUF_FULL", "slave/buffer-fills-in-mode-0", |_, _, frame| {
        with_code(frame, HResult::S_BUF_FULL, HResult::S_OK)
    }),
    of_reply("E_BUF_FULL is success", "slave/buffer-overflows-in-mode-0", |_, _, frame| {
        with_code(frame, HResult::E_BUF_FULL, HResult::S_OK)
    }),
    of_request("a write is not executed", Link::Tcp, "variables/write-i", |_, frame| match F(frame.code) {
        // becomes another call that succeeds without a value
        F::VARIABLE_PUT_VALUE => Some(TestFrame { code: F::VARIABLE_PUT_TAG.0, ..frame }),
        _ => Some(frame),
    }),
    of_request("names are case-sensitive", Link::Tcp, "variables/name-in-lower-case", |_, mut frame| {
        if F(frame.code) == F::CONTROLLER_GET_VARIABLE && frame.args.get(1) == Some(&Value::text("i1")) {
            frame.args[1] = Value::text("NoSuchVariable");
        }
        Some(frame)
    }),
    of_request("every name is I1", Link::Tcp, "variables/unknown-name", |_, mut frame| {
        if F(frame.code) == F::CONTROLLER_GET_VARIABLE && frame.args.len() == 3 {
            frame.args[1] = Value::text("I1");
        }
        Some(frame)
    }),
    of_request("a retransmission over UDP is executed again", Link::Udp, "udp/copy-of-release", |_, frame| {
        Some(TestFrame { reserved: frame.serial, ..frame })
    }),
    of_request("a retransmission over UDP opens a second object", Link::Udp, "udp/copy-of-open", |_, frame| {
        Some(TestFrame { reserved: frame.serial, ..frame })
    }),
    Fault {
        name: "a marker alone makes a copy",
        hooks: Hooks {
            reply: |memory, request, frame| match F(request.code) {
                F::CONTROLLER_GET_VARIABLE => {
                    memory.handle = frame.args.first().cloned();
                    frame.to_wire(false)
                }
                F::VARIABLE_GET_VALUE if request.reserved != request.serial => {
                    let handle = memory.handle.clone();
                    with_value(frame, |_| handle.clone())
                }
                _ => frame.to_wire(false),
            },
            ..Hooks::HONEST
        },
        link: Link::Udp,
        case: "udp/same-serial-other-function",
    },
    Fault {
        name: "a datagram of 500 bytes",
        hooks: Hooks {
            reply: |_, request, frame| match F(request.code) {
                F::CONTROLLER_GET_VARIABLE_NAMES => {
                    let names = Value::Array(8, vec![Value::text(&"a".repeat(235))]);
                    TestFrame { code: 0, args: vec![names], ..frame }.to_wire(false)
                }
                _ => frame.to_wire(false),
            },
            ..Hooks::HONEST
        },
        link: Link::Udp,
        case: "udp/reply-of-488-bytes",
    },
    of_request("a retransmission over UDP is not answered", Link::Udp, "udp/copy-of-start", |_, frame| {
        [0, frame.serial].contains(&frame.reserved).then_some(frame)
    }),
    of_request("a length with a sign bit is awaited for ever", Link::Tcp, "types/bstr-16384-characters", |_, frame| {
        (frame.to_wire(false).len() < 1 << 15).then_some(frame)
    }),
    of_request("a length of 17 bits is awaited for ever", Link::Tcp, "types/bstr-65536-characters", |_, frame| {
        (frame.to_wire(false).len() < 1 << 16).then_some(frame)
    }),
    of_bytes("an incomplete frame is lost", Link::Tcp, "frames/pieces-after-the-header", |_, bytes| {
        let is_complete = field::length(&bytes).is_some_and(|length| length as usize == bytes.len());
        if is_complete { bytes } else { Vec::new() }
    }),
    of_bytes(
        "only the first frame of a segment is served",
        Link::Tcp,
        "frames/two-frames-in-one-segment",
        |_, mut bytes| {
            bytes.truncate(bytes.get(1).map_or(0, |length| usize::from(*length)));
            bytes
        },
    ),
    of_bytes("an invalid frame is ignored without an answer", Link::Tcp, "frames/wrong-end", |_, bytes| {
        match bytes.last() {
            Some(4) => bytes,
            _ => Vec::new(),
        }
    }),
    of_bytes("an invalid datagram ends the service", Link::Udp, "frames/wrong-end", |memory, bytes| {
        memory.had_invalid |= TCP.decode_packet(&bytes).is_none();
        if memory.had_invalid { Vec::new() } else { bytes }
    }),
    of_line("the answer ends with LF", "rac/get-i", |line| line.replace('\r', "\n")),
    of_line("an I is of type 2", "rac/get-i", |line| line.replace("0,3,", "0,2,")),
    of_line("no error in an answer", "rac/unknown-command", |line| {
        if line.starts_with('-') { "0\r".into() } else { line.into() }
    }),
    of_line("a J with 6 numbers", "rac/get-j", |line| match line.split(',').count() {
        10 => format!("{}\r", line.trim_end().rsplitn(3, ',').last().unwrap_or_default()),
        _ => line.into(),
    }),
];

/// Runs one case of level `motion` against the controller behind a relay, and returns the verdict and the text of the result.
fn judged(served: &Served<Controller>, hooks: Hooks, link: Link, case: &str) -> (Verdict, String) {
    judged_until(served, hooks, link, Level::Motion, case, || false)
}

/// Runs one case at a level until `ended` returns true.
fn judged_until(
    served: &Served<Controller>,
    hooks: Hooks,
    link: Link,
    level: Level,
    case: &str,
    ended: impl Fn() -> bool,
) -> (Verdict, String) {
    let relay = Relay::start(hooks, served.tcp, served.udp, served.rac);
    let target = bcap_conform::Target {
        bcap: Some((link, if link == Link::Tcp { relay.tcp } else { relay.udp })),
        rac: Some(relay.rac),
    };
    let timeout = std::time::Duration::from_secs(2);
    let options = Options { level, cases: vec![case.into()], timeout, ..Options::new(target) };
    let report = run(&options, |_| (), ended);
    let [result] = report.results.as_slice() else { panic!("no case is named {case}") };
    (result.verdict, result.text())
}

#[test]
fn every_planted_fault_is_caught_by_its_case() {
    let found = |fault: &Fault| {
        let served = rc8(100.0);
        let (honest, text) = judged(&served, Hooks::HONEST, fault.link, fault.case);
        assert_eq!(honest, Verdict::Pass, "without the fault {:?}: {text}", fault.name);
        let (verdict, text) = judged(&served, fault.hooks, fault.link, fault.case);
        println!("{}: {}\n{text}", fault.name, fault.case);
        (fault.name, fault.case, verdict)
    };
    // a judge is idle most of the time
    let missed: Vec<_> = thread::scope(|scope| {
        let group = |faults: &'static [Fault]| scope.spawn(move || faults.iter().map(found).collect::<Vec<_>>());
        let groups: Vec<_> = FAULTS.chunks(3).map(group).collect();
        groups.into_iter().flat_map(|group| group.join().unwrap()).filter(|found| found.2 != Verdict::Fail).collect()
    });
    assert_eq!(missed, []);
    let names: BTreeSet<_> = FAULTS.iter().map(|fault| fault.name).collect();
    // the number in docs/conformance.md
    assert_eq!((names.len(), FAULTS.len()), (53, 53));
}

#[test]
fn a_wrong_reply_during_a_motion_leaves_the_robot_as_it_was() {
    let served = rc8(40.0);
    let before = state(&served);
    let reply: relay::OnReply = |_, _, frame| match HResult(frame.code) {
        HResult::S_EXECUTING => TestFrame { serial: 0, ..frame }.to_wire(false),
        _ => frame.to_wire(false),
    };
    let hooks = Hooks { reply, ..Hooks::HONEST };
    let (verdict, text) = judged(&served, hooks, Link::Tcp, "timeouts/keep-alives-of-a-motion");
    assert_eq!(verdict, Verdict::Fail, "{text}");
    assert_restored(&before, &served, &text);
}

#[test]
fn a_motion_that_is_too_short_for_keep_alives_does_not_pass() {
    let served = rc8(100.0);
    let request: relay::OnRequest = |_, mut frame| {
        if is_command(&frame, "ExtSpeed") {
            frame.args[2] = Value::Array(5, vec![Value::R8(100.0_f64.to_bits()); 3]);
        }
        Some(frame)
    };
    let reply: relay::OnReply = |_, _, frame| match HResult(frame.code) {
        HResult::S_EXECUTING => Vec::new(),
        _ => frame.to_wire(false),
    };
    let hooks = Hooks { request, reply, ..Hooks::HONEST };
    // skipped; it fails on a machine that is too busy for a short motion
    let (verdict, text) = judged(&served, hooks, Link::Tcp, "timeouts/keep-alives-of-a-motion");
    assert_ne!(verdict, Verdict::Pass, "{text}");
}

#[test]
fn a_motion_that_is_too_short_for_keep_alives_without_wdt_does_not_pass() {
    let served = rc8(100.0);
    // each motion becomes a call that only reads
    let request: relay::OnRequest = |_, mut frame| {
        if is_command(&frame, "DriveEx") {
            (frame.args[1], frame.args[2]) = (Value::text("CurJnt"), Value::Empty);
        }
        Some(frame)
    };
    let hooks = Hooks { request, ..Hooks::HONEST };
    // a busy machine may take 400 ms for such a call once
    let skips = |_| judged(&served, hooks, Link::Tcp, "timeouts/no-keep-alive-without-wdt").0 == Verdict::Skip;
    assert!((0..3).any(skips));
}

#[test]
fn after_an_interruption_no_motion_begins() {
    static IS_ENDED: AtomicBool = AtomicBool::new(false);
    static MOTIONS: AtomicUsize = AtomicUsize::new(0);
    let served = rc8(40.0);
    let before = state(&served);
    let request: relay::OnRequest = |_, frame| {
        if is_command(&frame, "Motor") {
            IS_ENDED.store(true, Ordering::SeqCst);
        }
        if is_command(&frame, "DriveEx") || is_command(&frame, "DriveAEx") {
            MOTIONS.fetch_add(1, Ordering::SeqCst);
        }
        Some(frame)
    };
    let hooks = Hooks { request, ..Hooks::HONEST };
    let ended = || IS_ENDED.load(Ordering::SeqCst);
    let case = "timeouts/no-keep-alive-without-wdt";
    let (verdict, text) = judged_until(&served, hooks, Link::Tcp, Level::Motion, case, ended);
    assert_eq!((verdict, MOTIONS.load(Ordering::SeqCst)), (Verdict::Skip, 0), "{text}");
    assert!(text.contains("interrupted"), "{text}");
    assert_restored(&before, &served, &text);
}

/// Commands that change the state of the controller need level `motion`, even commands to clear the errors that a case has
/// caused.
#[test]
fn a_case_that_reads_clears_no_errors() {
    static HAS_ERROR: AtomicBool = AtomicBool::new(false);
    static COMMANDS: Mutex<Vec<Value>> = Mutex::new(Vec::new());
    let request: relay::OnRequest = |_, frame| {
        if [F::CONTROLLER_EXECUTE, F::ROBOT_EXECUTE].contains(&F(frame.code)) {
            COMMANDS.lock().unwrap().extend(frame.args.get(1).cloned());
        }
        Some(frame)
    };
    // the first GetCurErrorCount is refused, and its code is the error of the controller from then on
    let reply: relay::OnReply = |_, request, frame| {
        let is =
            |name: &str| F(request.code) == F::CONTROLLER_EXECUTE && request.args.get(1) == Some(&Value::text(name));
        let code = HResult::E_SLVMODE_ON.0;
        let (code, args) = if is("GetCurErrorInfo") {
            (0, vec![Value::Array(12, vec![Value::I4(code), Value::text("")])])
        } else if !is("GetCurErrorCount") {
            (frame.code, frame.args)
        } else if HAS_ERROR.swap(true, Ordering::SeqCst) {
            (0, vec![Value::I4(1)])
        } else {
            (code, vec![])
        };
        TestFrame { code, args, ..frame }.to_wire(false)
    };
    let hooks = Hooks { request, reply, ..Hooks::HONEST };
    let served = rc8(100.0);
    for (level, clears) in [(Level::Read, false), (Level::Write, false), (Level::Motion, true)] {
        HAS_ERROR.store(false, Ordering::SeqCst);
        COMMANDS.lock().unwrap().clear();
        let (verdict, text) = judged_until(&served, hooks, Link::Tcp, level, "variables/error-count", || false);
        assert_eq!(verdict, Verdict::Fail, "{text}");
        let sent = |name: &str| COMMANDS.lock().unwrap().contains(&Value::text(name));
        assert_eq!((sent("ClearError"), sent("ManualResetPreparation")), (clears, clears), "{level:?}: {text}");
    }
}

#[test]
fn a_value_that_equals_a_handle_is_no_repeated_reply() {
    // the handle of the controller is 2, the handles of the variables are 3 and 4
    for (value, verdict) in [(3, Verdict::Pass), (4, Verdict::Skip)] {
        let served = rc8(100.0);
        assert_eq!(answer_of(served.rac, &format!("PUT:RC8:1:I:3,{value}\r")), "0\r");
        let (found, text) = judged(&served, Hooks::HONEST, Link::Udp, "udp/same-serial-other-function");
        assert_eq!(found, verdict, "I1 is {value}: {text}");
    }
}

#[test]
fn a_device_without_the_object_of_a_case_over_udp_is_skipped() {
    let served = rc8(100.0);
    let no_variables: relay::OnReply = |_, request, frame| match F(request.code) {
        F::CONTROLLER_GET_VARIABLE => {
            TestFrame { code: HResult::E_CAO_OBJECT_NOTFOUND.0, args: vec![], ..frame }.to_wire(false)
        }
        F::CONTROLLER_GET_VARIABLE_NAMES => {
            TestFrame { code: HResult::E_NOTIMPL.0, args: vec![], ..frame }.to_wire(false)
        }
        _ => frame.to_wire(false),
    };
    let hooks = Hooks { reply: no_variables, ..Hooks::HONEST };
    for case in ["udp/reserved-0-means-serial", "udp/reply-of-488-bytes"] {
        let (verdict, text) = judged(&served, hooks, Link::Udp, case);
        assert_eq!(verdict, Verdict::Skip, "{text}");
    }
}

/// A device that closes the connection when it has read the length of a large frame.
#[test]
fn a_large_frame_may_be_refused_by_its_length() {
    let served = rc8(100.0);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for mut client in listener.incoming().map(Result::unwrap) {
            let mut head = [0; 5];
            if client.read_exact(&mut head).is_ok() && field::length(&head).is_some_and(|length| length <= 4096) {
                let mut server = TcpStream::connect(served.tcp).unwrap();
                server.write_all(&head).unwrap();
                copy(server.try_clone().unwrap(), client.try_clone().unwrap(), address, None);
                copy(client, server, address, None);
            }
        }
    });
    for case in ["types/bstr-65536-characters", "types/nested-150000-deep"] {
        let target = bcap_conform::Target { bcap: Some((Link::Tcp, address)), rac: None };
        let report = run(&Options { cases: vec![case.into()], ..Options::new(target) }, |_| {}, || false);
        assert_eq!(report.count(Verdict::Pass), 1, "{:?}", report.results);
    }
}

/// Sends a line to a port of RAC, and returns the answer.
fn answer_of(address: SocketAddr, line: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    stream.write_all(line.as_bytes()).unwrap();
    let mut answer: Vec<u8> = Vec::new();
    while !answer.ends_with(b"\r") {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        answer.extend(byte);
    }
    String::from_utf8(answer).unwrap()
}

/// Runs a case of RAC without b-CAP while I49 is 7. Returns the text of its failure, and whether I49 is 7 after it.
fn failure_over_rac(hooks: Hooks, case: &str) -> (String, bool) {
    let served = rc8(100.0);
    assert_eq!(answer_of(served.rac, "PUT:RC8:49:I:3,7\r"), "0\r");
    let relay = Relay::start(hooks, served.tcp, served.udp, served.rac);
    let target = bcap_conform::Target { bcap: None, rac: Some(relay.rac) };
    let timeout = Duration::from_secs(1);
    let options = Options { level: Level::Write, cases: vec![case.into()], timeout, ..Options::new(target) };
    let report = run(&options, |_| (), || false);
    let [result] = report.results.as_slice() else { panic!("no case is named {case}") };
    assert_eq!(result.verdict, Verdict::Fail, "{}", result.text());
    (result.text(), answer_of(served.rac, "GET:RC8:49:I:\r") == "0,3,7\r")
}

#[test]
fn a_variable_is_restored_over_rac_after_a_failure() {
    let no_answer: fn(&str) -> String = |line| if line.contains("-123") { String::new() } else { line.into() };
    let hooks = Hooks { line: no_answer, ..Hooks::HONEST };
    let (text, is_restored) = failure_over_rac(hooks, "rac/put-i");
    assert!(is_restored && !text.contains("not restored"), "{text}");
    let hooks =
        Hooks { bytes: |_, bytes| if bytes.starts_with(b"PUT:RC8:49:I:3,7\r") { Vec::new() } else { bytes }, ..hooks };
    let (text, is_restored) = failure_over_rac(hooks, "rac/put-i");
    assert!(!is_restored && text.contains("the variable was not restored"), "{text}");
    let hooks = Hooks {
        bytes: |_, bytes| if bytes.ends_with(b":I:3,x\r") { b"PUT:RC8:49:I:3,9\r".to_vec() } else { bytes },
        ..Hooks::HONEST
    };
    let (text, is_restored) = failure_over_rac(hooks, "rac/put-of-a-word");
    assert!(is_restored && !text.contains("not restored"), "{text}");
}

#[test]
fn a_task_that_starts_with_an_error_is_stopped() {
    let served = rc8(100.0);
    let reply: relay::OnReply = |_, request, frame| match F(request.code) {
        F::TASK_START => with_code(frame, HResult::S_OK, HResult::E_FAIL),
        _ => frame.to_wire(false),
    };
    let (verdict, text) = judged(&served, Hooks { reply, ..Hooks::HONEST }, Link::Tcp, "tasks/start-and-stop");
    assert_eq!(verdict, Verdict::Skip, "{text}");
    // a task that still runs would skip the case
    let (verdict, text) = judged(&served, Hooks::HONEST, Link::Tcp, "tasks/start-and-stop");
    assert_eq!(verdict, Verdict::Pass, "{text}");
}

#[test]
fn a_task_that_does_not_start_does_not_pass() {
    let served = rc8(100.0);
    let request: relay::OnRequest = |_, mut frame| {
        if F(frame.code) == F::TASK_START {
            // a call that succeeds and starts nothing
            (frame.code, frame.args) = (F::TASK_GET_NAME.0, frame.args[..1].to_vec());
        }
        Some(frame)
    };
    let reply: relay::OnReply = |_, request, frame| match F(request.code) {
        F::TASK_START => TestFrame { args: vec![], ..frame }.to_wire(false),
        _ => frame.to_wire(false),
    };
    let hooks = Hooks { request, reply, ..Hooks::HONEST };
    let (verdict, text) = judged(&served, hooks, Link::Tcp, "tasks/start-and-stop");
    assert_eq!(verdict, Verdict::Skip, "{text}");
    assert!(text.contains("the program had ended before its status was read"), "{text}");
}

#[test]
fn a_session_that_stops_answering_is_replaced_to_switch_the_motor_off() {
    let served = rc8(40.0);
    let before = state(&served);
    let request: relay::OnRequest = |memory, frame| {
        // from then on the device answers nothing on this connection
        memory.had_invalid |= is_command(&frame, "slvChangeMode");
        (!memory.had_invalid).then_some(frame)
    };
    let hooks = Hooks { request, ..Hooks::HONEST };
    let (verdict, text) = judged(&served, hooks, Link::Tcp, "slave/enter-2-j");
    assert_eq!(verdict, Verdict::Fail, "{text}");
    assert_eq!(state(&served), before, "{text}");
}

/// A device in front of a correct device; it ends connections.
struct Ending {
    address: SocketAddr,
    /// The motions that it received.
    motions: Arc<AtomicUsize>,
    connections: Arc<AtomicUsize>,
}

impl Ending {
    /// Accepts a connection only if `accepts` returns true for the numbers of earlier connections and motions. Ends a
    /// connection at its first motion.
    fn start(device: SocketAddr, accepts: impl Fn(usize, usize) -> bool + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (motions, connections) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let ending = Self { address, motions: Arc::clone(&motions), connections: Arc::clone(&connections) };
        thread::spawn(move || {
            for client in listener.incoming() {
                let client = client.unwrap();
                if accepts(connections.fetch_add(1, Ordering::SeqCst), motions.load(Ordering::SeqCst)) {
                    let (motions, device) = (Arc::clone(&motions), TcpStream::connect(device).unwrap());
                    thread::spawn(move || relay_until_a_motion(&client, &device, &motions));
                }
            }
        });
        ending
    }

    fn judge(&self, level: Level, case: &str) -> (Verdict, String) {
        let target = bcap_conform::Target { bcap: Some((Link::Tcp, self.address)), rac: None };
        let timeout = std::time::Duration::from_secs(2);
        let options = Options { level, cases: vec![case.into()], timeout, ..Options::new(target) };
        let report = run(&options, |_| (), || false);
        let [result] = report.results.as_slice() else { panic!("no case is named {case}") };
        (result.verdict, result.text())
    }
}

fn relay_until_a_motion(mut client: &TcpStream, mut device: &TcpStream, motions: &AtomicUsize) {
    let name: Vec<u8> = "DriveEx".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let (mut from, mut to) = (device.try_clone().unwrap(), client.try_clone().unwrap());
    thread::spawn(move || {
        let _ = std::io::copy(&mut from, &mut to);
        let _ = to.shutdown(Shutdown::Both);
    });
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = client.read(&mut buffer) {
        let _ = device.write_all(&buffer[..count]);
        if buffer[..count].windows(name.len()).any(|part| part == name) {
            motions.fetch_add(1, Ordering::SeqCst);
            break;
        }
    }
    let _ = (client.shutdown(Shutdown::Both), device.shutdown(Shutdown::Both));
}

#[test]
fn a_motion_whose_connection_ends_is_not_repeated() {
    let served = rc8(100.0);
    // the connections of the halt and of the last session are refused
    let refused = AtomicUsize::new(0);
    let accepts = move |_, motions| motions == 0 || refused.fetch_add(1, Ordering::SeqCst) >= 12;
    let device = Ending::start(served.tcp, accepts);
    let (verdict, text) = device.judge(Level::Motion, "timeouts/keep-alives-of-a-motion");
    assert_eq!((verdict, device.motions.load(Ordering::SeqCst)), (Verdict::Fail, 1), "{text}");
    assert!(text.contains("axis 6 is not turned back"), "{text}");
}

#[test]
fn a_device_that_ends_every_connection_gets_few() {
    let served = rc8(100.0);
    for case in [
        "sessions/start-and-stop",
        "sessions/two-clients",
        "frames/wrong-end",
        "frames/wrong-start",
        "frames/pieces-after-the-header",
        "timeouts/quick-call-without-keep-alive",
    ] {
        let device = Ending::start(served.tcp, |_, _| false);
        let (verdict, text) = device.judge(Level::Read, case);
        // one connection with the bytes of the case, then a first call and its five repetitions
        let connections = device.connections.load(Ordering::SeqCst);
        assert!(verdict == Verdict::Fail && connections <= 7, "{case}: {connections} connections: {text}");
    }
}

#[test]
fn a_device_that_loses_its_slots_fails() {
    let served = rc8(100.0);
    let device = Ending::start(served.tcp, |connections, _| connections < 20);
    let (verdict, text) = device.judge(Level::Read, "sessions/one-after-another");
    assert_eq!(verdict, Verdict::Fail, "{text}");
}

/// Serves a controller through connections that close, as after a crash, when a request ends with 0x05 instead of 0x04. Then
/// the port stays closed until `restarts` returns true.
fn crashing(robot: SocketAddr, restarts: impl Fn() -> bool + Send + 'static) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        let mut listener = Some(listener);
        while let Some(life) = listener.take() {
            let crashed = Arc::new(AtomicUsize::new(0));
            let mut ends = Vec::new();
            while crashed.load(Ordering::SeqCst) == 0 {
                let (client, server) = (life.accept().unwrap().0, TcpStream::connect(robot).unwrap());
                ends.extend([client.try_clone().unwrap(), server.try_clone().unwrap()]);
                copy(server.try_clone().unwrap(), client.try_clone().unwrap(), address, None);
                copy(client, server, address, Some(Arc::clone(&crashed)));
            }
            // first, so that a client that sees the end of its connection cannot connect again
            drop(life);
            ends.iter().for_each(|end| drop(end.shutdown(Shutdown::Both)));
            listener = restarts().then(|| bound(address));
        }
    });
    address
}

/// Binds a port again, which may not be free immediately.
fn bound(address: SocketAddr) -> TcpListener {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        match TcpListener::bind(address) {
            Ok(listener) => return listener,
            Err(error) => assert!(Instant::now() < until, "{address}: {error}"),
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// Copies bytes until one end closes, or until bytes crash the device, which is then woken by a new connection.
fn copy(mut from: TcpStream, mut to: TcpStream, device: SocketAddr, crashed: Option<Arc<AtomicUsize>>) {
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if let Some(crashed) = crashed.as_ref().filter(|_| count >= 16 && bytes[count - 1] == 5) {
                crashed.store(1, Ordering::SeqCst);
                let _ = TcpStream::connect(device);
                return;
            }
            if to.write_all(&bytes[..count]).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}

#[test]
fn a_device_that_crashes_and_restarts_has_no_false_failures() {
    let served = rc8(100.0);
    let device = crashing(served.tcp, || {
        thread::sleep(Duration::from_millis(500));
        true
    });
    let target = bcap_conform::Target { bcap: Some((Link::Tcp, device)), rac: None };
    let report = run(&Options { groups: vec![Group::Frames], ..Options::new(target) }, |_| {}, || false);
    assert_eq!(report.crashes, ["frames/wrong-end"], "{:?}", report.failures().collect::<Vec<_>>());
    let others: Vec<_> = report.failures().filter(|name| *name != "frames/wrong-end").collect();
    assert_eq!((others, report.unreachable), (vec![], false));
    let frames = bcap_conform::cases().iter().filter(|case| case.group() == Group::Frames).count();
    assert_eq!(report.results.len(), frames);
}

#[test]
fn a_device_that_crashes_for_good_ends_the_run() {
    let served = rc8(100.0);
    let device = crashing(served.tcp, || false);
    let target = bcap_conform::Target { bcap: Some((Link::Tcp, device)), rac: None };
    let wait = Duration::from_millis(100);
    let report = run(&Options { wait, groups: vec![Group::Frames], ..Options::new(target) }, |_| {}, || false);
    assert_eq!((report.crashes, report.unreachable), (vec!["frames/wrong-end".to_owned()], true));
    assert_eq!(report.results.last().map(|result| result.name.as_str()), Some("frames/wrong-end"));
}

#[test]
fn a_device_that_crashes_is_started_by_the_command_a_limited_number_of_times() {
    let served = rc8(100.0);
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("conform-restart");
    let _ = std::fs::remove_file(&file);
    let report = |restarts| {
        let waited = file.clone();
        let device = crashing(served.tcp, move || {
            while std::fs::remove_file(&waited).is_err() {
                thread::sleep(Duration::from_millis(5));
            }
            true
        });
        let target = bcap_conform::Target { bcap: Some((Link::Tcp, device)), rac: None };
        let restart = Some(format!("touch '{}'", file.display()));
        run(&Options { restart, restarts, groups: vec![Group::Frames], ..Options::new(target) }, |_| {}, || false)
    };
    let started = report(1);
    assert_eq!((&started.crashes[..], started.unreachable), (&["frames/wrong-end".to_owned()][..], false));
    // the case passes if the device ends the connection before it closes its port: a permitted refusal
    assert!(started.failures().all(|name| name == "frames/wrong-end"));
    let frames = bcap_conform::cases().iter().filter(|case| case.group() == Group::Frames).count();
    assert_eq!(started.results.len(), frames);
    let ended = report(0);
    assert_eq!((ended.crashes, ended.unreachable), (vec!["frames/wrong-end".to_owned()], true));
}

/// Serves a controller over UDP until a request ends with 0x05 instead of 0x04; then it answers nothing until `restarts`
/// returns true.
fn crashing_over_udp(robot: SocketAddr, restarts: impl Fn() -> bool + Send + 'static) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap();
    thread::spawn(move || {
        let (mut clients, mut bytes) = (HashMap::new(), [0; 65_535]);
        while let Ok((count, client)) = socket.recv_from(&mut bytes) {
            if count >= 16 && bytes[count - 1] == 5 {
                clients.clear();
                if !restarts() {
                    return;
                }
                continue;
            }
            let server = clients.entry(client).or_insert_with(|| {
                let server = UdpSocket::bind("127.0.0.1:0").unwrap();
                server.connect(robot).unwrap();
                let (from, here) = (server.try_clone().unwrap(), socket.try_clone().unwrap());
                thread::spawn(move || {
                    let mut bytes = [0; 65_535];
                    while let Ok(count) = from.recv(&mut bytes) {
                        let _ = here.send_to(&bytes[..count], client);
                    }
                });
                server
            });
            let _ = server.send(&bytes[..count]);
        }
    });
    address
}

#[test]
fn a_device_over_udp_that_stops_answering_is_named_and_started_again() {
    let served = rc8(100.0);
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("conform-restart-udp");
    let _ = std::fs::remove_file(&file);
    for restarts in [1, 0] {
        let waited = file.clone();
        let device = crashing_over_udp(served.udp, move || {
            while std::fs::remove_file(&waited).is_err() {
                thread::sleep(Duration::from_millis(5));
            }
            true
        });
        let target = bcap_conform::Target { bcap: Some((Link::Udp, device)), rac: None };
        let restart = Some(format!("touch '{}'", file.display()));
        let options = Options { restart, restarts, groups: vec![Group::Frames], ..Options::new(target) };
        let report = run(&Options { timeout: Duration::from_secs(1), ..options }, |_| {}, || false);
        assert_eq!(report.failures().collect::<Vec<_>>(), ["frames/wrong-end"]);
        assert_eq!((report.crashes, report.unreachable), (vec!["frames/wrong-end".to_owned()], restarts == 0));
        let frames = bcap_conform::cases().iter().filter(|case| case.group() == Group::Frames).count();
        assert_eq!(report.results.len() == frames, restarts == 1);
    }
}

#[test]
fn a_device_that_crashes_in_a_case_of_rac_is_named() {
    let served = rc8(100.0);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for client in listener.incoming().map(Result::unwrap) {
            let mut line = [0; 4096];
            let count = client.peek(&mut line).unwrap_or_default();
            if line[..count].starts_with(b"SET") {
                return;
            }
            let server = TcpStream::connect(served.rac).unwrap();
            copy(server.try_clone().unwrap(), client.try_clone().unwrap(), address, None);
            copy(client, server, address, None);
        }
    });
    let target = bcap_conform::Target { bcap: Some((Link::Tcp, served.tcp)), rac: Some(address) };
    let wait = Duration::from_millis(100);
    let report = run(&Options { wait, groups: vec![Group::Rac], ..Options::new(target) }, |_| {}, || false);
    assert_eq!((report.crashes, report.unreachable), (vec!["rac/unknown-command".to_owned()], true));
    // a device without RAC skips the cases
    let target = bcap_conform::Target { bcap: Some((Link::Tcp, served.tcp)), rac: Some(address) };
    let report = run(&Options { wait, groups: vec![Group::Rac], ..Options::new(target) }, |_| {}, || false);
    assert_eq!((report.crashes.len(), report.unreachable, report.failures().count()), (0, false, 0));
}
