//! `bcap recover` and `bcap move --prepare`: the plan, the steps, the refusals, and the state after every ending.

use std::process::Stdio;
use std::thread;
use std::time::Duration;

use crate::common::robot::Robot;
use crate::common::tmux::Terminal;
use crate::common::{Run, command};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_sim::{Config, Mode, Profile, Scenario};
use bcap_std::Settings;
use bcap_std::blocking::Controller;
use bcap_tests::process::{Signal, send};
use serde_json::{Value, json};

/// A target out of reach.
const REACH: HResult = HResult::from_u32(0x8320_1501);

fn robot(profile: Profile) -> Robot {
    Robot::with(Config { motor_on_delay: Duration::from_millis(1), ..Config::new(profile) })
}

fn failed(profile: Profile) -> Robot {
    let robot = robot(profile);
    raise(&robot, REACH);
    robot
}

fn raise(robot: &Robot, code: HResult) {
    robot.served.application().inject_error(code, bcap_std::now());
}

fn recover(robot: &Robot, more: &[&str]) -> Run {
    robot.run(&[&["recover"], more].concat())
}

/// Returns whether a client owns the arm, whether the motor is on, and the number of errors.
fn state(robot: &Robot) -> (bool, bool, usize) {
    let mut sim = robot.served.application();
    sim.advance(bcap_std::now());
    (sim.arm_owner().is_some(), sim.motor_is_on(), sim.errors().count())
}

