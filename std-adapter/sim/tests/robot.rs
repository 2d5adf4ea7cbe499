//! The arm over the handler of b-CAP: authority, motor, motions and what stops them.

mod common;

use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Encode;
use bcap_sim::kinematics::{RANGES, SPEEDS};
use bcap_sim::motion::{ACCELERATION_TIME, LINE_SPEED};
use bcap_sim::{Config, EMERGENCY_STOP, Mode, Profile, Token, VariableKind};

use common::{Client, World, close, code, doubles, ok, value};

/// The pose and the joints of the guide's slvMove example, where every robot of this file starts.
const POSE: [f64; 7] = [364.16, 0.0, 278.5355, 180.0, 0.0, 180.0, 5.0];
const JOINTS: [f64; 8] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];

fn joints(world: &mut World, client: Client) -> Vec<f64> {
    let (result, value) = world.robot(client, "CurJnt", ());
    assert_eq!(result, HResult::S_OK);
    doubles(&value)
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert!(close(a, b, tolerance), "{a:?} is not {b:?}");
}

/// The time in seconds of a motion at full speed in which one joint turns by `degrees`.
fn joint_time(axis: usize, degrees: f64) -> f64 {
    degrees / SPEEDS[axis - 1] + ACCELERATION_TIME
}

fn seconds(world: &World) -> f64 {
    world.now.as_micros() as f64 / 1e6
}

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
    assert_eq!(world.robot(client, "P2J", [9000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0]).0, HResult::from_u32(0x8320_4073));
    assert_eq!(world.sim.errors().count(), 0, "a conversion moves nothing and is no error of the robot");
}

#[test]
fn each_missing_condition_has_its_code_in_this_order() {
    let mut world = World::with(Config { mode: Mode::Manual, token: Token::TeachPendant, ..Config::default() });
    let (client, other) = (world.client(1), world.client(2));
    let other_peer = other.peer;
    world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
    let try_move = |world: &mut World| world.move_to(client, 1, "J(0,40,90,0,45,0)", "");

    assert_eq!(try_move(&mut world), HResult::E_ACCESSDENIED);
    world.sim.set_mode(Mode::Auto, world.now);
    assert_eq!(try_move(&mut world), HResult::E_TOKEN_NOT_ETHERNET);
    world.sim.set_token(Token::Client(other_peer));
    assert_eq!(try_move(&mut world), HResult::E_TOKEN_ADDRESS);
    world.sim.set_token(Token::Client(client.peer));
    assert_eq!(try_move(&mut world), HResult::E_ERROR_PRESENT);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(try_move(&mut world), HResult::E_ARM_NOT_TAKEN);
    assert_eq!(world.robot(client, "TakeArm", [0, 0]), ok(&()));
    assert_eq!(try_move(&mut world), HResult::E_MOTOR_OFF);
    // switched on with "no wait", it is not on yet
    assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "Motor", [1, 1])), ok(&()));
    assert_eq!(try_move(&mut world), HResult::E_MOTOR_OFF);
    assert_eq!(world.robot_get(client, "@SERVO_ON"), ok(&false));
    world.pass(300);
    assert_eq!(world.robot_get(client, "@SERVO_ON"), ok(&true));
    assert_eq!(try_move(&mut world), HResult::S_OK);

    // a refusal is in the log, and nothing that had to be cleared
    let log: Vec<_> = world.sim.error_log().map(|e| e.code).collect();
    let expected = [
        HResult::E_MOTOR_OFF,
        HResult::E_MOTOR_OFF,
        HResult::E_ARM_NOT_TAKEN,
        HResult::E_ERROR_PRESENT,
        HResult::E_TOKEN_ADDRESS,
        HResult::E_TOKEN_NOT_ETHERNET,
        HResult::from_u32(0x8150_0001),
    ];
    assert_eq!(log, expected);
}

