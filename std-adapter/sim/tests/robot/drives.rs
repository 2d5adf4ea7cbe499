//! Turns of single axes: DriveEx, DriveAEx, extended joints of a motion; speeds in variables; numbers of mixed types.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::variant::Encode;
use bcap_sim::Config;
use bcap_sim::codes::WRONG_ARGUMENT;
use bcap_sim::kinematics::{EXTENDED_SPEED, SPEEDS};
use bcap_sim::motion::ACCELERATION_TIME;

use crate::common::{World, close, code, doubles, ok};

const HOME: [f64; 6] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];

/// A controller with two extended axes and a client that may move.
fn extended() -> (World, crate::common::Client) {
    let mut world = World::with(Config { extended_axes: 2, ..Config::default() });
    let client = world.mover(1);
    (world, client)
}

fn here(world: &World) -> [f64; 8] {
    world.sim.axes()
}

#[test]
fn drive_ex_turns_by_values_and_drive_a_ex_to_them() {
    let mut world = World::new();
    let client = world.mover(1);
    // the parameters of the public ROS 2 driver, as it was recorded
    assert_eq!(world.robot(client, "DriveEx", ["@E (1,5),(2,5)", ""]), ok(&()));
    assert_eq!(here(&world)[..3], [5.0, 50.0, 90.0]);
    assert_eq!(world.robot(client, "DriveAEx", ["@E (1,0)", ""]), ok(&()));
    assert_eq!(here(&world)[..3], [0.0, 50.0, 90.0]);
    let value = (([1.0_f32, 5.0], -1, -2), ([2.0_f32, -5.0], -1, 0));
    assert_eq!(world.robot(client, "DriveEx", (value, "")), ok(&()));
    assert_eq!(here(&world)[..3], [5.0, 45.0, 90.0]);
    assert_eq!(world.robot(client, "DriveAEx", (value, "SPEED=50")), ok(&()));
    assert_eq!(here(&world)[..3], [5.0, -5.0, 90.0]);
    // the pairs alone, one pair alone, NEXT
    assert_eq!(world.robot(client, "driveaex", "(2, 45)"), ok(&()));
    assert_eq!(world.robot(client, "DriveEx", [1, -5]), ok(&()));
    assert_eq!(here(&world)[..6], HOME);
    let next = call::robot_execute(client.robot, "DriveEx", ["(1,90)", "NEXT"]);
    assert_eq!(world.call(client.peer, next), ok(&()));
    assert!(world.sim.is_moving());
    assert_eq!(world.robot(client, "DriveEx", "(1,1)"), ok(&()));
    assert_eq!(here(&world)[0], 91.0);
}

#[test]
fn a_drive_is_refused_as_a_motion_is() {
    let mut world = World::new();
    let client = world.mover(1);
    for axis in ["(7,1)", "(8,1)", "(9,1)", "(0,1)"] {
        assert_eq!(world.robot(client, "DriveEx", axis), code(WRONG_ARGUMENT), "{axis}");
    }
    assert_eq!(world.robot(client, "DriveEx", ["(1,1)", "FAST"]), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "DriveEx", ()), code(WRONG_ARGUMENT));
    assert_eq!(world.errors(), [WRONG_ARGUMENT]);
    world.clear(client);
    assert_eq!(world.robot(client, "DriveEx", "(1,171)"), code(HResult::from_u32(0x8320_4231)));
    assert_eq!(world.sim.errors().count(), 1);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
    assert_eq!(world.robot(client, "DriveEx", "(1,1)"), code(HResult::E_ARM_NOT_TAKEN));
}

