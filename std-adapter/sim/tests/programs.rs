//! Tasks with a program, from a scenario: their steps, their states, their errors.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_sim::codes::ARM_OF_TASK;
use bcap_sim::{Scenario, TaskStatus, VariableKind};

use crate::common::{Client, World, code, ok};

const FEEDER: &str = r#"
[[task]]
name = "Feeder"
steps = [
    { wait = { IO128 = true } },
    { set = { IO24 = true, F1 = 2.5, S1 = "fed" } },
    { wait_ms = 500 },
    { add = { I10 = 1 } },
    { set = { IO24 = false, IO128 = false } },
]
"#;

fn world(text: &str) -> World {
    let mut world = World::new();
    world.sim.play(Scenario::parse(text).unwrap_or_else(|error| panic!("{error}")));
    world
}

fn int(world: &World, index: u32) -> i32 {
    world.sim.variable::<16>(VariableKind::I, index).unwrap().as_variant().as_i32().unwrap()
}

fn io(world: &World, index: u32) -> bool {
    world.sim.variable::<16>(VariableKind::Io, index).unwrap().as_variant().as_bool().unwrap()
}

fn start(world: &mut World, client: Client, name: &str, mode: i32) -> HResult {
    let task = world.task(client, name);
    world.call(client.peer, call::task_start(task, mode, "")).0
}

fn stop(world: &mut World, client: Client, name: &str, mode: i32) -> HResult {
    let task = world.task(client, name);
    world.call(client.peer, call::task_stop(task, mode, "")).0
}

#[test]
fn a_task_counts_once_a_second_whatever_the_steps_of_the_clock() {
    let text = "[[task]]\nname = 'Counter'\nstart = 2\nline_ms = 1\nsteps = [{ add = { I1 = 1 } }, { wait_ms = 999 }]";
    for step in [1, 7, 100, 10_500] {
        let mut world = world(text);
        while world.now < Instant::from_millis(10_500) {
            world.pass(step);
        }
        let seconds = i32::try_from(world.now.as_micros() / 1_000_000).unwrap();
        assert_eq!(int(&world, 1), seconds + 1, "in steps of {step} ms");
        assert_eq!(world.sim.task("counter"), Some((TaskStatus::Running, u64::from(seconds.unsigned_abs()))));
    }
}

#[test]
fn a_task_waits_for_an_io_of_a_client() {
    let mut world = world(FEEDER);
    let client = world.client(1);
    assert_eq!(start(&mut world, client, "feeder", 1), HResult::S_OK);
    world.pass(60_000);
    assert!(!io(&world, 24));
    assert_eq!(world.put(client, "IO128", true), HResult::S_OK);
    world.pass(20);
    assert!(io(&world, 24));
    assert_eq!(world.get(client, "F1"), ok(&2.5_f32));
    assert_eq!(world.get(client, "S1"), ok("fed"));
    world.pass(499);
    assert_eq!(int(&world, 10), 0);
    world.pass(31);
    assert_eq!((int(&world, 10), io(&world, 24)), (1, false));
    world.pass(10);
    assert_eq!(world.sim.task("Feeder"), Some((TaskStatus::Ready, 1)));
}

#[test]
fn a_task_that_waits_for_years_costs_nothing() {
    let text =
        "[[task]]\nname = 'T'\nstart = 1\nline_ms = 1\nsteps = [{ wait = { IO200 = true } }, { set = { I1 = 1 } }]";
    let mut world = world(text);
    let client = world.client(1);
    // a check each millisecond would take minutes
    world.pass(100 * 365 * 86_400_000);
    assert_eq!(world.put(client, "IO200", true), HResult::S_OK);
    world.pass(2);
    assert_eq!(int(&world, 1), 1);
}

