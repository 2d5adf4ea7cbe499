//! `bcap jog` and `bcap teach`.

use std::process::Command;

use bcap_sim::{Config, Profile};
use bcap_tests::process::{Signal, send};
use serde_json::Value;

use crate::common::robot::Robot;
use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;

/// Reads an array of numbers of the robot.
fn numbers(robot: &Virtual, name: &str) -> Vec<f64> {
    let line: Value = serde_json::from_str(&robot.run(&["get", "--json", name]).out).unwrap();
    line["v"].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Asserts that two positions differ in one number.
#[track_caller]
fn assert_step(before: &[f64], after: &[f64], place: usize, by: f64) {
    for (at, (before, after)) in before.iter().zip(after).enumerate() {
        let expected = if at == place { before + by } else { *before };
        // an angle of -180 degrees is one of 180 degrees
        let off = (after - expected).abs() % 360.0;
        assert!(off.min(360.0 - off) < 0.01, "{at}: {after} instead of {expected}");
    }
}

#[test]
fn a_step_moves_one_axis_and_gives_the_arm_back() {
    let robot = Virtual::start(&[]);
    let before = numbers(&robot, "robot/@CURRENT_ANGLE");
    let run = robot.run(&["jog", "J1", "+5"]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("J1 = 5.000\n", "", 0));
    assert_step(&before, &numbers(&robot, "robot/@CURRENT_ANGLE"), 0, 5.0);
    robot.assert_at_rest_with_free_arm();
    for (axis, place, by) in [("Z", 2, -10.0), ("x", 0, 2.5), ("RZ", 5, 1.0)] {
        let before = numbers(&robot, "robot/@CURRENT_POSITION");
        let run = robot.run(&["jog", axis, &by.to_string(), "--json"]);
        assert_eq!((run.err.as_str(), run.code), ("", 0), "{axis}");
        let after = numbers(&robot, "robot/@CURRENT_POSITION");
        assert_step(&before, &after, place, by);
        let line: Value = serde_json::from_str(&run.out).unwrap();
        assert_eq!((&line["axis"], &line["position"]), (&axis.to_uppercase().into(), &after[place].into()));
    }
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn a_step_along_z_is_the_same_with_another_tool() {
    let robot = Virtual::start(&[]);
    let before = numbers(&robot, "robot/@CURRENT_POSITION");
    let run = robot.run(&["jog", "Z", "-10", "--tool", "1"]);
    assert_eq!((run.err.as_str(), run.code), ("", 0));
    assert_eq!(robot.run(&["get", "robot/@CURRENT_TOOL"]).out, "robot/@CURRENT_TOOL = 1\n");
    assert_step(&before, &numbers(&robot, "robot/@CURRENT_POSITION"), 2, -10.0);
}

#[test]
fn an_invalid_step_moves_nothing() {
    let robot = Virtual::start(&[]);
    let before = numbers(&robot, "robot/@CURRENT_ANGLE");
    for (args, code, text) in [
        (&["jog", "J9", "5"][..], 2, "write J1 to J8, X, Y, Z, RX, RY or RZ"),
        (&["jog", "J1", "0"], 2, "write a step in mm or degrees"),
        (&["jog", "J1", "nan"], 2, "write a step in mm or degrees"),
        (&["jog", "J1", "5", "--speed", "101"], 2, "write a speed above 0 and up to 100"),
        (&["jog", "J1", "999"], 1, "0x8"),
    ] {
        let run = robot.run(args);
        assert!(run.code == code && run.err.contains(text) && run.out.is_empty(), "{args:?}: {run:?}");
    }
    assert_eq!(numbers(&robot, "robot/@CURRENT_ANGLE"), before);
    let lines =
        "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove 'J(60,45,90,0,45,0)' --speed 1 --no-wait\njog J2 -5\n";
    robot.run(&["errors", "--clear"]);
    let run = robot.script(lines);
    assert!(run.code == 1 && run.err.contains("-:4: the robot moves"), "{run:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn a_step_of_a_real_robot_needs_an_answer() {
    let robot = Robot::with(Config { serial_number: "1234567".into(), ..Config::new(Profile::Rc8) });
    let run = robot.run(&["jog", "J1", "5"]);
    let question = "moves to the end of the step J1 +5 at 10 % of its speed: cannot ask for confirmation";
    assert!(run.code == 2 && run.err.contains(question) && run.err.contains("give --yes"), "{run:?}");
    assert!(robot.served.application().joints()[0].abs() < 0.001);
    assert_eq!(robot.run(&["jog", "J1", "5", "--yes"]).out, "J1 = 5.000\n");
}

#[test]
fn an_rc9_needs_no_provider() {
    let robot = Virtual::start(&["--model", "rc9"]);
    assert_eq!(robot.run(&["get", "I1"]).out, "I1 = 0\n");
    let run = robot.run(&["jog", "J1", "+5"]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("J1 = 5.000\n", "", 0));
    let run = robot.run(&["halt"]);
    assert_eq!((run.out.as_str(), run.code), ("nothing was moving\n", 0));
    let run = robot.run(&["get", "I1", "--provider", "CaoProv.DENSO.VRC"]);
    assert!(run.code == 1 && run.err.contains("Controller_Connect: the controller refused"), "{run:?}");
    let child = robot.spawn(&["jog", "J1", "120", "--speed", "1"]);
    robot.wait_for_motion();
    send(Signal::INT, &child);
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(130));
    robot.wait_for_rest();
}

#[test]
fn the_names_are_those_with_a_text() {
    let robot = Virtual::start(&[]);
    let [all, some] = [&["names"][..], &["names", "PRO1"]].map(|args| robot.run(args).out);
    assert!(some.lines().all(|line| line.contains("Pro1")) && some.contains("task:Pro1\n"), "{some}");
    assert!(all.lines().count() > some.lines().count() && some.lines().all(|line| all.contains(line)), "{all}");
    assert_eq!(robot.run(&["names", "NoSuchName"]).out, "");
}

#[test]
fn ctrl_c_halts_a_step() {
    let robot = Virtual::start(&[]);
    let child = robot.spawn(&["jog", "J1", "120", "--speed", "1"]);
    robot.wait_for_motion();
    send(Signal::INT, &child);
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(130), &b""[..]), "{output:?}");
    assert!(numbers(&robot, "robot/@CURRENT_ANGLE")[0] < 119.0);
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn teaching_writes_the_present_position() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["jog", "J1", "5"]).code, 0);
    assert_eq!(robot.run(&["put", "P5", "1,2,3,4,5,6,7"]).code, 0);
    let run = robot.run(&["teach", "P5", "--joints", "J3"]);
    let lines: Vec<&str> = run.out.lines().collect();
    assert!(lines[0].starts_with("P5 = ") && lines[0].ends_with(" (tool 0, work 0); it was 1,2,3,4,5,6,7"), "{run:?}");
    assert!(lines[1].starts_with("J3 = 5,45,90,0,45,0,0,0 (tool 0, work 0); it was 0,"), "{run:?}");
    assert_step(&numbers(&robot, "robot/@CURRENT_POSITION"), &numbers(&robot, "P5"), 0, 0.0);
    assert_step(&numbers(&robot, "robot/@CURRENT_ANGLE"), &numbers(&robot, "J3"), 0, 0.0);
    // a label replaces the earlier one of the variable, and leaves the other lines
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.labels");
    let labels = file.to_str().unwrap();
    assert_eq!(robot.run(&["teach", "P5", "--label", "above the tray", "--labels", labels]).code, 0);
    std::fs::write(&file, std::fs::read_to_string(&file).unwrap() + "\nIO130 = gripper is open\np6=x\n").unwrap();
    for (name, label) in [("p5", "in the tray"), ("P6", "out = 3")] {
        assert_eq!(robot.run(&["teach", name, "--label", label, "--labels", labels]).code, 0);
    }
    let expected = "P5 = in the tray\n\nIO130 = gripper is open\nP6 = out = 3\n";
    assert_eq!(std::fs::read_to_string(&file).unwrap(), expected);
    let taught = numbers(&robot, "P5");
    assert_eq!(robot.run(&["jog", "J1", "5"]).code, 0);
    std::fs::write(&file, "no label").unwrap();
    for (args, text) in [
        (&["teach", "P5", "--label", "x", "--labels", labels][..], "cell.labels, line 1: write IO130 = LABEL"),
        (&["teach", "P5", "--label", "x", "--labels", "/"], "/"),
        (&["teach", "P5", "--label", "x\ny", "--labels", "y"], "one line"),
        (&["teach", "P5", "--label", "x"], "--labels"),
    ] {
        let run = robot.run(args);
        assert!(run.code == 2 && run.err.contains(text), "{args:?}: {run:?}");
    }
    assert_eq!(numbers(&robot, "P5"), taught, "a label that cannot be kept changes no position");
    assert_eq!(robot.run(&["teach", "P5"]).code, 0);
    for (args, text) in [
        (&["teach", "J5"][..], "J5 is not a variable of type P"),
        (&["teach", "--joints", "P3"], "P3 is not a variable of type J"),
        (&["teach", "I1"], "I1 is not a variable of type P"),
        (&["teach"], "required"),
    ] {
        let run = robot.run(args);
        assert!(run.code == 2 && run.err.contains(text), "{args:?}: {run:?}");
    }
    let taught = numbers(&robot, "P5");
    let lines =
        "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove 'J(60,45,90,0,45,0)' --speed 1 --no-wait\nteach P5\n";
    let run = robot.script(lines);
    assert!(run.code == 1 && run.err.contains("-:4: the robot moves"), "{run:?}");
    assert_eq!(numbers(&robot, "P5"), taught);
}

