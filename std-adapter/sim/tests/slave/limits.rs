//! Limits of speed and acceleration, and poses out of reach.

use bcap_core::hresult::HResult;
use bcap_sim::kinematics::SPEEDS;
use bcap_sim::motion::ACCELERATION_TIME;
use bcap_sim::slave::CYCLE;
use bcap_sim::{Config, SlaveConfig, SpeedSetting};

use crate::common::ok;
use crate::{Rig, START, assert_close, limit};

/// Moves one axis with this acceleration until it is too fast; returns the error, and the speed at which it came.
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
    assert_eq!(rig.slv_move([2000.0, 0.0, 0.0, 180.0, 0.0, 180.0, 5.0]).0, limit(0x8320_4070, 3));
}
