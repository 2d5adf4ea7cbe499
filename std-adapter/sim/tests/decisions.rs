//! The answers that no source describes: the table of `docs/spec-notes.md` has their values.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::{Config, Permission, Profile};

use crate::common::{Value, World, code, doubles, ok, value};

const PAGE: &str = include_str!("../../../docs/spec-notes.md");

/// Returns the value of the table for the answer that begins so.
fn ours(answer: &str) -> &'static str {
    let section =
        PAGE.split("\n## ").find(|section| section.starts_with("Answers that are ours")).expect("the heading");
    let row = section.lines().find(|line| line.starts_with(&format!("| {answer}"))).expect(answer);
    row.trim_matches('|').split('|').nth(1).expect("a value").trim()
}

fn named(answer: &str) -> HResult {
    HResult::from_name(ours(answer)).expect("a code")
}

#[test]
fn calls_without_an_effect() {
    let mut world = World::with(Config::new(Profile::Cobotta));
    let client = world.mover(1);
    let nothing = named("Robot_Halt, Task_Stop and HandStop without");
    assert_eq!(world.call(client.peer, call::robot_halt(client.robot, "")).0, nothing);
    let task = world.task(client, "Pro1");
    assert_eq!(world.call(client.peer, call::task_stop(task, 1, "")).0, nothing);
    assert_eq!(world.execute(client, "HandStop", ()).0, nothing);
    assert_eq!(world.robot(client, "MotionSkip", ()).0, nothing);
    assert_eq!(world.robot(client, "GiveArm", ()), ok(&()));
    assert_eq!(world.robot(client, "GiveArm", ()).0, nothing);
}

#[test]
fn refusals() {
    let mut world = World::new();
    let client = world.mover(1);
    let unknown = call::controller_get_robot(client.controller, "Arm", "Colour=red");
    assert_eq!(world.call(client.peer, unknown).0, named("an unknown option"));
    assert_eq!(world.robot(client, "StartLog", ()).0, named("StartLog before ClearLog"));
    world.sim.set_permission(Permission::None);
    assert_eq!(world.robot(client, "CurJnt", ()), code(named("a call that the communication permission")));
}

#[test]
fn names_and_times() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.sim.config().tasks.join(", "), ours("tasks"));
    let [serial, firmware] = ["@SERIAL_NO", "@FIRMWARE"].map(|name| world.get(client, name).1);
    let text = |value: &Value| value.as_variant().as_bstr().unwrap().to_string();
    assert_eq!([text(&serial), text(&firmware)].join(", "), ours("SERIAL_NO"));
    let connect = call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "");
    let unnamed = call::ControllerHandle(world.handle(client.peer, connect));
    assert_eq!(world.call(client.peer, call::controller_get_name(unnamed)).1, value(ours("name of a controller")));

    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    let before = world.now.as_micros();
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    assert_eq!(format!("{} ms", (world.now.as_micros() - before) / 1000), ours("time of Motor on"));
    let deviation: f64 = ours("deviation in GetSrvData 2").parse().unwrap();
    assert_eq!(doubles(&world.robot(client, "GetSrvData", 2).1)[0].to_bits(), deviation.to_bits());

    assert_eq!(world.move_to(client, 1, "J(60,45,90,0,45,0)", "NEXT"), HResult::S_OK);
    let accepted = (1..).find(|n| {
        let angle = if n % 2 == 0 { "J(0,45,90,0,45,0)" } else { "J(60,45,90,0,45,0)" };
        world.call(client.peer, call::robot_move(client.robot, 1, angle, "NEXT")).0 != HResult::S_OK
    });
    assert_eq!(accepted.unwrap().to_string(), ours("motions of a client"));
}
