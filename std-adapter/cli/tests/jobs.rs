//! The jobs of a technician, each with the command that does it and what it shows at the first try.
//!
//! `cargo test -p bcap-cli jobs:: -- --nocapture` prints the table. A job with steps of a person on a screen has a separate
//! test, named in the table of `docs/tester.md`: jog by keys, six errors at 80x24, a raw session line by line.

use std::fmt::Write as _;

use bcap_sim::{Config, Profile};

use crate::common::robot::Robot;

/// The rows of the table.
struct Jobs(String);

impl Jobs {
    /// Runs the command of a job, and asserts its exit code and a part of its output.
    #[track_caller]
    fn run(&mut self, job: &str, robot: &Robot, words: &[&str], code: i32, seen: &str) {
        let run = robot.run(words);
        let all = format!("{}{}", run.out, run.err);
        assert!(run.code == code && all.contains(seen), "{job}: {seen:?} is missing: {run:?}");
        let line = all.lines().find(|line| line.contains(seen.lines().next().unwrap_or_default())).unwrap_or_default();
        writeln!(self.0, "| {job} | `bcap {}` | {code} | {} |", words.join(" "), line.trim().replace('|', "\\|"))
            .unwrap();
    }
}

fn state(robot: &Robot) -> (Vec<f64>, bool, bool) {
    let mut sim = robot.served.application();
    sim.advance(bcap_std::now());
    (sim.joints().to_vec(), sim.motor_is_on(), sim.arm_owner().is_some())
}

#[test]
fn each_job_is_done_at_the_first_try() {
    let mut jobs = Jobs("| job | command | exit code | seen |\n|---|---|---|---|\n".into());
    let rc8 = Robot::start();
    let address = rc8.tcp.strip_prefix("tcp:").unwrap().to_owned();
    jobs.run("find", &rc8, &["scan", &address], 0, "RC8  2.8.0");
    jobs.run("state", &rc8, &["status"], 0, "yes, after the motor is on");
    jobs.run("jog J1 +5", &rc8, &["jog", "J1", "+5"], 0, "J1 = 5.000");
    jobs.run("teach", &rc8, &["teach", "P5"], 0, "(tool 0, work 0); it was 0,0,0,0,0,0");
    assert!(!state(&rc8).1, "the motor is off");
    // a script with a typo in its last line
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("cycle.bcap");
    std::fs::write(&script, "exec robot TakeArm 0 1\nmove 'J(20, 45, 90, 0, 45, 0)'\nmvoe P1\n").unwrap();
    let before = state(&rc8);
    jobs.run("script with a typo", &rc8, &["run", script.to_str().unwrap()], 2, "cycle.bcap:3: ");
    assert_eq!((state(&rc8), before.2), (before.clone(), false), "nothing moved, and the arm is free");
    // all 1,312 variables in one command
    let all = ["IO*=true", "I*=9", "F*=1.0", "D*=1.0", "S*=a", "V*=1,2,3", "P*=400,0,300,180,0,180,5"];
    let poses = ["J*=0,45,90,0,45,0,0,0", "T*=400,0,300,1,0,0,0,1,0,5"];
    let put = [&["put"], &all[..], &poses].concat();
    jobs.run("1,312 variables", &rc8, &put, 0, "T99 = 400,0,300,1,0,0,0,1,0,5");
    let grid = folder.path().join("cell.labels");
    std::fs::write(&grid, "IO130 = gripper is open\n").unwrap();
    rc8.run(&["put", "IO129", "off"]);
    let io = ["io", "IO128-IO143", "--labels", grid.to_str().unwrap()];
    jobs.run("IO as a grid", &rc8, &io, 0, "IO128    * . * * * * * *");
    jobs.run("IO with labels", &rc8, &io, 0, "IO130    * gripper is open");
    jobs.run("a name that is not an IO", &rc8, &["io", "I1"], 2, "I1 is no IO");
    // six errors, the first cause first
    for code in [0x8420_1482, 0x8150_1003, 0x8150_1025, 0x8320_4232, 0x8420_4041, 0x8150_1004] {
        rc8.served.application().inject_error(bcap_core::hresult::HResult::from_u32(code), bcap_std::now());
    }
    jobs.run("six errors", &rc8, &["errors"], 0, "0x84201482 (E_");
    for (name, profile) in [("RC8", Profile::Rc8), ("RC9", Profile::Rc9), ("COBOTTA", Profile::Cobotta)] {
        let robot = Robot::with(Config::new(profile));
        let job = |what: &str| format!("{what}, {name}");
        // no option names the model
        jobs.run(&job("first contact"), &robot, &["get", "@TYPE"], 0, "@TYPE = ");
        robot.served.application().emergency_stop(true, bcap_std::now());
        jobs.run(&job("emergency stop"), &robot, &["status"], 0, "FAILED emergency stop pressed");
        jobs.run(&job("recovery while it is pressed"), &robot, &["recover", "--yes"], 1, "not recovered");
        robot.served.application().emergency_stop(false, bcap_std::now());
        jobs.run(&job("recovery"), &robot, &["recover", "--yes"], 0, "recovered: no errors, the motor is off again");
        jobs.run(&job("motion after it"), &robot, &["jog", "J1", "+1"], 0, "J1 = 1.000");
        assert_eq!((state(&robot).1, state(&robot).2), (false, false), "{name}: the motor is off, the arm free");
    }
    println!("{}", jobs.0);
}
