//! The queue of motions: NEXT, pass motions, and what empties the queue.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::kinematics::SPEEDS;

use crate::common::{Client, World, code, ok};
use crate::robot::{assert_close, joint_time, joints, seconds};

/// Starts a motion with NEXT.
fn next(world: &mut World, client: Client, pose: &str) -> HResult {
    world.call(client.peer, call::robot_move(client.robot, 1, pose, "NEXT")).0
}

#[test]
fn motions_with_next_are_accepted_and_executed_in_order() {
    let mut world = World::new();
    let (client, other) = (world.mover(1), world.client(2));
    let start = seconds(&world);
    assert_eq!(next(&mut world, client, "J(90,45,90,0,45,0)"), HResult::S_OK);
    assert_eq!(next(&mut world, client, "J(90,20,90,0,45,0)"), HResult::S_OK);
    assert_eq!(world.call(other.peer, call::robot_move(other.robot, 1, "P1", "")), code(HResult::E_ARM_NOT_TAKEN));
    world.clear(client);
    world.pass(200);
    let here = joints(&mut world, other);
    assert!(here[0] > 0.0 && here[1] == 45.0, "{here:?}");
    // relative to the end of the queue; answered at its own end
    let drive = call::robot_drive(client.robot, 1, -10.0, "");
    assert_eq!(world.run(client.peer, drive), code(HResult::S_OK));
    assert_eq!(joints(&mut world, other)[..2], [80.0, 20.0]);
    // @0 comes to rest between the motions
    let expected =
        joint_time(1, 90.0) + 2.0 * (25.0 / (SPEEDS[1] / 0.2)).sqrt() + 2.0 * (10.0 / (SPEEDS[0] / 0.2)).sqrt();
    assert!((seconds(&world) - start - expected).abs() < 1e-4, "{} {expected}", seconds(&world) - start);
    assert_eq!(world.robot_get(other, "@BUSY_STATUS"), ok(&false));
}

#[test]
fn the_queue_is_bounded() {
    let mut world = World::new();
    let client = world.mover(1);
    for n in 0..16 {
        let pose = format!("J({},45,90,0,45,0)", n % 2 + 1);
        assert_eq!(next(&mut world, client, &pose), HResult::S_OK, "{n}");
    }
    assert_eq!(next(&mut world, client, "J(0,45,90,0,45,0)"), HResult::E_ROBOTISBUSY);
    world.pass(200);
    assert_eq!(next(&mut world, client, "J(0,45,90,0,45,0)"), HResult::S_OK);
    world.pass(5000);
    assert_eq!(joints(&mut world, client)[0], 0.0);
}

#[test]
fn a_pose_out_of_reach_is_refused_before_its_turn() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(next(&mut world, client, "J(160,45,90,0,45,0)"), HResult::S_OK);
    // from 160, not from the current 0
    let drive = call::robot_drive(client.robot, 1, 20.0, "NEXT");
    assert_eq!(world.call(client.peer, drive).0, HResult::from_u32(0x8320_4231));
    assert!(!world.sim.is_moving());
}

#[test]
fn halt_and_errors_end_all_motions() {
    const ERROR: HResult = HResult::from_u32(0x8220_0001);
    let halt: fn(&mut World, Client) = |world, other| {
        assert_eq!(world.run(other.peer, call::robot_halt(other.robot, "")), code(HResult::S_OK));
    };
    let fail: fn(&mut World, Client) = |world, _| world.sim.inject_error(ERROR, world.now);
    let stopped = HResult::E_MOTION_STOPPED;
    for (happens, errors) in [(halt, vec![stopped]), (fail, vec![stopped, ERROR])] {
        let mut world = World::new();
        let (client, other) = (world.mover(1), world.client(2));
        let third = call::robot_move(client.robot, 1, "J(120,20,90,0,45,0)", "");
        assert_eq!(next(&mut world, client, "J(120,45,90,0,45,0)"), HResult::S_OK);
        assert_eq!(next(&mut world, client, "J(120,45,90,0,45,50)"), HResult::S_OK);
        world.begin(client.peer, &third);
        world.pass(200);
        happens(&mut world, other);
        assert_eq!(world.run_again(client.peer, &third), code(stopped));
        assert_eq!(world.errors(), errors);
        world.pass(5000);
        let here = joints(&mut world, other);
        assert!(here[0] < 110.0 && here[1] == 45.0 && here[5] == 0.0, "{here:?}");
    }
}

