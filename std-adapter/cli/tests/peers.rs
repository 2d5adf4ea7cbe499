//! Hostile peers: terminal control characters, oversized and truncated replies, endless keep-alives.

use std::io::{Read, Write};
use std::net::{TcpListener, UdpSocket};
use std::thread;

use crate::common;
use crate::common::fake::{Answer, Fake, usual, value};
use crate::common::{Run, bcap, bcap_with, command};
use bcap_core::bcap::{Decoder, Frame, FrameWriter, FunctionId, Progress};
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, Writer};
use bcap_sim::{Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::served::Served;
use proptest::prelude::*;
use serde_json::Value;

/// A character of each kind that acts on a terminal or on the text around it, except NUL, which an argument cannot hold.
const ACTING: &str = "\u{1}\t\n\r\u{1b}]0;x\u{7}\u{7f}\u{80}\u{9b}31m\u{9f}\u{61c}\u{200e}\u{200f}\u{2028}\u{2029}\u{202a}\u{202e}\u{2066}\u{2069}";

fn acts(c: char) -> bool {
    let bidirectional = ['\u{61c}', '\u{200e}', '\u{200f}', '\u{2066}', '\u{2067}', '\u{2068}', '\u{2069}'];
    c.is_control() || bidirectional.contains(&c) || ('\u{2028}'..='\u{202e}').contains(&c)
}

/// Checks that the output has no acting character except line breaks.
#[track_caller]
fn assert_inert(run: &Run) {
    for text in [&run.out, &run.err] {
        assert!(!text.chars().any(|c| acts(c) && c != '\n'), "{text:?}");
    }
}

/// Runs the command with and without `--json`, and checks both outputs.
#[track_caller]
fn inert(args: &[&str], code: i32) -> [Run; 2] {
    let runs = [bcap(args), bcap(&[args, &["--json"]].concat())];
    for run in &runs {
        assert_inert(run);
        assert_eq!(run.code, code, "{run:?}");
    }
    for line in runs[1].out.lines() {
        serde_json::from_str::<Value>(line).unwrap();
    }
    runs
}

fn encoded(text: &str) -> String {
    let mut buffer = [0; 4096];
    let mut out = Writer::new(&mut buffer);
    text.encode(&mut out).unwrap();
    let len = out.len();
    buffer[..len].iter().map(|byte| format!("{byte:02x}")).collect()
}

fn acting_peer(request: &Frame<'_>) -> Answer {
    match request.function() {
        FunctionId::VARIABLE_GET_VALUE | FunctionId::CONTROLLER_EXECUTE => value(ACTING),
        FunctionId::CONTROLLER_GET_VARIABLE_NAMES | FunctionId::CONTROLLER_GET_ROBOT_NAMES => value([ACTING, "I1"]),
        _ => usual(request),
    }
}

#[test]
fn names_and_values_do_not_act() {
    let fake = Fake::tcp(acting_peer);
    let robot = ["--robot", &fake.address];
    for args in [
        &["get", "I1"][..],
        &["watch", "I1", "--count", "1"],
        &["exec", "controller", "X"],
        &["call", "ControllerExecute", "controller", "X", "0,"],
    ] {
        let [plain, json] = inert(&[args, &robot[..]].concat(), 0);
        assert_eq!(plain.out.lines().count(), 1, "{}", plain.out);
        assert!(plain.out.contains("\\u{9b}31m") && json.out.contains("\\u009b31m"), "{plain:?} {json:?}");
        let line: Value = serde_json::from_str(&json.out).unwrap();
        assert!(line["v"] == ACTING || line["value"]["v"] == ACTING, "{line}");
    }
    let [plain, json] = inert(&[&["names"], &robot[..]].concat(), 0);
    assert_eq!(plain.out.lines().count(), json.out.lines().count());
    let first: Value = serde_json::from_str(json.out.lines().next().unwrap()).unwrap();
    assert_eq!(first["name"], ACTING);
    // the doctor prints @TYPE and @VERSION
    let [plain, _] = inert(&["doctor", "--robot", &fake.address], 3);
    assert!(plain.out.contains("\\u{9b}31m"), "{}", plain.out);
}

#[test]
fn decoded_text_does_not_act() {
    let hex = encoded(ACTING);
    let [_, json] = inert(&["decode", "--variant", &hex], 0);
    assert_eq!(serde_json::from_str::<Value>(&json.out).unwrap()["v"], ACTING);
    // RAC has no text for a string with a line break
    let text = ACTING.replace(['\r', '\n'], "");
    let [plain, json] = inert(&["decode", "--rac", &encoded(&text)], 0);
    assert!(plain.out.starts_with("8,\\u{1}\\t\\u{1b}]0;x"), "{}", plain.out);
    assert_eq!(serde_json::from_str::<Value>(&json.out).unwrap()["text"], format!("8,{text}"));
    inert(&["decode", "--rac", &hex], 2);
    let mut buffer = [0; 1024];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    frame.argument(ACTING).unwrap();
    let frame = frame.finish(1, 0, 101).unwrap();
    let frame: String = frame.iter().map(|byte| format!("{byte:02x}")).collect();
    inert(&["decode", &frame], 0);
    for args in [&["decode", "-"][..], &["decode", "--json", "-"]] {
        let run = bcap_with(args, frame.as_bytes());
        assert_inert(&run);
        assert_eq!((run.out.lines().count(), run.code), (1, 0));
    }
}

#[test]
fn arguments_in_errors_do_not_act() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_VARIABLE | FunctionId::CONTROLLER_EXECUTE => HResult::E_FAIL.into(),
        _ => usual(request),
    });
    let robot = ["--robot", &fake.address];
    let [plain, json] = inert(&[&["get", ACTING], &robot[..]].concat(), 1);
    assert!(plain.err.contains("\\u{9b}31m"), "{}", plain.err);
    assert_eq!(serde_json::from_str::<Value>(&json.out).unwrap()["name"], ACTING);
    inert(&[&["exec", "controller", ACTING], &robot[..]].concat(), 1);
    inert(&["get", "I1", "--robot", &format!("tcp:{ACTING}:x")], 2);
    inert(&["get", "I1", "--robot", &format!("tcp:{ACTING}")], 3);
    inert(&["rac", "get", ACTING], 2);
    inert(&["call", ACTING], 2);
    for args in [
        &["decode", ACTING][..],
        &["decode", "--rac", "--reverse", ACTING],
        &["decode", "--reverse", ACTING],
        // errors of clap, and of the value parsers that it calls
        &[ACTING],
        &["get", "I1", &format!("--{ACTING}")],
        &["get", "I1", "--timeout", ACTING],
        &["watch", "I1", "--count", ACTING],
        &["gateway", "--allow-put", ACTING],
        &["sim", "--model", ACTING],
    ] {
        let run = bcap(args);
        assert_inert(&run);
        assert_eq!((run.out.as_str(), run.code), ("", 2), "{args:?}: {run:?}");
        assert!(run.err.starts_with("error: ") && run.err.len() < 2000, "{}", run.err);
    }
}

