//! The logs of errors, operations and positions; servo data; the load as set by a client.

use std::sync::{Arc, Mutex};

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_sim::trace::{Recorder, TracePoint};
use bcap_sim::{Config, Mode, Profile};

use crate::common::{Client, Value, World, close, code, doubles, ok};

fn items(value: &Value) -> Vec<String> {
    let array = value.as_variant().as_array().expect("an array");
    array.iter().map(|item| format!("{:?}", item.flatten())).collect()
}

fn number(value: &Value, place: usize) -> f64 {
    let item = value.as_variant().as_array().and_then(|array| array.get(place)).expect("the element exists");
    item.flatten().as_f64().or_else(|| item.flatten().as_i32().map(f64::from)).expect("a number")
}

fn operations(world: &mut World, client: Client) -> Vec<String> {
    let (_, count) = world.execute(client, "GetOprLogCount", ());
    let entries = 0..count.as_variant().as_i32().unwrap();
    let texts = entries.map(|n| {
        let (result, entry) = world.execute(client, "GetOprLog", n);
        assert_eq!(result, HResult::S_OK);
        let text = entry.as_variant().as_array().and_then(|array| array.get(11)).unwrap().flatten();
        let Variant::Bstr(text) = text else { panic!("{text:?} is no text") };
        text.to_string()
    });
    texts.collect()
}

#[test]
fn the_log_of_operations_has_what_was_done_and_when() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(operations(&mut world, client), [""; 0]);
    assert_eq!(world.robot(client, "TakeArm", [0, 0]), ok(&()));
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    let task = world.task(client, "Pro1");
    assert_eq!(world.call(client.peer, call::task_start(task, 2, "")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::task_stop(task, 0, "")), code(HResult::S_OK));
    world.sim.emergency_stop(true, world.now);
    world.sim.emergency_stop(true, world.now);
    world.sim.emergency_stop(false, world.now);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    world.sim.set_mode(Mode::Manual, world.now);
    let done = [
        "manual mode",
        "errors cleared",
        "emergency stop released",
        "emergency stop pressed",
        "task Pro1 stopped",
        "task Pro1 started",
        "motor on",
        "arm taken",
    ];
    assert_eq!(operations(&mut world, client), done);
    let (_, first) = world.execute(client, "GetOprLog", 7);
    assert_eq!(items(&first)[..8], ["I4(0)", "I4(1970)", "I4(1)", "I4(4)", "I4(1)", "I4(0)", "I4(0)", "I4(0)"]);
    assert_eq!(world.execute(client, "GetOprLog", 8).0, HResult::DISP_E_BADINDEX);
}

#[test]
fn the_log_of_positions_is_the_trace_of_the_arm() {
    let mut world = World::new();
    let client = world.mover(1);
    let count = |world: &mut World| world.robot(client, "GetLogCount", ()).1.as_variant().as_i32().unwrap();
    assert_eq!(count(&mut world), 0);
    assert_eq!(world.robot(client, "ClearLog", ()), ok(&()));
    let begin = world.now;
    world.call(client.peer, call::robot_move(client.robot, 1, "@E J(30,45,90,0,45,0)", "NEXT"));
    let mut angles = vec![world.sim.axes()[0]];
    for _ in 0..100 {
        world.pass(8);
        angles.push(world.sim.axes()[0]);
    }
    assert_eq!(world.robot(client, "StopLog", ()), ok(&()));
    assert_eq!(world.robot(client, "StopLog", ()).0, HResult::E_INVALIDARG);
    world.pass(1000);
    assert_eq!(count(&mut world), 101);
    for (n, angle) in angles.iter().enumerate() {
        let (result, record) = world.robot(client, "GetLogRecord", i32::try_from(n).unwrap());
        assert_eq!((result, record.as_variant().as_array().map(|record| record.len())), (HResult::S_OK, Some(39)));
        assert!((number(&record, 0) - angle).abs() < 1e-6, "commanded {n}");
        assert!((number(&record, 1) - angle).abs() < 1e-6, "measured {n}");
        assert_eq!(number(&record, 5), 45.0, "J2");
        let millis = (begin.as_micros() / 1000) as f64 + 8.0 * n as f64;
        assert_eq!(number(&record, 36), millis, "the counter");
    }
    assert_eq!(world.robot(client, "GetLogRecord", 101).0, HResult::DISP_E_BADINDEX);
    assert_eq!(world.robot(client, "ClearLog", ()), ok(&()));
    assert_eq!(count(&mut world), 1, "it records again");
}