#[test]
fn one_task_wakes_another() {
    let text = "[[task]]\nname = 'A'\nstart = 1\nsteps = [{ wait = { I1 = 1 } }, { set = { I2 = 1 } }]
                [[task]]\nname = 'B'\nstart = 1\nsteps = [{ wait = { I2 = 1 } }, { set = { I3 = 1 } }]
                [[task]]\nname = 'C'\nstart = 1\nsteps = [{ wait_ms = 1000 }, { set = { I1 = 1 } }]";
    let run = |step: u64| {
        let mut world = world(text);
        let mut seen = Vec::new();
        while world.now < Instant::from_millis(1200) {
            world.pass(step);
            if world.now.as_micros().is_multiple_of(100_000) {
                seen.push([1, 2, 3].map(|n| int(&world, n)));
            }
        }
        seen
    };
    let seen = run(100);
    assert_eq!((seen[8], seen[10]), ([0, 0, 0], [1, 1, 1]));
    assert_eq!(run(1), seen);
}

#[test]
fn a_task_is_stepped_stopped_continued_and_reset() {
    let text = "[[task]]\nname = 'T'\nsteps = [{ add = { I1 = 1 } }, { wait_ms = 100 }, { add = { I2 = 1 } }]";
    let mut world = world(text);
    let client = world.client(1);
    assert_eq!(start(&mut world, client, "T", 3), HResult::S_OK);
    world.pass(1000);
    assert_eq!(world.sim.task("T"), Some((TaskStatus::StepStop, 0)));
    assert_eq!((int(&world, 1), int(&world, 2)), (1, 0));
    assert_eq!(start(&mut world, client, "T", 2), HResult::S_OK);
    world.pass(60);
    assert_eq!(stop(&mut world, client, "T", 1), HResult::S_OK);
    let line = world.task(client, "T");
    let line = call::task_get_variable(line, "@LINE_NO", "");
    let line = call::VariableHandle(world.handle(client.peer, line));
    assert_eq!(world.call(client.peer, call::variable_get_value(line)), ok(&[2, 0][..]));
    world.pass(5000);
    assert_eq!(int(&world, 2), 0);
    assert_eq!(start(&mut world, client, "T", 2), HResult::S_OK);
    world.pass(39);
    assert_eq!(int(&world, 2), 0, "the rest of the step's time");
    world.pass(1);
    assert_eq!(int(&world, 2), 1);
    assert_eq!(stop(&mut world, client, "T", 3), HResult::S_OK);
    world.pass(10);
    assert_eq!(world.sim.task("T"), Some((TaskStatus::Ready, 1)));
    assert_eq!(stop(&mut world, client, "T", 4), HResult::S_FALSE);
}

#[test]
fn an_error_in_a_task_names_the_task_and_its_line() {
    let text = "[[task]]\nname = 'Bad'\nstart = 1\nsteps = [{ wait_ms = 100 }, { error = '0x81501003' }, { set = { I1 = 7 } }]";
    let mut world = world(text);
    let client = world.client(1);
    world.pass(99);
    assert_eq!(world.sim.errors().count(), 0);
    world.pass(1);
    assert_eq!(world.sim.errors().next().unwrap().at, Instant::from_millis(100));
    let (result, info) = world.execute(client, "GetCurErrorInfo", 0);
    assert_eq!(result, HResult::S_OK);
    let info: Vec<String> =
        info.as_variant().as_array().unwrap().iter().map(|item| format!("{:?}", item.flatten())).collect();
    assert!(info[0].contains(&0x8150_1003_u32.cast_signed().to_string()), "{info:?}");
    assert_eq!((info[4].as_str(), info[5].as_str()), ("\"Bad\"", "I4(2)"), "{info:?}");
    assert_eq!(world.sim.task("Bad"), Some((TaskStatus::Suspended, 0)));
    assert_eq!(start(&mut world, client, "Bad", 1), HResult::E_ERROR_PRESENT);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(start(&mut world, client, "Bad", 1), HResult::S_OK);
    world.pass(10);
    assert_eq!(int(&world, 1), 7, "it continues after the step");
    let message = world.handle(client.peer, call::controller_get_message(client.controller));
    let source = call::message_get_source(call::MessageHandle(message));
    assert_eq!(world.call(client.peer, source), ok("Bad"));
}