#[cfg(unix)]
#[test]
fn arguments_that_are_not_utf_8_do_not_act() {
    use std::os::unix::ffi::OsStrExt as _;
    let argument = std::ffi::OsStr::from_bytes(b"I1\x1b]\xff\xc2\x9b");
    let run: Run = command(&["get"]).arg(argument).output().unwrap().into();
    assert_inert(&run);
    assert_eq!(run.code, 2);
}

#[test]
fn a_further_line_of_an_error_is_indented() {
    let run = bcap(&["call", "x\nerror: y"]);
    assert!(run.err.starts_with("error: there is no function x\n       error: y"), "{}", run.err);
}

#[test]
fn long_errors_are_truncated() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_EXECUTE => HResult::E_FAIL.into(),
        _ => usual(request),
    });
    let name = "x".repeat(100_000);
    for run in inert(&["exec", "controller", &name, "--robot", &fake.address], 1) {
        assert!(run.err.len() < 1500 && run.err.contains(" more characters)"), "{}", run.err.len());
        assert!(run.out.len() < 1500, "{}", run.out.len());
    }
    for args in [&["get", "I1", "--timeout", &name][..], &["call", &name], &["decode", &name]] {
        let run = bcap(args);
        assert!(run.err.len() < 3000 && run.code == 2, "{args:.40?}: {}", run.err.len());
    }
}

#[test]
fn a_reply_of_a_wrong_type_is_described_by_type_and_size() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_CONNECT => value(&*Vec::leak(vec![0.1_f32; 3_000_000])),
        _ => usual(request),
    });
    for run in inert(&["get", "I1", "--robot", &fake.address], 3) {
        let described = "the reply carries an array of 3000000 VT_R4 in 12000006 bytes instead of a handle";
        assert!(run.err.contains(described) && run.err.len() < 300, "{}", &run.err[..run.err.len().min(500)]);
    }
    let short = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_CONNECT => value("one"),
        _ => usual(request),
    });
    let run = bcap(&["get", "I1", "--robot", &short.address]);
    assert!(run.err.contains("the reply carries \"one\" instead of a handle"), "{}", run.err);
}

