//! The same scenario and the same calls at the same times give the same answers, however often time is advanced between.
//! Scenario, calls and times are random. `just scenarios` runs 100.

use std::fmt::Write as _;

use bcap_core::bcap::call;
use bcap_core::handler::Outcome;
use bcap_core::time::Instant;
use bcap_sim::{Config, Profile, Scenario};

use crate::common::{Client, Value, World};

/// The number of programs; the environment variable `PROGRAMS` sets another number, for example 100.
const PROGRAMS: u64 = 5;
const CALLS: usize = 1000;

/// The tasks of all scenarios.
const TASKS: &str = r#"
[[task]]
name = "Count"
start = 2
line_ms = 3
steps = [{ add = { I1 = 1 } }, { wait_ms = 37 }, { set = { IO200 = true } }, { message = "counted" }]
[[task]]
name = "Wait"
start = 2
steps = [{ wait = { IO200 = true, IO201 = true } }, { set = { IO200 = false, IO201 = false } }, { add = { F1 = 0.5 } }]
[[task]]
name = "Move"
steps = [{ move = "@P J(20,45,90,0,45,0)" }, { wait_ms = 20 }, { move = { pose = "@E J(-20,45,90,0,45,0)", option = "SPEED=50" } }]
[[task]]
name = "Fail"
steps = [{ wait_ms = 100 }, { error = "0x81501003" }, { set = { S1 = "failed" } }]
"#;