#[test]
fn a_severe_error_resets_all_tasks() {
    let text = "[[task]]\nname = 'A'\nstart = 1\nsteps = [{ wait_ms = 50 }, { error = '0x83204001' }]
                [[task]]\nname = 'B'\nstart = 2\nsteps = [{ wait_ms = 60 }]";
    let mut world = world(text);
    world.pass(200);
    assert_eq!(world.sim.task("A"), Some((TaskStatus::Ready, 0)));
    assert_eq!(world.sim.task("B"), Some((TaskStatus::Ready, 0)));
}

#[test]
fn a_step_that_fails_raises_its_code_and_is_tried_again() {
    let text = "[[task]]\nname = 'A'\nstart = 1\nsteps = [{ set = { I5000 = 1 } }]";
    let mut world = world(text);
    world.pass(1);
    assert_eq!(world.sim.errors().map(|e| e.code).collect::<Vec<_>>(), [HResult::DISP_E_BADINDEX]);
    assert_eq!(world.sim.task("A"), Some((TaskStatus::Suspended, 0)));
}

#[test]
fn a_wait_for_a_value_that_its_variable_never_has_is_an_error() {
    for (wanted, expected) in [
        ("I1 = true", HResult::E_INVALIDARGTYPE),
        ("I1 = 'x'", HResult::E_INVALIDARGTYPE),
        ("S1 = 1", HResult::E_INVALIDARGTYPE),
        ("P1 = 1", HResult::E_INVALIDARGTYPE),
        ("IO1 = [1.0]", HResult::E_INVALIDARGTYPE),
        ("P1 = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]", HResult::E_INVALIDARG),
    ] {
        let mut world = world(&format!("[[task]]\nname = 'A'\nstart = 1\nsteps = [{{ wait = {{ {wanted} }} }}]"));
        world.pass(1000);
        assert_eq!(world.errors(), [expected], "{wanted}");
        assert_eq!(world.sim.task("A"), Some((TaskStatus::Suspended, 0)), "{wanted}");
    }
}

#[test]
fn a_task_moves_along_points() {
    let text = "[controller]\nmotor = true\n[[task]]\nname = 'Move'\nsteps = [
        { move = '@E J(30,45,90,0,45,0)' },
        { set = { I1 = 1 } },
        { move = { pose = 'J(0,45,90,0,45,0)', option = 'SPEED=50' } },
    ]";
    let mut world = world(text);
    let client = world.client(1);
    assert_eq!(start(&mut world, client, "Move", 1), HResult::S_OK);
    world.pass(1);
    assert!(world.sim.is_moving());
    assert_eq!(world.robot(client, "TakeArm", [0, 0]), code(HResult::E_ARM_NOT_TAKEN));
    while int(&world, 1) == 0 {
        world.pass(1);
    }
    assert_eq!(world.sim.axes()[0], 30.0);
    world.pass(5000);
    assert_eq!((world.sim.axes()[0], world.sim.arm_owner()), (0.0, None), "the refused call does not stop the task");
    assert_eq!(world.sim.task("Move"), Some((TaskStatus::Ready, 1)));
    world.clear(client);
    assert_eq!(world.robot(client, "TakeArm", [0, 0]), ok(&()));
}

#[test]
fn a_motion_of_a_task_that_cannot_begin_is_an_error_of_the_task() {
    let text = "[[task]]\nname = 'Move'\nstart = 1\nsteps = [{ move = 'J(30,45,90,0,45,0)' }]";
    let mut world = world(text);
    world.pass(1);
    assert_eq!(world.sim.errors().map(|e| e.code).collect::<Vec<_>>(), [HResult::E_MOTOR_OFF]);
}

#[test]
fn a_stopped_task_brakes_and_completes_its_motion_later() {
    let text = "[controller]\nmotor = true\n[[task]]\nname = 'Move'\nsteps = [{ move = '@E J(90,45,90,0,45,0)' }]";
    let mut world = world(text);
    let client = world.client(1);
    assert_eq!(start(&mut world, client, "Move", 1), HResult::S_OK);
    world.pass(150);
    assert_eq!(stop(&mut world, client, "Move", 1), HResult::S_OK);
    world.pass(2000);
    let rest = world.sim.axes()[0];
    assert!(!world.sim.is_moving() && rest > 0.0 && rest < 90.0, "{rest}");
    assert_eq!(start(&mut world, client, "Move", 1), HResult::S_OK);
    world.pass(5000);
    assert_eq!(world.sim.axes()[0], 90.0);
    assert_eq!(world.sim.task("Move"), Some((TaskStatus::Ready, 1)));
}