fn lines(run: &Run) -> Vec<Value> {
    run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn the_errors_the_plan_and_each_step_are_shown() {
    let robot = failed(Profile::Rc8);
    let run = recover(&robot, &["--yes"]);
    assert_eq!(run.code, 0, "{run:?}");
    let hint = run.out.lines().nth(1).unwrap();
    assert!(run.out.starts_with("0x83201501 ") && hint.starts_with("  hint: "), "{run:?}");
    let rest = "plan     ClearError, TakeArm, Motor\ndone     ClearError\ndone     TakeArm\ndone     Motor\n\
                recovered: no errors, the motor is off again\n";
    assert!(run.out.ends_with(rest), "{run:?}");
    assert_eq!(state(&robot), (false, false, 0));

    raise(&robot, REACH);
    let run = recover(&robot, &["--yes", "--json", "--speed", "5"]);
    let lines = lines(&run);
    assert_eq!((lines[0]["code"].clone(), lines[0]["level"].clone()), (json!(REACH.0), json!(3)));
    assert_eq!(lines[1], json!({ "plan": ["ClearError", "TakeArm", "Motor", "ExtSpeed"], "obstacles": [] }));
    for (line, step) in lines[2..].iter().zip(["ClearError", "TakeArm", "Motor", "ExtSpeed"]) {
        assert_eq!(*line, json!({ "step": step, "result": "done" }));
    }
    assert_eq!(lines[6..], [json!({ "recovered": true, "motor": false })]);
    assert_eq!(state(&robot), (false, false, 0));
}

#[test]
fn errors_are_cleared_only_after_an_answer() {
    // even on a virtual controller
    let faulty = failed(Profile::Rc8);
    let run = recover(&faulty, &[]);
    assert!(run.code == 2 && run.err.contains("give --yes"), "{run:?}");
    assert_eq!(state(&faulty), (false, false, 1));
    let real = Robot::with(Config { serial_number: "1234567".into(), ..Config::new(Profile::Rc8) });
    let run = recover(&real, &[]);
    assert!(run.code == 2 && run.err.contains("give --yes"), "{run:?}");
    assert_eq!(state(&real), (false, false, 0));
    // without errors, a virtual controller needs no confirmation
    let run = recover(&robot(Profile::Rc8), &[]);
    assert!(run.code == 0 && run.out.starts_with("plan     TakeArm, Motor\n"), "{run:?}");
    let run = recover(&faulty, &["--yes", "--speed", "101"]);
    assert!(run.code == 2 && run.err.contains("up to 100"), "{run:?}");
}

#[test]
fn the_question_says_what_happens() {
    let robot = failed(Profile::Cobotta);
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script");
    let line = format!("{} recover --robot {}\nsleep 60\n", env!("CARGO_BIN_EXE_bcap"), robot.tcp);
    std::fs::write(&script, line).unwrap();
    let Some(terminal) = Terminal::run((120, 30), &["sh", script.to_str().unwrap()], folder.path()) else { return };
    terminal.wait_for("Continue? [y/N]");
    let screen = terminal.screen();
    assert!(screen.contains("The arm CAN MOVE") && screen.contains("MotionPreparation"), "{screen}");
    terminal.keys(&["n", "Enter"]);
    terminal.wait_for("not confirmed: nothing was changed");
    assert_eq!(state(&robot), (false, false, 1));
}

#[test]
fn a_robot_of_another_client_is_left_alone() {
    let robot = robot(Profile::Rc8);
    let mut other = Controller::connect(&robot.tcp, &Settings::rc8()).unwrap();
    let mut arm = other.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm.motor_off().unwrap();
    let run = recover(&robot, &["--yes", "--json"]);
    let last = lines(&run).pop().unwrap();
    assert_eq!((run.code, last["hresult"].clone()), (1, json!("E_ARM_NOT_TAKEN")), "{run:?}");
    assert!(last["error"].as_str().unwrap().starts_with("TakeArm: "), "{last}");
    robot.run(&["errors", "--clear"]);
    arm.motor_on().unwrap();
    arm.robot().execute::<OwnedVariant>("slvChangeMode", 0x202).unwrap();
    let run = recover(&robot, &["--yes"]);
    assert!(run.code == 1 && run.err.contains("a client streams in Slave Mode: end its stream"), "{run:?}");
    assert_eq!(robot.served.application().slave_mode(), 0x202, "the stream goes on");
    assert!(state(&robot).1);
}

#[test]
fn what_only_a_person_can_do_is_named() {
    let fault = HResult::from_u32(0x8550_0001);
    let robot = robot(Profile::Rc8);
    raise(&robot, fault);
    robot.served.application().set_mode(Mode::Manual, bcap_std::now());
    let run = recover(&robot, &["--yes", "--json"]);
    let lines = lines(&run);
    let named = lines[1]["obstacles"].as_array().unwrap();
    assert!(named[0].as_str().unwrap().ends_with("switch the controller to Auto"), "{lines:?}");
    assert!(named.last().unwrap().as_str().unwrap().starts_with("the error 0x85500001"), "{lines:?}");
    assert_eq!((lines[1]["plan"].clone(), run.code), (json!([]), 1));
    assert!(robot.served.application().errors().any(|error| error.code == fault));
}

#[test]
fn a_refused_step_is_named_and_nothing_stays_on() {
    for (of, first) in [("Motor", "done     TakeArm\n"), ("TakeArm", "")] {
        let robot = robot(Profile::Rc8);
        let text =
            format!("[[fault]]\nwhen = {{ call = 1, of = \"{of}\" }}\nthen = {{ refuse = \"E_TOKEN_ADDRESS\" }}\n");
        robot.served.application().play(Scenario::parse(&text).unwrap());
        let run = recover(&robot, &["--yes"]);
        assert_eq!((run.code, run.out), (1, format!("plan     TakeArm, Motor\n{first}")));
        let expected = format!("{of}: the controller refused with 0x83501029 (E_TOKEN_ADDRESS)");
        assert!(run.err.contains(&expected) && run.err.contains("hint: "), "{}", run.err);
        let (owned, on, _) = state(&robot);
        assert_eq!((owned, on), (false, false));
    }
}

#[test]
fn a_signal_switches_the_motor_off_and_gives_the_arm_back() {
    for signal in [Signal::INT, Signal::TERM] {
        let robot = Robot::with(Config { motor_on_delay: Duration::from_secs(2), ..Config::new(Profile::Rc8) });
        raise(&robot, REACH);
        let args = ["recover", "--yes", "--keep", "--robot", &robot.tcp];
        let child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        while robot.served.application().arm_owner().is_none() {
            thread::sleep(Duration::from_millis(1));
        }
        send(signal, &child);
        let run = Run::from(child.wait_with_output().unwrap());
        assert!(run.code == 130 && run.err.contains("the motor was switched off and the arm given back"), "{run:?}");
        let (owned, on, _) = state(&robot);
        assert_eq!((owned, on), (false, false), "{signal:?}");
    }
}

/// The signal arrives during the Motor command, and the controller refuses to switch the motor off.
#[test]
fn a_motor_that_an_interrupted_recovery_leaves_on_is_not_called_off() {
    let robot = robot(Profile::Rc8);
    let scenario = "[[fault]]\nwhen = { call = 1, of = \"Motor\" }\nthen = { delay_ms = 2000 }\n\
                    [[fault]]\nwhen = { call = 2, to = 5, of = \"Motor\" }\nthen = { refuse = \"E_FAIL\" }\n";
    robot.served.application().play(Scenario::parse(scenario).unwrap());
    let args = ["recover", "--yes", "--robot", &robot.tcp];
    let child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while !state(&robot).1 {
        thread::sleep(Duration::from_millis(1));
    }
    send(Signal::INT, &child);
    let run = Run::from(child.wait_with_output().unwrap());
    let expected = "interrupted: IT IS UNKNOWN whether the motor is off and the arm is free; errors that";
    assert!(run.code == 130 && run.err.contains(expected), "{run:?}");
    let (owned, on, _) = state(&robot);
    assert_eq!((owned, on), (false, true));
}

#[test]
fn the_motor_stays_on_only_if_the_user_keeps_it() {
    let robot = failed(Profile::Rc8);
    let run = recover(&robot, &["--yes", "--keep"]);
    assert!(run.code == 0 && run.out.ends_with("recovered: no errors, the motor is on\n"), "{run:?}");
    assert_eq!(state(&robot), (false, true, 0));
    assert_eq!(recover(&robot, &[]).out, "recovered: no errors, the motor is on\n", "nothing to do");
    // a script keeps its own arm, and its end switches the motor off
    let robot = failed(Profile::Rc8);
    let script = "recover --yes\nexec robot TakeArm 0 1\nrecover --yes\nget robot/@SERVO_ON\n\
                  move 'J(1, 45, 90, 0, 45, 0)' --speed 50\n";
    let run = robot.run_with(&["run", "-"], script);
    assert!(run.code == 0 && run.out.contains("robot/@SERVO_ON = true"), "{run:?}");
    assert_eq!(state(&robot), (false, false, 0));
}

#[test]
fn a_cobotta_is_prepared_for_a_motion_only_with_the_option() {
    let robot = robot(Profile::Cobotta);
    let motion = ["move", "J(10, 45, 90, 0, 45, 0)", "--speed", "50"];
    let run = robot.run(&motion);
    assert!(
        run.code == 1 && run.err.contains("E_MOTION_UNPREPARED") && run.err.contains("--prepare before a motion"),
        "{run:?}"
    );
    robot.run(&["errors", "--clear"]);
    raise(&robot, REACH);
    let run = robot.run(&[&motion[..], &["--prepare"]].concat());
    assert!(run.code == 1 && run.err.contains("before the examination: the error "), "{run:?}");
    assert_eq!(robot.run(&["exec", "robot", "ManualResetPreparation"]).code, 0);
    assert_eq!(robot.run(&["errors", "--clear"]).code, 0);
    let run = robot.run(&[&motion[..], &["--prepare"]].concat());
    assert_eq!((run.code, run.out.as_str()), (0, "at J(10, 45, 90, 0, 45, 0)\n"), "{}", run.err);
    assert_eq!(state(&robot), (false, false, 0));
}
