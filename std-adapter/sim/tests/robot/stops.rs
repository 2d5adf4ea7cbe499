//! Everything that stops a motion: Halt, Hold, the emergency stop, errors, the mode switch, a client that disconnects.

use bcap_core::bcap::call;
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_sim::codes::{EMERGENCY_STOP, FAULT_PRESENT, MANUAL_MODE, RESET_IN_EMERGENCY_STOP};
use bcap_sim::{Config, Mode, Profile, Token};

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
    // it brakes before it stops, and is answered when it is at rest
    world.begin(stopper.peer, &call::robot_halt(stopper.robot, ""));
    assert!(matches!(world.again(client.peer, &go).0, Outcome::Wait(_)));
    assert_eq!(world.run_again(stopper.peer, &call::robot_halt(stopper.robot, "")), code(HResult::S_OK));
    assert!(!world.sim.is_moving());
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::E_MOTION_STOPPED));
    let stopped = joints(&mut world, client)[0];
    assert!(stopped > 10.0 && stopped < 119.0, "{stopped}");
    world.pass(1000);
    assert_eq!(joints(&mut world, client)[0], stopped);
    assert_eq!(world.call(stopper.peer, call::robot_halt(stopper.robot, "")), code(HResult::S_FALSE));
    // it is an error of the controller, of its client
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    assert_eq!(world.call(client.peer, &go), code(HResult::E_ERROR_PRESENT));
    assert_eq!(world.errors(), [HResult::E_ERROR_PRESENT, HResult::E_MOTION_STOPPED]);
    let (_, entry) = world.execute(client, "GetErrorLog", 1);
    let array = entry.as_variant().as_array().unwrap();
    assert_eq!(array.get(14).map(|client| client.flatten()), Some(Variant::I4(3)));
    world.clear(client);
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
    world.clear(client);
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
    assert_eq!(world.run_again(client.peer, &go), code(HResult::E_MOTION_STOPPED));
    let stopped = joints(&mut world, client);
    assert!(stopped[0] > 0.0 && stopped[0] < 120.0);
    assert!(!world.sim.motor_is_on() && !world.sim.is_moving());
    assert_eq!(world.get(client, "@EMERGENCY_STOP"), ok(&true));
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED], "the stop itself is no error");
    world.clear(client);
    assert_eq!(world.get(client, "@NORMAL_STATUS"), ok(&true));
    for _ in 0..2 {
        assert_eq!(world.robot(client, "Motor", [1, 0]), code(EMERGENCY_STOP));
    }
    assert_eq!(world.put(client, "@ERROR_CODE", 0), HResult::S_OK);
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), code(EMERGENCY_STOP));
    assert_eq!(world.errors(), [EMERGENCY_STOP]);

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
    assert_eq!(world.execute(client, "ManualReset", ()), code(RESET_IN_EMERGENCY_STOP));
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
fn errors_stop_motion_from_level_two_and_the_motor_from_level_three() {
    for (error, moves, motor_stays) in [
        (0x8150_0001, true, true),
        (0x8350_1024, true, true),
        (0x8220_0001, false, true),
        (0x8320_0001, false, false),
        (0x8540_0001, false, false),
    ] {
        let mut world = World::new();
        let client = world.mover(1);
        let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
        world.begin(client.peer, &go);
        world.pass(200);
        let error = HResult::from_u32(error);
        world.sim.inject_error(error, world.now);
        let failed = world.now;
        assert_eq!(world.sim.motor_is_on(), motor_stays, "{error}");
        assert_eq!(world.sim.is_moving(), moves, "{error}");
        let answer = world.run_again(client.peer, &go).0;
        if moves {
            assert_eq!((answer, world.errors()), (HResult::S_OK, vec![error]));
            continue;
        }
        // the cause, and later the client is notified
        assert_eq!((answer, world.errors()), (HResult::E_MOTION_STOPPED, vec![HResult::E_MOTION_STOPPED, error]));
        let times: Vec<_> = world.sim.errors().map(|error| error.at.saturating_since(failed).as_millis()).collect();
        assert_eq!(times, [20, 0]);
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
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::E_MOTION_STOPPED));
    assert_eq!(world.get(client, "@MODE"), ok(&1));
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED]);
    assert_eq!(world.robot(client, "Motor", 0), code(MANUAL_MODE));
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
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED]);
    world.clear(other);
    assert_eq!(world.robot(other, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.move_to(other, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
}

#[test]
fn a_motor_that_goes_off_stops_the_motion() {
    let mut world = World::new();
    let (client, other) = (world.mover(1), world.client(2));
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(200);
    assert_eq!(world.robot(other, "Motor", 0), ok(&()));
    assert!(!world.sim.is_moving() && !world.sim.motor_is_on());
    assert_eq!(world.run_again(client.peer, &go), code(HResult::E_MOTION_STOPPED));
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED]);
}

#[test]
fn an_abandoned_motion_that_is_halted_leaves_its_error() {
    let mut world = World::new();
    let (client, other) = (world.mover(1), world.client(2));
    world.begin(client.peer, &call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", ""));
    world.pass(200);
    world.sim.abandoned(client.peer, world.now);
    assert_eq!(world.run(other.peer, call::robot_halt(other.robot, "")), code(HResult::S_OK));
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED]);
}

#[test]
fn an_error_of_level_five_remains() {
    let fault = HResult::from_u32(0x8540_0001);
    let mut world = World::new();
    let client = world.client(1);
    world.sim.inject_error(fault, world.now);
    assert_eq!(world.robot(client, "Motor", 1), code(FAULT_PRESENT));
    assert_eq!(world.execute(client, "ClearError", ()), code(fault));
    assert_eq!(world.errors(), [fault]);
    assert_eq!(world.execute(client, "GetErrorLogCount", ()), ok(&2));
}
