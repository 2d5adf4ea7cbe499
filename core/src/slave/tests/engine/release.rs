//! The end of a stream, including after a fault.

use super::*;

/// A stream that has ended with an error of the controller.
fn faulted(config: Config) -> Rig {
    let fail = |rig: &mut Rig| rig.controller.fail(HResult::from_u32(0x8350_0001), "an error");
    let mut rig = disturbed(config, 20, fail);
    rig.controller.log.clear();
    rig
}

#[test]
fn after_a_fault_the_robot_is_halted_and_the_motor_switched_off_before_the_arm_is_given_back() {
    let mut rig = faulted(config(Mode::Mode2));
    assert_eq!(rig.engine.effects(), Effects { moving: true, motor: true, ..Effects::default() });
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!(rig.names(), ["Robot_Halt", "Motor", "GiveArm"]);
    assert!(!rig.controller.motor && !rig.controller.arm);
    assert_eq!(rig.engine.effects(), Effects::default());
}

#[test]
fn a_motor_that_is_to_stay_on_is_not_switched_off() {
    let config = Config { motor_off: false, ..config(Mode::Mode0) };
    let mut rig = Rig::new(config, &[0.0; 8]);
    assert_eq!(rig.run(trajectory(20)), EngineAction::Finished);
    assert_eq!((rig.names().last(), rig.controller.motor), (Some(&"GiveArm"), true));
    let mut rig = faulted(config);
    rig.engine.stop();
    assert_eq!((rig.run(|_| None), rig.names()), (EngineAction::Finished, ["Robot_Halt", "GiveArm"].to_vec()));
    assert_eq!(rig.engine.effects(), Effects::default());
}

#[test]
fn a_refused_step_of_the_end_prevents_none_after_it() {
    for (refuses, left) in [
        ("Robot_Halt", Effects { moving: true, ..Effects::default() }),
        ("Motor", Effects { motor: true, ..Effects::default() }),
        ("GiveArm", Effects::default()),
    ] {
        let mut rig = faulted(config(Mode::Mode2));
        let before = rig.fault().to_string();
        rig.controller.script.push((refuses, refused(HResult::E_FAIL)));
        rig.engine.stop();
        assert_eq!(rig.run(|_| None), EngineAction::Faulted, "{refuses}");
        assert_eq!(rig.names(), ["Robot_Halt", "Motor", "GiveArm"]);
        assert_eq!((rig.fault().to_string(), rig.engine.effects()), (before, left));
        // again, only the missing step
        rig.controller.log.clear();
        rig.engine.stop();
        rig.controller.arm = true;
        assert_eq!((rig.run(|_| None), rig.names()), (EngineAction::Finished, [refuses].to_vec()));
    }
}

/// E_BUSY_PROC: the controller still executes an abandoned call.
#[test]
fn a_step_of_the_end_is_repeated_while_the_controller_is_busy() {
    let busy = |count: usize| core::iter::repeat_n(("Robot_Halt", refused(HResult::E_BUSY_PROC)), count);
    let mut rig = faulted(config(Mode::Mode2));
    rig.controller.script.extend(busy(2));
    let began = rig.now;
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), EngineAction::Finished);
    assert_eq!(rig.names(), ["Robot_Halt", "Robot_Halt", "Robot_Halt", "Motor", "GiveArm"]);
    assert!((20..100).contains(&rig.now.saturating_since(began).as_millis()), "{:?}", rig.now);
    // for a limited time
    let mut rig = faulted(config(Mode::Mode2));
    rig.controller.script.extend(busy(1000));
    let began = rig.now;
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), EngineAction::Faulted);
    assert!((4900..5100).contains(&rig.now.saturating_since(began).as_millis()), "{:?}", rig.now);
    assert_eq!(rig.engine.effects(), Effects { moving: true, ..Effects::default() });
}

#[test]
fn a_motor_that_stays_on_at_the_end_of_a_stream_is_a_fault() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut poses = trajectory(20);
    let end = rig.run(|rig| {
        let pose = poses(rig);
        if pose.is_none() {
            rig.controller.script.push(("Motor", refused(HResult::E_FAIL)));
        }
        pose
    });
    assert_eq!(end, EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.step, fault.cause), (Step::MotorOff, Cause::Refused(HResult::E_FAIL)));
    assert!(rig.controller.motor && !rig.controller.arm);
    assert_eq!(rig.engine.effects(), Effects { motor: true, ..Effects::default() });
}

#[test]
fn an_arm_whose_taking_has_no_reply_is_given_back() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    loop {
        let EngineAction::Call(step, _) = rig.engine.poll(rig.now) else { panic!("no call") };
        if step == Step::TakeArm {
            break rig.engine.handle_failure(Failure::Timeout, rig.now);
        }
        rig.call();
    }
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    rig.engine.stop();
    assert_eq!((rig.run(|_| None), rig.names().last()), (EngineAction::Finished, Some(&"GiveArm")));
}

/// E_TIMEOUT: the controller has abandoned the call, and still executes it.
#[test]
fn the_effect_of_a_call_that_the_controller_gave_up_is_ended() {
    for (given_up, end) in
        [("TakeArm", &["GiveArm"][..]), ("Motor", &["Motor", "GiveArm"]), ("slvChangeMode", &["Motor", "GiveArm"])]
    {
        let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
        rig.controller.script.push((given_up, refused(HResult::E_TIMEOUT)));
        if given_up == "slvChangeMode" {
            // off before it, on afterwards
            rig.controller.script.extend([0, 0x102].map(|mode| ("slvGetMode", ok(&mode))));
        }
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted, "{given_up}");
        assert_eq!(rig.fault().cause, Cause::Refused(HResult::E_TIMEOUT));
        // the diagnosis leaves Slave Mode
        let left = if given_up == "slvChangeMode" { 2 } else { 0 };
        assert_eq!(rig.names().iter().filter(|name| **name == "slvChangeMode").count(), left, "{given_up}");
        rig.controller.arm = true;
        rig.controller.log.clear();
        rig.engine.stop();
        assert_eq!((rig.run(|_| None), rig.names()), (EngineAction::Finished, end.to_vec()), "{given_up}");
    }
}
