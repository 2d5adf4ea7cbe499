//! Serial lines: `bcap --robot serial:PATH` and `bcap sim --serial PATH`, at the two ends of a cable.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::time::Duration;

use crate::common::running::Running;
use crate::common::{Run, bare, bcap, bcap_with, command};
use bcap_sim::{Config, Controller, Profile};
use bcap_tests::cable::{Cable, End, Quality};
use bcap_tests::hooked::Hooked;
use bcap_tests::line_server::LineServer;
use bcap_tests::process::{Signal, send};
use bcap_tests::pty::Line;
use bcap_tests::real_time::repeated;
use bcap_tests::slowed::Slowed;

/// Starts a virtual controller at the end of a cable.
fn sim(cable: &Cable, more: &[&str]) -> Running {
    let line = format!("{}?baud=115200", cable.path(End::Controller).display());
    Running::of(bare(&[&["sim", "--serial", &line], more].concat()).stderr(Stdio::piped()))
}

#[track_caller]
fn done(run: Run) -> String {
    assert_eq!((run.err.as_str(), run.code), ("", 0), "{}", run.out);
    run.out
}

#[test]
fn variables_are_written_and_read_over_a_serial_line() {
    let line = Line::to(Controller::new(Config::new(Profile::Rc8)), 1, 0);
    let robot = line.address();
    let [put, get, doctor] = [["put", "I1", "42"].as_slice(), &["get", "I1"], &["doctor"]]
        .map(|command| bcap(&[command, &["--robot", &robot]].concat()));
    assert_eq!((put.code, get.code), (0, 0), "{put:?} {get:?}");
    assert!(get.out.contains("42"), "{get:?}");
    assert!(doctor.code != 0 && doctor.err.contains("serial lines are not supported by this command"), "{doctor:?}");
}

#[test]
fn a_device_that_does_not_exist_is_named_with_a_hint() {
    let run = bcap(&["get", "I1", "--robot", "serial:/dev/no-such-line"]);
    assert!(run.err.contains("cannot open serial:/dev/no-such-line?baud=115200: No such file"), "{run:?}");
    assert!(run.err.contains("check the name and the permissions of the device"), "{run:?}");
    let run = command(&["sim", "--serial", "/dev/no-such-line", "--no-network"]).output().unwrap().into();
    let Run { out, err, code } = run;
    assert_eq!((out.as_str(), code), ("", 3), "{err}");
    assert!(err.contains("cannot open serial:/dev/no-such-line?baud=115200: No such file"), "{err}");
}