#[test]
fn the_log_does_not_depend_on_the_steps_of_the_clock_and_is_bounded() {
    let run = |step: u64| {
        let mut world = World::new();
        let client = world.mover(1);
        world.robot(client, "ClearLog", ());
        world.call(client.peer, call::robot_move(client.robot, 1, "@P J(30,45,90,0,45,0)", "NEXT"));
        world.call(client.peer, call::robot_move(client.robot, 2, "@E J(0,45,90,0,45,0)", "NEXT"));
        while world.now.as_micros() < 3_000_000 {
            world.pass(step.min((3_000_000 - world.now.as_micros()) / 1000));
        }
        let count = world.robot(client, "GetLogCount", ()).1.as_variant().as_i32().unwrap();
        (0..count).map(|n| items(&world.robot(client, "GetLogRecord", n).1)).collect::<Vec<_>>()
    };
    let exact = run(1);
    assert!(exact.len() > 300);
    assert_eq!(run(1700), exact);

    let mut world = World::new();
    let client = world.mover(1);
    world.robot(client, "ClearLog", ());
    world.pass(3_600_000);
    assert_eq!(world.robot(client, "GetLogCount", ()), ok(&1250));
    world.robot(client, "StartLog", ());
    world.pass(20_000);
    assert_eq!(world.robot(client, "StopLog", ()).0, HResult::E_INVALIDARG, "it has ended by itself");
}

#[test]
fn a_recorder_gets_the_motion_and_one_point_of_rest() {
    let points = Arc::new(Mutex::new(Vec::<TracePoint>::new()));
    let kept = Arc::clone(&points);
    let recorder = Recorder::new(move |point| kept.lock().unwrap().push(*point));
    let mut world = World::with(Config { recorder, ..Config::default() });
    let client = world.mover(1);
    world.pass(100_000);
    world.call(client.peer, call::robot_move(client.robot, 1, "@E J(30,45,90,0,45,0)", "NEXT"));
    world.pass(100_000);
    let points = points.lock().unwrap();
    let (first, last) = (points.first().unwrap(), points.last().unwrap());
    assert_eq!((first.axes[0], last.axes[0]), (0.0, 30.0));
    let resting = points.iter().filter(|point| point.axes[0] == 30.0).count();
    assert_eq!(resting, 1);
    let motion = &points[1..];
    assert!(motion.windows(2).all(|pair| pair[1].at.saturating_since(pair[0].at).as_millis() == 8), "{motion:?}");
    assert!(motion.len() > 20 && motion.len() < 100, "{}", motion.len());
    assert!((first.position[0] - 364.16).abs() < 0.01, "{:?}", first.position);
}

#[test]
fn servo_data_has_the_speed_of_the_tool_centre_point() {
    let mut world = World::new();
    let client = world.mover(1);
    let (_, speed) = world.robot(client, "GetSrvData", 17);
    assert_eq!(doubles(&speed), [0.0; 8]);
    world.call(client.peer, call::robot_move(client.robot, 2, "@E P(364.16,200,278.5355,180,0,180,5)", "NEXT"));
    world.pass(100);
    let place = |world: &mut World| doubles(&world.robot(client, "CurPos", ()).1)[1];
    let before = place(&mut world);
    let (_, speed) = world.robot(client, "GetSrvData", 17);
    world.pass(1);
    let moved = (place(&mut world) - before) * 1000.0;
    // the path between its knots is not quite straight
    assert!(close(&doubles(&speed)[..3], &[0.0, moved, 0.0], 5.0), "{moved} {:?}", doubles(&speed));
    assert_eq!(doubles(&world.robot(client, "GetSrvData", 4).1), [0.0; 8]);
    let on = doubles(&world.robot(client, "GetSrvData", 2).1);
    assert!(on[..6].iter().all(|n| *n != 0.0) && on[6..] == [0.0; 2], "{on:?}");
    let (code, all) = world.robot(client, "GetAllSrvData", ());
    let all = all.as_variant().as_array().expect("an array");
    assert_eq!((code, all.len()), (HResult::S_OK, 8));
    let joints = doubles(&world.robot(client, "CurJnt", ()).1);
    let array = |n: usize| -> Vec<f64> {
        let item = all.iter().nth(n).unwrap().flatten();
        item.as_array().unwrap().items::<f32>().unwrap().iter().map(f64::from).collect()
    };
    assert!(close(&array(2), &joints, 1e-4), "{:?}", array(2));
    assert_eq!(array(7), [0.0; 8]);
    assert!(array(4).iter().any(|speed| *speed != 0.0), "the robot moves");
    assert_eq!(world.robot(client, "GetSrvData", 3).0, HResult::E_INVALIDARG);
}

