//! Arcs, rotations, Approach and Depart.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::codes::{UNREACHABLE, WRONG_ARGUMENT};
use bcap_sim::{ArmProfile, Config, Profile};

use crate::common::{Client, World, close, code, doubles, ok};
use crate::robot::assert_close;

const START: &str = "P(300, 0, 300, 180, 0, 180, 5)";

fn pose(world: &mut World, client: Client) -> Vec<f64> {
    doubles(&world.robot(client, "CurPos", ()).1)
}

/// Moves with NEXT, and returns the poses of each 5 ms.
fn trace(world: &mut World, client: Client, call: impl bcap_core::bcap::Call) -> Vec<Vec<f64>> {
    assert_eq!(world.call(client.peer, call), code(HResult::S_OK));
    let mut poses = Vec::new();
    while world.sim.is_moving() {
        world.pass(5);
        poses.push(pose(world, client));
    }
    poses
}

fn at_start() -> (World, Client) {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, START, ""), HResult::S_OK);
    (world, client)
}

#[test]
fn an_arc_is_a_circle_through_its_point() {
    let (mut world, client) = at_start();
    assert_eq!(world.put(client, "P1", [350.0_f32, 50.0, 300.0, 180.0, 0.0, 180.0, 5.0]), HResult::S_OK);
    // a half circle about (350, 0, 300), whose middle is P1; the flange turns by 30 degrees
    let go = call::robot_move(client.robot, 3, "P1, @E P(400, 0, 300, 180, 0, 150, 5)", "SPEED=10, NEXT");
    let poses = trace(&mut world, client, go);
    assert!(poses.len() > 20, "{}", poses.len());
    let mut nearest = f64::MAX;
    for pose in &poses {
        assert!(((pose[0] - 350.0).hypot(pose[1]) - 50.0).abs() < 0.1 && (pose[2] - 300.0).abs() < 0.1, "{pose:?}");
        nearest = nearest.min((pose[0] - 350.0).hypot(pose[1] - 50.0));
    }
    assert!(nearest < 2.0, "{nearest}");
    assert_close(&pose(&mut world, client)[..3], &[400.0, 0.0, 300.0], 1e-6);
    assert_close(&pose(&mut world, client)[5..6], &[150.0], 1e-6);
}

#[test]
fn an_arc_without_a_circle_is_refused() {
    let (mut world, client) = at_start();
    let end = "P(400, 0, 300, 180, 0, 180, 5)";
    for poses in [
        "P(350, 0, 300, 180, 0, 180, 5), P(400, 0, 300, 180, 0, 180, 5)",
        end,
        "@P P(350, 50, 300, 180, 0, 180, 5), P(400, 0, 300, 180, 0, 180, 5)",
        "P1, P2, P3",
        "",
    ] {
        assert_eq!(world.move_to(client, 3, poses, ""), WRONG_ARGUMENT, "{poses}");
    }
    assert_eq!(world.move_to(client, 3, 1, ""), WRONG_ARGUMENT);
    world.clear(client);
    let far = "P(800, 300, 300, 180, 0, 180, 5), P(400, 0, 300, 180, 0, 180, 5)";
    assert_eq!(world.move_to(client, 3, far, ""), HResult::from_u32(0x8320_4073));
}