/// Creates a scenario with its seed and up to ten faults.
fn scenario(random: &mut fastrand::Rng) -> String {
    let mut text = format!("seed = {}\n[controller]\nmotor = {}\n{TASKS}", random.u32(..), random.bool());
    for _ in 0..random.usize(0..6) {
        let when = match random.u32(0..3) {
            0 => format!("chance = {}", f64::from(random.u32(1..30)) / 1000.0),
            1 => format!("every = {}", random.u32(50..400)),
            _ => format!("cycle = {}", random.u32(1..60)),
        };
        let then = match random.u32(0..3) {
            0 => r#"refuse = "E_BUF_FULL""#.to_owned(),
            1 => format!("delay_ms = {}", random.u32(1..60)),
            _ => r#"error = "0x83204001""#.to_owned(),
        };
        // an action that answers a call does not fit a cycle of Slave Mode
        let then = if when.starts_with("cycle") { r#"error = "0x84204043""#.to_owned() } else { then };
        let _ = writeln!(text, "[[fault]]\nwhen = {{ {when} }}\nthen = {{ {then} }}");
    }
    for _ in 0..random.usize(0..3) {
        let at = random.u32(100..3000);
        for (at, pressed) in [(at, true), (at + random.u32(10..300), false)] {
            let _ = writeln!(text, "[[fault]]\nwhen = {{ at_ms = {at} }}\nthen = {{ emergency_stop = {pressed} }}");
        }
    }
    text
}

fn programs() -> u64 {
    std::env::var("PROGRAMS").ok().and_then(|n| n.parse().ok()).unwrap_or(PROGRAMS)
}

/// A client's call that waits.
type Waiting = Box<dyn Fn(&mut World, bool) -> (Outcome, Value)>;

fn random_call(random: &mut fastrand::Rng, client: Client) -> Waiting {
    let Client { peer, controller, robot } = client;
    let j1 = f64::from(random.i32(-60..=60));
    let n = random.i32(0..4);
    let task = ["Count", "Wait", "Move", "Fail", "Pro1"][random.usize(0..5)];
    let variable = ["I1", "I2", "F1", "IO200", "IO201", "S1"][random.usize(0..6)];
    let robot_read = ["CurPos", "CurJnt", "DestJnt", "GetLogCount", "TakeArmState", "slvGetMode"][random.usize(0..6)];
    let read = ["SysState", "GetCurErrorCount", "GetErrorLogCount", "GetOprLogCount"][random.usize(0..4)];
    let pass = ["@P", "@0", "@E", "@20"][random.usize(0..4)];
    match random.u32(0..24) {
        0..4 => Box::new(move |world, again| {
            let handle = world.variable_of(client, variable);
            world.poll(peer, &call::variable_get_value(handle), again)
        }),
        4 => Box::new(move |world, again| {
            let handle = world.variable_of(client, "IO201");
            world.poll(peer, &call::variable_put_value(handle, true), again)
        }),
        5 => Box::new(move |world, again| {
            let handle = world.task_of(client, task);
            world.poll(peer, &call::task_start(handle, n.min(3), ""), again)
        }),
        6 => Box::new(move |world, again| {
            let handle = world.task_of(client, task);
            world.poll(peer, &call::task_stop(handle, n, ""), again)
        }),
        7 => Box::new(move |world, again| {
            let handle = world.task_of(client, task);
            world.poll(peer, &call::task_execute(handle, "GetStatus", ()), again)
        }),
        8..11 => Box::new(move |world, again| world.poll(peer, &call::controller_execute(controller, read, ()), again)),
        11..14 => Box::new(move |world, again| world.poll(peer, &call::robot_execute(robot, robot_read, ()), again)),
        14 => Box::new(move |world, again| {
            world.poll(peer, &call::controller_execute(controller, "ClearError", ()), again)
        }),
        15 => Box::new(move |world, again| world.poll(peer, &call::robot_execute(robot, "TakeArm", [0, 0]), again)),
        16 => Box::new(move |world, again| world.poll(peer, &call::robot_execute(robot, "Motor", [1, 0]), again)),
        17 => Box::new(move |world, again| world.poll(peer, &call::robot_halt(robot, ""), again)),
        18 => Box::new(move |world, again| {
            let command = ["StartLog", "StopLog", "GiveArm", "MotionSkip"][n.unsigned_abs() as usize];
            world.poll(peer, &call::robot_execute(robot, command, ()), again)
        }),
        19 => Box::new(move |world, again| world.poll(peer, &call::controller_get_message(controller), again)),
        20 => {
            Box::new(move |world, again| world.poll(peer, &call::robot_execute(robot, "GetLogRecord", n * 20), again))
        }
        21 => Box::new(move |world, again| {
            let mode = if n == 0 { 0 } else { 0x102 };
            world.poll(peer, &call::robot_execute(robot, "slvChangeMode", mode), again)
        }),
        _ => Box::new(move |world, again| {
            let pose = format!("{pass} J({j1},45,90,0,45,0)");
            let option = if n == 0 { "" } else { "SPEED=40,NEXT" };
            world.poll(peer, &call::robot_move(robot, 1, pose.as_str(), option), again)
        }),
    }
}

impl World {
    fn variable_of(&mut self, client: Client, name: &str) -> call::VariableHandle {
        let get = call::controller_get_variable(client.controller, name, "");
        call::VariableHandle(self.poll(client.peer, &get, false).1.as_variant().as_i32().unwrap_or(0))
    }

    fn task_of(&mut self, client: Client, name: &str) -> call::TaskHandle {
        let get = call::controller_get_task(client.controller, name, "");
        call::TaskHandle(self.poll(client.peer, &get, false).1.as_variant().as_i32().unwrap_or(0))
    }
}

/// Runs a program, and returns its record: each answer with its time. With `often`, time advances in smaller steps.
fn run(seed: u64, often: bool) -> String {
    let mut random = fastrand::Rng::with_seed(seed);
    let profile = if seed.is_multiple_of(2) { Profile::Rc8 } else { Profile::Rc9 };
    let mut world = World::with(Config { max_objects: 100_000, ..Config::new(profile) });
    let clients = [world.client(1), world.client(2)];
    let text = scenario(&mut random);
    world.sim.play(Scenario::parse(&text).unwrap_or_else(|error| panic!("seed {seed}: {error}\n{text}")));
    let mut waiting: [Option<Waiting>; 2] = [None, None];
    let mut record = String::new();
    for _ in 0..CALLS {
        let to = world.now.as_micros() + random.u64(0..8000);
        if often {
            for part in 1..4 {
                world
                    .sim
                    .advance(Instant::from_micros(world.now.as_micros() + (to - world.now.as_micros()) * part / 4));
            }
        }
        world.now = Instant::from_micros(to);
        let who = random.usize(0..2);
        let (again, call) = match waiting[who].take() {
            Some(call) => (true, call),
            None => (false, random_call(&mut random, clients[who])),
        };
        let (outcome, value) = call(&mut world, again);
        let _ = writeln!(record, "{to} {who} {outcome:?} {value:?}");
        if matches!(outcome, Outcome::Wait(_)) {
            waiting[who] = Some(call);
        }
    }
    let _ = write!(record, "{:?} {:?}", world.sim.axes(), world.sim.error_log().collect::<Vec<_>>());
    record
}

#[test]
fn the_same_calls_at_the_same_times_give_the_same_record() {
    let mut records = Vec::new();
    for seed in 0..programs() {
        let record = run(seed, false);
        for often in [false, true] {
            let again = run(seed, often);
            let different = record.lines().zip(again.lines()).find(|(a, b)| a != b);
            assert_eq!(different, None, "seed {seed}, often {often}");
            assert_eq!(record.len(), again.len(), "seed {seed}, often {often}");
        }
        records.push(record);
    }
    // the programs differ, and do something
    assert!(records.windows(2).all(|pair| pair[0] != pair[1]));
    let moved = records.iter().filter(|record| record.contains("E_SLVMODE") || record.contains("Wait(")).count();
    assert!(moved as u64 > programs() / 2, "{moved}");
}
