//! Random programs of motions, with each arm in turn: no axis ever jumps, exceeds its speed or leaves its range, and a program
//! has one outcome. `just programs` runs 10,000.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::kinematics::{Geometry, Links};
use bcap_sim::{ArmProfile, Config, Profile};

use crate::common::{Client, World, ok};

/// The number of programs; the environment variable `PROGRAMS` sets another number.
const PROGRAMS: u64 = 60;
const STEPS: usize = 40;

type Axes = [f64; 8];

fn programs() -> u64 {
    std::env::var("PROGRAMS").ok().and_then(|n| n.parse().ok()).unwrap_or(PROGRAMS)
}

/// Returns the settings of a program: the arm of a model or another arm.
fn config(seed: u64) -> Config {
    let rc8 = || Config::new(Profile::Rc8);
    let arm_of = |profile: Profile| Config { geometry: profile.model().geometry, ..rc8() };
    let config = match seed % 6 {
        0 => rc8(),
        1 => arm_of(Profile::Cobotta),
        2 => arm_of(Profile::CobottaPro),
        n => rc8().with_arm(ArmProfile::ALL[n as usize - 3].arm()),
    };
    Config { extended_axes: 1, ..config }
}

/// Returns a place that the arm may reach, and its RX and RZ: the flange points down, or of four axes up.
fn place(arm: &Geometry, random: &mut fastrand::Rng) -> [f64; 5] {
    let (radius, height, tilt) = match arm.links {
        // about the middle of the reach
        Links::Vertical(links) => ((links.a2 + links.d4) * 0.6, links.d1 - 50.0, 180.0),
        _ => (450.0, 50.0, 0.0),
    };
    let mut about = |middle: f64, by: f64| middle + by * (2.0 * random.f64() - 1.0);
    [about(radius, radius * 0.25), about(0.0, radius / 2.0), about(height, 50.0), tilt, tilt]
}

fn pass(random: &mut fastrand::Rng) -> &'static str {
    ["", "@0 ", "@E ", "@P ", "@P ", "@5 ", "@100 "][random.usize(0..7)]
}

/// Creates a motion command; most are possible, some are not.
fn command(world: &mut World, arm: &Geometry, client: Client, random: &mut fastrand::Rng) -> HResult {
    let mut percent = |least: f64| least + (100.0 - least) * random.f64();
    let option = format!("SPEED={},ACCEL={},DECEL={},NEXT", percent(1.0), percent(5.0), percent(5.0));
    let joint = |random: &mut fastrand::Rng, axis: usize| {
        let (low, high) = arm.ranges[axis];
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
            let [x, y, z, rx, rz] = place(arm, random);
            let pose = format!("{pass}P({x},{y},{z},{rx},0,{rz},-1)");
            world.call(client.peer, call::robot_move(client.robot, random.i32(1..=2), pose.as_str(), &option)).0
        }
        6 => {
            let length = format!("{pass}{}", random.i32(-50..=100));
            let depart = (random.i32(1..=2), length.as_str(), option.as_str());
            world.call(client.peer, call::robot_execute(client.robot, "Depart", depart)).0
        }
        7 => {
            let ([x, y, z, rx, rz], [u, v, w, ..]) = (place(arm, random), place(arm, random));
            let poses = format!("P({x},{y},{z},{rx},0,{rz},-1), {pass}P({u},{v},{w},{rx},0,{rz},-1)");
            world.call(client.peer, call::robot_move(client.robot, 3, poses.as_str(), &option)).0
        }
        8 => {
            let turn = call::robot_rotate(client.robot, "XY", random.f32() * 90.0 - 45.0, "V(0,0,0)", &option);
            world.call(client.peer, turn).0
        }
        _ => {
            let axis = random.usize(0..if matches!(arm.links, Links::Vertical(_)) { 6 } else { 4 });
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

/// Advances the clock, and checks each millisecond. An error, which stops without braking, may occur in between.
fn watch(world: &mut World, arm: &Geometry, millis: u64, seed: u64, trace: &mut Vec<Axes>) {
    for _ in 0..millis {
        let before = world.sim.axes();
        world.pass(1);
        let here = world.sim.axes();
        for axis in 0..8 {
            let (limit, (low, high)) = (arm.speeds[axis], arm.ranges[axis]);
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
    let config = config(seed);
    let arm = config.geometry;
    let mut world = World::with(config);
    let client = world.mover(1);
    let mut trace = Vec::new();
    for _ in 0..STEPS {
        let before = world.sim.axes();
        match random.u32(0..24) {
            0 => drop(world.call(client.peer, call::robot_hold(client.robot, ""))),
            1 | 2 => drop(world.call(client.peer, call::robot_unhold(client.robot, ""))),
            3 => drop(world.call(client.peer, call::robot_execute(client.robot, "MotionSkip", [-1, 0]))),
            4 => drop(world.poll(client.peer, &call::robot_halt(client.robot, ""), false)),
            _ => drop(command(&mut world, &arm, client, &mut random)),
        }
        assert_eq!(world.sim.axes(), before, "seed {seed}: a command makes the arm jump");
        recover(&mut world, client);
        watch(&mut world, &arm, random.u64(0..400), seed, &mut trace);
    }
    let _ = world.call(client.peer, call::robot_unhold(client.robot, ""));
    while world.sim.is_moving() {
        watch(&mut world, &arm, 100, seed, &mut trace);
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
    for seed in 100..106 {
        assert_eq!(run(seed), run(seed), "seed {seed}");
    }
}
