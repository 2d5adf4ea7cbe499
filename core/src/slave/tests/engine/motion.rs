//! The poses of a stream, and its stop.

use super::*;

#[test]
fn every_mode_executes_every_pose_once_and_in_order() {
    for mode in [Mode::Mode0, Mode::Mode1, Mode::Mode2] {
        let mut rig = Rig::new(config(mode), &[0.0; 8]);
        assert_eq!(rig.run(trajectory(500)), EngineAction::Finished, "{mode:?}: {:?}", rig.engine.fault());
        let path = rig.path();
        let expected: Vec<f64> = (1..=500).map(|n| smooth(n, 500)).collect();
        assert_eq!(path[..500], expected, "{mode:?}");
        // the stop repeats the last pose until the robot is at rest, and no longer
        assert!(
            path[500..].iter().all(|joint| *joint == 1.0) && (2..=8).contains(&(path.len() - 500)),
            "{}",
            path.len()
        );
        assert_eq!(rig.names()[..6], START[..6]);
        assert_eq!(rig.names()[6..], ["slvChangeMode", "slvChangeMode", "Motor", "GiveArm"]);
        assert!(
            !rig.controller.arm
                && !rig.controller.motor
                && rig.controller.mode == 0
                && rig.controller.errors.is_empty()
        );
        let stats = rig.engine.stats();
        assert_eq!((stats.underflows, stats.late), (0, 0), "{mode:?}");
        assert_eq!(usize::try_from(stats.cycles).unwrap(), path.len(), "{mode:?}");
        assert_eq!(stats.least_margin.is_some(), mode != Mode::Mode1);
        assert!(stats.least_margin.is_none_or(|least| least >= CYCLE), "{:?}", stats.least_margin);
    }
}

#[test]
fn mode_0_fills_the_buffer_and_then_keeps_the_cycle() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut dues = Vec::new();
    let mut next = trajectory(50);
    let _ = rig.run(|rig| {
        dues.push(rig.now);
        next(rig)
    });
    // the buffer is filled without waiting; after that, one pose is sent per cycle
    let filling = dues.iter().take_while(|at| at.saturating_since(dues[0]) < Duration::from_millis(2)).count();
    // (three in the buffer, one in execution, and one requested ahead)
    assert!((4..=5).contains(&filling), "{dues:?}");
    assert!(rig.engine.stats().jitter.max() == 0);
    assert_eq!(rig.engine.stats().rtt.max(), 300);
}

#[test]
fn a_pose_refused_with_e_buf_full_is_sent_again() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut next = trajectory(100);
    let mut count = 0;
    assert_eq!(
        rig.run(|rig| {
            count += 1;
            if count % 20 == 0 {
                // the controller executes no pose for this many cycles
                rig.controller.asleep = 3;
            }
            next(rig)
        }),
        EngineAction::Finished
    );
    assert_eq!(rig.path()[..100], (1..=100).map(|n| smooth(n, 100)).collect::<Vec<_>>());
    let stats = rig.engine.stats();
    assert!((10..=20).contains(&stats.refused), "{}", stats.refused);
    assert_eq!(stats.cycles + stats.refused, u32::try_from(rig.moves).unwrap());
}

#[test]
fn a_controller_whose_buffer_stays_full_ends_the_stream() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        rig.controller.asleep = if count == 10 { 1000 } else { 0 };
        Some(joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Stalled, Released::Yes));
    // one second of cycles
    assert!((120..=130).contains(&rig.engine.stats().refused), "{}", rig.engine.stats().refused);
}

