//! Slave mode over the handler of b-CAP: each row of its tables, by codes, values and cycles of a stopped clock.

mod access;
mod extended;
mod formats;
mod leaving;
mod limits;
mod modes;
mod refused;
mod time;
mod underflow;

use bcap_core::bcap::call;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Encode;
use bcap_sim::Config;

use crate::common::{Client, Reply, Value, World, close, ok};

/// Where every robot of this file starts.
const START: [f64; 8] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];
const POSE: [f64; 7] = [364.16, 0.0, 278.5355, 180.0, 0.0, 180.0, 5.0];

const UNDERFLOW: HResult = HResult::E_COMMAND_BUFFER_EMPTY;

fn j1(angle: f64) -> [f64; 8] {
    let mut joints = START;
    joints[0] = angle;
    joints
}

/// A controller with one client that has the arm and the motor on.
struct Rig {
    world: World,
    client: Client,
}

impl Rig {
    fn new() -> Self {
        Self::with(Config::default())
    }

    fn with(config: Config) -> Self {
        let mut world = World::with(config);
        let client = world.mover(1);
        Self { world, client }
    }

    /// Enters a mode with the default formats.
    fn enter(mode: i32) -> Self {
        let mut rig = Self::new();
        assert_eq!(rig.execute("slvChangeMode", mode), ok(&()));
        rig
    }

    /// Executes a command that must answer immediately.
    fn execute(&mut self, command: &str, param: impl Encode) -> Reply {
        self.world.call(self.client.peer, call::robot_execute(self.client.robot, command, param))
    }

    fn slv_move(&mut self, pose: impl Encode) -> Reply {
        self.execute("slvMove", pose)
    }

    /// Sends joints in mode 0 or 1. Only J1 differs from the start; returns the code.
    fn j1(&mut self, angle: f64) -> HResult {
        self.slv_move(j1(angle)).0
    }

    /// Begins a slvMove that is not answered immediately; returns when to poll it again.
    fn withheld(&mut self, pose: [f64; 8]) -> Instant {
        match self.world.poll(self.client.peer, &call::robot_execute(self.client.robot, "slvMove", pose), false) {
            (Outcome::Wait(at), _) => at,
            (done, _) => panic!("answered at once: {done:?}"),
        }
    }

    fn again(&mut self, pose: [f64; 8]) -> (Outcome, Value) {
        self.world.again(self.client.peer, &call::robot_execute(self.client.robot, "slvMove", pose))
    }

    /// Lets cycles begin.
    fn cycles(&mut self, count: u64) {
        self.world.pass(8 * count);
    }

    fn errors(&self) -> Vec<HResult> {
        self.world.sim.errors().map(|e| e.code).collect()
    }

    fn here(&self) -> [f64; 8] {
        self.world.sim.axes()
    }

    fn mode(&self) -> i32 {
        self.world.sim.slave_mode()
    }
}

fn limit(base: u32, axis: usize) -> HResult {
    HResult::from_u32(base + u32::try_from(axis).unwrap())
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert!(close(a, b, tolerance), "{a:?} is not {b:?}");
}

/// Brings J1 to 0.2 degrees a cycle, 25 degrees per second.
fn moving(mode: i32) -> Rig {
    let mut rig = Rig::enter(mode);
    for angle in [0.2, 0.4, 0.6] {
        assert!(rig.j1(angle).is_ok());
    }
    rig.cycles(1);
    assert!(rig.world.sim.is_moving());
    rig
}
