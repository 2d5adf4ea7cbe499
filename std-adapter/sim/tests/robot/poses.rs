//! Commands that compute with poses, and the digits of the arm's reports.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;

use crate::common::{World, close, code, doubles, ok};
use crate::robot::assert_close;

#[test]
fn dev_moves_in_the_base_and_dev_h_in_the_flange() {
    let mut world = World::new();
    let client = world.client(1);
    // the flange points down, with its x against the x of the base
    let base = [300.0, 50.0, 260.0, 180.0, 0.0, 180.0, 5.0];
    let offset = "P(10, 0, 20, 0, 0, 0, -1)";
    let moved = doubles(&world.robot(client, "Dev", ((base, "P"), offset)).1);
    assert_close(&moved, &[310.0, 50.0, 280.0, 180.0, 0.0, 180.0, 5.0], 1e-6);
    let moved = doubles(&world.robot(client, "devh", ((base, "P"), offset)).1);
    assert!(close(&moved[..3], &[290.0, 50.0, 240.0], 1e-6), "{moved:?}");
    // a P as CurPos answers it, and an offset without Fig
    let here = doubles(&world.robot(client, "CurPos", ()).1);
    let up = doubles(&world.robot(client, "DevH", (here.as_slice(), "P(0, 0, -40, 0, 0, 0)")).1);
    assert_close(&up, &[here[0], here[1], here[2] + 40.0, here[3], here[4], here[5], 5.0], 1e-6);
    assert_eq!(world.robot(client, "Dev", ((base, "P"), "J1")), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "Dev", "P1"), code(HResult::E_INVALIDARGTYPE));
    assert_eq!(world.robot(client, "Dev", ("P1", "P2", "P3")), code(HResult::E_INVALIDARG));
}

#[test]
fn out_range_tells_whether_a_pose_can_be_reached() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.robot(client, "OutRange", "J(0, 45, 90, 0, 45, 0, 0, 0)"), ok(&0));
    assert_eq!(world.robot(client, "OutRange", "J(0, 45, 90, 0, 121, 0)"), ok(&16));
    assert_eq!(world.robot(client, "OutRange", "J(0, 145, 90, 0, 121, 0)"), ok(&18));
    let (_, in_line) = world.robot(client, "J2P", [0.0, 45.0, 45.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.robot(client, "OutRange", doubles(&in_line).as_slice()), ok(&-2), "J4 and J6 are in line");
    // the query of the public sample
    let pose = ([300.0, 0.0, 400.0, 180.0, 0.0, 180.0, 5.0], "P");
    assert_eq!(world.robot(client, "OutRange", (pose, -1, -1)), ok(&0));
    let far = ([900.0, 0.0, 400.0, 180.0, 0.0, 180.0, 5.0], "P");
    assert_eq!(world.robot(client, "OutRange", (far, -1, -1)), ok(&-1));
    assert_eq!(world.robot(client, "OutRange", (pose, 64, -1)), code(HResult::E_INVALIDARG));
    assert_eq!(world.sim.errors().count(), 0);
}

