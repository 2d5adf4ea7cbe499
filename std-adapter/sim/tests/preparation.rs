//! The preparation that only a COBOTTA needs before it moves.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::codes::{EMERGENCY_STOP, RESET_IN_EMERGENCY_STOP};
use bcap_sim::{Config, Profile, Scenario, SysStateBit, Token};

use crate::common::{Client, World, code, ok};

fn cobotta() -> (World, Client) {
    let mut world = World::with(Config::new(Profile::Cobotta));
    let client = world.client(1);
    (world, client)
}

fn calibrated(world: &mut World, client: Client) -> bool {
    let (_, state) = world.execute(client, "SysState", ());
    state.as_variant().as_i32().unwrap() & 1 << SysStateBit::Calibrated as u32 != 0
}

#[test]
fn the_motor_wants_the_motion_prepared_and_that_the_manual_reset() {
    let (mut world, client) = cobotta();
    assert_eq!(world.robot(client, "GetMotionPreparationState", ()), ok(&false));
    assert_eq!(world.robot(client, "MotionPreparation", ()), code(HResult::E_MANUAL_RESET_UNPREPARED));
    world.clear(client);
    assert_eq!(world.robot(client, "Motor", 1), code(HResult::E_MOTION_UNPREPARED));
    world.clear(client);
    assert_eq!(world.robot(client, "ManualResetPreparation", ""), ok(&()));
    assert_eq!(world.robot(client, "Motionpreparation", ""), ok(&()));
    assert_eq!(world.robot(client, "GetMotionPreparationState", ()), ok(&true));
    assert_eq!(world.robot(client, "Motor", 1), ok(&()));
    assert!(world.sim.motor_is_on());
    // a preparation is for all commands
    assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
}

#[test]
fn before_version_2_8_nothing_needs_the_manual_reset() {
    let mut world = World::with(Config { version: "2.7.9".to_owned(), ..Config::new(Profile::Cobotta) });
    let client = world.client(1);
    assert_eq!(world.robot(client, "ManualResetPreparation", ()), code(HResult::E_INVALIDARG));
    assert_eq!(world.execute(client, "ManualResetPreparation", ()), code(HResult::E_INVALIDARG));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", 1), code(HResult::E_MOTION_UNPREPARED));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", 1), ok(&()));
    for (version, needs) in [("2.8.0", true), ("2.10", true), ("3", true), ("2.8", false), ("1.9.9", false)] {
        let mut world = World::with(Config { version: version.to_owned(), ..Config::new(Profile::Cobotta) });
        let client = world.client(1);
        let answer = world.execute(client, "ClearError", ());
        assert_eq!(answer.0 == HResult::E_MANUAL_RESET_UNPREPARED, needs, "{version}");
    }
}

#[test]
fn a_scenario_starts_with_a_prepared_arm() {
    let (mut world, client) = cobotta();
    world.sim.play(Scenario::parse("[controller]\nprepared = true").unwrap());
    assert_eq!(world.robot(client, "GetMotionPreparationState", ()), ok(&true));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", 1), ok(&()));
}

#[test]
fn without_the_token_only_what_moves_is_refused() {
    let (mut world, client) = cobotta();
    world.sim.set_token(Token::TeachPendant);
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.robot(client, "ManualResetPreparation", ()), ok(&()));
    assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
    assert!(world.robot(client, "Motor", 0).0.is_ok());
    assert_eq!(world.robot(client, "Motor", 1), code(HResult::E_TOKEN_NOT_ETHERNET));
    let task = world.task(client, "Pro1");
    assert_eq!(world.call(client.peer, call::task_start(task, 1, "")), code(HResult::E_TOKEN_NOT_ETHERNET));
}

#[test]
fn errors_are_cleared_behind_a_preparation_only() {
    let (mut world, client) = cobotta();
    world.sim.inject_error(HResult::from_u32(0x8350_0001), world.now);
    for _ in 0..2 {
        assert_eq!(world.execute(client, "ClearError", ()), code(HResult::E_MANUAL_RESET_UNPREPARED));
        assert_eq!(world.put(client, "@ERROR_CODE", 0), HResult::E_MANUAL_RESET_UNPREPARED);
    }
    assert_eq!(world.errors(), [HResult::E_MANUAL_RESET_UNPREPARED, HResult::from_u32(0x8350_0001)]);
    // the controller has the command as well as the robot
    assert_eq!(world.execute(client, "ManualResetPreparation", ()), ok(&()));
    assert_eq!(world.robot(client, "AutoCal", ()), code(HResult::E_ERROR_PRESENT));
    assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()), "the preparation lasts");
}