/// Starts `bcap jog` in a terminal that keeps its last lines.
fn jog_by_keys(robot: &Virtual, args: &str, folder: &tempfile::TempDir) -> Option<Terminal> {
    let terminal = Terminal::run((80, 24), &["sh"], folder.path())?;
    let program = env!("CARGO_BIN_EXE_bcap");
    terminal.enter(&format!("PS1='ready> '; {program} jog {args} --robot {}; echo code $?", robot.tcp));
    terminal.wait_for("step 1 mm or degrees");
    Some(terminal)
}

#[test]
fn a_key_makes_a_step_and_a_repeated_key_repeats_it() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = jog_by_keys(&robot, "--speed 100", &folder) else { return };
    terminal.wait_for("> J1 =     0.000");
    terminal.keys(&["Right"]);
    terminal.wait_for("> J1 =     1.000");
    terminal.keys(&["]", "Left"]);
    terminal.wait_for("> J1 =    -4.000");
    terminal.keys(&["Down", "["]);
    terminal.wait_for("> J2 =    45.000");
    // a key that is held: the step repeats, and ends with the key
    let mut joint = 45.0;
    while joint < 49.5 {
        terminal.keys(&["Right"]);
        joint = numbers(&robot, "robot/@CURRENT_ANGLE")[1];
    }
    // the last keys may still begin a step; when a later key has an effect, that step has ended
    terminal.wait_until("a step of 0.1", |screen| {
        terminal.keys(&["["]);
        screen.contains("step 0.1 mm or degrees") && !screen.contains("Esc HALTS")
    });
    let rests = numbers(&robot, "robot/@CURRENT_ANGLE");
    assert!((rests[1] - rests[1].round()).abs() < 0.01 && rests[1] < 53.0, "{rests:?}");
    terminal.wait_for(&format!("> J2 = {:9.3}", rests[1]));
    // along an axis
    let before = numbers(&robot, "robot/@CURRENT_POSITION");
    terminal.keys(&["]", "Down", "Down", "Down", "Down", "Down", "Down", "Down", "Down", "Down", "Left"]);
    terminal.wait_for(&format!("> Z  = {:9.3}", before[2] - 1.0));
    assert_step(&before, &numbers(&robot, "robot/@CURRENT_POSITION"), 2, -1.0);
    terminal.keys(&["q"]);
    terminal.wait_for("code 0");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn escape_and_a_lost_terminal_halt_a_step() {
    for end in ["Escape", "C-c", "-TERM", "closed"] {
        let robot = Virtual::start(&[]);
        let folder = tempfile::tempdir().unwrap();
        let Some(terminal) = jog_by_keys(&robot, "--speed 0.1", &folder) else { return };
        terminal.keys(&["]", "]", "Right"]);
        terminal.wait_for("J1 moves by +10; Esc HALTS");
        robot.wait_for_motion();
        match end {
            "closed" => drop(terminal),
            "-TERM" => {
                let kill = format!("kill -TERM $(pgrep -P {})", terminal.variable("pane_pid"));
                assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
                terminal.wait_for("code 130");
            }
            key => {
                terminal.keys(&[key]);
                terminal.wait_for("note: the robot was halted, and the arm was given back");
                terminal.wait_for("code 0");
            }
        }
        robot.wait_for_rest();
        while robot.run(&["exec", "robot", "TakeArm", "0", "1"]).code != 0 {
            robot.run(&["errors", "--clear"]);
        }
        assert!(numbers(&robot, "robot/@CURRENT_ANGLE")[0] < 9.9, "{end}");
        robot.assert_at_rest_with_free_arm();
    }
}