#[test]
fn mode_1_leaves_cycles_out_that_were_missed() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    let mut count = 0;
    let mut sent = Vec::new();
    let end = rig.run(|rig| {
        count += 1;
        if count == 11 {
            rig.now = rig.now + Duration::from_millis(30);
        }
        sent.push(rig.now);
        (count <= 20).then(|| joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, EngineAction::Finished);
    assert_eq!(rig.engine.stats().late, 1);
    assert!(rig.engine.stats().jitter.max() >= 22_000);
    // no burst catches up
    let gaps: Vec<_> = sent[12..20].windows(2).map(|pair| pair[1].saturating_since(pair[0])).collect();
    assert!(gaps.iter().all(|gap| *gap == CYCLE), "{gaps:?}");
}

#[test]
fn mode_2_is_paced_by_the_controller_alone() {
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    let mut next = trajectory(100);
    let mut asked = 0;
    let end = rig.run(|rig| {
        asked += 1;
        assert_eq!(rig.engine.poll(rig.now), EngineAction::Pose { deadline: rig.now });
        next(rig)
    });
    assert_eq!((end, asked), (EngineAction::Finished, 101));
    let stats = rig.engine.stats();
    assert!((7_000..=8_300).contains(&stats.rtt.quantile(500)), "{}", stats.rtt.quantile(500));
    assert!(stats.jitter.max() <= 300, "{}", stats.jitter.max());
}

#[test]
fn poses_beyond_the_limits_are_refused_with_axis_and_values() {
    let limits = AxisLimits { speed: [100.0; 8], acceleration: [5000.0; 8] };
    let mut rig = Rig::new(Config { limits, ..config(Mode::Mode2) }, &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        match count {
            // from rest, 0.4 degrees in 8 ms are 6250 deg/s^2
            1 => {
                let error = rig.engine.push(&Pose::j([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap_err();
                let PoseError::Acceleration { axis: 3, acceleration, limit: 5000.0 } = error else {
                    panic!("{error:?}")
                };
                assert!((acceleration - 6250.0).abs() < 1e-6);
            }
            2 => {
                let error = rig.engine.push(&joints(1.0)).unwrap_err();
                assert_eq!(
                    error.to_string(),
                    "axis 1 would move at 125 degrees or mm per second, its limit is 100: put the poses closer"
                );
            }
            3 => {
                let error = rig.engine.push(&Pose::j([0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap_err();
                assert_eq!(error, PoseError::NotFinite { number: 2 });
                let error = rig.engine.push(&spec_pose()).unwrap_err();
                assert!(matches!(error, PoseError::Format(FormatError::Layout { .. })));
            }
            _ => {}
        }
        (count <= 10).then(|| joints(0.0))
    });
    assert_eq!(end, EngineAction::Finished);
    assert!(rig.path().iter().all(|joint| *joint == 0.0));
}

#[test]
fn a_stop_in_motion_slows_down_within_the_limits() {
    let limits = AxisLimits { speed: [120.0; 8], acceleration: [1000.0; 8] };
    for (mode, ramp) in [(Mode::Mode0, 0), (Mode::Mode1, 100), (Mode::Mode2, 400)] {
        let ramp = Duration::from_millis(ramp);
        let mut rig = Rig::new(Config { limits, ramp, ..config(mode) }, &[0.0; 8]);
        let (mut at, mut speed, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|_| {
            count += 1;
            speed = f64::min(speed + 0.06, 0.9);
            at += speed;
            (count <= 60).then(|| joints(at))
        });
        assert_eq!(end, EngineAction::Finished);
        let path = rig.path();
        let speeds: Vec<f64> = path.windows(2).map(|pair| (pair[1] - pair[0]) / 0.008).collect();
        let hardest = speeds.windows(2).map(|pair| ((pair[1] - pair[0]) / 0.008).abs()).fold(0.0, f64::max);
        assert!(hardest <= 1000.0, "{hardest}");
        assert_eq!(speeds.last(), Some(&0.0));
        let slowing = speeds[59..].iter().filter(|speed| **speed > 0.0).count();
        // 112.5 deg/s at 900 deg/s^2 are 125 ms
        let least = ramp.as_millis().max(125) / 8;
        assert!((least - 1..=least + 1).contains(&u128::try_from(slowing).unwrap()), "{slowing}");
    }
}

#[test]
fn a_stop_within_a_low_acceleration_limit_takes_longer() {
    // from 100 degrees per second, by nine tenths of 10 degrees per second squared
    let velocity = [0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let part = |limit| crate::slave::limits::slow_down(&AxisLimits::uniform(100.0, limit), 0.008, &velocity);
    let acceleration = part(10.0) * velocity[0] / (0.008 * 0.008);
    assert!((acceleration - 9.0).abs() < 1e-9, "{acceleration}");
    // even with a limit of 0 the stop ends
    assert_eq!(part(0.0), 1e-3);
}

#[test]
fn a_stop_before_the_first_pose_moves_nothing() {
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!((rig.moves, rig.names()), (0, [&START[..], &["Motor", "GiveArm"]].concat()));
    // even before Slave Mode is entered
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    let _ = rig.engine.poll(rig.now);
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!(rig.names(), ["slvGetMode"]);
}

#[test]
fn the_stop_waits_for_a_robot_that_still_moves() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        if count == 11 {
            // the replies lag for a while
            for n in (1..=20).rev() {
                rig.controller.script.insert(0, ("slvMove", ok(&[f64::from(n), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
            }
        }
        (count <= 10).then(|| joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, EngineAction::Finished);
    assert!((10 + 20..10 + 25).contains(&rig.moves), "{}", rig.moves);
    // joints that the robot does not have may have any value
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    for n in 0..30 {
        rig.controller.script.push(("slvMove", ok(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f64::from(n), f64::NAN])));
    }
    assert_eq!(rig.run(trajectory(10)), EngineAction::Finished);
    assert!(rig.moves < 20, "{}", rig.moves);
}

#[test]
fn cartesian_streams_wrap_angles_and_command_extended_joints() {
    let axes = |j8| Extended::Eight(j8);
    let format = Format { extended: ExtendedAxes::Eight, ..format(Mode::Mode2, PoseType::P) };
    let limits = AxisLimits::uniform(100.0, 20_000.0);
    let at = [300.0, 0.0, 200.0, 179.9, 0.0, 180.0, 5.0];
    let config = Config { limits, ramp: Duration::from_millis(40), ..Config::new(format, HANDLES) };
    let mut rig = Rig::new(config, &at);
    rig.controller.script.push(("CurJnt", ok(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 40.0])));
    for _ in 0..100 {
        rig.controller.script.push(("slvMove", ok(&[0.0; 8])));
    }
    let mut count = 0;
    let mut last = None;
    let end = rig.run(|rig| {
        count += 1;
        last = Some(*rig.engine.last_pose());
        let angle = 179.9 + f64::from(count) * 0.1;
        let angle = if angle > 180.0 { angle - 360.0 } else { angle };
        let pose = Pose::p([300.0, 0.0, 200.0, angle, 0.0, 180.0, 5.0]);
        (count <= 5).then(|| pose.with_extended(axes(40.0 + f64::from(count) * 0.2)))
    });
    assert_eq!(end, EngineAction::Finished);
    assert_eq!(rig.names()[5..7], ["CurPos", "CurJnt"]);
    assert_eq!(rig.engine.start_pose(), Some(&Pose::p(at).with_extended(axes(40.0))));
    let (last, end) = (last.unwrap(), *rig.engine.last_pose());
    assert!((last.as_slice()[3] + 179.6).abs() < 1e-9);
    // a ramp of 40 ms: 0.8 + 0.6 + 0.4 + 0.2 of the last step
    assert!((end.as_slice()[3] - last.as_slice()[3] - 0.2).abs() < 1e-9, "{end:?}");
    assert!((end.as_slice()[8] - last.as_slice()[8] - 0.4).abs() < 1e-9, "{end:?}");
    assert_eq!(end.as_slice()[6..8], [5.0, 4_194_432.0]);
}

#[test]
fn transforms_keep_their_vectors_at_length_one() {
    let (sin, cos) = (0.02_f64.sin(), 0.02_f64.cos());
    let before = Pose::t([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 5.0]);
    let now = Pose::t([1.0, 0.0, 0.0, cos, sin, 0.0, 0.0, 0.0, 1.0, 5.0]);
    let next = now.shifted(&now.since(&before));
    let [_, _, _, o1, o2, o3, a1, a2, a3, fig] = next.as_slice().try_into().unwrap();
    assert_eq!((next.as_slice()[0], fig), (2.0, 5.0));
    assert!((o1 * o1 + o2 * o2 + o3 * o3 - 1.0_f64).abs() < 1e-12);
    assert!((a1 * a1 + a2 * a2 + a3 * a3 - 1.0_f64).abs() < 1e-12);
    assert!((o2 - 0.04_f64.sin()).abs() < 1e-4);
}

#[test]
fn finishing_ends_in_the_last_pose_if_the_limits_allow_it() {
    for (acceleration, ends) in [(f64::INFINITY, true), (100.0, false)] {
        let limits = AxisLimits { speed: [f64::INFINITY; 8], acceleration: [acceleration; 8] };
        let mut rig = Rig::new(Config { limits, ramp: Duration::from_secs(1), ..config(Mode::Mode2) }, &[0.0; 8]);
        let (mut at, mut speed, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|rig| {
            count += 1;
            speed += 0.005;
            at += speed;
            if count > 10 {
                rig.engine.finish();
            }
            (count <= 10).then(|| joints(at))
        });
        assert_eq!(end, EngineAction::Finished);
        let (last, commanded) = (rig.engine.last_pose().as_slice()[0], 0.005 * 55.0);
        assert_eq!((last - commanded).abs() < 1e-12, ends, "{last}");
    }
}
