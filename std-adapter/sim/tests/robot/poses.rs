//! Commands that compute with poses, and the digits of what the arm reports.

use bcap_core::hresult::HResult;

use crate::assert_close;
use crate::common::{World, close, code, doubles, ok};

#[test]
fn dev_moves_in_the_base_and_dev_h_in_the_flange() {
    let mut world = World::new();
    let client = world.client(1);
    // the flange points down, with its x against that of the base
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
    // as the public sample asks
    let pose = ([300.0, 0.0, 400.0, 180.0, 0.0, 180.0, 5.0], "P");
    assert_eq!(world.robot(client, "OutRange", (pose, -1, -1)), ok(&0));
    let far = ([900.0, 0.0, 400.0, 180.0, 0.0, 180.0, 5.0], "P");
    assert_eq!(world.robot(client, "OutRange", (far, -1, -1)), ok(&4));
    assert_eq!(world.robot(client, "OutRange", (pose, 1, -1)), code(HResult::E_INVALIDARG));
    assert_eq!(world.sim.errors().count(), 0);
}

#[test]
fn definitions_of_tools_and_works_are_zero() {
    let mut world = World::new();
    let client = world.client(1);
    for command in ["GetToolDef", "GetWorkDef"] {
        assert_eq!(world.robot(client, command, 1), ok(&[0.0; 6]));
        assert_eq!(world.robot(client, command, 64), code(HResult::E_INVALIDARG));
    }
    assert_eq!(world.robot(client, "SetToolDef", (1, "P(0,0,50,0,0,0)")), code(HResult::E_NOTIMPL));
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