/// Text of any characters, with acting characters more frequent than others.
fn text() -> impl Strategy<Value = String> {
    let acting = proptest::sample::select(ACTING.chars().chain(['\0']).collect::<Vec<_>>());
    proptest::collection::vec(prop_oneof![acting, any::<char>()], 0..30).prop_map(String::from_iter)
}

proptest! {
    // one case runs the command four times with a hundred texts
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]

    #[test]
    fn no_text_acts(texts in proptest::collection::vec(text(), 100)) {
        let lines: Vec<String> = texts.iter().map(|text| encoded(text)).collect();
        let input = lines.join("\n");
        for args in [
            &["decode", "--variant", "-"][..],
            &["decode", "--variant", "--json", "-"],
            &["decode", "--rac", "-"],
            &["decode", "--rac", "--json", "-"],
        ] {
            let run = bcap_with(args, input.as_bytes());
            assert_inert(&run);
            prop_assert_eq!(run.out.lines().count(), texts.len(), "{:?}", args);
            if !args.contains(&"--json") {
                continue;
            }
            for (line, text) in run.out.lines().zip(&texts) {
                let line: Value = serde_json::from_str(line).unwrap();
                let is_same = line["v"] == *text || line["text"] == format!("8,{text}");
                // some strings have no text form in RAC
                let is_refused = args.contains(&"--rac") && line["error"].is_string();
                prop_assert!(is_same || is_refused, "{} {:?}", line, text);
            }
        }
    }
}

#[test]
fn an_incomplete_list_over_udp_is_an_error() {
    let sim = Served::of(Controller::new(bcap_sim::Config::new(Profile::Rc8)), Limits::default());
    let tcp = bcap(&["names", "--robot", &format!("tcp:{}", sim.tcp)]);
    assert_eq!((tcp.code, tcp.err.as_str()), (0, ""));
    let udp = bcap(&["names", "--robot", &format!("udp:{}", sim.udp)]);
    assert_eq!(udp.code, 1, "{udp:?}");
    // the lists that do not fit a datagram are reported, the others are complete
    for list in [
        "controller: Controller_GetVariableNames",
        "controller: Controller_GetCommandNames",
        "robot:Arm0: Robot_GetVariableNames",
    ] {
        let refused = format!("error: {list}: the controller refused with 0x80000909 (E_TOO_MUCH_DATA)");
        assert!(udp.err.contains(&refused), "{}", udp.err);
    }
    assert!(udp.err.contains("or use TCP") && udp.err.contains("the output is not complete"), "{}", udp.err);
    let kept: Vec<&str> = tcp.out.lines().filter(|line| udp.out.lines().any(|other| other == *line)).collect();
    assert_eq!(kept, udp.out.lines().collect::<Vec<_>>());
    let missing = tcp.out.lines().filter(|line| !kept.contains(line));
    for line in missing {
        let is_of_the_controller = !line.contains('/') && (!line.contains(':') || line.starts_with("command:"));
        assert!(is_of_the_controller || line.starts_with("robot:Arm0/"), "{line}");
    }
    let json = bcap(&["names", "--json", "--robot", &format!("udp:{}", sim.udp)]);
    assert_eq!(json.out.matches("\"hresult\":\"E_TOO_MUCH_DATA\"").count(), 3, "{}", json.out);
}

#[test]
fn a_refused_list_is_an_error_except_with_e_notimpl() {
    let names = |code: HResult| {
        let fake = Fake::udp(move |request| match request.function() {
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => value(["I1"]),
            FunctionId::CONTROLLER_GET_TASK_NAMES => code.into(),
            _ => usual(request),
        });
        bcap(&["names", "--robot", &fake.address])
    };
    let run = names(HResult::E_NOTIMPL);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("I1\n", "", 0));
    for code in [HResult::E_ACCESSDENIED, HResult::E_FAIL, HResult::E_TOO_MUCH_DATA] {
        let run = names(code);
        assert_eq!((run.out.as_str(), run.code), ("I1\n", 1), "{run:?}");
        assert!(run.err.contains("controller: Controller_GetTaskNames: the controller refused"), "{}", run.err);
    }
}

#[test]
fn a_reply_that_is_not_a_list_of_strings_is_an_error() {
    for odd in [|| value(5), || value([1, 2]), || value(("I1", 5)), || value("I1")] {
        let fake = Fake::tcp(move |request| match request.function() {
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => odd(),
            _ => usual(request),
        });
        let run = bcap(&["names", "--robot", &fake.address]);
        assert_eq!((run.out.as_str(), run.code), ("", 3), "{run:?}");
        assert!(run.err.contains("instead of a list of names"), "{}", run.err);
    }
}