#[test]
fn extended_joints_move_with_the_pose() {
    let (mut world, client) = extended();
    let start = world.now;
    // as the ROS 2 driver sends it: EXA, J7 to 100
    let joints: &dyn Encode = &HOME;
    let pose = (joints, 2, -2, (2, (7, 100.0_f32)));
    assert_eq!(world.move_to(client, 1, pose, ""), HResult::S_OK);
    assert_eq!(here(&world), [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 100.0, 0.0]);
    let seconds = world.now.saturating_since(start).as_secs_f64();
    assert!((seconds - 2.0 * (100.0 / (EXTENDED_SPEED / ACCELERATION_TIME)).sqrt()).abs() < 1e-4, "{seconds}");
    assert_eq!(world.robot(client, "CurJnt", ()), ok(&here(&world)));
    assert_eq!(world.robot(client, "DestJnt", ()), ok(&here(&world)));
    // EX: from where it is; with a pose of the flange, on a line, as text
    let flange = [364.16, 0.0, 270.0, 180.0, 0.0, 180.0, 5.0];
    assert_eq!(world.move_to(client, 2, (flange, 0, -2, (1, [7, 10], [8, -20])), ""), HResult::S_OK);
    assert_eq!(here(&world)[6..], [110.0, -20.0]);
    assert!(close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &flange[..3], 1e-6));
    assert_eq!(world.move_to(client, 1, "@E J(0,45,90,0,45,0) EXA((7,1),(8,2))", ""), HResult::S_OK);
    assert_eq!(here(&world), [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 1.0, 2.0]);
    assert_eq!(world.robot(client, "DriveAEx", ["(7, -15), (1, 3)", ""]), ok(&()));
    assert_eq!(here(&world), [3.0, 45.0, 90.0, 0.0, 45.0, 0.0, -15.0, 2.0]);
    assert_eq!(world.run(client.peer, call::robot_drive(client.robot, 8, -2.0, "")), code(HResult::S_OK));
    assert_eq!(here(&world)[7], 0.0);

    // positions that an axis does not reach, and numbers that are not an axis
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0) EX((7,2000))", ""), HResult::from_u32(0x8320_4237));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0) EX((6,1))", ""), WRONG_ARGUMENT);
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0) EX((7,1))", ""), WRONG_ARGUMENT);
}

#[test]
fn a_halt_stops_extended_joints_on_their_way() {
    let (mut world, client) = extended();
    assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "DriveEx", ["(7,900)", "NEXT"])), ok(&()));
    world.pass(500);
    assert_eq!(world.run(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
    assert!(!world.sim.is_moving());
    let place = here(&world)[6];
    assert!(place > 100.0 && place < 899.0, "{place}");
    world.pass(1000);
    assert_eq!(here(&world)[6], place);
    assert_eq!(world.errors(), [HResult::E_MOTION_STOPPED]);
    world.clear(client);
    assert_eq!(world.robot(client, "DriveAEx", "(7,0)"), ok(&()));
}

#[test]
fn a_speed_may_be_a_variable() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.put(client, "F2", 50.0_f32), HResult::S_OK);
    assert_eq!(world.put(client, "I3", 50), HResult::S_OK);
    assert_eq!(world.put(client, "D4", 50.0_f64), HResult::S_OK);
    let expected = 90.0 / (SPEEDS[0] / 2.0) + ACCELERATION_TIME / 2.0;
    let mut target = 90.0;
    for option in ["SPEED=F2", "S=I3", "SPEED = d[4]", "SPEED=50"] {
        let start = world.now;
        let pose = format!("J({target},45,90,0,45,0)");
        assert_eq!(world.move_to(client, 1, pose.as_str(), option), HResult::S_OK, "{option}");
        let seconds = world.now.saturating_since(start).as_secs_f64();
        assert!((seconds - expected).abs() < 1e-4, "{option}: {seconds}");
        target = 90.0 - target;
    }
    for option in ["SPEED=F3", "SPEED=S1", "SPEED=P1", "SPEED=F*", "SPEED="] {
        assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", option), WRONG_ARGUMENT, "{option}");
    }
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", "SPEED=F100"), WRONG_ARGUMENT);
}

#[test]
fn numbers_of_mixed_types_are_converted() {
    let mut world = World::new();
    let client = world.mover(1);
    let expected = world.robot(client, "J2P", HOME);
    assert_eq!(expected.0, HResult::S_OK);
    assert_eq!(world.robot(client, "J2P", (HOME, "J")), expected);
    assert_eq!(world.robot(client, "J2P", ((0.0_f64, 45, 90_i16, 0.0_f32, 45_u8, 0_i64), "J")), expected);
    assert_eq!(world.robot(client, "J2P", (0.0_f64, 45, 90, 0, 45, 0, 0, 0)), expected);
    assert_eq!(world.move_to(client, 1, ((10, 45.0_f64, 90, 0, 45, 0.0_f32), "J"), ""), HResult::S_OK);
    assert_eq!(here(&world)[0], 10.0);
    assert_eq!(world.robot(client, "TakeArm", (0, true)), ok(&()));
    assert_eq!(world.robot(client, "ExtSpeed", (50, 25.0_f32)), ok(&()));
    assert_eq!(world.robot(client, "Motor", (true, 0_i16)), ok(&()));
}
