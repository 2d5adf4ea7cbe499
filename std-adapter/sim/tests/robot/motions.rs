//! Motions: poses in every form, paths, times, and refusals.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::variant::Encode;
use bcap_sim::Config;
use bcap_sim::codes::{CONVERSION_UNREACHABLE, OTHER_FIGURE, SINGULAR, UNREACHABLE, WRONG_ARGUMENT};
use bcap_sim::kinematics::{RANGES, SPEEDS};
use bcap_sim::motion::{ACCELERATION_TIME, LINE_SPEED};

use crate::common::{Client, World, code, doubles, ok, value};
use crate::robot::{JOINTS, POSE, assert_close, joint_time, joints, seconds};

#[test]
fn a_robot_is_used_as_the_sample_program_does() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.put(client, "P1", [300.0_f32, 100.0, 300.0, 180.0, 0.0, 180.0, 5.0]), HResult::S_OK);
    // parameters as strings
    assert_eq!(world.robot(client, "Takearm", ""), ok(&()));
    assert_eq!(world.robot(client, "Motor", "1"), ok(&()));
    assert_eq!(world.move_to(client, 1, "P1", ""), HResult::S_OK);
    let (_, here) = world.robot(client, "CurPos", ());
    let here = doubles(&here);
    assert_close(&here[..3], &[300.0, 100.0, 300.0], 1e-3);
    assert_eq!(here[6], 5.0);
    assert_eq!(world.robot(client, "Motor", "0"), ok(&()));
    assert_eq!(world.robot(client, "Givearm", ""), ok(&()));
    assert_eq!(world.sim.arm_owner(), None);
}

#[test]
fn position_angle_and_transform_agree() {
    let mut world = World::new();
    let client = world.client(1);
    let read = |world: &mut World, name: &str| doubles(&world.robot_get(client, name).1);
    assert_close(&read(&mut world, "@CURRENT_ANGLE"), &JOINTS, 1e-9);
    let position = read(&mut world, "@Current_Position");
    assert_close(&position[..3], &POSE[..3], 1e-3);
    assert_eq!(position[6], 5.0);
    let transform = read(&mut world, "@CURRENT_TRANS");
    // pointing down, its y where the base has it
    assert_close(&transform, &[364.16, 0.0, 278.5355, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 5.0], 1e-3);
    for (command, variable) in
        [("CurPos", "@HIGH_CURRENT_POSITION"), ("DestJnt", "@DEST_ANGLE"), ("HighCurTrn", "@DEST_TRANS")]
    {
        let (_, answer) = world.robot(client, command, ());
        assert_eq!(world.robot_get(client, variable), (HResult::S_OK, answer), "{command}");
    }
    assert_close(&doubles(&world.robot(client, "P2J", POSE).1), &JOINTS, 1e-3);
    assert_close(&doubles(&world.robot(client, "J2P", JOINTS).1)[..3], &POSE[..3], 1e-3);
    assert_close(&doubles(&world.robot(client, "t2j", transform.as_slice()).1), &JOINTS, 1e-6);
    assert_eq!(world.robot(client, "CurFig", ()), ok(&5));
    world.pass(1500);
    let timed = doubles(&world.robot(client, "HighCurJntEx", ()).1);
    assert_close(&timed, &[&[1500.0], &JOINTS[..]].concat(), 1e-9);
    assert_eq!(world.robot(client, "P2J", [9000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0]).0, CONVERSION_UNREACHABLE);
    assert_eq!(world.errors(), [CONVERSION_UNREACHABLE]);
}