/// Encodes an S_EXECUTING reply to a request.
fn executing(request: &[u8]) -> Vec<u8> {
    let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(request) else { panic!("{request:?}") };
    let mut buffer = [0; 16];
    FrameWriter::new(&mut buffer).unwrap().finish(frame.serial, 0, HResult::S_EXECUTING.0).unwrap().to_vec()
}

/// Starts a server that only sends S_EXECUTING, `at_a_time` replies at once; returns its addresses for TCP and UDP.
fn keeps_alive(at_a_time: usize) -> [String; 2] {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let addresses =
        [format!("tcp:{}", listener.local_addr().unwrap()), format!("udp:{}", socket.local_addr().unwrap())];
    let pace = move || {
        if at_a_time == 1 {
            // frequent enough to keep an attempt alive, but not a flood
            thread::sleep(std::time::Duration::from_millis(25));
        }
    };
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut request = [0; 1024];
            let count = stream.read(&mut request).unwrap();
            let reply = executing(&request[..count]).repeat(at_a_time);
            // until the client disconnects
            while stream.write_all(&reply).is_ok() {
                pace();
            }
        }
    });
    thread::spawn(move || {
        let mut request = [0; 600];
        let (count, client) = socket.recv_from(&mut request).unwrap();
        let reply = executing(&request[..count]);
        // a connected socket reports that the client has ended
        socket.connect(client).unwrap();
        while socket.send(&reply).is_ok() {
            pace();
        }
    });
    addresses
}

#[test]
fn the_timeout_bounds_the_whole_command_while_the_server_keeps_it_alive() {
    for address in keeps_alive(1) {
        let run = bcap(&["get", "I1", "--timeout", "1000", "--robot", &address]);
        assert_eq!((run.out.as_str(), run.code), ("", 4), "{run:?}");
        let limit = "did not answer Service_Start within the command's time limit of 1000 ms (--timeout)";
        assert!(run.err.contains(limit) && run.err.contains("allow more time"), "{}", run.err);
    }
}

#[test]
fn a_flood_of_keep_alives_ends_the_command() {
    for address in keeps_alive(1000) {
        let run = bcap(&["get", "I1", "--timeout", "60s", "--robot", &address]);
        assert_eq!((run.out.as_str(), run.code), ("", 3), "{run:?}");
        assert!(run.err.contains("the peer floods this client"), "{}", run.err);
    }
}

#[test]
fn a_halt_has_a_short_limit_of_its_own() {
    let [tcp, _] = keeps_alive(1);
    let run = Run::from(common::bare(&["halt", "--robot", &tcp]).output().unwrap());
    assert_eq!((run.out.as_str(), run.code), ("", 4));
    assert!(run.err.contains("within the command's time limit of 3000 ms"), "{}", run.err);
}

#[test]
fn calls_share_the_limit_of_the_command() {
    // every call takes half of the limit, so the third call exceeds it
    let fake = Fake::tcp(|request| {
        thread::sleep(std::time::Duration::from_millis(300));
        usual(request)
    });
    let run = bcap(&["get", "I1", "--timeout", "600", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("", 4), "{run:?}");
    assert!(run.err.contains("within the command's time limit of 600 ms (--timeout)"), "{}", run.err);
    assert!(fake.seen().len() < 4, "{:?}", fake.seen());
}

#[test]
fn a_watch_has_the_limit_for_each_round() {
    // each round takes a small part of the limit, and all rounds together exceed it
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => {
            thread::sleep(std::time::Duration::from_millis(300));
            value(1)
        }
        _ => usual(request),
    });
    let run = bcap(&["watch", "I1", "--count", "15", "--interval", "1", "--timeout", "4000", "--robot", &fake.address]);
    assert_eq!((run.out.lines().count(), run.code), (15, 0), "{run:?}");
}

#[test]
fn times_have_units() {
    let fake = Fake::tcp(usual);
    for time in ["30000", "30000ms", "30s", "1min", "86400000"] {
        assert_eq!(bcap(&["call", "ServiceStop", "--timeout", time, "--robot", &fake.address]).code, 0, "{time}");
    }
    for time in ["0", "", "s", "-1", "1.5s", "2 s", "1h", "86400001", "1441min", "99999999999999999999s"] {
        let run = bcap(&["call", "ServiceStop", "--timeout", time, "--robot", &fake.address]);
        assert_eq!(run.code, 2, "{time}");
    }
}
