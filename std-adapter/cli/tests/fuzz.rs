//! `bcap fuzz`: finds planted bugs, finds no bugs in the virtual controller, and sends no calls that move the robot.

use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::common::planted::{Bug, Planted};
use crate::common::running::Running;
use crate::common::{Run, bare, bcap};
use bcap_core::bcap::{FunctionId, Object};
use bcap_testkit::step::{Argument, Call, Step};
use serde_json::Value;

const MINE: &str = "--yes-this-device-is-mine";

/// In the options of a test: over UDP.
const DATAGRAMS: &str = "datagrams";

/// An empty folder for findings.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

/// Fuzzes a device; the findings are in a folder with this name.
fn fuzz(device: &Planted, name: &str, more: &[&str]) -> Run {
    let folder = folder(name);
    let is_udp = more.contains(&DATAGRAMS);
    let more: Vec<_> = more.iter().copied().filter(|word| *word != DATAGRAMS).collect();
    let robot = if is_udp { &device.udp } else { &device.bcap };
    let fixed = ["fuzz", "--robot", robot, "--robot-rac", &device.rac, MINE, "--rate", "0"];
    let out = ["--out", folder.to_str().unwrap()];
    bare(&[&fixed, &out[..], &more].concat()).output().unwrap().into()
}

/// Returns the findings and the totals of a run with `--json`.
fn lines(run: &Run) -> (Vec<Value>, Value) {
    let mut lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let totals = lines.pop().unwrap_or_else(|| panic!("{run:?}"));
    (lines, totals)
}

#[test]
fn without_a_confirmation_nothing_is_sent() {
    let device = Planted::start(Bug::None);
    let run = bcap(&["fuzz", "--robot", &device.bcap, "--runs", "1"]);
    assert_eq!((run.code, device.calls()), (2, vec![]), "{run:?}");
    assert!(run.err.contains(MINE), "{run:?}");
}

/// Asserts that all functions only read, except Execute if the gate permits its commands.
fn assert_gated(calls: &[FunctionId], may_execute: bool) {
    let is_gated = |function: &FunctionId| {
        let name = function.to_string();
        let is_known = function.signature().is_some();
        !is_known
            || name.contains("_Get")
            || name.ends_with("_Release")
            || name.starts_with("Service_")
            || ["Controller_Connect", "Controller_Disconnect"].contains(&&*name)
            || (may_execute && function.commands().any(|command| command.properties.effect.is_harmless()))
    };
    assert_eq!(calls.iter().filter(|function| !is_gated(function)).collect::<Vec<_>>(), [&FunctionId(0); 0]);
}

#[test]
fn a_device_without_a_bug_has_no_finding_and_gets_only_calls_that_read() {
    let device = Planted::start(Bug::None);
    let run = fuzz(&device, "none", &["--runs", "150", "--duration", "10min", "--timeout", "30000"]);
    assert_eq!(run.code, 0, "{run:?}");
    assert!(run.out.starts_with("seed 1: 150 sessions, ") && run.out.contains(" 0 findings in "), "{run:?}");
    let calls = device.calls();
    assert!(calls.len() > 1000, "{}", calls.len());
    assert_gated(&calls, true);
    assert!(calls.contains(&FunctionId::CONTROLLER_GET_FILE) && calls.contains(&FunctionId::ROBOT_EXECUTE));
}

#[test]
fn a_device_without_a_bug_has_no_finding_over_udp() {
    let device = Planted::start(Bug::None);
    let run = fuzz(&device, "datagrams", &[DATAGRAMS, "--runs", "150", "--duration", "10min", "--timeout", "30000"]);
    assert_eq!(run.code, 0, "{run:?}");
    assert!(run.out.starts_with("seed 1: 150 sessions, ") && run.out.contains(" 0 findings in "), "{run:?}");
    assert!(device.calls().len() > 500, "{}", device.calls().len());
    assert_gated(&device.calls(), true);
    assert!(device.joined().len() > 100, "{}", device.joined().len());
    assert_gated(&device.joined(), false);
}

