//! `bcap slave` and `bcap halt` against a virtual controller in the test, which can inspect each cycle.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::common;
use crate::common::fake::{Fake, usual};
use crate::common::{Run, bcap, command};
use bcap_core::bcap::{Decoder, FunctionId};
use bcap_core::hresult::HResult;
use bcap_sim::{Controller, Profile, Scenario, SlaveCycle, TaskStatus};
use bcap_std::server::Limits;
use bcap_tests::process::{Signal, send};
use bcap_tests::proxy::{Cut, Relay};
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::slowed::Slowed;
use serde_json::Value;

/// A controller with a slow clock. Mode 2 paces the command, so a busy machine does not affect the test.
fn controller() -> Served<Slowed> {
    with_serial_number("VIRTUAL")
}

/// A controller that does not say that it is virtual, unless its serial number says so.
fn with_serial_number(serial_number: &str) -> Served<Slowed> {
    let config = bcap_sim::Config {
        motor_on_delay: Duration::from_millis(1),
        serial_number: serial_number.into(),
        ..bcap_sim::Config::new(Profile::Rc8)
    };
    Served::of(Slowed(Controller::new(config)), Limits::default())
}

fn tcp(sim: &Served<Slowed>) -> String {
    format!("tcp:{}", sim.tcp)
}

fn slave(sim: &Served<Slowed>, args: &[&str]) -> Run {
    bcap(&[&["slave"], args, &["--robot", &tcp(sim)]].concat())
}

