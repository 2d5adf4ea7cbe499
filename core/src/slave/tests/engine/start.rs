//! The start of a stream, and a restart after a fault.

use super::*;

#[test]
fn recovery_happens_on_request_and_starts_at_the_position_of_the_robot() {
    let start = joints(0.0);
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &[0.0; 8]);
    assert_eq!(rig.engine.recover(), Err(RecoverError::NoFault));
    rig.fault_at(20, |rig| rig.controller.fail(HResult::from_u32(0x8420_4051), "J1 command speed limit over"));
    let stopped_at = rig.controller.at[0];
    assert!(stopped_at > 0.0);
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Faulted);
    let asked = rig.controller.log.len();
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    let names: Vec<&str> = rig.controller.log[asked..].iter().map(|(_, name)| name.as_str()).collect();
    assert_eq!(names[..3], ["slvGetMode", "SysState", "ClearError"]);
    assert_eq!(names[3..9], START[..6]);
    assert_eq!(rig.engine.start_pose().unwrap().as_slice()[0], stopped_at);
    assert!(rig.engine.fault().is_none() && rig.controller.errors.is_empty());
}

#[test]
fn a_robot_without_a_finite_position_is_not_moved() {
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let limited = Config { limits: AxisLimits::uniform(10.0, 100.0), ..config(Mode::Mode0) };
        let mut rig = Rig::new(limited, &[0.0, number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.cause, rig.moves), (Step::Position, Cause::NoValue, 0));
        // joints that it does not have may have any value
        let mut rig = Rig::new(limited, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, number, number]);
        assert_eq!(rig.run(|_| None), EngineAction::Finished);
        assert_eq!(*rig.engine.start_pose().unwrap(), joints(0.0));
    }
}

#[test]
fn nan_bounds_are_refused() {
    let nan = |axis: usize| {
        let mut limits = AxisLimits::uniform(10.0, 100.0);
        limits.speed[axis] = f64::NAN;
        limits
    };
    let good = config(Mode::Mode0);
    let acceleration = AxisLimits { acceleration: [f64::NAN; 8], ..AxisLimits::NONE };
    for bad in [
        Config { limits: nan(0), ..good },
        Config { limits: nan(7), ..good },
        Config { limits: acceleration, ..good },
        Config { tolerance: f64::NAN, ..good },
        Config { start: Some(joints(f64::NAN)), ..good },
        Config { start: Some(joints(f64::INFINITY)), ..good },
    ] {
        assert_eq!(Engine::<256>::new(bad).unwrap_err(), ConfigError::Number);
    }
    assert!(Engine::<256>::new(Config { limits: AxisLimits::NONE, ..good }).is_ok(), "infinite limits are valid");
}

#[test]
fn a_stop_during_a_recovery_is_not_forgotten() {
    let mut rig = refused_start(config(Mode::Mode2), "Motor", HResult::from_u32(0x8350_106e));
    rig.engine.recover().unwrap();
    assert!(matches!(rig.engine.poll(rig.now), EngineAction::Call(Step::GetMode, _)));
    rig.engine.stop();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Finished);
    assert_eq!((rig.names().last(), rig.moves), (Some(&"GiveArm"), 0));
    // a stop requested before the fault ends with it
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    rig.controller.script.push(("slvGetMode", refused(HResult::E_FAIL)));
    rig.engine.stop();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    rig.engine.recover().unwrap();
    let mut poses = 0;
    let _ = rig.run(|_| {
        poses += 1;
        (poses < 3).then(|| joints(0.0))
    });
    assert_eq!(poses, 3);
}

#[test]
fn recovery_is_refused_after_an_emergency_stop() {
    let mut rig = disturbed(config(Mode::Mode2), 20, |rig| {
        rig.controller.system = 1 << 10;
        rig.controller.fail(HResult::from_u32(0x8350_0001), "Emergency stop");
    });
    assert_eq!(rig.fault().emergency_stop, Some(true));
    let (calls, done) = (rig.controller.log.len(), rig.path().len());
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    rig.controller.system = 0;
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Faulted);
    assert_eq!((rig.controller.log.len(), rig.path().len()), (calls, done));
    // the arm can still be given back
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!(rig.names().last(), Some(&"GiveArm"));
}

#[test]
fn a_later_emergency_stop_prevents_a_recovery() {
    let mut rig = refused_start(config(Mode::Mode2), "Motor", HResult::from_u32(0x8350_106e));
    assert_eq!(rig.fault().code(), Some(HResult::from_u32(0x8350_106e)));
    rig.controller.system = 1 << 10;
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| None), EngineAction::Faulted);
    assert_eq!(rig.fault().cause, Cause::EmergencyStop);
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    assert!(!rig.names().contains(&"ClearError"));
}

#[test]
fn each_refused_step_ends_the_start() {
    let code = HResult::E_ARM_NOT_TAKEN;
    for (command, step) in [
        ("slvSendFormat", Step::SendFormat),
        ("slvRecvFormat", Step::ReceiveFormat),
        ("TakeArm", Step::TakeArm),
        ("Motor", Step::Motor),
        ("CurJnt", Step::Position),
        ("slvChangeMode", Step::Enter),
    ] {
        let rig = refused_start(config(Mode::Mode1), command, code);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.cause, fault.released), (step, Cause::Refused(code), Released::Yes));
        assert_eq!(rig.names().last(), Some(&"SysState"));
        assert_eq!(rig.moves, 0);
    }
}