#[test]
fn a_tool_moves_the_pose_and_its_lines() {
    let mut world = World::new();
    let client = world.mover(1);
    let flange = doubles(&world.robot(client, "CurPos", ()).1);
    // as public programs define tools: in text, as numbers, with a type
    assert_eq!(world.robot(client, "SetToolDef", (1, "P(0, 0, 50, 0, 0, 0)")), ok(&()));
    assert_eq!(world.robot(client, "GetToolDef", 1), ok(&[0.0, 0.0, 50.0, 0.0, 0.0, 0.0]));
    assert_eq!(world.robot(client, "SetToolDef", (2, [1.0, 2.0, 3.0, 0.0, 0.0, 90.0])), ok(&()));
    assert_eq!(world.robot(client, "SetToolDef", (3, ([0.0, 0.0, 20.0, 0.0, 0.0, 0.0], "P"))), ok(&()));
    assert_eq!(world.robot(client, "GetToolDef", 3), ok(&[0.0, 0.0, 20.0, 0.0, 0.0, 0.0]));
    assert_eq!(world.robot(client, "GetToolDef", 0), ok(&[0.0; 6]));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "Tool1")), code(HResult::S_OK));
    // the flange points down
    let tip = doubles(&world.robot(client, "CurPos", ()).1);
    assert_close(&tip[..3], &[flange[0], flange[1], flange[2] - 50.0], 1e-6);
    let start = doubles(&world.robot(client, "CurJnt", ()).1);
    assert_close(&doubles(&world.robot(client, "P2J", tip.as_slice()).1), &start, 1e-4);

    // the tip moves on the line while the flange tilts
    let target = "P(364, 40, 228, 180, 20, 180, 5)";
    let line = call::robot_move(client.robot, 2, target, "SPEED=10, NEXT");
    assert_eq!(world.call(client.peer, line), code(HResult::S_OK));
    while world.sim.is_moving() {
        let here = doubles(&world.robot(client, "CurPos", ()).1);
        let part = here[1] / 40.0;
        assert!((here[0] - tip[0] - (364.0 - tip[0]) * part).abs() < 0.05, "{here:?}");
        world.pass(20);
    }
    assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &[364.0, 40.0, 228.0], 1e-6);
    // Depart goes along the tool, and Rotate about the tip turns in place
    assert_eq!(world.robot(client, "Depart", (2, 10)), ok(&()));
    let here = doubles(&world.robot(client, "CurPos", ()).1);
    let moved = (here[0] - 364.0).hypot(here[1] - 40.0).hypot(here[2] - 228.0);
    assert!((moved - 10.0).abs() < 1e-6 && here[2] > 228.0, "{here:?}");
    let centre = format!("V({},{},{})", here[0], here[1], here[2]);
    let turn = call::robot_rotate(client.robot, "XY", 15.0, centre.as_str(), "");
    assert_eq!(world.run(client.peer, turn), code(HResult::S_OK));
    assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &here[..3], 1e-5);
}

#[test]
fn work_coordinates_turn_poses() {
    let mut world = World::new();
    let client = world.mover(1);
    // turned by 90 degrees about Z, 300 mm forward: X of the work is Y of the base
    assert_eq!(world.robot(client, "SetWorkDef", (1, "P(300, 0, 300, 0, 0, 90)")), ok(&()));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "Work1")), code(HResult::S_OK));
    assert_eq!(world.move_to(client, 1, "P(50, -20, 10, 180, 0, 90, 5)", ""), HResult::S_OK);
    assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &[50.0, -20.0, 10.0], 1e-6);
    let pose = ([50.0, -20.0, 10.0, 180.0, 0.0, 90.0, 5.0], "P");
    assert_eq!(world.robot(client, "OutRange", (pose, -1, -1)), ok(&0));
    assert_eq!(world.robot(client, "SetWorkDef", (2, "P(2000, 0, 0, 0, 0, 0)")), ok(&()));
    assert_eq!(world.robot(client, "OutRange", (pose, 0, 2)), ok(&-1));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "Work0")), code(HResult::S_OK));
    assert_close(&doubles(&world.robot(client, "CurPos", ()).1)[..3], &[320.0, 50.0, 310.0], 1e-6);

    for command in ["SetWorkDef", "SetToolDef"] {
        assert_eq!(world.robot(client, command, (0, "P(0,0,0,0,0,0)")), code(HResult::E_INVALIDARG));
        assert_eq!(world.robot(client, command, (64, "P(0,0,0,0,0,0)")), code(HResult::E_INVALIDARG));
        assert_eq!(world.robot(client, command, (1, "J1")), code(HResult::E_INVALIDARG));
        let other = world.client(2);
        assert_eq!(world.robot(other, command, (1, "P(0,0,0,0,0,0)")), code(HResult::E_ARM_NOT_TAKEN));
    }
    assert_eq!(world.robot(client, "GetWorkDef", 64), code(HResult::E_INVALIDARG));
}

#[test]
fn positions_have_the_digits_of_a_measurement() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, "J(10.123456789, 40, 95, 7, 45, -3)", ""), HResult::S_OK);
    for command in ["CurPos", "CurJnt", "CurTrn", "DestPos", "DestJnt", "HighCurPosEx"] {
        for n in doubles(&world.robot(client, command, ()).1) {
            let digits = if command == "CurTrn" { 1e9 } else { 1e6 };
            assert_eq!(n, (n * digits).round() / digits, "{command}");
        }
    }
    assert_eq!(doubles(&world.robot(client, "CurJnt", ()).1)[0], 10.123457);
    // Y of the start is not 1.27e-14
    assert_eq!(world.move_to(client, 1, "J(0, 45, 90, 0, 45, 0)", ""), HResult::S_OK);
    assert_eq!(doubles(&world.robot(client, "CurPos", ()).1)[1].to_string(), "0");
}