#[test]
fn hold_keeps_the_queue() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(next(&mut world, client, "@P J(90,45,90,0,45,0)"), HResult::S_OK);
    assert_eq!(next(&mut world, client, "J(90,0,90,0,45,0)"), HResult::S_OK);
    // in the middle of the handover, at which both axes move
    world.pass(300);
    let here = joints(&mut world, client);
    assert!(here[0] < 90.0 && here[1] < 45.0, "{here:?}");
    assert_eq!(world.call(client.peer, call::robot_hold(client.robot, "")), code(HResult::S_OK));
    world.pass(5000);
    let held = joints(&mut world, client);
    assert!(held[0] <= 90.0 && held[1] < 45.0 && held[1] > 0.0, "{held:?}");
    assert_eq!(world.robot(client, "MotionComplete", [-1, 1]), ok(&false));
    assert_eq!(world.call(client.peer, call::robot_unhold(client.robot, "")), code(HResult::S_OK));
    world.pass(5000);
    assert_eq!(joints(&mut world, client)[..2], [90.0, 0.0]);
}

#[test]
fn motion_skip_ends_the_present_motion_only() {
    let mut world = World::new();
    let client = world.mover(1);
    // public programs overwrite a target like this: they skip the motion and immediately start another
    assert_eq!(next(&mut world, client, "J(90,45,90,0,45,0)"), HResult::S_OK);
    world.pass(200);
    assert_eq!(world.robot(client, "MotionComplete", [-1, 1]), ok(&false));
    assert_eq!(world.robot(client, "MotionSkip", [-1, 3]), ok(&()));
    assert_eq!(next(&mut world, client, "J(10,45,90,0,45,0)"), HResult::S_OK);
    let mut most = 0.0_f64;
    while world.sim.is_moving() {
        world.pass(1);
        most = most.max(world.sim.joints()[0]);
    }
    assert!(most < 80.0, "{most}");
    assert_eq!(joints(&mut world, client)[0], 10.0);
    assert_eq!(world.robot(client, "MotionComplete", [-1, 1]), ok(&true));
    assert_eq!(world.robot(client, "MotionSkip", [-1, 0]).0, HResult::S_FALSE);

    // the next motion of the queue begins where the arm came to rest, and the skipped call has succeeded
    let drive = call::robot_drive(client.robot, 1, 60.0, "");
    world.begin(client.peer, &drive);
    world.pass(150);
    assert_eq!(world.robot(client, "MotionSkip", ()), ok(&()));
    world.begin(client.peer, &drive);
    let (result, _) = world.run_again(client.peer, &drive);
    assert_eq!(result, HResult::S_OK);
    let end = joints(&mut world, client)[0];
    assert!(end > 70.0 && end < 120.0, "{end}");

    for bad in [[-1, 4], [-1, -1], [32, 0]] {
        assert_eq!(world.robot(client, "MotionSkip", bad), code(HResult::E_INVALIDARG));
    }
    assert_eq!(world.robot(client, "MotionComplete", [-1, 2]), code(HResult::E_INVALIDARG));
    let other = world.client(2);
    assert_eq!(world.robot(other, "MotionSkip", ()), code(HResult::E_ARM_NOT_TAKEN));
}

/// Calls Robot_Hold (h), Robot_Unhold (u) and MotionSkip (s) in this order.
fn stop_and_go(world: &mut World, client: Client, calls: &str) {
    for call in calls.chars() {
        let (result, _) = match call {
            'h' => world.call(client.peer, call::robot_hold(client.robot, "")),
            'u' => world.call(client.peer, call::robot_unhold(client.robot, "")),
            _ => world.robot(client, "MotionSkip", ()),
        };
        assert_eq!(result, HResult::S_OK, "{call} of {calls}");
    }
}

