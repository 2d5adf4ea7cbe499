//! Random programs of motions: no axis ever jumps, exceeds its speed or leaves its range, and a program has one outcome.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::Config;
use bcap_sim::kinematics::{EXTENDED_RANGE, EXTENDED_SPEED, RANGES, SPEEDS};

use crate::common::{Client, World, ok};

/// The number of programs; the environment variable `PROGRAMS` sets another one.
const PROGRAMS: u64 = 20;
const STEPS: usize = 40;

type Axes = [f64; 8];

fn programs() -> u64 {
    std::env::var("PROGRAMS").ok().and_then(|n| n.parse().ok()).unwrap_or(PROGRAMS)
}

fn pass(random: &mut fastrand::Rng) -> &'static str {
    ["", "@0 ", "@E ", "@P ", "@P ", "@5 ", "@100 "][random.usize(0..7)]
}

/// Makes a command of a motion; most are possible, some are not.
fn command(world: &mut World, client: Client, random: &mut fastrand::Rng) -> HResult {
    let mut percent = |least: f64| least + (100.0 - least) * random.f64();
    let option = format!("SPEED={},ACCEL={},DECEL={},NEXT", percent(1.0), percent(5.0), percent(5.0));
    let joint = |random: &mut fastrand::Rng, axis: usize| {
        let (low, high) = RANGES[axis];
        // often at the end of the range
        match random.u32(0..6) {
            0 => low,
            1 => high,
            _ => low + (high - low) * random.f64(),
        }
    };
    let pass = pass(random);
    match random.u32(0..11) {
        0..4 => {
            let joints: Vec<_> = (0..6).map(|axis| joint(random, axis).to_string()).collect();
            let extended =
                if random.bool() { format!(" EXA((7,{}))", random.i32(-1000..=1000)) } else { String::new() };
            let pose = format!("{pass}J({}){extended}", joints.join(","));
            world.call(client.peer, call::robot_move(client.robot, 1, pose.as_str(), &option)).0
        }
        4..6 => {
            let [x, y, z] = [(250.0, 400.0), (-200.0, 200.0), (250.0, 400.0)].map(|(a, b)| a + (b - a) * random.f64());
            let pose = format!("{pass}P({x},{y},{z},180,0,180,-1)");
            world.call(client.peer, call::robot_move(client.robot, random.i32(1..=2), pose.as_str(), &option)).0
        }
        6 => {
            let length = format!("{pass}{}", random.i32(-50..=100));
            let depart = (random.i32(1..=2), length.as_str(), option.as_str());
            world.call(client.peer, call::robot_execute(client.robot, "Depart", depart)).0
        }
        7 => {
            let poses = format!("P(350,{},300,180,0,180,-1), {pass}P(300,0,400,180,0,180,-1)", random.i32(-90..=90));
            world.call(client.peer, call::robot_move(client.robot, 3, poses.as_str(), &option)).0
        }
        8 => {
            let turn = call::robot_rotate(client.robot, "XY", random.f32() * 90.0 - 45.0, "V(0,0,0)", &option);
            world.call(client.peer, turn).0
        }
        _ => {
            let axis = random.usize(0..6);
            let pairs = format!("{pass}({},{})", axis + 1, joint(random, axis));
            world.call(client.peer, call::robot_execute(client.robot, "DriveAEx", [pairs.as_str(), &option])).0
        }
    }
}

/// Clears an error, which has switched the motor off.
fn recover(world: &mut World, client: Client) {
    if world.sim.errors().count() > 0 {
        assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
        assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "Motor", [1, 1])), ok(&()));
    }
}

/// Advances the clock, and checks each millisecond. An error and its stop without braking may come between.
fn watch(world: &mut World, millis: u64, seed: u64, trace: &mut Vec<Axes>) {
    for _ in 0..millis {
        let before = world.sim.axes();
        world.pass(1);
        let here = world.sim.axes();
        for axis in 0..8 {
            let (limit, (low, high)) = match axis {
                0..6 => (SPEEDS[axis], RANGES[axis]),
                _ => (EXTENDED_SPEED, (-EXTENDED_RANGE, EXTENDED_RANGE)),
            };
            let moved = (here[axis] - before[axis]).abs();
            assert!(moved <= limit / 1000.0 * 1.0001 + 1e-6, "seed {seed}: J{} moves {moved} in 1 ms", axis + 1);
            assert!(
                (low - 1e-6..=high + 1e-6).contains(&here[axis]),
                "seed {seed}: J{} is at {}",
                axis + 1,
                here[axis]
            );
        }
        trace.push(here);
    }
}

/// Runs a program and returns the position of the axes at each millisecond.
fn run(seed: u64) -> Vec<Axes> {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut world = World::with(Config { extended_axes: 1, ..Config::default() });
    let client = world.mover(1);
    let mut trace = Vec::new();
    for _ in 0..STEPS {
        let before = world.sim.axes();
        match random.u32(0..24) {
            0 => drop(world.call(client.peer, call::robot_hold(client.robot, ""))),
            1 | 2 => drop(world.call(client.peer, call::robot_unhold(client.robot, ""))),
            3 => drop(world.call(client.peer, call::robot_execute(client.robot, "MotionSkip", [-1, 0]))),
            4 => drop(world.poll(client.peer, &call::robot_halt(client.robot, ""), false)),
            _ => drop(command(&mut world, client, &mut random)),
        }
        assert_eq!(world.sim.axes(), before, "seed {seed}: a command makes the arm jump");
        recover(&mut world, client);
        watch(&mut world, random.u64(0..400), seed, &mut trace);
    }
    let _ = world.call(client.peer, call::robot_unhold(client.robot, ""));
    while world.sim.is_moving() {
        watch(&mut world, 100, seed, &mut trace);
    }
    trace
}

#[test]
fn no_axis_exceeds_its_limits() {
    let mut moved = 0;
    for seed in 0..programs() {
        let trace = run(seed);
        moved += trace.windows(2).filter(|pair| pair[0] != pair[1]).count();
    }
    // the programs do move
    assert!(moved as u64 > programs() * 1000, "{moved} ms of motion");
}

#[test]
fn a_program_has_one_outcome() {
    for seed in 100..102 {
        assert_eq!(run(seed), run(seed), "seed {seed}");
    }
}