#[test]
fn approach_and_depart_keep_their_distance() {
    let (mut world, client) = at_start();
    // the flange points down, so 40 mm against its approach vector are 40 mm up
    let target = [320.0, 60.0, 280.0, 180.0, 0.0, 180.0, 5.0];
    let text = "P(320, 60, 280, 180, 0, 180, 5)";
    assert_eq!(world.robot(client, "Approach", (1, text, "@0 40")), ok(&()));
    assert_close(&pose(&mut world, client)[..3], &[320.0, 60.0, 320.0], 1e-6);
    assert_eq!(world.move_to(client, 2, text, ""), HResult::S_OK);
    assert_eq!(world.robot(client, "Depart", (2, "@0 30")), ok(&()));
    assert_close(&pose(&mut world, client)[..3], &[320.0, 60.0, 310.0], 1e-6);
    // as the public sample sends them
    assert_eq!(world.robot(client, "Approach", (1, (target, "P"), (20.0, "", "@E"))), ok(&()));
    assert_close(&pose(&mut world, client)[..3], &[320.0, 60.0, 300.0], 1e-6);
    assert_eq!(world.robot(client, "Depart", (1, (20.0, "", "@E"))), ok(&()));
    assert_close(&pose(&mut world, client)[..3], &[320.0, 60.0, 320.0], 1e-6);
    let next = call::robot_execute(client.robot, "Depart", (2, "@P -10", "SPEED=20, NEXT"));
    assert_eq!(world.call(client.peer, next), ok(&()));
    assert!(world.sim.is_moving());
    assert_eq!(world.robot(client, "Depart", (2, 5)), ok(&()));
    assert_close(&pose(&mut world, client)[..3], &[320.0, 60.0, 315.0], 1e-6);

    assert_eq!(world.robot(client, "Approach", (1, text, "@X 40")), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "Approach", (3, text, "@0 40")), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "Approach", (1, text)), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "Depart", (1, (20.0, "x", "@E"))), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "Depart", ()), code(WRONG_ARGUMENT));
    world.clear(client);
    assert_eq!(world.robot(client, "Depart", (1, "900")), code(UNREACHABLE));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.robot(client, "Depart", (1, "1")), code(HResult::E_MOTOR_OFF));
    world.clear(client);
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
    assert_eq!(world.robot(client, "Approach", (1, text, "1")), code(HResult::E_ARM_NOT_TAKEN));
}

#[test]
fn rotate_h_turns_the_tool_in_place() {
    let (mut world, client) = at_start();
    assert_eq!(world.robot(client, "RotateH", 30), ok(&()));
    let here = pose(&mut world, client);
    assert_close(&here[..3], &[300.0, 0.0, 300.0], 1e-6);
    // the flange points down, so that its right-handed turn lowers RZ
    assert!((here[5] - 150.0).abs() < 1e-6, "{here:?}");
    assert_eq!(world.robot(client, "RotateH", ("@0 -50", "SPEED=50")), ok(&()));
    assert!((pose(&mut world, client)[5].abs() - 160.0).abs() < 1e-6);
    assert_eq!(world.robot(client, "RotateH", 181), code(WRONG_ARGUMENT));
    assert_eq!(world.robot(client, "RotateH", ()), code(WRONG_ARGUMENT));
    // four axes turn J4
    let arm = ArmProfile::Hsr065.arm();
    let mut world = World::with(Config::new(Profile::Rc8).with_arm(arm));
    let client = world.mover(1);
    assert_eq!(world.robot(client, "RotateH", -40), ok(&()));
    assert!((world.sim.joints()[3] + 40.0).abs() < 1e-6, "{:?}", world.sim.joints());
}

#[test]
fn rotate_turns_the_flange_with_the_circle_or_not() {
    for (option, turned) in [("@0, Pose = 1, NEXT", 200.0_f64 - 360.0), ("@0,Pose=2,NEXT", 180.0), ("NEXT", 180.0)] {
        let (mut world, client) = at_start();
        let go = call::robot_rotate(client.robot, "XY", 20.0, "V(0,0,0)", option);
        let poses = trace(&mut world, client, go);
        assert!(poses.iter().all(|pose| (pose[0].hypot(pose[1]) - 300.0).abs() < 0.1), "{option}");
        let here = pose(&mut world, client);
        let (sine, cosine) = 20.0_f64.to_radians().sin_cos();
        assert_close(&here[..3], &[300.0 * cosine, 300.0 * sine, 300.0], 1e-6);
        assert!((here[5].to_radians().cos() - turned.to_radians().cos()).abs() < 1e-9, "{option}: {here:?}");
    }
    // about the flange's own place: it only turns
    let (mut world, client) = at_start();
    let go = call::robot_rotate(client.robot, "yz", 15.0, "V(300.00,0.00,300.00)", "Pose=1");
    assert_eq!(world.run(client.peer, go), code(HResult::S_OK));
    let here = pose(&mut world, client);
    assert_close(&here[..3], &[300.0, 0.0, 300.0], 1e-6);
    // RZ is 180, so the x of the flange points against the x of the base
    assert!((here[3] - 165.0).abs() < 1e-6, "{here:?}");
    for (plane, centre, option) in [
        ("XZ", "V(0,0,0)", ""),
        ("XY", "P(0,0,0)", ""),
        ("XY", "V(0,0)", ""),
        ("XY", "V(0,0,0)", "Pose=3"),
        ("XY", "V(0,0,0)", "@X"),
        ("XY", "V(0,0,0)", "FAST"),
    ] {
        let go = call::robot_rotate(client.robot, plane, 1.0, centre, option);
        assert_eq!(world.run(client.peer, go), code(WRONG_ARGUMENT), "{plane} {centre} {option}");
    }
}