#[test]
fn after_hold_and_motion_skip_the_next_motion_begins_with_unhold() {
    for (calls, held) in [("sh", true), ("hs", true), ("shu", false), ("hsu", false)] {
        let mut world = World::new();
        let client = world.mover(1);
        assert_eq!(next(&mut world, client, "J(90,45,90,0,45,0)"), HResult::S_OK);
        assert_eq!(next(&mut world, client, "J(90,0,90,0,45,0)"), HResult::S_OK);
        world.pass(200);
        stop_and_go(&mut world, client, calls);
        world.pass(5000);
        let here = joints(&mut world, client);
        assert_eq!((here[1], world.sim.is_moving()), if held { (45.0, true) } else { (0.0, false) }, "{calls}");
        if held {
            assert!(here[0] < 90.0, "{calls}: {here:?}");
            stop_and_go(&mut world, client, "u");
            world.pass(5000);
        }
        assert_eq!(joints(&mut world, client)[..2], [90.0, 0.0], "{calls}");

        // without a next motion there is nothing to hold, nor after Halt
        for halts in [false, true] {
            assert_eq!(next(&mut world, client, "J(0,45,90,0,45,0)"), HResult::S_OK);
            world.pass(100);
            stop_and_go(&mut world, client, calls);
            if halts {
                assert_eq!(world.run(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
                world.clear(client);
            }
            world.pass(5000);
            assert!(!world.sim.is_moving(), "{calls}");
            assert_eq!(world.move_to(client, 1, "J(90,0,90,0,45,0)", ""), HResult::S_OK);
        }
    }
}

#[test]
fn a_pass_is_answered_before_the_end() {
    let mut world = World::new();
    let client = world.mover(1);
    let start = seconds(&world);
    assert_eq!(world.move_to(client, 1, "@P J(90,45,90,0,45,0)", ""), HResult::S_OK);
    // when it begins to brake
    assert!((seconds(&world) - start - 90.0 / SPEEDS[0]).abs() < 1e-5, "{}", seconds(&world) - start);
    assert_eq!(world.robot(client, "MotionComplete", [-1, 0]), ok(&true));
    assert_eq!(world.robot(client, "MotionComplete", [-1, 1]), ok(&false));
    // the next motion begins immediately, and both take less time than in sequence
    assert_eq!(world.move_to(client, 1, "@0 J(90,45,90,0,45,60)", ""), HResult::S_OK);
    assert_eq!(joints(&mut world, client)[..6], [90.0, 45.0, 90.0, 0.0, 45.0, 60.0]);
    let blended = 90.0 / SPEEDS[0] + 2.0 * (60.0 / (SPEEDS[5] / 0.2)).sqrt();
    assert!((seconds(&world) - start - blended).abs() < 1e-4, "{} {blended}", seconds(&world) - start);
}

#[test]
fn give_arm_waits_for_the_end_of_the_motions() {
    let mut world = World::new();
    let client = world.mover(1);
    // as the maker's ROS 2 driver does it
    assert_eq!(world.move_to(client, 1, "@P J(90,45,90,0,45,0)", ""), HResult::S_OK);
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
    assert_eq!(world.sim.arm_owner(), None);
    assert_eq!(joints(&mut world, client)[0], 90.0);
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(next(&mut world, client, "@P J(0,45,90,0,45,0)"), HResult::S_OK);
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
    assert_eq!(joints(&mut world, client)[0], 0.0);
}

#[test]
fn a_distance_decides_how_near_a_pass_comes() {
    let corner = |pass: &str| {
        let mut world = World::new();
        let client = world.mover(1);
        assert_eq!(world.move_to(client, 1, "P(300, -100, 300, 180, 0, 180, 5)", ""), HResult::S_OK);
        let first = format!("{pass} P(300, 100, 300, 180, 0, 180, 5)");
        for pose in [first.as_str(), "P(300, 100, 400, 180, 0, 180, 5)"] {
            let line = call::robot_move(client.robot, 2, pose, "SPEED=20, NEXT");
            assert_eq!(world.call(client.peer, line), code(HResult::S_OK));
        }
        let mut nearest = f64::MAX;
        while world.sim.is_moving() {
            let here = crate::common::doubles(&world.robot(client, "CurPos", ()).1);
            nearest = nearest.min((here[1] - 100.0).hypot(here[2] - 300.0));
            world.pass(1);
        }
        assert_close(&crate::common::doubles(&world.robot(client, "CurPos", ()).1)[..3], &[300.0, 100.0, 400.0], 1e-6);
        nearest
    };
    let [stop, five, fifty, near] = ["@0", "@2", "@50", "@P"].map(corner);
    assert!(stop < 0.01, "{stop}");
    assert!(five > stop + 0.1 && five < 2.0, "{five}");
    // @50 mm is farther than the braking distance, so it is @P
    assert!(fifty > five && (fifty - near).abs() < 1e-9, "{fifty} {near}");
}

#[test]
fn arrive_100_answers_at_the_end_of_any_motion() {
    let mut world = World::new();
    let client = world.mover(1);
    for j1 in 1..=170 {
        let pose = format!("J({j1},45,90,0,45,0)");
        let start = world.now;
        assert_eq!(world.move_to(client, 1, pose.as_str(), ""), HResult::S_OK);
        let time = world.now.saturating_since(start);
        assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
        let start = world.now;
        assert_eq!(next(&mut world, client, &pose), HResult::S_OK);
        assert_eq!(world.robot(client, "Arrive", 100), ok(&()), "J1 {j1}");
        let waited = world.now.saturating_since(start);
        assert!(waited.abs_diff(time).as_millis() < 50, "J1 {j1}: {waited:?}, {time:?}");
        assert_eq!(world.move_to(client, 1, "J(0,45,90,0,45,0)", ""), HResult::S_OK);
    }
}
