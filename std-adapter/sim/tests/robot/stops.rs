//! Everything that stops a motion: Halt, Hold, the emergency stop, errors, the mode switch, a client that disconnects.

use bcap_core::bcap::call;
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_sim::{Config, EMERGENCY_STOP, Mode, Profile, Token};

use crate::common::{World, code, ok};
use crate::robot::joints;

#[test]
fn halt_from_another_connection_ends_the_waiting_move() {
    let mut world = World::new();
    let client = world.mover(1);
    let stopper = world.client(2);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(300);
    // it brakes before it stands, and is answered when it does
    world.begin(stopper.peer, &call::robot_halt(stopper.robot, ""));
    assert!(matches!(world.again(client.peer, &go).0, Outcome::Wait(_)));
    assert_eq!(world.run_again(stopper.peer, &call::robot_halt(stopper.robot, "")), code(HResult::S_OK));
    assert!(!world.sim.is_moving());
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::E_ABORT));
    let stopped = joints(&mut world, client)[0];
    assert!(stopped > 10.0 && stopped < 119.0, "{stopped}");
    world.pass(1000);
    assert_eq!(joints(&mut world, client)[0], stopped);
    assert_eq!(world.call(stopper.peer, call::robot_halt(stopper.robot, "")), code(HResult::S_FALSE));
    // no error, and the next motion is not refused
    assert_eq!(world.move_to(client, 1, "J(120,45,90,0,45,0)", ""), HResult::S_OK);
}

#[test]
fn hold_stands_until_unhold() {
    let mut world = World::new();
    let client = world.mover(1);
    let other = world.client(2);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    assert_eq!(world.call(other.peer, call::robot_hold(other.robot, "")), code(HResult::S_FALSE));
    world.begin(client.peer, &go);
    world.pass(200);
    assert_eq!(world.call(other.peer, call::robot_hold(other.robot, "")), code(HResult::S_OK));
    world.pass(5000);
    let held = joints(&mut world, other)[0];
    world.pass(5000);
    assert_eq!(joints(&mut world, other)[0], held);
    assert!(matches!(world.again(client.peer, &go).0, Outcome::Wait(_)));
    assert_eq!(world.robot_get(other, "@BUSY_STATUS"), ok(&true));
    world.sim.set_token(Token::Client(client.peer));
    assert_eq!(world.call(other.peer, call::robot_unhold(other.robot, "")), code(HResult::E_TOKEN_ADDRESS));
    world.sim.set_token(Token::Any);
    assert_eq!(world.call(other.peer, call::robot_unhold(other.robot, "")), code(HResult::S_OK));
    assert_eq!(world.call(other.peer, call::robot_unhold(other.robot, "")), code(HResult::S_FALSE));
    world.pass(5000);
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::S_OK));
    assert_eq!(joints(&mut world, other)[0], 120.0);
}

#[test]
fn the_emergency_stop_stops_everything_until_it_is_released_and_cleared() {
    let mut world = World::new();
    let client = world.mover(1);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(300);
    world.sim.emergency_stop(true, world.now);
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(EMERGENCY_STOP));
    let stopped = joints(&mut world, client);
    assert!(stopped[0] > 0.0 && stopped[0] < 120.0);
    assert!(!world.sim.motor_is_on() && !world.sim.is_moving());
    assert_eq!(world.get(client, "@EMERGENCY_STOP"), ok(&true));
    assert_eq!(world.get(client, "@NORMAL_STATUS"), ok(&false));
    assert_eq!(world.execute(client, "ClearError", ()), code(EMERGENCY_STOP));
    assert_eq!(world.put(client, "@ERROR_CODE", 0), EMERGENCY_STOP);
    assert_eq!(world.robot(client, "Motor", [1, 0]), code(HResult::E_ERROR_PRESENT));
    world.sim.emergency_stop(true, world.now);
    assert_eq!(world.execute(client, "GetCurErrorCount", ()), ok(&1));

    world.sim.emergency_stop(false, world.now);
    assert_eq!(world.robot(client, "Motor", [1, 0]), code(HResult::E_ERROR_PRESENT));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    assert_eq!(joints(&mut world, client), stopped);
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
}

#[test]
fn an_rc9_wants_manual_reset_after_the_emergency_stop() {
    let mut world = World::with(Config::new(Profile::Rc9));
    let client = world.mover(1);
    assert_eq!(world.execute(client, "StoState", ()), ok(&false));
    world.sim.emergency_stop(true, world.now);
    assert_eq!(world.execute(client, "StoState", ()), ok(&true));
    assert_eq!(world.execute(client, "ManualReset", ()), code(HResult::E_ACCESSDENIED));
    world.sim.emergency_stop(false, world.now);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", [1, 0]), code(HResult::E_ACCESSDENIED));
    assert_eq!(world.execute(client, "ManualReset", ()), ok(&()));
    assert_eq!(world.execute(client, "StoState", ()), ok(&false));
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));

    let mut rc8 = World::new();
    let client = rc8.client(1);
    assert_eq!(rc8.execute(client, "StoState", ()), code(HResult::E_INVALID_CMD_NAME));
}

#[test]
fn errors_stop_motion_and_from_level_three_the_motor() {
    for (error, motor_stays) in [(0x8150_0001, true), (0x8220_0001, true), (0x8320_0001, false), (0x8540_0001, false)] {
        let mut world = World::new();
        let client = world.mover(1);
        let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
        world.begin(client.peer, &go);
        world.pass(200);
        let error = HResult::from_u32(error);
        world.sim.inject_error(error, world.now);
        assert_eq!(world.again(client.peer, &go).0, Outcome::Done(error));
        assert_eq!(world.sim.motor_is_on(), motor_stays, "{error}");
        assert!(!world.sim.is_moving());
    }
}

#[test]
fn leaving_auto_mode_halts() {
    let mut world = World::new();
    let client = world.mover(1);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(200);
    world.sim.set_mode(Mode::Manual, world.now);
    world.pass(500);
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::E_ABORT));
    assert_eq!(world.get(client, "@MODE"), ok(&1));
    assert_eq!(world.robot(client, "Motor", 0), code(HResult::E_ACCESSDENIED));
}

#[test]
fn a_client_that_goes_leaves_no_motion_behind() {
    let mut world = World::new();
    let client = world.mover(1);
    let other = world.client(2);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(200);
    world.sim.abandoned(client.peer, world.now);
    assert!(world.sim.is_moving(), "a call that ran out of time leaves its motion running");
    world.sim.left(client.peer, world.now);
    world.pass(500);
    let stopped = joints(&mut world, other)[0];
    assert!(!world.sim.is_moving() && stopped < 119.0);
    assert_eq!(world.robot(other, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.move_to(other, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
}