#[test]
fn a_deleted_task_has_a_state_and_nothing_else() {
    let mut world = world(FEEDER);
    let client = world.client(1);
    let task = world.task(client, "Feeder");
    assert_eq!(world.call(client.peer, call::task_start(task, 1, "")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::task_delete(task, "")), code(HResult::E_CAO_CMD_EXECUTE));
    assert_eq!(world.call(client.peer, call::task_stop(task, 1, "")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::task_delete(task, "")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::task_execute(task, "GetStatus", ())), ok(&0));
    assert_eq!(world.call(client.peer, call::task_start(task, 1, "")), code(HResult::E_CAO_OBJECT_NOTFOUND));
    let again = call::controller_get_task(client.controller, "Feeder", "");
    assert_eq!(world.call(client.peer, again), code(HResult::E_CAO_OBJECT_NOTFOUND));
    let (_, names) = world.call(client.peer, call::controller_get_task_names(client.controller, ""));
    assert_eq!(names.as_variant().as_array().map(|names| names.len()), Some(3));
    assert_eq!(world.call(client.peer, call::task_release(task)), code(HResult::S_OK));
}

#[test]
fn a_task_and_a_scenario_post_messages() {
    let text = "[[task]]\nname = 'T'\nsteps = [{ message = 'one part' }]
                [[fault]]\nwhen = { at_ms = 50 }\nthen = { message = 'lunch' }";
    let mut world = world(text);
    let client = world.client(1);
    assert_eq!(start(&mut world, client, "T", 1), HResult::S_OK);
    world.pass(100);
    let mut seen = Vec::new();
    for _ in 0..2 {
        let message = call::MessageHandle(world.handle(client.peer, call::controller_get_message(client.controller)));
        let (_, value) = world.call(client.peer, call::message_get_value(message));
        let (_, source) = world.call(client.peer, call::message_get_source(message));
        assert_eq!(world.call(client.peer, call::message_get_number(message)), ok(&0));
        let text = |value: Variant<'_>| value.as_bstr().unwrap().to_string();
        seen.push((text(value.as_variant()), text(source.as_variant())));
        assert_eq!(world.call(client.peer, call::message_release(message)), code(HResult::S_OK));
    }
    assert_eq!(seen, [("one part".to_owned(), "T".to_owned()), ("lunch".to_owned(), "RC8".to_owned())]);
    assert_eq!(world.call(client.peer, call::controller_get_message(client.controller)), code(HResult::S_FALSE));
}

#[test]
fn an_invalid_task_is_refused_with_its_step() {
    for (text, problem) in [
        ("name = ''\nsteps = [{ wait_ms = 1 }]", "has a name"),
        ("name = 'T'\nsteps = []", "1 to 9999 steps"),
        ("name = 'T'\nline_ms = 0\nsteps = [{ wait_ms = 1 }]", "`line_ms`"),
        ("name = 'T'\nstart = 3\nsteps = [{ wait_ms = 1 }]", "1 or 2, not 3"),
        ("name = 'T'\nsteps = [{ wait_ms = 1 }, { set = { X1 = 1 } }]", "step 2: \"X1\""),
        ("name = 'T'\nsteps = [{ set = { 'I*' = 1 } }]", "step 1: \"I*\""),
        ("name = 'T'\nsteps = [{ add = { IO1 = 1 } }]", "I, F and D"),
        ("name = 'T'\nsteps = [{ error = 'S_OK' }]", "begins with 8"),
        ("name = 'T'\nsteps = [{ move = { pose = 'P1', interpolation = 4 } }]", "not 4"),
        ("name = 'T'\nsteps = [{ jump = 1 }]", "line 3"),
    ] {
        let error = Scenario::parse(&format!("[[task]]\n{text}")).unwrap_err().to_string();
        assert!(error.contains(problem), "{text}: {error}");
    }
}