#[test]
fn a_lost_datagram_is_retransmitted_with_another_serial() {
    let device = Planted::start(Bug::LosesDatagrams);
    let run = fuzz(&device, "lost", &[DATAGRAMS, "--runs", "20", "--duration", "10min", "--timeout", "2500"]);
    assert_eq!(run.code, 0, "{run:?}");
    let (lost, retransmitted) = device.lost();
    assert!(lost > 0 && retransmitted >= lost, "{lost} lost, {retransmitted} retransmitted");
}

#[test]
fn a_slow_call_that_may_act_is_sent_once() {
    let (device, folder) = (Planted::start(Bug::SlowExecute), folder("slow"));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("slow.steps");
    let step = |function, arguments: Vec<Argument>| Step::Call(Call::new(function, arguments));
    let text = |text: &str| Argument::Value(bcap_testkit::value::Value::text(text));
    let steps = [
        step(FunctionId::SERVICE_START, vec![text("")]),
        step(FunctionId::CONTROLLER_EXECUTE, vec![Argument::Handle(Object::Controller), text("SysState"), text("")]),
    ];
    std::fs::write(&file, steps.map(|step| format!("{step}\n")).concat()).unwrap();
    let again = ["--again", file.to_str().unwrap(), "--timeout", "5000"];
    let run = bcap(&[&["fuzz", "--robot", &device.udp, "--robot-rac", &device.rac, MINE], &again[..]].concat());
    assert!(run.out.contains("hang: Controller_Execute: no reply within 5000 ms"), "{run:?}");
    let executed = device.calls().into_iter().filter(|function| *function == FunctionId::CONTROLLER_EXECUTE);
    assert_eq!(executed.count(), 1);
}

#[test]
fn a_refused_connection_of_rac_is_retried() {
    let device = Planted::start(Bug::BusyRac);
    let limits = ["--runs", "40", "--duration", "10min", "--timeout", "20000"];
    let run = fuzz(&device, "busy", &[&limits[..], &["--reconnect", "5s"]].concat());
    assert_eq!(run.code, 0, "{run:?}");
    let run = fuzz(&device, "busy", &limits);
    assert_eq!(run.code, 1, "{run:?}");
}

#[test]
fn the_same_seed_sends_the_same_calls() {
    let calls = |seed: &str| {
        let device = Planted::start(Bug::None);
        let run = fuzz(&device, &format!("same{seed}"), &["--runs", "20", "--seed", seed, "--timeout", "30000"]);
        assert_eq!(run.code, 0, "{run:?}");
        device.calls()
    };
    let first = calls("5");
    assert_eq!(first, calls("5"));
    assert_ne!(first, calls("6"));
}

#[test]
fn a_finding_is_reduced_saved_and_found_again() {
    let device = Planted::start(Bug::SurrogateResets);
    let run = fuzz(&device, "saved", &["--findings", "1", "--duration", "10min", "--timeout", "5000", "--json"]);
    assert_eq!(run.code, 1, "{run:?}");
    let (findings, totals) = lines(&run);
    let [finding] = &findings[..] else { panic!("{run:?}") };
    assert_eq!(
        (&finding["kind"], &finding["repeatable"], &totals["findings"]),
        (&"reset".into(), &true.into(), &1.into())
    );
    assert!(finding["steps"].as_u64().unwrap() <= 2, "{finding}");
    let file = finding["file"].as_str().unwrap();
    let text = std::fs::read_to_string(file).unwrap();
    assert!(text.starts_with("# bcap fuzz, seed 1, session "), "{text}");
    let capture = finding["capture"].as_str().unwrap();
    let decoded = bcap(&["decode", capture]);
    assert_eq!(decoded.code, 0, "{decoded:?}");
    assert!(decoded.out.contains(finding["subject"].as_str().unwrap()), "{decoded:?}");
    let again =
        |device: &Planted| bcap(&["fuzz", "--robot", &device.bcap, "--robot-rac", &device.rac, MINE, "--again", file]);
    let run = again(&device);
    assert_eq!(run.code, 1, "{run:?}");
    assert!(run.out.contains("the device closes the connection after a valid frame"), "{run:?}");
    let run = again(&Planted::start(Bug::None));
    assert_eq!((run.code, &*run.out), (0, "no finding\n"), "{run:?}");
}