#[test]
fn the_slowest_motion_is_still_one() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.robot(client, "ExtSpeed", 0.0001), ok(&()));
    let go = call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "SPEED=0.0001,ACCEL=0.0001,NEXT");
    assert_eq!(world.call(client.peer, go), code(HResult::S_OK));
    world.pass(1_000_000);
    let here = world.sim.joints()[0];
    assert!(here > 0.0 && here < 0.1, "{here}");
    assert!(world.sim.is_moving());
    assert_eq!(world.run(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
    assert!(!world.sim.is_moving());
}

#[test]
fn a_move_answers_when_it_has_ended() {
    let mut world = World::new();
    let client = world.mover(1);
    let start = seconds(&world);
    assert_eq!(world.move_to(client, 1, ([90.0, 45.0, 90.0, 0.0, 45.0, 0.0], "J", "@E"), ""), HResult::S_OK);
    assert!((seconds(&world) - start - joint_time(1, 90.0)).abs() < 1e-4);
    assert_close(&joints(&mut world, client), &[90.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0], 1e-9);

    let start = seconds(&world);
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", "SPEED=50"), HResult::S_OK);
    let expected = 90.0 / (SPEEDS[0] / 2.0) + ACCELERATION_TIME / 2.0;
    assert!((seconds(&world) - start - expected).abs() < 1e-4);

    // to its current position
    let start = world.now;
    assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
    assert_eq!(world.now, start);
}

#[test]
fn with_next_a_move_is_watched_while_it_runs() {
    let mut world = World::new();
    let client = world.mover(1);
    let watcher = world.client(2);
    let go = || call::robot_move(client.robot, 1, "J(90,45,90,0,45,0)", "NEXT");
    assert_eq!(world.call(client.peer, go()), code(HResult::S_OK));
    assert_eq!(world.robot_get(watcher, "@BUSY_STATUS"), ok(&true));
    assert_eq!(world.get(watcher, "@BUSY_STATUS"), ok(&true));
    let moving = 1 << 20 | 1 << 21;
    let state = |world: &mut World| world.execute(watcher, "SysState", ()).1.as_variant().as_i32().unwrap();
    assert_eq!(state(&mut world) & moving, moving);
    let mut last = -1.0;
    for _ in 0..4 {
        let here = joints(&mut world, watcher)[0];
        assert!(here > last, "{here} after {last}");
        last = here;
        world.pass(100);
    }
    assert_close(&doubles(&world.robot_get(watcher, "@DEST_ANGLE").1)[..1], &[90.0], 1e-9);
    world.pass(1000);
    assert_eq!(world.robot_get(watcher, "@BUSY_STATUS"), ok(&false));
    assert_eq!(state(&mut world) & moving, 0);
    assert_eq!(joints(&mut world, watcher)[0], 90.0);
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
}

#[test]
fn every_form_of_a_pose_moves_to_the_same_place() {
    let mut world = World::new();
    let client = world.mover(1);
    let target = [30.0, 20.0, 100.0, 10.0, 50.0, -20.0];
    let target_joints = [30.0_f32, 20.0, 100.0, 10.0, 50.0, -20.0, 0.0, 0.0];
    let pose = doubles(&world.robot(client, "J2P", target).1);
    let trans = doubles(&world.robot(client, "J2T", target).1);
    world.put(client, "P1", pose.as_slice());
    world.put(client, "J12", target_joints);
    world.put(client, "T3", trans.as_slice());
    let text = format!("P({})", pose.iter().map(f64::to_string).collect::<Vec<_>>().join(", "));

    fn check(world: &mut World, client: Client, pose: impl Encode, to: [f64; 6]) {
        let shown = value(&pose);
        assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
        assert_eq!(world.move_to(client, 1, pose, ""), HResult::S_OK, "{shown:?}");
        // with @P, it is answered before the arm is at rest
        world.pass(1000);
        assert_close(&joints(world, client)[..6], &to, 1e-2);
    }
    for pose in ["P1", "@E P1", "@P p[1]", "@0 J12", "T3", "@E J(30,20,100,10,50,-20)", text.as_str()] {
        check(&mut world, client, pose, target);
    }
    check(&mut world, client, (pose.as_slice(), "P", "@E"), target);
    check(&mut world, client, (pose.as_slice(), "@E", "P"), target);
    check(&mut world, client, (pose.as_slice(), 0, -2), target);
    check(&mut world, client, (target, 2, 0), target);
    check(&mut world, client, (target_joints, "J"), target);
    check(&mut world, client, (trans.as_slice(), 1, -1), target);
    check(&mut world, client, pose.as_slice(), target);
}

#[test]
fn a_line_is_straight_and_takes_the_time_of_its_length() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, "P(300, -100, 300, 180, 0, 180, 5)", ""), HResult::S_OK);
    let start = seconds(&world);
    // slow enough that the flange's speed is the limit
    let line = call::robot_move(client.robot, 2, "P(300, 100, 350, 180, 0, 180, 5)", "SPEED=10, NEXT");
    assert_eq!(world.call(client.peer, line), code(HResult::S_OK));
    let mut seen = 0;
    while world.sim.is_moving() {
        let here = doubles(&world.robot(client, "CurPos", ()).1);
        // y from -100 to 100 while z goes from 300 to 350
        assert_close(&[here[0], here[2]], &[300.0, 325.0 + here[1] / 4.0], 0.05);
        seen += 1;
        world.pass(10);
    }
    assert!(seen > 50);
    let length = (200.0_f64 * 200.0 + 50.0 * 50.0).sqrt();
    let expected = length / (LINE_SPEED * 0.1) + ACCELERATION_TIME * 0.1;
    assert!((seconds(&world) - start - expected).abs() < 0.011, "{} {expected}", seconds(&world) - start);
    // a line cannot turn the elbow over
    assert_eq!(world.move_to(client, 2, "P(300, 0, 350, 180, 0, 180, 7)", ""), OTHER_FIGURE);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    // nor leave the arm's reach
    assert_eq!(world.move_to(client, 2, "P(800, 0, 350, 180, 0, 180, 5)", ""), UNREACHABLE);
}

#[test]
fn drive_and_go_home_move_joints() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.run(client.peer, call::robot_drive(client.robot, 6, -30.0, "")), code(HResult::S_OK));
    assert_eq!(world.run(client.peer, call::robot_drive(client.robot, 6, -30.0, "")), code(HResult::S_OK));
    assert_close(&joints(&mut world, client), &[0.0, 45.0, 90.0, 0.0, 45.0, -60.0, 0.0, 0.0], 1e-9);
    assert_eq!(world.run(client.peer, call::robot_go_home(client.robot)), code(HResult::S_OK));
    assert_close(&joints(&mut world, client), &JOINTS, 1e-9);
    for axis in [0, 7, -1] {
        let drive = call::robot_drive(client.robot, axis, 1.0, "");
        assert_eq!(world.run(client.peer, drive), code(WRONG_ARGUMENT));
    }
    let drive = call::robot_drive(client.robot, 1, f32::NAN, "");
    assert_eq!(world.run(client.peer, drive), code(WRONG_ARGUMENT));
}