#[test]
fn the_turning_speed_of_the_tool_has_no_jumps_at_180_degrees() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.move_to(client, 1, "P(300,-100,300,180,0,180,5)", ""), HResult::S_OK);
    // RX and RZ stay at 180, which the rounding of the path makes -180 at times
    let line = call::robot_move(client.robot, 2, "P(300,100,350,180,0,180,5)", "NEXT");
    assert_eq!(world.call(client.peer, line), code(HResult::S_OK));
    let mut fastest = 0.0_f64;
    while world.sim.is_moving() {
        let speed = doubles(&world.robot(client, "GetSrvData", 18).1);
        assert!(speed[3..6].iter().all(|turning| turning.abs() < 2000.0), "{speed:?}");
        fastest = fastest.max(speed[1]);
        world.pass(1);
    }
    assert!(fastest > 100.0, "{fastest}");
}

#[test]
fn a_pose_is_converted_between_work_coordinates() {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.robot(client, "SetWorkDef", (1, "P(100,200,300,0,0,90)")), ok(&()));
    let convert = |world: &mut World, from: i32, to: i32, pose: &str| {
        doubles(&world.robot(client, "ConvertPosWork", (pose, from, to)).1)
    };
    let base = convert(&mut world, 1, 0, "P(73,10,0,0,0,0)");
    assert!(close(&base, &[90.0, 273.0, 300.0, 0.0, 0.0, 90.0, -1.0], 1e-6), "{base:?}");
    let back = convert(&mut world, 0, 1, "P(90,273,300,0,0,90,5)");
    assert!(close(&back, &[73.0, 10.0, 0.0, 0.0, 0.0, 0.0, 5.0], 1e-6), "{back:?}");
    assert_eq!(world.robot(client, "ConvertPosWork", ("P(1,2,3,0,0,0)", 64, 0)).0, HResult::E_INVALIDARG);
    assert_eq!(world.robot(client, "CheckVirtualFence", "J(0,0,90,0,90,0)"), ok(&0));
    assert_eq!(world.robot(client, "CheckVirtualFence", "X").0, HResult::E_INVALIDARG);
}

#[test]
fn load_and_speed_mode_are_checked() {
    let mut world = World::new();
    let client = world.mover(1);
    let zero = [0.0_f64; 3];
    assert_eq!(world.robot(client, "PayLoad", (1000, [0.0, 0.0, 100.0], zero)), ok(&()));
    assert_eq!(world.robot(client, "PayLoad", 1000), ok(&()));
    assert_eq!(world.robot(client, "PayLoad", (1000, "V(0,0,100)")), ok(&()));
    assert_eq!(world.robot(client, "PayLoad", (-1, zero, zero)).0, HResult::E_INVALIDARG);
    assert_eq!(world.robot(client, "PayLoad", (1000, [1.0, 2.0], zero)).0, HResult::E_INVALIDARG);
    for (mode, result) in [(0, HResult::S_OK), (3, HResult::S_OK), (4, HResult::E_INVALIDARG)] {
        assert_eq!(world.robot(client, "SpeedMode", mode).0, result, "{mode}");
    }
    let other = world.client(2);
    assert_eq!(world.robot(other, "SpeedMode", 1).0, HResult::E_ARM_NOT_TAKEN);
}

#[test]
fn the_hand_of_a_cobotta_moves_grips_and_sucks() {
    let mut world = World::with(Config::new(Profile::Cobotta));
    let client = world.mover(1);
    let run = |world: &mut World, command: &str, param: [f64; 3]| {
        world.run(client.peer, call::controller_execute(client.controller, command, param)).0
    };
    assert_eq!(run(&mut world, "HandMoveAH", [20.0, 100.0, 10.0]), HResult::S_OK);
    assert_eq!(world.sim.hand_position(), 20.0);
    assert_eq!(run(&mut world, "HandMoveAH", [5.0, 100.0, 30.0]), HResult::E_INVALIDARG);
    assert_eq!(world.execute(client, "HandHoldState", ()), ok(&false));
    assert_eq!(world.execute(client, "HandMoveVH", (70, true)), ok(&()));
    assert_eq!(world.execute(client, "HandMoveVH", (101, true)).0, HResult::E_INVALIDARG);
    assert_eq!(world.execute(client, "HandStop", ()), ok(&()));
    assert_eq!(world.execute(client, "HandStop", ()), code(HResult::S_FALSE));
}
