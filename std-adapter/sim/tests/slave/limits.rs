//! Limits of speed and acceleration, and poses out of reach.

use bcap_core::hresult::HResult;
use bcap_sim::codes::UNREACHABLE;
use bcap_sim::kinematics::SPEEDS;
use bcap_sim::motion::ACCELERATION_TIME;
use bcap_sim::slave::CYCLE;
use bcap_sim::{Config, Scenario, SlaveConfig, SpeedSetting};

use crate::common::ok;
use crate::slave::{Rig, START, assert_close, limit};

/// Moves one axis with this acceleration until it is too fast; returns the error, and the speed at which it occurred.
fn accelerate(rig: &mut Rig, axis: usize, acceleration: f64) -> (HResult, f64) {
    let mut pose = START;
    let mut speed = 0.0;
    for _ in 0..2000 {
        speed += acceleration * CYCLE.as_secs_f64();
        pose[axis - 1] += speed * CYCLE.as_secs_f64();
        assert_eq!(rig.slv_move(pose).0, HResult::S_OK);
        rig.cycles(1);
        if let [error] = rig.errors()[..] {
            return (error, speed);
        }
    }
    panic!("axis {axis} is never too fast");
}

#[test]
fn each_axis_has_its_limit_of_speed_in_each_setting() {
    for (setting, ext_speed, part) in [
        (SpeedSetting::Servo, 50.0, 1.2),
        (SpeedSetting::ServoByExtSpeed, 50.0, 0.6),
        (SpeedSetting::Command, 50.0, 1.0),
        (SpeedSetting::CommandByExtSpeed, 50.0, 0.5),
    ] {
        for axis in 1..=6 {
            let slave = SlaveConfig { speed_setting: setting, ..SlaveConfig::default() };
            let mut rig = Rig::with(Config { slave, ..Config::default() });
            assert_eq!(rig.execute("ExtSpeed", ext_speed), ok(&()));
            let limits = rig.world.sim.slave_limits();
            assert_close(&limits.speed[..6], &SPEEDS.map(|s| s * part), 1e-9);
            assert_eq!(rig.execute("slvChangeMode", 0x102), ok(&()));
            // as hard as it may, so that it is fast before its range ends
            let (error, speed) = accelerate(&mut rig, axis, limits.acceleration[axis - 1] * 0.9);
            assert_eq!(error, limit(0x8420_4050, axis), "{setting:?}");
            let step = limits.acceleration[axis - 1] * 0.9 * CYCLE.as_secs_f64();
            let top = limits.speed[axis - 1];
            assert!(speed > top && speed - step <= top * 1.000_001, "{setting:?}: J{axis} at {speed}, not {top}");
        }
    }
}

#[test]
fn each_axis_has_its_limit_of_acceleration() {
    let seconds = CYCLE.as_secs_f64();
    for (setting, ext_speed, part) in [
        (SpeedSetting::Servo, 50, 4.0),
        // the external acceleration is the square of the external speed
        (SpeedSetting::ServoByExtSpeed, 50, 1.0),
        (SpeedSetting::Command, 50, 1.0),
        (SpeedSetting::CommandByExtSpeed, 50, 0.25),
    ] {
        for axis in 1..=6 {
            for (factor, error) in [(0.999, None), (1.001, Some(limit(0x8420_4040, axis)))] {
                let slave = SlaveConfig { speed_setting: setting, ..SlaveConfig::default() };
                let mut rig = Rig::with(Config { slave, ..Config::default() });
                rig.execute("ExtSpeed", ext_speed);
                rig.execute("slvChangeMode", 0x002);
                let allowed = SPEEDS[axis - 1] / ACCELERATION_TIME * part;
                let mut pose = START;
                pose[axis - 1] += allowed * factor * seconds * seconds;
                assert_eq!(rig.slv_move(pose).0, HResult::S_OK, "it is the cycle that notices");
                rig.cycles(1);
                assert_eq!(rig.errors().first().copied(), error, "{setting:?}, J{axis}, {factor}");
                assert_eq!(rig.mode() == 0, error.is_some());
            }
        }
    }
}

#[test]
fn a_first_pose_far_from_the_robot_is_too_fast() {
    let mut rig = Rig::enter(0x002);
    rig.j1(10.0);
    rig.cycles(1);
    assert_eq!((rig.mode(), rig.errors(), rig.here()), (0, vec![limit(0x8420_4050, 1)], START));
}

