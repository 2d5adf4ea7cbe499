//! The preconditions of Slave Mode, the calls that it allows, and the events that end it.

use bcap_core::bcap::call;
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_sim::codes::MANUAL_MODE;
use bcap_sim::{Config, Mode, Profile, SlaveConfig, Token};

use crate::common::{Value, World, code, ok};
use crate::slave::{Rig, START, UNDERFLOW, assert_close, j1, moving};

/// The error of a stop from outside.
const STOPPED: HResult = HResult::E_COMMAND_POSITION_GEN_STOPPED;

#[test]
fn entering_needs_what_every_motion_needs_and_a_licence() {
    let slave = SlaveConfig { licensed: false, ..SlaveConfig::default() };
    let mut world = World::with(Config { slave, ..Config::default() });
    let client = world.client(1);
    assert_eq!(world.robot(client, "slvChangeMode", 4), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "slvChangeMode", 2), code(HResult::E_NO_LICENSE));

    let config = Config { mode: Mode::Manual, token: Token::TeachPendant, ..Config::default() };
    let mut world = World::with(config);
    let (client, other) = (world.client(1), world.client(2));
    world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
    let enter = |world: &mut World| world.robot(client, "slvChangeMode", 0x002).0;
    assert_eq!(enter(&mut world), MANUAL_MODE);
    world.sim.set_mode(Mode::Auto, world.now);
    assert_eq!(enter(&mut world), HResult::E_TOKEN_NOT_ETHERNET);
    world.sim.set_token(Token::Client(other.peer));
    assert_eq!(enter(&mut world), HResult::E_TOKEN_ADDRESS);
    world.sim.set_token(Token::Client(client.peer));
    assert_eq!(enter(&mut world), HResult::E_ERROR_PRESENT);
    world.clear(client);
    assert_eq!(enter(&mut world), HResult::E_ARM_NOT_TAKEN);
    world.clear(client);
    world.robot(client, "TakeArm", [0, 1]);
    assert_eq!(enter(&mut world), HResult::E_MOTOR_OFF);
    world.clear(client);
    world.robot(client, "Motor", 1);
    let moves = call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "NEXT");
    assert_eq!(world.call(client.peer, moves), code(HResult::S_OK));
    assert_eq!(enter(&mut world), HResult::E_ROBOTISBUSY);
    world.pass(1000);
    assert_eq!(enter(&mut world), HResult::S_OK);
    assert_eq!(world.robot(other, "slvChangeMode", 0).0, HResult::E_ARM_NOT_TAKEN);
    assert_eq!(world.sim.slave_mode(), 0x002, "Slave Mode allows the command");
    assert_eq!(enter(&mut world), HResult::E_SLVMODE_ON);
    assert_eq!(world.sim.slave_mode(), 0);
}

#[test]
fn the_nine_modes_are_told_by_get_mode_and_others_are_none() {
    for mode in [0x001, 0x002, 0x003, 0x101, 0x102, 0x103, 0x201, 0x202, 0x203] {
        let mut rig = Rig::enter(mode);
        assert_eq!(rig.execute("slvGetMode", ()), ok(&mode));
        assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
        assert_eq!(rig.execute("slvGetMode", ()), ok(&0));
        assert_eq!(rig.execute("slvChangeMode", 0), ok(&()), "leaving twice is no error");
    }
    let mut rig = Rig::new();
    for mode in [-1, 0x004, 0x00f, 0x100, 0x104, 0x200, 0x301, 0x1002] {
        assert_eq!(rig.execute("slvChangeMode", mode), code(HResult::E_INVALIDARG), "{mode:#x}");
    }
    assert_eq!(rig.execute("slvChangeMode", ()), code(HResult::E_INVALIDARG));
}