#[test]
fn an_emergency_stop_undoes_the_preparation() {
    let (mut world, client) = cobotta();
    let _ = world.mover(2);
    assert_eq!(world.execute(client, "StoState", ()), ok(&false));
    world.sim.emergency_stop(true, world.now);
    assert_eq!(world.robot(client, "GetMotionPreparationState", ()), ok(&false));
    assert_eq!(world.execute(client, "StoState", ()), ok(&true));
    assert_eq!(world.errors(), []);
    assert_eq!(world.robot(client, "Motor", 1), code(EMERGENCY_STOP));
    assert_eq!(world.robot(client, "MotionPreparation", ()), code(EMERGENCY_STOP));
    world.clear(client);
    world.sim.emergency_stop(false, world.now);
    assert_eq!(world.robot(client, "Motor", 1), code(HResult::E_MOTION_UNPREPARED));
    world.clear(client);
    world.robot(client, "ManualResetPreparation", ());
    assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
    assert_eq!(world.execute(client, "StoState", ()), ok(&false));
    assert_eq!(world.robot(client, "Motor", 1), ok(&()));
}

#[test]
fn calibrating_is_told_by_sys_state() {
    let (mut world, client) = cobotta();
    assert!(!calibrated(&mut world, client));
    assert_eq!(world.robot(client, "AutoCal", ()), ok(&()));
    assert!(calibrated(&mut world, client));
}

#[test]
fn other_models_have_nothing_to_prepare() {
    for profile in [Profile::Rc8, Profile::Rc9] {
        let mut world = World::with(Config::new(profile));
        let client = world.client(1);
        assert!(calibrated(&mut world, client));
        for command in ["ManualResetPreparation", "MotionPreparation", "GetMotionPreparationState", "AutoCal"] {
            assert_eq!(world.robot(client, command, ()), code(HResult::E_INVALID_CMD_NAME), "{profile:?}: {command}");
        }
        assert_eq!(world.robot(client, "Motor", 1), ok(&()));
        assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    }
}

#[test]
fn an_rc9_is_reset_by_either_name_of_the_command() {
    for command in ["ManualReset", "ResetStoState"] {
        let mut world = World::with(Config::new(Profile::Rc9));
        let client = world.client(1);
        world.sim.emergency_stop(true, world.now);
        assert_eq!(world.execute(client, command, ()), code(RESET_IN_EMERGENCY_STOP));
        world.sim.emergency_stop(false, world.now);
        assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
        assert_eq!(world.robot(client, "Motor", 1), code(HResult::E_ACCESSDENIED));
        assert_eq!(world.execute(client, command, ()), ok(&()));
        assert_eq!(world.robot(client, "Motor", 1), ok(&()));
    }
}

#[test]
fn the_start_of_the_ros_2_driver_succeeds() {
    let mut world = World::with(Config::new(Profile::Cobotta));
    // one session moves the robot, the other monitors it
    let (acts, watches) = (world.client(1), world.client(2));
    assert_eq!(world.robot_get(watches, "@TYPE_NAME"), ok("CVR038A1"));
    assert_eq!(world.robot(acts, "ManualResetPreparation", ()), ok(&()));
    assert_eq!(world.execute(watches, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(acts, "ManualResetPreparation", ()), ok(&()));
    assert_eq!(world.robot(acts, "MotionPreparation", ()), ok(&()));
    assert_eq!(world.robot(watches, "HighCurJntEx", ()).0, HResult::S_OK);
    let servo = world.robot_variable(watches, "@SERVO_ON");
    assert_eq!(world.run(watches.peer, call::variable_put_value(servo, true)), code(HResult::S_OK));
    assert_eq!(world.robot(acts, "slvSendFormat", 0), ok(&()));
    assert_eq!(world.robot(acts, "slvRecvFormat", 2), ok(&()));
    assert_eq!(world.robot(acts, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.robot(acts, "slvChangeMode", 514), ok(&()));
    assert_eq!(world.sim.slave_mode(), 514);
}