#[test]
fn a_pose_out_of_reach_is_an_error_at_once() {
    let mut rig = Rig::enter(0x002);
    assert_eq!(rig.j1(171.0), limit(0x8320_4070, 1));
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8320_4070, 1)]));
    let mut rig = Rig::enter(0x001);
    assert_eq!(rig.slv_move([2000.0, 0.0, 0.0, 180.0, 0.0, 180.0, 5.0]).0, UNREACHABLE);
}

/// Streams poses in mode 0 as the maker's sample does: it waits for 8 ms after each reply that is not `S_OK`, and sends
/// a pose again that was not stored. Returns the causes that this ended with.
fn stream(rig: &mut Rig, poses: &[[f64; 8]]) -> Vec<HResult> {
    for pose in poses {
        loop {
            let (reply, _) = rig.slv_move(*pose);
            if reply != HResult::S_OK {
                rig.cycles(1);
            }
            match reply {
                HResult::E_BUF_FULL => {}
                _ if reply.is_ok() => break,
                _ => return causes(rig),
            }
        }
    }
    let leave = bcap_core::bcap::call::robot_execute(rig.client.robot, "slvChangeMode", 0);
    let (peer, left) = (rig.client.peer, ok(&()));
    let reply = rig.world.run(peer, leave);
    if rig.errors().is_empty() {
        assert_eq!(reply, left);
    }
    causes(rig)
}

/// Returns the current errors, without the refusals of the later poses.
fn causes(rig: &Rig) -> Vec<HResult> {
    rig.errors().into_iter().filter(|code| *code != HResult::E_SLVMODE_OFF).collect()
}

/// One turn in 100 cycles around the start, while J1 advances by 0.1 degrees a cycle, and the last pose once more.
fn sample(j2: impl Fn(f64) -> f64) -> Vec<[f64; 8]> {
    let mut poses: Vec<[f64; 8]> = (0..100_u8)
        .map(|n| {
            let mut pose = START;
            pose[0] += f64::from(n) / 10.0;
            pose[1] += j2(f64::from(n) / 100.0 * std::f64::consts::TAU);
            pose
        })
        .collect();
    poses.push(poses[99]);
    poses
}

#[test]
fn the_sine_of_the_old_sample_starts_too_hard_and_the_cosine_of_the_new_one_does_not() {
    // docs/spec-notes.md has the arithmetic: 9,811 and 617 degrees per second squared of J2, whose limit is 6,600
    let mut rig = Rig::enter(0x002);
    assert!((rig.world.sim.slave_limits().acceleration[1] - 6600.0).abs() < 1e-9);
    assert_eq!(stream(&mut rig, &sample(|turn| 10.0 * turn.sin())), [limit(0x8420_4040, 2)]);
    assert_close(&rig.here(), &START, 1e-9);

    let mut rig = Rig::enter(0x002);
    assert_eq!(stream(&mut rig, &sample(|turn| 10.0 * (1.0 - turn.cos()))), []);
    assert_close(&rig.here()[..1], &[9.9], 1e-9);
}

#[test]
fn a_scenario_sets_limits_of_single_axes() {
    let with = |text: &str| {
        let mut rig = Rig::new();
        rig.world.sim.play(Scenario::parse(&format!("[controller]\n{text}")).unwrap());
        rig
    };
    let mut rig = with("slave_acceleration = { j2 = 10000.0 }");
    let limits = rig.world.sim.slave_limits();
    assert_close(&limits.acceleration[..3], &[7500.0, 10_000.0, 8100.0], 1e-9);
    assert_eq!(rig.execute("slvChangeMode", 0x002), ok(&()));
    assert_eq!(stream(&mut rig, &sample(|turn| 10.0 * turn.sin())), []);

    let mut rig = with("slave_speed = { j1 = 10, j8 = 0.5 }");
    assert_close(&rig.world.sim.slave_limits().speed[..2], &[10.0, 330.0 * 1.2], 1e-9);
    assert_eq!(rig.world.sim.slave_limits().speed[7], 0.5);
    assert_eq!(rig.execute("slvChangeMode", 0x002), ok(&()));
    // 0.1 degrees a cycle are 12.5 degrees per second
    assert_eq!(stream(&mut rig, &sample(|_| 0.0)), [limit(0x8420_4050, 1)]);

    for text in ["slave_speed = { j1 = 0 }", "slave_speed = { j1 = inf }", "slave_speed = { j9 = 1 }"] {
        assert!(Scenario::parse(&format!("[controller]\n{text}")).is_err(), "{text}");
    }
}