/// Every call of a start but slvGetMode would end the other stream.
#[test]
fn a_stream_of_another_client_is_left_alone() {
    let mut rig = Rig::new(Config { watch: Some(WATCH), ..config(Mode::Mode0) }, &[0.0; 8]);
    rig.controller.mode = 0x202;
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.step, fault.cause), (Step::GetMode, Cause::Occupied(StreamState::Runs)));
    assert_eq!(
        (fault.to_string().as_str(), fault.released),
        ("slvGetMode: a stream of Slave Mode runs already", Released::No)
    );
    rig.engine.stop();
    assert_eq!(
        (rig.run(|_| None), rig.names(), rig.controller.mode),
        (EngineAction::Finished, ["slvGetMode"].to_vec(), 0x202)
    );
    // a controller that does not report its mode may have a stream; one without Slave Mode has none
    let rig = refused_start(config(Mode::Mode0), "slvGetMode", HResult::E_FAIL);
    let fault = rig.fault();
    assert_eq!(fault.cause, Cause::Occupied(StreamState::Unknown(HResult::E_FAIL)));
    assert!(fault.to_string().ends_with("so the stream of another client may run"), "{fault}");
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.controller.script.push(("slvGetMode", refused(HResult::E_NOTIMPL)));
    assert_eq!(rig.run(trajectory(10)), EngineAction::Finished);
}

/// Every call of a recovery but slvGetMode would end the other stream.
#[test]
fn a_recovery_leaves_the_stream_of_another_client_alone() {
    let mut occupied = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    occupied.controller.mode = 0x202;
    assert_eq!(occupied.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    // the other client takes the arm, then streams
    let mut unarmed = refused_start(config(Mode::Mode0), "TakeArm", HResult::E_ARM_NOT_TAKEN);
    unarmed.controller.mode = 0x202;
    for mut rig in [occupied, unarmed] {
        rig.controller.log.clear();
        rig.engine.recover().unwrap();
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.cause), (Step::GetMode, Cause::Occupied(StreamState::Runs)));
        assert_eq!((rig.names(), rig.controller.mode), (["slvGetMode"].to_vec(), 0x202));
        // after the end of the other stream
        rig.controller.mode = 0;
        rig.engine.recover().unwrap();
        assert_eq!(rig.run(trajectory(10)), EngineAction::Finished);
    }
}

#[test]
fn a_stream_that_the_engine_could_not_leave_prevents_no_recovery() {
    let mut rig = disturbed(config(Mode::Mode0), 5, |rig| {
        rig.failures.push((rig.moves + 1, Failure::Timeout));
        rig.controller.script.push(("slvChangeMode", refused(HResult::E_FAIL)));
    });
    assert_eq!(rig.fault().released, Released::No);
    rig.controller.buffer.clear();
    (rig.controller.mode, rig.controller.moving) = (0x002, false);
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    assert_eq!((rig.fault().step, rig.fault().released), (Step::SystemState, Released::Yes));
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
}

#[test]
fn a_stream_that_begins_during_the_start_is_left_alone() {
    for (command, step) in [("TakeArm", Step::TakeArm), ("slvChangeMode", Step::Enter)] {
        let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
        rig.controller.script.push((command, refused(HResult::E_ARM_NOT_TAKEN)));
        rig.controller.script.push(("slvGetMode", ok(&0)));
        rig.controller.script.push(("slvGetMode", ok(&0x102)));
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.released), (step, Released::No));
        assert_eq!(rig.names().last(), Some(&"slvGetMode"));
        rig.engine.stop();
        assert_eq!((rig.run(|_| None), rig.names().last()), (EngineAction::Finished, Some(&"slvGetMode")));
    }
}

#[test]
fn a_robot_that_is_not_at_the_start_is_not_moved() {
    let start = Pose::j([10.0, 20.0, 30.0, 0.0, 0.0, 0.0, 99.0, 99.0]);
    let at = [10.0, 20.04, 30.5, 0.0, 0.0, 0.0, 1e-307, 3e-313];
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &at);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!(fault.cause, Cause::NotAtStart { number: 3, actual: 30.5, expected: 30.0 });
    assert_eq!((rig.names().last(), rig.controller.mode), (Some(&"CurJnt"), 0));
    // within the tolerance, with any value of joints that the robot does not have
    let at = [10.0, 20.04, 29.96, 0.0, 0.0, 0.0, 1e-307, 3e-313];
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &at);
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!(rig.engine.start_pose(), Some(&start));
    assert_eq!(rig.names(), [&START[..], &["Motor", "GiveArm"]].concat());
}

#[test]
fn an_inconsistent_configuration_is_refused() {
    let wrong = Config { start: Some(spec_pose()), ..config(Mode::Mode0) };
    assert_eq!(
        Engine::<256>::new(wrong).unwrap_err().to_string(),
        "the start of the stream: the format has poses of type J, this pose is P"
    );
    let wrong = Config { cycle: Duration::ZERO, ..config(Mode::Mode0) };
    assert_eq!(Engine::<256>::new(wrong).unwrap_err(), ConfigError::Cycle);
    assert!(matches!(Engine::<64>::new(config(Mode::Mode0)).unwrap_err(), ConfigError::Frame(_)));
}

#[test]
fn unrequested_input_changes_nothing() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    assert_eq!(rig.engine.push(&joints(0.0)), Err(PoseError::NotNow));
    assert!(rig.engine.request().is_none());
    rig.engine.handle_failure(Failure::Lost, rig.now);
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Call(Step::GetMode, Channel::Motion));
    // polling again returns the same call
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Call(Step::GetMode, Channel::Motion));
    assert_eq!(rig.run(trajectory(5)), EngineAction::Finished);
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Finished);
    assert_eq!(rig.names().iter().filter(|name| **name == "slvGetMode").count(), 1);
}