#[test]
fn the_examples_of_the_help_run() {
    let (device, folder) = (Planted::start(Bug::None), folder("examples"));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("finding.steps"), "call Service_Start 08000100000000000000\n").unwrap();
    let help = bcap(&["fuzz", "--help"]).out;
    let (_, examples) = help.split_once("Examples:\n").unwrap();
    let examples: Vec<_> = examples.lines().filter_map(|line| line.trim().strip_prefix("bcap ")).collect();
    assert_eq!(examples.len(), 4, "{help}");
    for example in examples {
        let line = example.replace("udp:192.168.0.1", &device.udp).replace("192.168.0.1", &device.bcap);
        let words: Vec<_> = line.split_whitespace().chain(["--robot-rac", &device.rac, "--timeout", "30000"]).collect();
        let run: Run = bare(&words).current_dir(&folder).output().unwrap().into();
        assert_eq!(run.code, 0, "{example}: {run:?}");
    }
}

#[test]
fn steps_that_move_are_refused_without_the_option() {
    let device = Planted::start(Bug::None);
    let folder = folder("moves");
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("moves.steps");
    std::fs::write(&file, "call Robot_Halt @Robot 08000100000000000000\n").unwrap();
    let args = ["fuzz", "--robot", &device.bcap, "--robot-rac", &device.rac, MINE, "--again", file.to_str().unwrap()];
    let run = bcap(&args);
    assert_eq!(run.code, 2, "{run:?}");
    assert!(run.err.contains("this step may move or write: call Robot_Halt"), "{run:?}");
    assert!(!device.calls().contains(&FunctionId::ROBOT_HALT));
    let run = bcap(&[&args[..], &["--with-motion"]].concat());
    assert_eq!(run.code, 0, "{run:?}");
    assert!(device.calls().contains(&FunctionId::ROBOT_HALT));
}

#[test]
fn writes_reach_only_the_named_range() {
    let sim = Running::sim(&[]);
    let robot = ["--robot", &sim.bcap, "--robot-rac", &sim.rac];
    let get = |name: &str| bcap(&["get", name, "--robot", &sim.bcap]).out;
    assert_eq!(bcap(&["put", "I89", "5", "--robot", &sim.bcap]).code, 0);
    let folder = folder("writes");
    let more = ["--with-writes", "I/90-91", "--rate", "0", "--runs", "60", "--timeout", "30000", "--duration", "10min"];
    let run = bcap(&[&["fuzz", MINE, "--out", folder.to_str().unwrap()], &robot[..], &more].concat());
    assert_eq!(run.code, 0, "{run:?}");
    assert_eq!(get("I89"), "I89 = 5\n");
    assert_ne!((get("I90"), get("I91")), ("I90 = 0\n".into(), "I91 = 0\n".into()));
}

#[test]
fn the_virtual_controller_has_no_finding() {
    for (model, link) in [("rc8", "tcp"), ("rc9", "tcp"), ("rc8", "udp")] {
        let sim = Running::sim(&["--model", model]);
        let folder = folder(&format!("{model}-{link}"));
        let out = ["--out", folder.to_str().unwrap(), "--rate", "0", "--runs", "100", "--duration", "10min"];
        let address = if link == "udp" { format!("udp:{}", sim.udp) } else { sim.bcap.clone() };
        let robot = ["--robot", &address, "--robot-rac", &sim.rac, "--timeout", "30000"];
        let run = bcap(&[&["fuzz", MINE], &robot[..], &out].concat());
        assert_eq!(run.code, 0, "{model} over {link}: {run:?}");
    }
}

/// Fuzzes a device with a planted bug until the first finding; returns it.
fn first_finding(bug: Bug, limits: &[&str]) -> Option<Value> {
    let device = Planted::start(bug);
    let link = if bug.is_of_datagrams() { &[DATAGRAMS][..] } else { &[] };
    let run = fuzz(&device, &format!("{bug:?}"), &[&["--findings", "1", "--json"], limits, link].concat());
    lines(&run).0.into_iter().next()
}

