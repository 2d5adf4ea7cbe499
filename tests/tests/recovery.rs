//! Examining, recovering and preparing robots of each model against the virtual controller, blocking and under tokio.

use std::ops::ControlFlow;

use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_sim::{Controller as Simulated, Profile};
use bcap_std::server::Limits;
use bcap_std::{Error, Obstacle, RecoveryConfig, RecoveryStep, Settings, asynch, blocking};
use bcap_tests::served::Served;
use bcap_tests::simulated::quick;

const MODELS: [Profile; 4] = [Profile::Rc8, Profile::Rc9, Profile::Cobotta, Profile::CobottaPro];
const ERROR: HResult = HResult::from_u32(0x8420_4043);
const ALONE: RecoveryConfig = RecoveryConfig { is_alone: true, speed: None, agreed: None };

fn simulated(profile: Profile) -> (Served<Simulated>, Settings) {
    let settings = match profile {
        Profile::Rc9 | Profile::CobottaPro => Settings::rc9(),
        Profile::Cobotta => Settings::cobotta(),
        _ => Settings::rc8(),
    };
    (Served::of(Simulated::new(quick(profile)), Limits::default()), settings)
}

fn connect(sim: &Served<Simulated>, settings: &Settings) -> blocking::Controller {
    blocking::Controller::connect(&format!("tcp:{}", sim.tcp), settings).unwrap()
}

/// Returns whether a client owns the arm, whether the motor is on, and the number of errors.
fn state(sim: &Served<Simulated>) -> (bool, bool, usize) {
    let mut sim = sim.application();
    sim.advance(bcap_std::now());
    (sim.arm_owner().is_some(), sim.motor_is_on(), sim.errors().count())
}

fn press(sim: &Served<Simulated>, pressed: bool) {
    sim.application().emergency_stop(pressed, bcap_std::now());
}

fn not_recovered(error: Error) -> (RecoveryStep, Option<Obstacle>, Option<HResult>) {
    let code = error.code();
    let Error::NotRecovered(error) = error else { panic!("{error}") };
    (error.step, error.obstacle, code)
}

/// Presses the emergency stop, releases it, recovers, and drops the arm; `$wait` is `.await` or nothing.
macro_rules! recovered {
    ($sim:expr, $cell:expr $(, $wait:tt)?) => {{
        let (sim, mut cell) = ($sim, $cell);
        press(sim, true);
        let mut robot = cell.robot()$(.$wait)?.unwrap();
        let seen = robot.examine()$(.$wait)?.unwrap();
        assert_eq!(seen.errors(), [], "the stop itself is no error");
        assert_eq!(seen.obstacles().collect::<Vec<_>>(), [Obstacle::EmergencyStop]);
        let error = robot.recover(ALONE)$(.$wait)?.map(drop).unwrap_err();
        assert_eq!(not_recovered(error).1, Some(Obstacle::EmergencyStop));
        assert_eq!(state(sim), (false, false, 0));

        press(sim, false);
        sim.application().inject_error(ERROR, bcap_std::now());
        // the controller does not report the owner of the arm while it has an error, so the error stays
        let unsure = cell.robot()$(.$wait)?.unwrap().recover(RecoveryConfig::default())$(.$wait)?.map(drop);
        let (step, obstacle, _) = not_recovered(unsure.unwrap_err());
        assert_eq!((step, obstacle), (RecoveryStep::TakeArm, Some(Obstacle::OwnerUnknown)));
        assert!(sim.application().errors().any(|error| error.code == ERROR));
        let arm = cell.robot()$(.$wait)?.unwrap().recover(ALONE)$(.$wait)?.unwrap();
        assert_eq!(state(sim), (true, true, 0));
        arm.give()$(.$wait)?.unwrap();
        assert_eq!(state(sim), (false, false, 0));

        let mut robot = cell.robot()$(.$wait)?.unwrap();
        assert!(!robot.examine()$(.$wait)?.unwrap().is_ready(), "the motor is off");
        let mut arm = robot.prepare()$(.$wait)?.unwrap();
        assert_eq!(state(sim), (true, false, 0));
        arm.motor_on()$(.$wait)?.unwrap();
        assert!(arm.robot().examine()$(.$wait)?.unwrap().is_ready());
        arm.give()$(.$wait)?.unwrap();
        assert_eq!(state(sim), (false, false, 0));
    }};
}

#[test]
fn every_model_is_recovered_after_an_emergency_stop() {
    for profile in MODELS {
        let (sim, settings) = simulated(profile);
        recovered!(&sim, connect(&sim, &settings));
    }
}

#[tokio::test]
#[expect(unused_mut, reason = "the objects for tokio need no exclusive access")]
async fn every_model_is_recovered_after_an_emergency_stop_under_tokio() {
    for profile in MODELS {
        let (sim, settings) = simulated(profile);
        let cell = asynch::Controller::connect(&format!("tcp:{}", sim.tcp), &settings).await.unwrap();
        recovered!(&sim, cell, await);
    }
}

#[test]
fn another_client_keeps_its_arm_its_motor_and_its_stream() {
    let (sim, settings) = simulated(Profile::Rc9);
    let (mut other, mut cell) = (connect(&sim, &settings), connect(&sim, &settings));
    let mut arm = other.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let error = cell.robot().unwrap().recover(ALONE).map(drop).unwrap_err();
    let (step, _, code) = not_recovered(error);
    assert_eq!((step, code), (RecoveryStep::TakeArm, Some(HResult::E_ARM_NOT_TAKEN)));
    cell.execute::<OwnedVariant>("ClearError", ()).unwrap();
    assert_eq!(state(&sim), (true, true, 0));
    arm.robot().execute::<OwnedVariant>("slvChangeMode", 0x202).unwrap();
    let error = cell.robot().unwrap().prepare().map(drop).unwrap_err();
    assert_eq!(not_recovered(error).1, Some(Obstacle::Stream));
    assert_eq!(cell.robot().unwrap().examine().unwrap().state, None, "SysState would end the stream");
    assert_eq!(sim.application().slave_mode(), 0x202);
}

#[test]
fn a_recovery_that_ends_early_leaves_the_robot_as_it_was() {
    let (sim, settings) = simulated(Profile::Rc8);
    let raise = |code| sim.application().inject_error(HResult::from_u32(code), bcap_std::now());
    for panics in [false, true] {
        raise(0x8320_1501);
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let mut cell = connect(&sim, &settings);
            let ended = cell.make_ready(Some(ALONE), |step, _| match step {
                RecoveryStep::Motor if panics => panic!("in the middle"),
                RecoveryStep::Motor => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            });
            assert_eq!(not_recovered(ended.map(drop).unwrap_err()), (RecoveryStep::Motor, None, None));
            assert!(!cell.has_arm() && !cell.has_motor());
        }));
        assert_eq!(ended.is_err(), panics);
        assert_eq!(state(&sim), (false, false, 0));
    }
    // only a restart ends this one
    raise(0x8550_0001);
    let error = connect(&sim, &settings).robot().unwrap().recover(ALONE).map(drop).unwrap_err();
    assert!(error.to_string().starts_with("not recovered: before the examination: the error 0x85500001"), "{error}");
}