#[test]
fn out_of_range_is_an_error_of_the_axis() {
    for axis in 1..=6_usize {
        let mut world = World::new();
        let client = world.mover(1);
        let mut target = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];
        target[axis - 1] = RANGES[axis - 1].1 + 1.0;
        let expected = HResult::from_u32(0x8320_4230 + u32::try_from(axis).unwrap());
        assert_eq!(world.move_to(client, 1, (target, "J"), ""), expected);
        assert_close(&joints(&mut world, client), &JOINTS, 1e-9);
        // level 3: motor off
        assert!(!world.sim.motor_is_on());
        assert_eq!(world.get(client, "@ERROR_CODE"), ok(&expected.0));
    }
}

#[test]
fn what_is_no_motion_command_is_refused() {
    let mut world = World::new();
    let client = world.mover(1);
    let pose = "J(0,45,90,0,45,0)";
    assert_eq!(world.move_to(client, 4, 1, ""), WRONG_ARGUMENT, "a path without points");
    for interpolation in [0, 5, -1] {
        assert_eq!(world.move_to(client, interpolation, pose, ""), WRONG_ARGUMENT);
    }
    for option in ["SPEED", "SPEED=x", "SPEED=0", "SPEED=101", "FAST", "NEXT=1"] {
        assert_eq!(world.move_to(client, 1, pose, option), WRONG_ARGUMENT, "{option}");
    }
    assert_eq!(world.move_to(client, 1, "J100", ""), WRONG_ARGUMENT);
    assert_eq!(world.move_to(client, 1, 1, ""), WRONG_ARGUMENT);
    assert_eq!(world.errors(), [WRONG_ARGUMENT]);
}

#[test]
fn a_line_near_a_singular_point_is_refused() {
    for (from, to) in [
        // across J5 = 0, and out of it sideways
        ("J(0,45,45,0,45,0)", "J(0,45,45,0,-45,0)"),
        ("J(0,45,45,0,1,0)", "J(20,45,45,0,1,0)"),
    ] {
        let mut world = World::new();
        let client = world.mover(1);
        assert_eq!(world.move_to(client, 1, from, ""), HResult::S_OK);
        assert_eq!(world.move_to(client, 2, to, ""), SINGULAR, "{from} to {to}");
        assert!(!world.sim.motor_is_on());
    }
}

#[test]
fn a_line_without_length_passes_no_singular_point() {
    let mut world = World::new();
    let client = world.mover(1);
    for (x, y) in (280..=380).step_by(20).flat_map(|x| (-120..=120).step_by(40).map(move |y| (x, y))) {
        let pose = format!("P({x},{y},300,180,0,180,5)");
        assert_eq!(world.move_to(client, 1, pose.as_str(), ""), HResult::S_OK, "{pose}");
        // the rounding of the joints is all that this line moves
        assert_eq!(world.move_to(client, 2, pose.as_str(), ""), HResult::S_OK, "{pose}");
        assert_eq!(world.robot(client, "Draw", (2, "V(0,0,0)")), ok(&()), "{pose}");
        assert_eq!(world.robot(client, "Depart", (2, 0)), ok(&()), "{pose}");
        assert_eq!(world.robot(client, "RotateH", 0), ok(&()), "{pose}");
        assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..2], &[f64::from(x), f64::from(y)], 1e-6);
    }
}

#[test]
fn a_long_way_of_an_extended_axis_is_not_singular() {
    let mut world = World::with(Config { extended_axes: 1, ..Config::default() });
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, "P(300,0,300,180,0,180,5)", ""), HResult::S_OK);
    assert_eq!(world.move_to(client, 2, "P(310,0,300,180,0,180,5) EX((7,300))", ""), HResult::S_OK);
    assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &[310.0, 0.0, 300.0], 1e-6);
    assert_close(&world.sim.axes()[6..7], &[300.0], 1e-9);
}

#[test]
fn a_line_ends_within_the_ranges_and_in_the_posture_of_its_joints() {
    for (joints, expected) in [
        ("J(5,45,90,0,45,400)", HResult::from_u32(0x8320_4236)),
        // the same place with a flipped wrist
        ("J(5,45,90,180,-45,180)", OTHER_FIGURE),
        ("J(5,45,90,0,45,0)", HResult::S_OK),
    ] {
        let mut world = World::new();
        let client = world.mover(1);
        assert_eq!(world.move_to(client, 2, joints, ""), expected, "{joints}");
        let j1 = if expected == HResult::S_OK { 5.0 } else { 0.0 };
        assert_close(&world.sim.joints()[..1], &[j1], 1e-9);
    }
}