/// A task that moves the arm to and fro without a pause.
const MOVER: &str = "[controller]\nmotor = true
    [[task]]\nname = 'Mover'\nstart = 2\nsteps = [
        { move = 'J(60, 45, 90, 0, 45, 0)' },
        { move = 'J(-60, 45, 90, 0, 45, 0)' },
    ]";
/// Returns a controller whose task moves the arm, and a client.
fn moving() -> (World, Client) {
    let mut world = World::new();
    world.sim.play(Scenario::parse(MOVER).unwrap_or_else(|error| panic!("{error}")));
    let client = world.client(1);
    world.pass(500);
    assert!(world.sim.is_moving() && world.sim.arm_owner().is_some());
    (world, client)
}

#[test]
fn a_halt_of_a_task_is_refused_until_the_task_is_stopped() {
    let (mut world, client) = moving();
    assert_eq!(world.call(client.peer, call::robot_halt(client.robot, "")), code(ARM_OF_TASK));
    world.pass(10);
    assert!(world.sim.is_moving());
    assert_eq!(world.sim.task("Mover").unwrap().0, TaskStatus::Running);
    assert_eq!(world.sim.error_log().next().map(|entry| entry.code), Some(ARM_OF_TASK));
    assert_eq!(stop(&mut world, client, "Mover", 4), HResult::S_OK);
    assert_eq!(world.run(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
    assert!(!world.sim.is_moving());
    // of a client's motion it is accepted
    assert_eq!(world.errors(), [ARM_OF_TASK]);
    world.clear(client);
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    let away = call::robot_move(client.robot, 1, "J(10, 45, 90, 0, 45, 0)", "NEXT");
    assert_eq!(world.call(client.peer, away), code(HResult::S_OK));
    assert_eq!(world.run(client.peer, call::robot_halt(client.robot, "")), code(HResult::S_OK));
}

#[test]
fn kill_all_stops_every_task_and_frees_the_arm() {
    for (sync, waits) in [(None, false), (Some(0), false), (Some(1), true)] {
        let (mut world, client) = moving();
        assert_eq!(start(&mut world, client, "Pro1", 2), HResult::S_OK);
        let reply = match sync {
            None => world.execute(client, "KillAll", ()),
            Some(sync) => world.run(client.peer, call::controller_execute(client.controller, "KillAll", sync)),
        };
        assert_eq!(reply, ok(&()), "{sync:?}");
        assert_eq!(world.sim.is_moving(), !waits, "{sync:?}");
        assert_eq!(world.sim.arm_owner(), None);
        for task in ["Mover", "Pro1", "Pro2"] {
            assert_eq!(world.sim.task(task).unwrap().0, TaskStatus::Ready, "{task}");
        }
        world.pass(5000);
        assert!(!world.sim.is_moving());
    }
    let (mut world, client) = moving();
    for wrong in [-1, 2] {
        assert_eq!(world.execute(client, "KillAll", wrong), code(HResult::E_INVALIDARG));
    }
    assert_eq!(world.sim.task("Mover").unwrap().0, TaskStatus::Running);
}

#[test]
fn step_stop_all_answers_when_tasks_and_robot_rest() {
    // the line of a pass motion ends when the arm begins to brake
    let text = "[controller]\nmotor = true\n[[task]]\nname = 'Move'\nstart = 1\nsteps = [
        { move = '@P J(60, 45, 90, 0, 45, 0)' },
        { wait_ms = 1 },
    ]";
    let mut world = world(text);
    let client = world.client(1);
    world.pass(100);
    assert!(world.sim.is_moving());
    let stop = call::controller_execute(client.controller, "StepStopAll", 1);
    assert_eq!(world.run(client.peer, stop), ok(&()));
    assert_eq!(world.sim.task("Move"), Some((TaskStatus::StepStop, 0)));
    assert!(!world.sim.is_moving());
}