#[test]
fn the_arm_belongs_to_one_client_until_it_goes() {
    let mut world = World::new();
    let (one, two) = (world.client(1), world.client(2));
    assert_eq!(world.robot(one, "TakeArmState", -1), ok(&-1));
    assert_eq!(world.robot(one, "TakeArmState", "x"), code(HResult::DISP_E_TYPEMISMATCH));
    assert_eq!(world.robot(one, "TakeArm", ()), ok(&()));
    assert_eq!(world.robot(one, "takearm", [0, 1]), ok(&()));
    assert_eq!(world.robot(one, "TakeArmState", -1), ok(&0));
    assert_eq!(world.robot(one, "TakeArmState", ()), ok(&0));
    assert_eq!(world.robot(one, "TakeArmState", 1), ok(&-1));
    assert_eq!(world.robot(two, "TakeArmState", -1), ok(&-1));
    assert_eq!(world.robot(two, "TakeArm", [0, 0]), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!(world.robot(two, "GiveArm", ()).0, HResult::S_FALSE);
    assert_eq!(world.call(two.peer, call::robot_speed(two.robot, -1, 5.0)), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!(world.robot(one, "TakeArm", [1, 0]), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(one, "TakeArm", [0, 2]), code(HResult::E_INVALIDARG));

    world.sim.left(one.peer, world.now);
    assert_eq!(world.robot(two, "TakeArm", [0, 0]), ok(&()));
    assert_eq!(world.sim.arm_owner(), Some(two.peer));
    assert_eq!(world.call(two.peer, call::service_stop()), code(HResult::S_OK));
    assert_eq!(world.sim.arm_owner(), None);
}

#[test]
fn take_arm_keeps_or_resets_speed_tool_and_work() {
    let mut world = World::new();
    let client = world.client(1);
    world.robot(client, "TakeArm", [0, 0]);
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, -1, 40.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, 0, 30.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_accelerate(client.robot, -1, 50.0, 60.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "Tool3")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "work2")), code(HResult::S_OK));
    let all =
        |world: &mut World| ["@SPEED", "@JSPEED", "@ACCEL", "@JDECEL"].map(|name| world.robot_get(client, name).1);
    world.robot(client, "TakeArm", [0, 1]);
    assert_eq!(all(&mut world), [40.0_f32, 30.0, 50.0, 60.0].map(|n| value(&n)));
    assert_eq!(world.robot(client, "CurTool", ()), ok(&3));
    assert_eq!(world.robot_get(client, "@CURRENT_WORK"), ok(&2));
    world.robot(client, "TakeArm", [0, 0]);
    assert_eq!(all(&mut world), [100.0_f32; 4].map(|n| value(&n)));
    assert_eq!(world.robot_get(client, "@CURRENT_TOOL"), ok(&0));

    for bad in [0.0, 1e-6, -1.0, 100.5, f32::NAN] {
        assert_eq!(world.call(client.peer, call::robot_speed(client.robot, -1, bad)), code(HResult::E_INVALIDARG));
    }
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, 7, 1.0)), code(HResult::E_INVALIDARG));
    for bad in ["Tool64", "Tool", "Tool-1", "Hand1", ""] {
        assert_eq!(
            world.call(client.peer, call::robot_change(client.robot, bad)),
            code(HResult::E_INVALIDARG),
            "{bad}"
        );
    }
}

#[test]
fn external_speed_sets_its_accelerations_unless_told() {
    let mut world = World::new();
    let client = world.client(1);
    let read = |world: &mut World| {
        let [a, b, c] = ["@EXTSPEED", "@EXTACCEL", "@EXTDECEL"].map(|name| world.robot_get(client, name).1);
        (a, b, c)
    };
    assert_eq!(world.robot(client, "ExtSpeed", 50), ok(&()));
    assert_eq!(read(&mut world), (value(&50.0_f32), value(&25.0_f32), value(&25.0_f32)));
    assert_eq!(world.robot(client, "ExtSpeed", [80.0, 70.0, 60.0]), ok(&()));
    assert_eq!(read(&mut world), (value(&80.0_f32), value(&70.0_f32), value(&60.0_f32)));
    let handle = world.robot_variable(client, "@EXTSPEED");
    assert_eq!(world.call(client.peer, call::variable_put_value(handle, 20.0_f32)), code(HResult::S_OK));
    assert_eq!(world.robot(client, "CurExtSpd", ()), ok(&20.0_f32));
    assert_eq!(world.robot(client, "CurExtAcc", ()), ok(&4.0_f32));
    assert_eq!(world.robot(client, "ExtSpeed", 0), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "ExtSpeed", ()), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "ExtSpeed", (1, "x")), code(HResult::E_INVALIDARGTYPE));
}

#[test]
fn the_motor_takes_its_time() {
    let mut world = World::with(Config { motor_on_delay: Duration::from_millis(500), ..Config::default() });
    let client = world.client(1);
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    assert_eq!(world.now, Instant::from_millis(500));
    assert!(world.sim.motor_is_on());
    assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "Motor", 1_i16)), ok(&()));
    let servo = world.robot_variable(client, "@SERVO_ON");
    assert_eq!(world.call(client.peer, call::variable_put_value(servo, false)), code(HResult::S_OK));
    assert!(!world.sim.motor_is_on());
    assert_eq!(world.call(client.peer, call::variable_put_value(servo, true)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(servo)), ok(&false));
    world.pass(500);
    assert_eq!(world.call(client.peer, call::variable_get_value(servo)), ok(&true));

    // switched off while somebody waits for it
    world.robot(client, "Motor", 0);
    let on = call::robot_execute(client.robot, "Motor", [1, 0]);
    world.begin(client.peer, &on);
    let other = world.client(2);
    assert_eq!(world.robot(other, "Motor", 0), ok(&()));
    assert_eq!(world.again(client.peer, &on).0, Outcome::Done(HResult::E_MOTOR_OFF));
    assert_eq!(world.robot(client, "Motor", ()), code(HResult::E_INVALIDARG));

    // as a command of the controller
    let start = world.now;
    assert_eq!(world.run(client.peer, call::controller_execute(client.controller, "Motor", true)), ok(&()));
    assert_eq!(world.now.saturating_since(start), Duration::from_millis(500));
    assert!(world.sim.motor_is_on());
}