#[test]
fn a_shell_that_has_the_arm_keeps_it_after_the_keys() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = Terminal::start((120, 24), &["shell", "--robot", &robot.tcp], folder.path()) else { return };
    terminal.wait_for("ok>");
    terminal.enter("exec robot TakeArm 0 1");
    terminal.wait_for("arm>");
    terminal.enter("jog");
    terminal.wait_for("step 1 mm or degrees");
    terminal.keys(&["Escape"]);
    terminal.wait_for("note: this session keeps the arm, and leaves the motor on");
    terminal.wait_for("arm motor>");
    terminal.enter("jog --speed 0.1");
    terminal.wait_for("step 1 mm or degrees");
    terminal.keys(&["]", "]", "Right"]);
    terminal.wait_for("J1 moves by +10; Esc HALTS");
    robot.wait_for_motion();
    terminal.keys(&["Escape"]);
    let screen =
        terminal.wait_for("note: the robot was halted, and this session keeps the arm, and leaves the motor on");
    assert!(!screen.contains("given back"), "{screen}");
    terminal.enter("exit");
    robot.wait_for_rest();
}

#[test]
fn keys_need_a_terminal() {
    let robot = Virtual::start(&[]);
    let run = robot.run(&["jog"]);
    assert!(run.code == 2 && run.err.contains("a live screen needs a terminal"), "{run:?}");
    let run = robot.run(&["jog", "--json"]);
    assert!(run.code == 2 && run.err.contains("a live screen has no JSON"), "{run:?}");
    assert_eq!(robot.run(&["jog", "J1"]).code, 2);
}