#[test]
fn a_path_goes_through_its_points() {
    let mut world = World::new();
    let client = world.mover(1);
    let place = "364.16,0,278.5355,180,0,180,5";
    for pose in [&format!("P({place})"), "P(364.16,100,278.5355,180,0,180,5)", "P(300,100,278.5355,180,0,180,5)"] {
        assert_eq!(world.robot(client, "AddPathPoint", (20, pose)), ok(&()));
    }
    assert_eq!(world.move_to(client, 4, "@E 20", ""), HResult::S_OK);
    let here = doubles(&world.robot(client, "CurPos", ()).1);
    assert!(close(&here, &[300.0, 100.0, 278.5355, 180.0, 0.0, 180.0, 5.0], 1e-3), "{here:?}");
    for path in [0, 21] {
        assert_eq!(world.move_to(client, 4, path, ""), WRONG_ARGUMENT, "{path}");
    }
}

/// Adds 200 points to path 1: the place, START, the place, ...
fn add_points(world: &mut World, client: Client, place: &str) {
    for n in 0..200 {
        let pose = if n % 2 == 0 { place } else { START };
        assert_eq!(world.robot(client, "AddPathPoint", (1, pose)), ok(&()), "{n}");
    }
}

#[test]
fn a_path_leaves_out_none_of_many_points() {
    let (mut world, client) = at_start();
    add_points(&mut world, client, "P(800, 0, 300, 180, 0, 180, 5)");
    assert_eq!(world.move_to(client, 4, 1, ""), UNREACHABLE);

    let (mut world, client) = at_start();
    add_points(&mut world, client, "P(304, 0, 300, 180, 0, 180, 5)");
    let go = call::robot_move(client.robot, 4, 1, "NEXT");
    assert_eq!(world.call(client.peer, go), code(HResult::S_OK));
    let (mut visits, mut is_there) = (0, false);
    while world.sim.is_moving() {
        world.pass(1);
        let before = is_there;
        is_there = (world.sim.point().position[0] - 304.0).abs() < 0.1;
        visits += u32::from(is_there && !before);
    }
    assert_eq!(visits, 100);
}

#[test]
fn each_turn_of_a_rotation_is_a_circle() {
    let (mut world, client) = at_start();
    let rotate = |degrees: f32| call::robot_rotate(client.robot, "XY", degrees, "V(320,0,300)", "Pose=2, NEXT");
    for pose in trace(&mut world, client, rotate(3600.0)) {
        assert!(((pose[0] - 320.0).hypot(pose[1]) - 20.0).abs() < 0.1, "{pose:?}");
    }
    assert_close(&pose(&mut world, client)[..3], &[300.0, 0.0, 300.0], 1e-6);
    for degrees in [3601.0, -3601.0, 1e30, f32::NAN] {
        assert_eq!(world.run(client.peer, rotate(degrees)), code(WRONG_ARGUMENT), "{degrees}");
    }
}

#[test]
fn a_plane_is_three_points_or_two_axes_of_the_tool() {
    let end = |plane: &str| {
        let mut world = World::new();
        let client = world.mover(1);
        let rotate = call::robot_rotate(client.robot, plane, 10.0, "V(300,0,278.5355)", "");
        assert_eq!(world.run(client.peer, rotate), code(HResult::S_OK), "{plane}");
        doubles(&world.robot(client, "CurPos", ()).1)
    };
    let base = end("XY");
    for plane in ["V(0,0,5), V(1,0,5), V(0,1,5)", "V(0,0,0) V(1,0,0)\tV(0,1,0)"] {
        assert!(close(&end(plane), &base, 1e-3), "{plane}");
    }
    // the z of the tool points down
    assert!((end("XYH")[1] + base[1]).abs() < 1e-3, "{:?} {base:?}", end("XYH"));
}