#[test]
fn the_virtual_controller_serves_a_serial_line_and_its_sockets() {
    let cable = Cable::new(Quality::default());
    let files = tempfile::tempdir().unwrap();
    let free = ["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
    let sim = self::sim(&cable, &[&free[..], &["--files", files.path().to_str().unwrap()]].concat());
    let path = cable.path(End::Controller).display().to_string();
    assert!(sim.ready.ends_with(&format!(" serial={path}?baud=115200\n")), "{}", sim.ready);
    let tcp = sim.bcap.clone();
    let robot = cable.address(115_200);
    let run = |args: &[&str]| bcap(&[args, &["--robot", &robot]].concat());

    done(run(&["put", "I1=42", "S2=over the line"]));
    assert_eq!(done(bcap(&["get", "I1", "S2", "--robot", &tcp])), "I1 = 42\nS2 = over the line\n");
    done(run(&["exec", "robot", "CurJnt"]));
    done(run(&["call", "ControllerGetName", "controller"]));
    let halted = run(&["move", "J(5, 45, 90, 0, 45, 0)"]);
    assert_eq!((halted.out.as_str(), halted.code), ("at J(5, 45, 90, 0, 45, 0)\n", 0), "{halted:?}");

    let local = files.path().join("local.txt");
    fs::write(&local, "a small file").unwrap();
    done(run(&["cp", local.to_str().unwrap(), "robot:/copy.txt"]));
    assert_eq!(fs::read_to_string(files.path().join("copy.txt")).unwrap(), "a small file");
    let large = files.path().join("large.bin");
    fs::write(&large, [0xff; 1000]).unwrap();
    let refused = run(&["cp", large.to_str().unwrap(), "robot:/large2.bin"]);
    assert!(refused.code == 2 && refused.err.contains("use TCP for larger values"), "{refused:?}");

    let script = "put I1 7\nexpect I1 = 7\nexec robot TakeArm 0 1\nexec robot GiveArm\n";
    let script = bcap_with(&["run", "-", "--robot", &robot], script.as_bytes());
    assert_eq!(script.code, 0, "{script:?}");
}

#[test]
fn the_virtual_controller_survives_unplugging() {
    let mut cable = Cable::new(Quality::default());
    let mut sim = self::sim(&cable, &["--no-network"]);
    let path = cable.path(End::Controller).display().to_string();
    assert_eq!(sim.ready, format!("ready serial={path}?baud=115200\n"));
    let robot = cable.address(115_200);
    let run = |args: &[&str]| bcap(&[args, &["--robot", &robot]].concat());
    done(run(&["put", "I1", "1"]));
    for round in 1..=2 {
        cable.unplug(End::Controller);
        let lost = sim.error_line();
        assert!(lost.contains(&format!("serial:{path}?baud=115200 is lost")), "{lost}");
        cable.plug(End::Controller);
        let again = sim.error_line();
        assert!(again.contains(&format!("serial:{path}?baud=115200 is open again")), "{again}");
        assert_eq!(done(run(&["get", "I1"])), format!("I1 = {round}\n"));
        done(run(&["put", "I1", &(round + 1).to_string()]));
    }
}

/// The client whose line was unplugged releases nothing itself: the controller gives its arm back.
#[test]
fn an_unplugged_client_loses_the_arm() {
    let mut cable = Cable::new(Quality::default());
    let mut sim = self::sim(&cable, &["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"]);
    let tcp = sim.bcap.clone();
    let mut shell = bare(&["shell", "--robot", &cable.address(115_200)]);
    let mut shell = shell.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = shell.stdin.take().unwrap();
    lines.write_all(b"exec robot TakeArm 0 1\nget I1\n").unwrap();
    let mut out = BufReader::new(shell.stdout.take().unwrap());
    let mut line = String::new();
    while !line.contains("I1 = 0") {
        line.clear();
        assert!(out.read_line(&mut line).unwrap() > 0, "the shell ended");
    }
    let take = ["exec", "robot", "TakeArm", "0", "1", "--robot", &tcp];
    assert_eq!(bcap(&take).code, 1);
    cable.unplug(End::Controller);
    assert!(sim.error_line().contains("is lost"));
    // the refusal is an error
    assert_eq!(bcap(&["errors", "--clear", "--robot", &tcp]).code, 0);
    assert_eq!(bcap(&take).code, 0);
    cable.plug(End::Controller);
    drop(lines);
    shell.wait().unwrap();
}

/// No other session can halt the motion over a line, so it is halted when the arm is given back.
#[test]
fn ctrl_c_during_a_motion_over_a_line_says_that_the_robot_was_halted() {
    let cable = Cable::new(Quality::default());
    let sim = LineServer::start(Hooked::new(Controller::new(Config::new(Profile::Rc8))), &cable.path(End::Controller));
    let (begun, waits) = std::sync::mpsc::channel();
    sim.handler().set(move |request| {
        if request.value(1).as_bstr().is_some_and(|name| name == "I2") {
            // without a receiver the test has already received it
            let _ = begun.send(());
        }
        None
    });
    let mut child = bare(&["run", "-", "--robot", &cable.address(115_200)]);
    let mut child = child.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = "exec robot TakeArm 0 1\nexec robot Motor 1 0\n\
                 move 'J(90, 45, 90, 0, 45, 0)' --speed 1 --no-wait\nwait I2 = 1\n";
    child.stdin.as_mut().unwrap().write_all(lines.as_bytes()).unwrap();
    waits.recv_timeout(Duration::from_secs(60)).unwrap();
    send(Signal::INT, &child);
    let run = Run::from(child.wait_with_output().unwrap());
    assert!(run.err.contains("interrupted: the robot was halted, and the arm was given back"), "{run:?}");
    assert_eq!(run.code, 130);
    let controller = &sim.handler().inner;
    assert_eq!((controller.arm_owner(), controller.is_moving()), (None, false));
    assert!(controller.joints()[0] < 89.0, "{:?}", controller.joints());
}

#[test]
fn the_serial_options_are_checked() {
    for (args, part) in [
        (&["sim", "--no-network"][..], "--serial"),
        (&["sim", "--serial", "/dev/ttyS0?baud=1"], "\"1\" is not a baud rate"),
        (&["sim", "--serial", "/dev/ttyS0", "--no-network", "--bcap", "127.0.0.1:0"], "cannot be used with"),
        (&["sim", "--serial", "/dev/ttyS0", "--write", "x.pcapng"], "a serial line has no packets to record"),
    ] {
        let run = bcap(args);
        assert!(run.code == 2 && run.err.contains(part), "{args:?}: {run:?}");
    }
}

/// A slow controller. Its cycle is 40 ms, half of the 80 ms after which `bcap slave` treats a reply as lost.
fn slow() -> Slowed<5> {
    Slowed(Controller::new(Config::new(Profile::Rc8)))
}

#[test]
fn a_line_that_is_too_slow_for_slave_mode_is_refused_before_anything_moves() {
    let cable = Cable::new(Quality::default());
    let sim = LineServer::start(slow(), &cable.path(End::Controller));
    let run = bcap(&["slave", "cosine", "--yes", "--robot", &cable.address(115_200)]);
    let part =
        "together 226 bytes of 10 bits, which are 2260 bits and take 19.6 ms at 115200 baud; a pose is sent every 8 ms";
    assert!(run.code == 2 && run.err.contains(part), "{run:?}");
    assert_eq!(cable.passed().bytes, 0);
    assert!(!sim.handler().0.motor_is_on());
}

/// Streams a cosine over a cable of 921600 baud.
fn stream<H: bcap_core::bcap::server::Handler + Send + 'static>(cable: &Cable, controller: H, seconds: &str) -> Run {
    let _sim = LineServer::start(controller, &cable.path(End::Controller));
    let report = ["--json", "--robot", &cable.address(921_600)];
    bcap(&[&["slave", "cosine", "--yes", "--seconds", seconds, "--amplitude", "10"][..], &report].concat())
}