#[test]
fn planted_bugs_are_found() {
    // those that are found in few sessions, of every kind
    for (bug, kind) in [
        (Bug::ArrayCountCrashes, "crash"),
        (Bug::LongStringCrashes, "crash"),
        (Bug::ExtraArgumentHangs, "hang"),
        (Bug::UnknownFunctionResets, "reset"),
        (Bug::NameIsNumber, "wrong-reply"),
        (Bug::LengthIsOffByOne, "wrong-reply"),
        (Bug::NegativeHandleIsValid, "handle"),
        (Bug::HandleLivesOn, "handle"),
        (Bug::ReleaseLeaks, "leak"),
        (Bug::DoubleIsSingle, "wrong-reply"),
        (Bug::LongDatagramCrashes, "crash"),
        (Bug::CutDatagramHangs, "hang"),
        (Bug::RetransmissionIsExecuted, "wrong-reply"),
    ] {
        // a busy machine must not look like a device that hangs, except where the fuzzer waits for bytes that do not arrive
        let waits = kind == "hang" || bug == Bug::LengthIsOffByOne;
        let timeout = if waits { "1500" } else { "20000" };
        let found = first_finding(bug, &["--runs", "400", "--duration", "10min", "--wait", "5s", "--timeout", timeout]);
        let found = found.unwrap_or_else(|| panic!("{bug:?} is not found"));
        assert_eq!(found["kind"], kind, "{bug:?}: {found}");
    }
}

#[test]
fn a_device_that_has_crashed_is_started_by_the_command_a_limited_number_of_times() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz-restart");
    let touch = format!("touch '{}'", file.display());
    let found = |restart: &[&str]| {
        let _ = std::fs::remove_file(&file);
        let device = Planted::start_by_file(Bug::LongStringCrashes, file.clone());
        let limits = ["--runs", "400", "--duration", "10min", "--timeout", "20000", "--findings", "1", "--json"];
        let run = fuzz(&device, "restarted", &[&limits, restart].concat());
        assert_eq!(run.code, 1, "{run:?}");
        let (findings, _) = lines(&run);
        let [finding] = &findings[..] else { panic!("{run:?}") };
        assert_eq!(finding["kind"], "crash", "{finding}");
        (finding["repeatable"].as_bool().unwrap(), finding["steps"].as_u64().unwrap(), run.err)
    };
    let (is_repeatable, steps, _) = found(&["--restart", &touch, "--wait", "20s"]);
    assert_eq!((is_repeatable, steps), (true, 1));
    // the first restart is after the finding; the repetition of its steps needs the second one
    for restarts in [&["--restart", &touch, "--restarts", "1", "--wait", "100ms"][..], &["--wait", "100ms"]] {
        let (is_repeatable, _, note) = found(restarts);
        assert!(!is_repeatable && note.contains("the device has not answered for 100 ms, so the run ends"), "{note}");
    }
}

#[test]
fn a_device_that_repeats_an_old_reply_does_not_keep_the_fuzzer() {
    let limits = ["--runs", "20", "--duration", "10min", "--wait", "5s", "--timeout", "1500"];
    let found = first_finding(Bug::OldReplyRepeats, &limits).unwrap();
    assert_eq!(found["kind"], "wrong-reply", "{found}");
}

/// Prints how long each planted bug takes: `cargo test -p bcap-cli fuzz:: -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes and measures: `just planted`"]
fn the_time_to_find_each_planted_bug() {
    let mut found = 0;
    println!("{:<26} {:<12} {:>8} {:>8} {:>6}  finding", "bug", "kind", "session", "ms", "steps");
    for bug in Bug::ALL.iter().copied() {
        let began = Instant::now();
        let Some(finding) = first_finding(bug, &["--duration", "5min", "--timeout", "800"]) else {
            println!("{:<26} not found in {} s", format!("{bug:?}"), began.elapsed().as_secs());
            continue;
        };
        found += 1;
        let text = |key: &str| finding[key].as_str().unwrap_or_default().to_owned();
        let number = |key: &str| finding[key].as_u64().unwrap_or_default();
        println!(
            "{:<26} {:<12} {:>8} {:>8} {:>6}  {}: {}",
            format!("{bug:?}"),
            text("kind"),
            number("session"),
            number("after_ms"),
            number("steps"),
            text("subject"),
            text("detail")
        );
    }
    println!("{found} of {} found", Bug::ALL.len());
}