#[test]
fn slv_move_without_slave_mode_hides_the_first_cause_which_the_list_tells() {
    let mut rig = Rig::new();
    assert_eq!(rig.j1(0.0), HResult::E_SLVMODE_OFF);
    assert_eq!(rig.errors(), [HResult::E_SLVMODE_OFF]);
    let client = rig.client;
    rig.world.clear(client);
    rig.execute("slvChangeMode", 0x002);
    rig.j1(0.1);
    rig.cycles(2);
    assert_eq!(rig.j1(0.2), HResult::E_SLVMODE_OFF);
    assert_eq!(rig.world.execute(client, "GetCurErrorCount", ()), ok(&2));
    let (_, info) = rig.world.execute(client, "GetCurErrorInfo", 1);
    let Variant::Array(info) = info.as_variant() else { panic!("no array") };
    assert_eq!(info.get(0).map(Variant::flatten), Some(Variant::I4(UNDERFLOW.0)));
    assert_eq!(rig.world.get(client, "@ERROR_CODE"), ok(&HResult::E_SLVMODE_OFF.0));
    // recovery: only the listed order works
    assert_eq!(rig.execute("slvChangeMode", 0x002), code(HResult::E_ERROR_PRESENT));
    assert_eq!(rig.world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(rig.execute("slvChangeMode", 0x002), code(HResult::E_MOTOR_OFF));
    rig.world.clear(client);
    assert_eq!(rig.world.robot(client, "Motor", 1), ok(&()));
    assert_eq!(rig.execute("slvChangeMode", 0x002), ok(&()));
    assert_eq!(rig.j1(0.2), HResult::S_OK);
}

#[test]
fn the_state_of_a_safe_stop_is_read_and_reset_in_slave_mode() {
    let mut rig = Rig::with(Config::new(Profile::Rc9));
    let client = rig.client;
    rig.execute("slvChangeMode", 0x002);
    assert_eq!(rig.execute("curjnt", ()), ok(&START));
    assert_eq!(rig.world.execute(client, "StoState", ()), ok(&false));
    assert_eq!(rig.world.execute(client, "ManualReset", ()), ok(&()));
    assert_eq!((rig.mode(), rig.errors()), (2, vec![]));
}

#[test]
fn a_pose_of_another_client_is_refused_and_leaves_slave_mode_on() {
    let mut rig = Rig::enter(0x002);
    let other = rig.world.client(2);
    assert_eq!(rig.world.robot(other, "slvMove", START), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!((rig.mode(), rig.errors()), (2, vec![HResult::E_ARM_NOT_TAKEN]));
    assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
}

#[test]
fn the_token_counts_for_every_pose() {
    let mut rig = Rig::enter(0x002);
    rig.world.sim.set_token(Token::TeachPendant);
    assert_eq!(rig.j1(0.0), HResult::E_TOKEN_NOT_ETHERNET);
    rig.world.sim.set_token(Token::Any);
    assert_eq!(rig.j1(0.0), HResult::S_OK);
}

#[test]
fn the_emergency_stop_and_the_mode_switch_end_slave_mode_where_the_robot_is() {
    let stops: [fn(&mut World); 2] =
        [|world| world.sim.emergency_stop(true, world.now), |world| world.sim.set_mode(Mode::Manual, world.now)];
    for stop in stops {
        let mut rig = moving(0x202);
        rig.j1(0.8);
        rig.withheld(j1(1.0));
        rig.world.pass(4);
        stop(&mut rig.world);
        assert_eq!(rig.again(j1(1.0)), (Outcome::Done(STOPPED), Value::EMPTY), "a waiting call ends");
        assert_eq!((rig.mode(), rig.errors()), (0, vec![STOPPED]));
        assert!(!rig.world.sim.motor_is_on());
        assert_close(&rig.here(), &j1(0.1), 1e-12);
        rig.cycles(10);
        assert_close(&rig.here(), &j1(0.1), 1e-12);
        assert_eq!(rig.j1(0.2), HResult::E_SLVMODE_OFF);
        assert_eq!(rig.errors(), [HResult::E_SLVMODE_OFF, STOPPED]);
    }
}

#[test]
fn an_error_from_level_two_ends_it_too() {
    for (error, mode) in [(0x8150_0001, 2), (0x8220_0001, 0)] {
        let mut rig = moving(0x002);
        rig.world.sim.inject_error(HResult::from_u32(error), rig.world.now);
        assert_eq!((rig.mode(), rig.errors()), (mode, vec![HResult::from_u32(error)]));
    }
}

#[test]
fn halt_brakes_from_any_connection() {
    let mut rig = moving(0x002);
    rig.world.pass(4);
    let other = rig.world.client(2);
    let halt = call::robot_halt(other.robot, "");
    rig.world.begin(other.peer, &halt);
    assert_eq!(rig.mode(), 0);
    // 25 degrees per second at the servo's 7500 per second squared: 3.33 ms, and half as far as at that speed
    let way = 25.0 * 25.0 / 7500.0 / 2.0;
    assert!(rig.world.sim.is_moving());
    assert_close(&rig.here(), &j1(0.1), 1e-9);
    rig.world.pass(4);
    assert!(!rig.world.sim.is_moving());
    assert_close(&rig.here(), &j1(0.1 + way), 1e-9);
    assert_eq!(rig.world.again(other.peer, &halt), (Outcome::Done(HResult::S_OK), Value::EMPTY));
    assert_eq!((rig.errors(), rig.world.sim.motor_is_on()), (vec![], true));
}

#[test]
fn a_client_that_goes_leaves_no_slave_mode_behind() {
    let mut rig = moving(0x002);
    rig.world.sim.left(rig.client.peer, rig.world.now);
    rig.world.pass(100);
    assert_eq!((rig.mode(), rig.world.sim.arm_owner(), rig.world.sim.is_moving()), (0, None, false));
    assert!(rig.here()[0] < 0.2, "what was buffered is dropped");
}