#[test]
fn slave_mode_streams_over_a_fast_line() {
    repeated(|| {
        let cable = Cable::new(Quality { baud: Some(921_600), ..Quality::default() });
        let run = stream(&cable, slow(), "1");
        assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
        let report: serde_json::Value = serde_json::from_str(&run.out).unwrap();
        assert!(report["cycles"].as_u64().unwrap() >= 125 && report["underflows"] == 0, "{report}");
    });
}

#[test]
#[ignore = "measures a stream in real time: `just serial`"]
fn slave_mode_streams_in_real_time_over_a_line_of_921600_baud() {
    let cable = Cable::new(Quality { baud: Some(921_600), ..Quality::default() });
    let run = stream(&cable, Controller::new(Config::new(Profile::Rc8)), "10");
    println!("{}{:?}", run.out, cable.passed());
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    let report: serde_json::Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!(report["underflows"], 0, "{report}");
}

#[test]
fn slave_mode_stops_on_ctrl_c_over_a_line_and_refuses_a_motion_that_nothing_could_halt() {
    let cable = Cable::new(Quality { baud: Some(921_600), ..Quality::default() });
    let _sim = LineServer::start(slow(), &cable.path(End::Controller));
    let robot = cable.address(921_600);
    for start in [&["cosine", "--from", "J1"][..], &["play", "path.csv", "--approach"]] {
        let run = bcap(&[&["slave"], start, &["--yes", "--robot", &robot]].concat());
        assert!(run.code == 2 && run.err.contains("a serial line carries one session"), "{run:?}");
    }
    repeated(interrupted_stream);
}

fn interrupted_stream() {
    let cable = Cable::new(Quality { baud: Some(921_600), ..Quality::default() });
    let sim = LineServer::start(slow(), &cable.path(End::Controller));
    let robot = cable.address(921_600);
    let args = ["slave", "cosine", "--yes", "--seconds", "60", "--robot", &robot];
    let mut stream = bare(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while sim.handler().0.slave_record().count() < 50 && stream.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    if stream.try_wait().unwrap().is_none() {
        send(Signal::INT, &stream);
    }
    let run = Run::from(stream.wait_with_output().unwrap());
    assert!(run.code == 130 && run.err.contains("the robot has stopped and the arm is released"), "{run:?}");
    assert!(!run.err.contains("Ctrl-C again halts"), "{run:?}");
    let controller = &sim.handler().0;
    assert_eq!((controller.slave_mode(), controller.arm_owner(), controller.is_moving()), (0, None, false));
}