fn file(name: &str, text: &str) -> String {
    let path = path(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Moves joint 1 at 10 degrees per second after a smooth start; the other joints do not move.
fn ramp(name: &str, seconds: u32) -> String {
    let mut at = 0.0;
    let mut text = String::new();
    for cycle in 0..seconds * 125 {
        text += &format!("{at},45,90,0,45,0\n");
        at += 0.08 * f64::from(cycle + 1).min(50.0) / 50.0;
    }
    file(name, &text)
}

fn cycles(sim: &Served<Slowed>) -> Vec<SlaveCycle> {
    sim.application().0.slave_record().collect()
}

/// The speed of joint 1 in each cycle, in degrees per second of the controller's time.
fn speeds(sim: &Served<Slowed>) -> Vec<f64> {
    cycles(sim).windows(2).map(|pair| (pair[1].axes[0] - pair[0].axes[0]) / 0.008).collect()
}

/// Checks that Slave Mode and the motor are off, the arm is free, the robot does not move, and that this is the first error.
fn assert_at_rest(sim: &Served<Slowed>, first: Option<HResult>) {
    let controller = &sim.application().0;
    assert_eq!((controller.slave_mode(), controller.arm_owner(), controller.is_moving()), (0, None, false));
    assert!(!controller.motor_is_on());
    assert_eq!(controller.errors().last().map(|error| error.code), first);
}

/// Starts to stream a file.
fn play(sim: &Served<Slowed>, file: &str) -> Child {
    let mut stream = command(&["slave", "play", file, "--yes", "--robot", &tcp(sim)]);
    stream.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until the robot moves faster than `least`, and fails if it does not get there.
fn await_speed(sim: &Served<Slowed>, stream: &mut Child, least: f64) {
    let begun = Instant::now();
    while !speeds(sim).last().is_some_and(|speed| *speed > least) {
        if stream.try_wait().unwrap().is_some() {
            panic!("the stream has ended: {}", std::io::read_to_string(stream.stderr.take().unwrap()).unwrap());
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "the robot did not reach {least}");
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_cosine_returns_to_its_start_and_is_reported() {
    repeated(reported_cosine);
}

fn reported_cosine() {
    let sim = controller();
    let (report, plot) = (path("cosine.json"), path("cosine.svg"));
    let files = ["--report", report.to_str().unwrap(), "--plot", plot.to_str().unwrap()];
    let run = slave(&sim, &[&["cosine", "--seconds", "1", "--amplitude", "-4", "--yes"], &files[..]].concat());
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    assert!(run.out.contains("underflows         0") && run.out.contains("up to"), "{}", run.out);

    let text = fs::read_to_string(report).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>().join(" ");
    assert_eq!(keys(&json), "cycles jitter_us late refused rtt_us underflows");
    assert_eq!(
        (keys(&json["rtt_us"]), keys(&json["jitter_us"])),
        ("max p50 p99 p999".into(), "max p50 p99 p999".into())
    );
    // 125 poses, and repetitions of the last pose until the robot has stopped
    let count = json["cycles"].as_u64().unwrap();
    assert!((130..200).contains(&count), "{count}");
    assert_eq!((&json["underflows"], &json["refused"]), (&0.into(), &0.into()));
    assert!(json["rtt_us"]["p50"].as_u64() <= json["rtt_us"]["max"].as_u64(), "{text}");

    let svg = fs::read_to_string(plot).unwrap();
    for word in ["<svg", "J1 commanded", "J1 actual", "J1 commanded - actual", "from answer to answer", "</svg>"] {
        assert!(svg.contains(word), "{word}");
    }
    let lowest = cycles(&sim).iter().map(|cycle| cycle.axes[0]).fold(0.0, f64::min);
    assert!((lowest + 4.0).abs() < 1e-3, "{lowest}");
    assert!(sim.application().0.joints()[0].abs() < 1e-9);
    assert_at_rest(&sim, None);

    // with --json the report is the output
    let run = slave(
        &sim,
        &["cosine", "--seconds", "0.2", "--amplitude", "1", "--mode", "0", "--type", "P", "--yes", "--json"],
    );
    assert_eq!(run.code, 0, "{run:?}");
    assert_eq!(keys(&serde_json::from_str(&run.out).unwrap()), "cycles jitter_us late refused rtt_us underflows");
}

#[test]
fn a_recording_can_be_played() {
    repeated(|| {
        let sim = controller();
        let recorded = path("recorded.csv");
        let recorded = recorded.to_str().unwrap();
        let run = slave(&sim, &["record", recorded, "--seconds", "0.2", "--hz", "50"]);
        assert_eq!((run.code, run.out.as_str()), (0, format!("11 poses in {recorded}\n").as_str()), "{}", run.err);
        let text = fs::read_to_string(recorded).unwrap();
        // without a robot the older recording stays as it is
        let run = bcap(&["slave", "record", recorded, "--robot", "tcp:127.0.0.1:1"]);
        assert_eq!((run.code, fs::read_to_string(recorded).unwrap()), (3, text.clone()), "{run:?}");
        assert!(text.starts_with("t,J1,J2,J3,J4,J5,J6,J7,J8\n0."), "{text}");
        assert!(cycles(&sim).is_empty(), "nothing was moved");

        let run = slave(&sim, &["play", recorded, "--loop", "3", "--yes"]);
        assert_eq!(run.code, 0, "{run:?}");
        assert!(cycles(&sim).iter().filter(|cycle| cycle.took).count() > 3 * 25, "three times 0.2 s");
        assert_at_rest(&sim, None);

        // from another pose the stream is refused without --approach
        let elsewhere = file("elsewhere.csv", "J1,J2,J3,J4,J5,J6\n5,45,90,0,45,0\n5.01,45,90,0,45,0\n");
        let run = slave(&sim, &["play", &elsewhere, "--yes"]);
        assert!(
            run.code == 1 && run.err.contains("the robot is not at the start") && run.err.contains("--approach"),
            "{run:?}"
        );
        let run = slave(&sim, &["play", &elsewhere, "--yes", "--approach", "50"]);
        assert_eq!(run.code, 0, "{run:?}");
        assert!((sim.application().0.joints()[0] - 5.01).abs() < 1e-9);
        assert_at_rest(&sim, None);
    });
}

#[test]
fn nothing_moves_without_confirmation_or_with_an_invalid_file() {
    let sim = with_serial_number("1234567");
    let run = slave(&sim, &["cosine"]);
    assert!(run.code == 2 && run.err.contains("give --yes"), "{run:?}");
    let bad = file("bad.csv", "0,45,90,0,45,0\n0,45,ninety,0,45,0\n");
    let run = slave(&sim, &["play", &bad, "--yes"]);
    assert!(
        run.code == 2 && run.err.contains("bad.csv: line 2: field 3: \"ninety\" is not a finite number"),
        "{run:?}"
    );
    let run = slave(&sim, &["play", "no/such.csv", "--yes"]);
    assert!(run.code == 2 && run.err.contains("cannot read no/such.csv"), "{run:?}");
    assert_eq!(sim.application().0.error_log().count(), 0);
    assert!(!sim.application().0.motor_is_on());

    // a pose that is too fast is found before the arm is taken, also between the last pose and the first
    let jump = file("jump.csv", &("0,45,90,0,45,0\n".repeat(20) + "9,45,90,0,45,0\n"));
    let back = file("back.csv", "0,45,90,0,45,0\n0.5,45,90,0,45,0\n1,45,90,0,45,0\n");
    for (args, problem) in [
        (&["play", &jump, "--yes", "--max-speed", "100"][..], "jump.csv: pose 20: axis 1 would move at 1125"),
        (
            &["play", &jump, "--yes", "--max-acceleration", "100"],
            "jump.csv: pose 20: axis 1 would accelerate by 140625",
        ),
        (&["play", &back, "--yes", "--max-speed", "100", "--loop", "2"], "back.csv: pose 0: axis 1 would move at 125"),
    ] {
        let run = slave(&sim, args);
        assert!(run.code == 2 && run.err.contains(problem), "{run:?}");
    }
    assert!(cycles(&sim).is_empty() && !sim.application().0.motor_is_on());
    assert_at_rest(&sim, None);
}

#[test]
fn the_motor_is_as_it_was_before_the_stream() {
    repeated(|| {
        let sim = controller();
        let stream = ["cosine", "--seconds", "0.2", "--amplitude", "1"];
        let slave = |more: &[&str]| {
            let run = slave(&sim, &[&stream[..], more].concat());
            assert_eq!(run.code, 0, "{run:?}");
        };
        // a virtual controller moves without a question
        slave(&[]);
        assert_at_rest(&sim, None);
        slave(&["--keep-motor"]);
        assert!(sim.application().0.motor_is_on());
        assert_eq!(sim.application().0.arm_owner(), None);
        // a motor that was on stays on
        slave(&[]);
        assert!(sim.application().0.motor_is_on());
    });
}

#[test]
fn the_first_error_is_reported() {
    repeated(|| {
        let sim = controller();
        let text = "[[fault]]\nwhen = { cycle = 40 }\nthen = { error = '0x84204043' }\n";
        sim.application().0.play(Scenario::parse(text).unwrap());
        let report = path("error.json");
        let run = slave(&sim, &["cosine", "--yes", "--report", report.to_str().unwrap()]);
        assert!(run.code == 1 && run.err.contains("the controller's first error is 0x84204043"), "{run:?}");
        assert!(
            fs::read_to_string(report).unwrap().starts_with("{\"cycles\":"),
            "a stream that failed is reported, too"
        );
        assert_at_rest(&sim, Some(HResult::from_u32(0x8420_4043)));
        // a refusal also reports the controller's pending error
        let run = slave(&sim, &["cosine", "--yes"]);
        assert!(run.code == 1 && run.err.contains("TakeArm: refused") && run.err.contains("0x84204043"), "{run:?}");
    });
}

/// On a real controller, the calls that begin a stream would end the running stream, and so would the calls that switch the
/// motor off.
#[test]
fn a_stream_of_another_client_is_not_ended() {
    repeated(|| {
        let sim = controller();
        let ramp = ramp("ramp_other.csv", 60);
        let mut other = play(&sim, &ramp);
        await_speed(&sim, &mut other, 5.0);
        let owner = sim.application().0.arm_owner();
        for args in [&["cosine", "--yes"][..], &["play", &ramp, "--yes"], &["play", &ramp, "--yes", "--approach", "10"]]
        {
            let run = slave(&sim, args);
            assert_eq!(sim.application().0.errors().next().map(|error| error.code), None);
            assert_eq!(run.code, 1, "{run:?}");
            assert!(run.err.contains("a stream of Slave Mode runs") && !run.err.contains("motor"), "{run:?}");
            let controller = &sim.application().0;
            assert!(owner.is_some() && controller.arm_owner() == owner && controller.slave_mode() != 0, "{args:?}");
            assert!(controller.motor_is_on(), "{args:?}");
        }
        send(Signal::INT, &other);
        let ended: Run = other.wait_with_output().unwrap().into();
        assert!(ended.err.contains("the robot has stopped and the arm is released"), "{ended:?}");
        assert_at_rest(&sim, None);
    });
}

/// Over UDP the controller would keep a session that was not ended.
#[test]
fn an_error_before_the_stream_ends_both_sessions() {
    for (core, connects, code) in [("1000000", 2, 2), ("0", 1, 1)] {
        let connected = AtomicU32::new(0);
        let fake = Fake::udp(move |request| match request.function() {
            FunctionId::CONTROLLER_CONNECT if connected.fetch_add(1, Ordering::Relaxed) >= connects => {
                HResult::E_MAX_CONNECT.into()
            }
            _ => usual(request),
        });
        // with the provider no other session looks for it
        let args = ["slave", "cosine", "--yes", "--provider", "rc8", "--core", core, "--robot", &fake.address];
        let run = bcap(&args);
        assert_eq!(run.code, code, "{run:?}");
        let seen = fake.seen();
        let count = |call: &str| seen.iter().filter(|seen| seen.starts_with(call)).count();
        assert_eq!((count("ServiceStart("), count("ServiceStop(")), (2, 2), "{seen:?}");
    }
}

#[test]
fn the_attempts_of_a_stream_over_udp_are_those_of_the_option() {
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = format!("udp:{}", silent.local_addr().unwrap());
    let stream = ["slave", "cosine", "--yes", "--provider", "rc8", "--robot", &address];
    let run = bcap(&[&stream[..], &["--attempts", "2", "--attempt-timeout", "200"]].concat());
    assert_eq!(run.code, 4, "{run:?}");
    silent.set_nonblocking(true).unwrap();
    let (mut starts, mut bytes) = (0, [0; 600]);
    while let Ok(count) = silent.recv(&mut bytes) {
        let frame = Decoder::UDP.decode_datagram(&bytes[..count]).unwrap();
        starts += usize::from(frame.function() == FunctionId::SERVICE_START);
    }
    assert_eq!(starts, 2);
}

#[test]
fn ctrl_c_slows_down_within_the_limits_and_releases_the_arm() {
    repeated(|| {
        let sim = controller();
        let ramp = ramp("ramp.csv", 60);
        let mut child = play(&sim, &ramp);
        await_speed(&sim, &mut child, 9.9);
        send(Signal::INT, &child);
        let mut err = String::new();
        child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{err}");
        assert!(err.contains("stopping") && err.contains("the robot has stopped and the arm is released"), "{err}");

        let speeds = speeds(&sim);
        let limits = sim.application().0.slave_limits();
        let top = speeds.iter().copied().fold(0.0, f64::max);
        assert!((9.9..10.1).contains(&top), "{top}");
        let begin = speeds.iter().rposition(|speed| *speed > top - 0.01).unwrap();
        let falling = &speeds[begin..];
        // a ramp of 200 ms has 25 cycles
        assert!((24..=40).contains(&falling.len()), "{falling:?}");
        assert!(falling.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9), "ever slower: {falling:?}");
        assert!(falling.last().unwrap().abs() < 1e-9, "to rest: {falling:?}");
        for pair in speeds.windows(2) {
            let acceleration = (pair[1] - pair[0]) / 0.008;
            assert!(acceleration.abs() <= limits.acceleration[0].min(55.0), "{pair:?}");
        }
        assert_at_rest(&sim, None);
    });
}

#[test]
#[cfg(target_os = "linux")]
fn a_lost_terminal_stops_a_stream_after_the_motion_to_its_start() {
    repeated(|| {
        let sim = controller();
        let ramp = ramp("ramp4.csv", 60);
        let bcap = command(&["slave", "play", &ramp, "--yes", "--approach", "100", "--robot", &tcp(&sim)]);
        // a test under nohup would hand down that SIGHUP is ignored, which the command respects
        let mut env = Command::new("env");
        env.arg("--default-signal=HUP").arg(bcap.get_program()).args(bcap.get_args());
        for (name, _) in bcap.get_envs() {
            env.env_remove(name);
        }
        let mut child = env.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        await_speed(&sim, &mut child, 9.0);
        send(Signal::HUP, &child);
        let output = child.wait_with_output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(130), "{err}");
        assert!(err.contains("the robot has stopped and the arm is released"), "{err}");
        assert_at_rest(&sim, None);
    });
}

/// Sends a second Ctrl-C when the first was reported, and returns the rest of the standard error.
fn interrupt_twice(child: &mut Child) -> String {
    send(Signal::INT, child);
    let mut err = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    err.read_line(&mut line).unwrap();
    assert!(line.contains("stopping"), "{line}");
    send(Signal::INT, child);
    let mut rest = String::new();
    err.read_to_string(&mut rest).unwrap();
    rest
}

#[test]
fn a_second_ctrl_c_halts_over_its_own_connection() {
    repeated(|| {
        let sim = controller();
        let ramp = ramp("ramp2.csv", 60);
        let mut child = play(&sim, &ramp);
        await_speed(&sim, &mut child, 9.0);
        let rest = interrupt_twice(&mut child);
        assert_eq!(child.wait().unwrap().code(), Some(130), "{rest}");
        assert!(rest.contains("halted"), "{rest}");
        assert_at_rest(&sim, None);
    });
}

#[test]
fn a_halt_that_fails_does_not_hide_the_fault_of_the_stream() {
    repeated(|| {
        let sim = controller();
        let relay = Relay::tcp(sim.tcp);
        let (ramp, address) = (ramp("ramp3.csv", 60), format!("tcp:{}", relay.tcp));
        let mut stream = common::bare(&["slave", "play", &ramp, "--yes", "--timeout", "2s", "--robot", &address]);
        let mut child = stream.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        await_speed(&sim, &mut child, 9.0);
        // neither the stream nor a new connection gets an answer
        relay.cut(Cut::Silent);
        let rest = interrupt_twice(&mut child);
        // without its text, which is the one of a starved stream
        let told =
            ["the halt failed", "the robot was halted", "slvMove: no reply in time"].map(|text| rest.contains(text));
        assert_eq!((told, child.wait().unwrap().code()), ([true, false, true], Some(4)));
    });
}

/// A task that moves the arm to and fro without a pause.
const MOVER: &str = "[controller]\nmotor = true
    [[task]]\nname = 'Mover'\nstart = 2\nsteps = [
        { move = 'J(60, 45, 90, 0, 45, 0)' },
        { move = 'J(-60, 45, 90, 0, 45, 0)' },
    ]\n";

/// Creates a controller that refuses Robot_Halt while its task moves the arm.
fn moved_by_a_task(model: Profile, faults: &str) -> Served<Controller> {
    let mut sim = Controller::new(bcap_sim::Config::new(model));
    sim.play(Scenario::parse(&format!("{MOVER}{faults}")).unwrap());
    Served::of(sim, Limits::default())
}

/// The controller does not have KillAll.
const NO_KILL_ALL: &str = "[[fault]]\nwhen = { every = 1, of = 'KillAll' }\nthen = { refuse = 'E_INVALID_CMD_NAME' }\n";
/// It does not list its tasks either.
const NO_LIST: &str =
    "[[fault]]\nwhen = { every = 1, of = 'Controller_GetTaskNames' }\nthen = { refuse = 'E_NOTIMPL' }\n";

/// Runs `bcap halt` with these arguments while the task moves the arm.
fn halt_task(sim: &Served<Controller>, args: &[&str]) -> Run {
    while !sim.application().is_moving() {
        sim.application().advance(bcap_std::now());
        thread::sleep(Duration::from_millis(1));
    }
    bcap(&[&["halt", "--robot", &format!("tcp:{}", sim.tcp)], args].concat())
}

/// The tasks of the controller continue after KillAll.
const IDLE_KILL_ALL: &str = "[[fault]]\nwhen = { every = 1, of = 'KillAll' }\nthen = { refuse = 'S_OK' }\n";

#[test]
fn halt_stops_the_task_that_owns_the_arm() {
    let answers = [
        ("", "all tasks were stopped (KillAll)", "\"all\""),
        (NO_KILL_ALL, "1 task was stopped (Task_Stop)", "1"),
        (IDLE_KILL_ALL, "1 task was stopped (Task_Stop)", "1"),
    ];
    for model in [Profile::Rc8, Profile::Rc9, Profile::Cobotta, Profile::CobottaPro] {
        for (faults, tasks, json) in answers {
            for (args, out) in [
                (&[][..], format!("halted\n{tasks}\n")),
                (&["--json"][..], format!("{{\"halted\":true,\"tasks\":{json}}}\n")),
            ] {
                let sim = moved_by_a_task(model, faults);
                let provider = if matches!(model, Profile::Rc8 | Profile::Cobotta) {
                    "CaoProv.DENSO.VRC"
                } else {
                    "CaoProv.DENSO.VRC9"
                };
                let run = halt_task(&sim, &[&["--provider", provider], args].concat());
                assert_eq!((run.out.as_str(), run.code), (out.as_str(), 0), "{model:?} {}", run.err);
                assert!(!sim.application().is_moving());
                assert_eq!(sim.application().task("Mover").unwrap().0, TaskStatus::Ready);
            }
        }
    }
}

/// Five tasks of 2.2 s each take longer than any fixed limit of the whole halt.
#[test]
fn a_halt_has_time_for_each_task() {
    let waits: String =
        (1..5).map(|n| format!("[[task]]\nname = 'Wait{n}'\nstart = 2\nsteps = [{{ wait_ms = 60000 }}]\n")).collect();
    let slow = "[[fault]]\nwhen = { every = 1, of = 'Task_Stop' }\nthen = { delay_ms = 2200 }\n";
    let sim = moved_by_a_task(Profile::Rc8, &format!("{waits}{NO_KILL_ALL}{slow}"));
    let run = halt_task(&sim, &[]);
    assert_eq!((run.out.as_str(), run.code), ("halted\n5 tasks were stopped (Task_Stop)\n", 0), "{}", run.err);
    // --timeout limits the whole command, which does not report a halt
    let sim = moved_by_a_task(Profile::Rc8, &format!("{waits}{NO_KILL_ALL}{slow}"));
    let run = halt_task(&sim, &["--timeout", "2500"]);
    assert_eq!((run.out.as_str(), run.code), ("", 4), "{}", run.err);
    assert!(run.err.contains("the robot may still move; use the emergency stop"), "{}", run.err);
}

#[test]
fn a_robot_that_still_moves_is_the_first_line() {
    let sim = moved_by_a_task(Profile::Rc8, &format!("{NO_KILL_ALL}{NO_LIST}"));
    let run = halt_task(&sim, &[]);
    assert_eq!(run.code, 1, "{run:?}");
    let lines: Vec<_> = run.out.lines().collect();
    assert!(matches!(lines[..], ["the robot STILL MOVES", refused] if refused.contains("0x83500079")), "{run:?}");
    assert!(run.err.contains("the robot STILL MOVES") && run.err.contains("use the emergency stop"), "{run:?}");
    let run = halt_task(&sim, &["--json"]);
    let line: Value = serde_json::from_str(run.out.lines().next().unwrap()).unwrap();
    assert!(line["error"].as_str().unwrap().starts_with("the robot STILL MOVES"), "{line}");
    assert_eq!((line["hint"].as_str(), run.code), (Some("use the emergency stop"), 1));
    // the shell and scripts halt over their own session
    let run = common::bcap_with(&["run", "-", "--robot", &format!("tcp:{}", sim.tcp)], b"get I1\nhalt\n");
    assert!(run.code == 1 && run.out.contains("\nthe robot STILL MOVES\n"), "{run:?}");
}

#[test]
fn halt_stops_a_motion_of_another_connection() {
    repeated(|| {
        let sim = controller();
        let halt = || bcap(&["halt", "--robot", &tcp(&sim)]);
        assert_eq!((halt().code, halt().out.as_str()), (0, "nothing was moving\n"));
        let ramp = ramp("ramp5.csv", 60);
        let mut child = play(&sim, &ramp);
        await_speed(&sim, &mut child, 5.0);
        let halted = halt();
        let run: Run = child.wait_with_output().unwrap().into();
        assert!(run.code == 1 && run.err.contains("slvMove: refused with 0x80004004 (E_ABORT)"), "{run:?}");
        assert_eq!((halted.code, halted.out.as_str()), (0, "halted\n"), "{}", halted.err);
        assert_at_rest(&sim, None);
        let run = bcap(&["halt", "--robot", &tcp(&sim), "--json"]);
        assert_eq!(run.out, "{\"halted\":false}\n");
    });
}