#[test]
fn the_slowest_motion_is_still_one() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.robot(client, "ExtSpeed", 0.0001), ok(&()));
    let go = call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "SPEED=0.0001,ACCEL=0.0001,NEXT");
    assert_eq!(world.call(client.peer, go), code(HResult::S_OK));
    world.pass(1_000_000);
    let here = joints(&mut world, client)[0];
    assert!(here > 0.0 && here < 0.1, "{here}");
    assert!(world.sim.is_moving());
    assert_eq!(world.call(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
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

    // to where it stands
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
    assert_eq!(world.call(client.peer, go()), code(HResult::E_ROBOTISBUSY));
    assert_eq!(world.robot(client, "GiveArm", ()), code(HResult::E_ROBOTISBUSY));
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
        assert_close(&joints(world, client)[..6], &to, 1e-2);
    }
    for pose in ["P1", "@E P1", "@P p[1]", "@0 J12", "T3", "@E J(30,20,100,10,50,-20)", text.as_str()] {
        check(&mut world, client, pose, target);
    }
    check(&mut world, client, (pose.as_slice(), "P", "@E"), target);
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
    assert_eq!(world.move_to(client, 2, "P(300, 0, 350, 180, 0, 180, 7)", ""), HResult::E_INVALIDARG);
    // nor leave the arm's reach
    assert_eq!(world.move_to(client, 2, "P(800, 0, 350, 180, 0, 180, 5)", ""), HResult::from_u32(0x8320_4073));
}

#[test]
fn halt_from_another_connection_ends_the_waiting_move() {
    let mut world = World::new();
    let client = world.mover(1);
    let stopper = world.client(2);
    let go = call::robot_move(client.robot, 1, "J(120,45,90,0,45,0)", "");
    world.begin(client.peer, &go);
    world.pass(300);
    assert_eq!(world.call(stopper.peer, call::robot_halt(stopper.robot, "")), code(HResult::S_OK));
    // it brakes before it stands
    assert!(matches!(world.again(client.peer, &go).0, Outcome::Wait(_)));
    world.pass(250);
    assert_eq!(world.again(client.peer, &go).0, Outcome::Done(HResult::E_ABORT));
    let stopped = joints(&mut world, client)[0];
    assert!(stopped > 10.0 && stopped < 119.0, "{stopped}");
    world.pass(1000);
    assert_eq!(joints(&mut world, client)[0], stopped);
    assert_eq!(world.call(stopper.peer, call::robot_halt(stopper.robot, "")), code(HResult::S_FALSE));
    // no error, and it may go on
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
        assert_eq!(world.run(client.peer, drive), code(HResult::E_INVALIDARG));
    }
    let drive = call::robot_drive(client.robot, 1, f32::NAN, "");
    assert_eq!(world.run(client.peer, drive), code(HResult::E_INVALIDARG));
}

#[test]
fn out_of_range_is_an_error_of_the_axis() {
    for axis in 1..=6_usize {
        let mut world = World::new();
        let client = world.mover(1);
        let mut target = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];
        target[axis - 1] = RANGES[axis - 1].1 + 1.0;
        let expected = HResult::from_u32(0x8320_4070 + u32::try_from(axis).unwrap());
        assert_eq!(world.move_to(client, 1, (target, "J"), ""), expected);
        assert_eq!(expected.axis().map(usize::from), Some(axis));
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
    for interpolation in [3, 4] {
        assert_eq!(world.move_to(client, interpolation, pose, ""), HResult::E_NOTIMPL);
    }
    for interpolation in [0, 5, -1] {
        assert_eq!(world.move_to(client, interpolation, pose, ""), HResult::E_INVALIDARG);
    }
    for option in ["SPEED", "SPEED=x", "SPEED=0", "SPEED=101", "FAST", "NEXT=1"] {
        assert_eq!(world.move_to(client, 1, pose, option), HResult::E_INVALIDARG, "{option}");
    }
    assert_eq!(world.move_to(client, 1, "J100", ""), HResult::DISP_E_BADINDEX);
    assert_eq!(world.move_to(client, 1, 1, ""), HResult::E_INVALIDARGTYPE);
    assert_eq!(world.sim.errors().count(), 0);
    assert_eq!(world.run(client.peer, call::robot_rotate(client.robot, 1, 1.0, 1, "")).0, HResult::E_NOTIMPL);
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

#[test]
fn values_that_cannot_be_written_stay() {
    let mut world = World::new();
    let client = world.client(1);
    for name in ["@CURRENT_POSITION", "@BUSY_STATUS", "@TYPE_NAME", "@SPEED", "@EXTACCEL"] {
        let handle = world.robot_variable(client, name);
        let refused = call::variable_put_value(handle, 1);
        assert_eq!(world.call(client.peer, refused), code(HResult::E_CAO_NOT_WRITABLE), "{name}");
    }
    let tool: VariableHandle = world.robot_variable(client, "@CURRENT_TOOL");
    assert_eq!(world.call(client.peer, call::variable_put_value(tool, 64)), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::variable_put_value(tool, 63)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(tool)), ok(&63));
    world.sim.set_variable(VariableKind::J, 0, &value(&[0.0_f32; 8]).as_variant()).unwrap();
}
