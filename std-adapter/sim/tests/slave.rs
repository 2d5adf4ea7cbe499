//! Slave mode over the handler of b-CAP: each row of its tables, by codes, values and cycles of a clock that stands.

mod common;

use bcap_core::bcap::call;
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};
use bcap_sim::kinematics::SPEEDS;
use bcap_sim::motion::ACCELERATION_TIME;
use bcap_sim::slave::CYCLE;
use bcap_sim::{Config, EMERGENCY_STOP, Mode, Profile, SlaveConfig, SlaveFormats, SpeedSetting, Token, VariableKind};

use common::{Client, Reply, Value, World, close, code, doubles, ok, value};

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

    /// Executes a command that must answer at once.
    fn execute(&mut self, command: &str, param: impl Encode) -> Reply {
        self.world.call(self.client.peer, call::robot_execute(self.client.robot, command, param))
    }

    fn slv_move(&mut self, pose: impl Encode) -> Reply {
        self.execute("slvMove", pose)
    }

    /// Sends joints in mode 0 or 1, of which only J1 differs from the start; returns the code.
    fn j1(&mut self, angle: f64) -> HResult {
        self.slv_move(j1(angle)).0
    }

    /// Begins a slvMove that is not answered at once; returns when it is to be asked about again.
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

// --- the modes and their buffers

#[test]
fn mode_0_tells_when_the_buffer_is_full_and_stores_nothing_more() {
    let mut rig = Rig::enter(0x002);
    assert_eq!(rig.slv_move(j1(0.1)), ok(&START), "the answer is where the robot is");
    assert_eq!(rig.j1(0.2), HResult::S_OK);
    // the third fills it, and has a value as well
    assert_eq!(rig.slv_move(j1(0.3)), (HResult::S_BUF_FULL, value(&START)));
    assert_eq!(rig.slv_move(j1(9.0)), code(HResult::E_BUF_FULL), "no value");
    assert_eq!(rig.world.sim.slave_counters().refused, 1);
    // each cycle takes one out
    rig.cycles(1);
    assert_eq!(rig.j1(0.4), HResult::S_BUF_FULL);
    assert_eq!(rig.j1(9.0), HResult::E_BUF_FULL);
    rig.cycles(2);
    assert_eq!((rig.j1(0.5), rig.j1(0.5), rig.j1(9.0)), (HResult::S_OK, HResult::S_BUF_FULL, HResult::E_BUF_FULL));
    rig.cycles(5);
    assert_close(&rig.here(), &j1(0.5), 1e-12);
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));
    let taken: Vec<_> = rig.world.sim.slave_record().map(|c| (c.cycle, c.took, c.axes[0])).collect();
    let expected = [(1, true, 0.1), (2, true, 0.2), (3, true, 0.3), (4, true, 0.4), (5, true, 0.5), (6, true, 0.5)];
    assert_eq!(taken, expected);
    assert!(!rig.world.sim.error_log().any(|e| e.code == HResult::E_BUF_FULL), "no error of the controller");
}

#[test]
fn mode_1_takes_the_newest_of_each_cycle() {
    let mut rig = Rig::enter(0x102);
    for angle in [0.05, 9.0, 90.0, 0.1] {
        assert_eq!(rig.slv_move(j1(angle)), ok(&START));
    }
    rig.cycles(2);
    assert_close(&rig.here(), &j1(0.1), 1e-12);
    let counters = rig.world.sim.slave_counters();
    assert_eq!((counters.cycles, counters.taken, counters.held, counters.overwritten), (2, 1, 1, 3));
    assert_eq!(counters.refused + counters.withheld + counters.underflows, 0);
}

#[test]
fn mode_2_answers_when_the_pose_is_stored() {
    let mut rig = Rig::enter(0x202);
    let entered = rig.world.now;
    for angle in [0.1, 0.2, 0.3] {
        assert_eq!(rig.slv_move(j1(angle)), ok(&START));
    }
    // the fourth waits for the next cycle, which begins 8 ms after slave mode was entered
    rig.world.pass(3);
    assert_eq!(rig.withheld(j1(0.4)), entered + CYCLE);
    rig.world.pass(4);
    assert_eq!(rig.again(j1(0.4)).0, Outcome::Wait(entered + CYCLE));
    rig.world.pass(1);
    assert_eq!(rig.again(j1(0.4)), (Outcome::Done(HResult::S_OK), value(&START)));
    // the buffer is full again
    assert_eq!(rig.withheld(j1(0.4)), entered + CYCLE * 2);
    // asked late, it answers with where the robot is by then
    rig.world.pass(12);
    let (outcome, answer) = rig.again(j1(0.4));
    assert_eq!(outcome, Outcome::Done(HResult::S_OK));
    assert_close(&doubles(&answer), &j1(0.15), 1e-12);
    assert_eq!(rig.world.sim.slave_counters().withheld, 2);
    rig.cycles(10);
    assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (0x202, vec![], 0.4));
}

#[test]
fn a_withheld_pose_is_dropped_when_nobody_waits_for_it() {
    let mut rig = Rig::enter(0x202);
    for angle in [0.1, 0.2, 0.2] {
        assert_eq!(rig.j1(angle), HResult::S_OK);
    }
    rig.withheld(j1(0.3));
    rig.world.sim.abandoned(rig.client.peer, rig.world.now);
    rig.cycles(10);
    assert_eq!((rig.here()[0], rig.errors()), (0.2, vec![]));
}

#[test]
fn the_axes_move_evenly_from_pose_to_pose() {
    let mut rig = Rig::enter(0x002);
    rig.j1(0.4);
    rig.j1(0.8);
    rig.j1(0.8);
    let mut way = Vec::new();
    for _ in 0..14 {
        rig.world.pass(2);
        way.push((rig.here()[0] * 1000.0).round() / 1000.0);
    }
    assert_eq!(way, [0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.8, 0.8]);
    assert!(!rig.world.sim.is_moving());
}

// --- underflow: the six rows of the specification's table

#[test]
fn modes_0_and_2_underflow_in_motion_and_are_released() {
    for mode in [0x002, 0x202] {
        let mut rig = Rig::enter(mode);
        rig.j1(0.1);
        rig.j1(0.2);
        rig.cycles(2);
        assert!(rig.world.sim.is_moving());
        assert_eq!((rig.mode(), rig.errors()), (mode, vec![]), "the second is being moved to");
        rig.cycles(1);
        assert_eq!((rig.mode(), rig.errors()), (0, vec![UNDERFLOW]), "{mode:#x}");
        assert_eq!(rig.world.sim.slave_counters().underflows, 1);
        assert!(!rig.world.sim.is_moving() && !rig.world.sim.motor_is_on());
        assert_eq!(rig.here()[0], 0.2, "it stands where the last pose was");
        let at = rig.world.sim.errors().next().unwrap().at;
        assert_eq!(at, rig.world.now, "noticed in the third cycle");
    }
}

#[test]
fn modes_0_and_2_keep_still_without_poses() {
    for mode in [0x002, 0x202] {
        let mut rig = Rig::enter(mode);
        rig.cycles(1000);
        // the same pose twice is a stop
        for angle in [0.1, 0.2, 0.2] {
            assert!(rig.j1(angle).is_ok());
        }
        rig.cycles(1000);
        assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (mode, vec![], 0.2), "{mode:#x}");
        let counters = rig.world.sim.slave_counters();
        assert_eq!((counters.cycles, counters.taken, counters.held, counters.underflows), (2000, 3, 1997, 0));
    }
}

#[test]
fn mode_1_holds_its_position_in_motion_and_at_rest() {
    let mut rig = Rig::enter(0x102);
    rig.cycles(100);
    assert_eq!((rig.mode(), rig.errors()), (0x102, vec![]));
    rig.j1(0.2);
    rig.cycles(1);
    assert!(rig.world.sim.is_moving());
    rig.cycles(1);
    assert!(!rig.world.sim.is_moving(), "held");
    rig.cycles(100);
    assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (0x102, vec![], 0.2));
}

#[test]
fn mode_1_holding_out_of_fast_motion_is_too_hard_a_stop() {
    let mut rig = Rig::enter(0x102);
    let mut angle = 0.0;
    for n in 1..=4 {
        angle += 0.4 * f64::from(n);
        assert_eq!(rig.j1(angle), HResult::S_OK);
        rig.cycles(1);
    }
    assert_eq!(rig.errors(), []);
    // from 1.6 degrees a cycle, 200 degrees per second, to a stop: 25,000 per second squared
    rig.cycles(1);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8420_4040, 1)]));
}

// --- limits of speed and acceleration

/// Moves one axis with this acceleration until it is too fast; returns the error, and the speed at which it came.
fn accelerate(rig: &mut Rig, axis: usize, acceleration: f64) -> (HResult, f64) {
    let mut pose = START;
    let mut speed = 0.0;
    for _ in 0..2000 {
        speed += acceleration * CYCLE.as_secs_f64();
        pose[axis - 1] += speed * CYCLE.as_secs_f64();
        assert_eq!(rig.slv_move(pose).0, HResult::S_OK);
        rig.cycles(1);
        if let [error] = rig.errors()[..] {
            return (error, speed);
        }
    }
    panic!("axis {axis} is never too fast");
}

#[test]
fn each_axis_has_its_limit_of_speed_in_each_setting() {
    for (setting, ext_speed, part) in [
        (SpeedSetting::Servo, 50.0, 1.2),
        (SpeedSetting::ServoByExtSpeed, 50.0, 0.6),
        (SpeedSetting::Command, 50.0, 1.0),
        (SpeedSetting::CommandByExtSpeed, 50.0, 0.5),
    ] {
        for axis in 1..=6 {
            let slave = SlaveConfig { speed_setting: setting, ..SlaveConfig::default() };
            let mut rig = Rig::with(Config { slave, ..Config::default() });
            assert_eq!(rig.execute("ExtSpeed", ext_speed), ok(&()));
            let limits = rig.world.sim.slave_limits();
            assert_close(&limits.speed[..6], &SPEEDS.map(|s| s * part), 1e-9);
            assert_eq!(rig.execute("slvChangeMode", 0x102), ok(&()));
            // as hard as it may, so that it is fast before its range ends
            let (error, speed) = accelerate(&mut rig, axis, limits.acceleration[axis - 1] * 0.9);
            assert_eq!(error, limit(0x8420_4050, axis), "{setting:?}");
            let step = limits.acceleration[axis - 1] * 0.9 * CYCLE.as_secs_f64();
            let top = limits.speed[axis - 1];
            assert!(speed > top && speed - step <= top * 1.000_001, "{setting:?}: J{axis} at {speed}, not {top}");
        }
    }
}

#[test]
fn each_axis_has_its_limit_of_acceleration() {
    let seconds = CYCLE.as_secs_f64();
    for (setting, ext_speed, part) in [
        (SpeedSetting::Servo, 50, 4.0),
        // the external acceleration is the square of the external speed
        (SpeedSetting::ServoByExtSpeed, 50, 1.0),
        (SpeedSetting::Command, 50, 1.0),
        (SpeedSetting::CommandByExtSpeed, 50, 0.25),
    ] {
        for axis in 1..=6 {
            for (factor, error) in [(0.999, None), (1.001, Some(limit(0x8420_4040, axis)))] {
                let slave = SlaveConfig { speed_setting: setting, ..SlaveConfig::default() };
                let mut rig = Rig::with(Config { slave, ..Config::default() });
                rig.execute("ExtSpeed", ext_speed);
                rig.execute("slvChangeMode", 0x002);
                let allowed = SPEEDS[axis - 1] / ACCELERATION_TIME * part;
                let mut pose = START;
                pose[axis - 1] += allowed * factor * seconds * seconds;
                assert_eq!(rig.slv_move(pose).0, HResult::S_OK, "it is the cycle that notices");
                rig.cycles(1);
                assert_eq!(rig.errors().first().copied(), error, "{setting:?}, J{axis}, {factor}");
                assert_eq!(rig.mode() == 0, error.is_some());
            }
        }
    }
}

#[test]
fn a_first_pose_far_from_the_robot_is_too_fast() {
    let mut rig = Rig::enter(0x002);
    rig.j1(10.0);
    rig.cycles(1);
    assert_eq!((rig.mode(), rig.errors(), rig.here()), (0, vec![limit(0x8420_4050, 1)], START));
}

#[test]
fn a_pose_out_of_reach_is_an_error_at_once() {
    let mut rig = Rig::enter(0x002);
    assert_eq!(rig.j1(171.0), limit(0x8320_4070, 1));
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8320_4070, 1)]));
    let mut rig = Rig::enter(0x001);
    assert_eq!(rig.slv_move([2000.0, 0.0, 0.0, 180.0, 0.0, 180.0, 5.0]).0, limit(0x8320_4070, 3));
}

// --- what slave mode needs, and what ends it

#[test]
fn entering_needs_what_every_motion_needs_and_a_licence() {
    let slave = SlaveConfig { licensed: false, ..SlaveConfig::default() };
    let mut world = World::with(Config { slave, ..Config::default() });
    let client = world.client(1);
    assert_eq!(world.robot(client, "slvChangeMode", 4), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "slvChangeMode", 2), code(HResult::E_NO_LICENSE));

    let config = Config { mode: Mode::Manual, token: Token::TeachPendant, ..Config::default() };
    let mut world = World::with(config);
    let (client, other) = (world.client(1), world.client(2));
    world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
    let enter = |world: &mut World| world.robot(client, "slvChangeMode", 0x002).0;
    assert_eq!(enter(&mut world), HResult::E_ACCESSDENIED);
    world.sim.set_mode(Mode::Auto, world.now);
    assert_eq!(enter(&mut world), HResult::E_TOKEN_NOT_ETHERNET);
    world.sim.set_token(Token::Client(other.peer));
    assert_eq!(enter(&mut world), HResult::E_TOKEN_ADDRESS);
    world.sim.set_token(Token::Client(client.peer));
    assert_eq!(enter(&mut world), HResult::E_ERROR_PRESENT);
    world.execute(client, "ClearError", ());
    assert_eq!(enter(&mut world), HResult::E_ARM_NOT_TAKEN);
    world.robot(client, "TakeArm", [0, 1]);
    assert_eq!(enter(&mut world), HResult::E_MOTOR_OFF);
    world.robot(client, "Motor", 1);
    let moves = call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "NEXT");
    assert_eq!(world.call(client.peer, moves), code(HResult::S_OK));
    assert_eq!(enter(&mut world), HResult::E_ROBOTISBUSY);
    world.pass(1000);
    assert_eq!(enter(&mut world), HResult::S_OK);
    assert_eq!(enter(&mut world), HResult::E_SLVMODE_ON);
    assert_eq!(world.robot(other, "slvChangeMode", 0x002).0, HResult::E_SLVMODE_ON);
    assert_eq!(world.robot(other, "slvChangeMode", 0).0, HResult::E_ARM_NOT_TAKEN);
}

#[test]
fn the_nine_modes_are_told_by_get_mode_and_others_are_none() {
    for mode in [0x001, 0x002, 0x003, 0x101, 0x102, 0x103, 0x201, 0x202, 0x203] {
        let mut rig = Rig::enter(mode);
        assert_eq!(rig.execute("slvGetMode", ()), ok(&mode));
        assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
        assert_eq!(rig.execute("slvGetMode", ()), ok(&0));
        assert_eq!(rig.execute("slvChangeMode", 0), ok(&()), "leaving twice is no error");
    }
    let mut rig = Rig::new();
    for mode in [-1, 0x004, 0x00f, 0x100, 0x104, 0x200, 0x301, 0x1002] {
        assert_eq!(rig.execute("slvChangeMode", mode), code(HResult::E_INVALIDARG), "{mode:#x}");
    }
    assert_eq!(rig.execute("slvChangeMode", ()), code(HResult::E_INVALIDARG));
}

#[test]
fn slv_move_without_slave_mode_hides_the_first_cause_which_the_list_tells() {
    let mut rig = Rig::new();
    assert_eq!(rig.j1(0.0), HResult::E_SLVMODE_OFF);
    assert_eq!(rig.errors(), [], "a refusal is no error of the controller");
    rig.execute("slvChangeMode", 0x002);
    rig.j1(0.1);
    rig.cycles(2);
    assert_eq!(rig.j1(0.2), HResult::E_SLVMODE_OFF);
    let client = rig.client;
    assert_eq!(rig.world.execute(client, "GetCurErrorCount", ()), ok(&1));
    let (_, info) = rig.world.execute(client, "GetCurErrorInfo", 0);
    let Variant::Array(info) = info.as_variant() else { panic!("no array") };
    assert_eq!(info.get(0).map(Variant::flatten), Some(Variant::I4(UNDERFLOW.0)));
    assert_eq!(rig.world.get(client, "@ERROR_CODE"), ok(&UNDERFLOW.0));
    // recovery: nothing but its own order
    assert_eq!(rig.execute("slvChangeMode", 0x002), code(HResult::E_ERROR_PRESENT));
    assert_eq!(rig.world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(rig.execute("slvChangeMode", 0x002), code(HResult::E_MOTOR_OFF));
    assert_eq!(rig.world.robot(client, "Motor", 1), ok(&()));
    assert_eq!(rig.execute("slvChangeMode", 0x002), ok(&()));
    assert_eq!(rig.j1(0.2), HResult::S_OK);
}

#[test]
fn in_slave_mode_its_client_may_call_little_else() {
    let mut rig = Rig::with(Config::new(Profile::Rc9));
    let (client, other) = (rig.client, rig.world.client(2));
    let variable = rig.world.variable(client, "I1");
    rig.execute("slvChangeMode", 0x002);
    for (command, param) in [("TakeArm", 0), ("Motor", 0), ("CurPos", 0), ("slvSendFormat", 0), ("slvRecvFormat", 2)] {
        assert_eq!(rig.execute(command, param), code(HResult::E_SLVMODE_ON), "{command}");
    }
    assert_eq!(rig.execute("GiveArm", ()), code(HResult::E_SLVMODE_ON));
    assert_eq!(rig.execute("slvChangeMode", 0x102), code(HResult::E_SLVMODE_ON));
    for command in ["ClearError", "GetCurErrorCount", "SysState", "NoSuchCommand"] {
        assert_eq!(rig.world.execute(client, command, ()), code(HResult::E_SLVMODE_ON), "{command}");
    }
    let refused = rig.world.call(client.peer, call::robot_move(client.robot, 1, "J1", ""));
    assert_eq!(refused, code(HResult::E_SLVMODE_ON));
    assert_eq!(rig.world.call(client.peer, call::variable_get_value(variable)), code(HResult::E_SLVMODE_ON));
    assert_eq!(rig.world.call(client.peer, call::variable_put_value(variable, 1)), code(HResult::E_SLVMODE_ON));

    assert_eq!(rig.execute("slvGetMode", ()), ok(&2));
    assert_eq!(rig.execute("curjnt", ()), ok(&START));
    assert_eq!(rig.world.execute(client, "StoState", ()), ok(&false));
    assert_eq!(rig.world.execute(client, "ManualReset", ()), ok(&()));
    assert_eq!(rig.world.call(client.peer, call::variable_release(variable)), code(HResult::S_OK));
    rig.world.variable(client, "I2");

    // another connection is free, but has not the arm
    assert_eq!(rig.world.put(other, "I1", 5), HResult::S_OK);
    assert_eq!(rig.world.execute(other, "GetCurErrorCount", ()), ok(&0));
    assert_eq!(rig.world.robot(other, "slvGetMode", ()), ok(&2));
    assert_eq!(rig.world.robot(other, "slvMove", START), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!(rig.world.move_to(other, 1, "J1", ""), HResult::E_ARM_NOT_TAKEN);
    assert_eq!(rig.mode(), 2, "refused calls release nothing");
    assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
    assert_eq!(rig.world.execute(client, "GetCurErrorCount", ()), ok(&0));
}

#[test]
fn the_token_counts_for_every_pose() {
    let mut rig = Rig::enter(0x002);
    rig.world.sim.set_token(Token::TeachPendant);
    assert_eq!(rig.j1(0.0), HResult::E_TOKEN_NOT_ETHERNET);
    rig.world.sim.set_token(Token::Any);
    assert_eq!(rig.j1(0.0), HResult::S_OK);
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

#[test]
fn the_emergency_stop_ends_slave_mode_where_the_robot_is() {
    let mut rig = moving(0x202);
    rig.j1(0.8);
    rig.withheld(j1(1.0));
    rig.world.pass(4);
    rig.world.sim.emergency_stop(true, rig.world.now);
    assert_eq!(rig.again(j1(1.0)), (Outcome::Done(EMERGENCY_STOP), Value::EMPTY), "who waits is told");
    assert_eq!((rig.mode(), rig.errors()), (0, vec![EMERGENCY_STOP]));
    assert_close(&rig.here(), &j1(0.1), 1e-12);
    rig.cycles(10);
    assert_close(&rig.here(), &j1(0.1), 1e-12);
    assert_eq!(rig.j1(0.2), HResult::E_SLVMODE_OFF);
}

#[test]
fn an_error_the_motor_and_the_mode_switch_end_it_too() {
    let mut rig = moving(0x002);
    rig.world.sim.inject_error(HResult::from_u32(0x8150_0001), rig.world.now);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![HResult::from_u32(0x8150_0001)]));

    let mut rig = moving(0x002);
    let other = rig.world.client(2);
    assert_eq!(rig.world.robot(other, "Motor", 0), ok(&()));
    assert_eq!((rig.mode(), rig.errors(), rig.world.sim.is_moving()), (0, vec![], false));

    let mut rig = moving(0x002);
    rig.world.sim.set_mode(Mode::Manual, rig.world.now);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![]));
    assert_eq!(rig.j1(0.8), HResult::E_SLVMODE_OFF);
}

#[test]
fn halt_brakes_from_any_connection() {
    let mut rig = moving(0x002);
    rig.world.pass(4);
    let other = rig.world.client(2);
    assert_eq!(rig.world.call(other.peer, call::robot_halt(other.robot, "")), code(HResult::S_OK));
    assert_eq!(rig.mode(), 0);
    // 25 degrees per second at the servo's 7500 per second squared: 3.33 ms, and half as far as at that speed
    let way = 25.0 * 25.0 / 7500.0 / 2.0;
    assert!(rig.world.sim.is_moving());
    assert_close(&rig.here(), &j1(0.1), 1e-9);
    rig.world.pass(4);
    assert!(!rig.world.sim.is_moving());
    assert_close(&rig.here(), &j1(0.1 + way), 1e-9);
    assert_eq!((rig.errors(), rig.world.sim.motor_is_on()), (vec![], true));
}

#[test]
fn a_client_that_goes_leaves_no_slave_mode_behind() {
    let mut rig = moving(0x002);
    rig.world.sim.left(rig.client.peer, rig.world.now);
    rig.world.pass(100);
    assert_eq!((rig.mode(), rig.world.sim.arm_owner(), rig.world.sim.is_moving()), (0, None, false));
    assert!(rig.here()[0] < 0.2, "what was buffered is dropped");
}

// --- leaving

#[test]
fn leaving_does_what_is_buffered_and_then_answers() {
    let mut rig = Rig::enter(0x002);
    let entered = rig.world.now;
    for angle in [0.2, 0.4, 0.4] {
        rig.j1(angle);
    }
    let client = rig.client;
    let leave = call::robot_execute(client.robot, "slvChangeMode", 0);
    let (outcome, _) = rig.world.poll(client.peer, &leave, false);
    assert_eq!(outcome, Outcome::Wait(entered + CYCLE));
    assert_eq!(rig.mode(), 0x002, "not yet");
    assert_eq!(rig.world.run_again(client.peer, &leave), ok(&()));
    // three cycles begin, the third stands
    assert_eq!(rig.world.now, entered + CYCLE * 3);
    assert_eq!((rig.mode(), rig.here()[0], rig.errors()), (0, 0.4, vec![]));
}

#[test]
fn leaving_without_a_stop_stops_at_the_last_pose_if_that_is_not_too_hard() {
    let mut rig = moving(0x002);
    assert_eq!(rig.world.robot(rig.client, "slvChangeMode", 0), ok(&()));
    assert_close(&rig.here(), &j1(0.6), 1e-12);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![]));

    let mut rig = Rig::enter(0x002);
    for angle in [0.4, 1.2, 2.0] {
        rig.j1(angle);
    }
    assert_eq!(rig.world.robot(rig.client, "slvChangeMode", 0).0, limit(0x8420_4040, 1));
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8420_4040, 1)]));
}

#[test]
fn slv_move_while_leaving_comes_too_late() {
    let mut rig = moving(0x002);
    let leave = call::robot_execute(rig.client.robot, "slvChangeMode", 0);
    rig.world.begin(rig.client.peer, &leave);
    rig.world.sim.abandoned(rig.client.peer, rig.world.now);
    assert_eq!(rig.j1(0.8), HResult::E_SLVMODE_OFF);
    rig.cycles(3);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![]));
}

// --- formats

/// The items of an answer; one that is no array of VARIANT is its only item.
fn items(answer: &Value) -> Vec<String> {
    match answer.as_variant() {
        Variant::Array(array) if array.items::<f64>().is_none() && array.items::<u8>().is_none() => {
            array.iter().map(|item| shape(&item.flatten())).collect()
        }
        other => vec![shape(&other)],
    }
}

/// Names a value by what it can only be in an answer.
fn shape(value: &Variant<'_>) -> String {
    match value {
        Variant::I4(_) => "I4".to_owned(),
        Variant::Array(array) => match (array.items::<f64>(), array.items::<u8>()) {
            (Some(numbers), _) => format!("R8[{}]", numbers.len()),
            (_, Some(bytes)) => format!("UI1[{}]", bytes.len()),
            _ => panic!("{array:?}"),
        },
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_receive_format_has_its_items_in_order_with_every_send_format() {
    let mut rig = Rig::new();
    for send in [0x0000, 0x0020, 0x0100, 0x0120, 0x0200, 0x0220] {
        for (pose, numbers) in [(1, 7), (2, 8), (3, 10), (4, 15), (5, 18)] {
            for extras in 0..32 {
                let bits = [(1, 0x0010), (2, 0x0100), (4, 0x0200), (8, 0x0020), (16, 0x0040)];
                let has = |extra: i32| extras & extra != 0;
                let receive = bits.iter().filter(|(n, _)| has(*n)).fold(pose, |format, (_, bit)| format | bit);
                assert_eq!(rig.execute("slvSendFormat", send), ok(&()));
                assert_eq!(rig.execute("slvRecvFormat", receive), ok(&()));
                rig.execute("slvChangeMode", 0x102);

                let mini: i32 = 0x0001_0000;
                let data = [0xff_u8, 0x01];
                let mut param: Vec<&dyn Encode> = vec![&START];
                if send & 0x0100 != 0 {
                    param.push(&mini);
                }
                if send & 0x0200 != 0 {
                    param.extend([&128 as &dyn Encode, &16, &data]);
                }
                if has(4) {
                    param.extend([&136 as &dyn Encode, &24]);
                }
                if send & 0x0020 != 0 {
                    param.push(&mini);
                }
                let (result, answer) = match param[..] {
                    [pose] => rig.slv_move(pose),
                    _ => rig.slv_move(param.as_slice()),
                };
                assert_eq!(result, HResult::S_OK, "{send:#x} {receive:#x}");

                let mut expected = vec![format!("R8[{numbers}]")];
                if has(1) {
                    expected.insert(0, "I4".to_owned());
                }
                expected.extend(has(2).then(|| "I4".to_owned()));
                expected.extend(has(4).then(|| "UI1[3]".to_owned()));
                expected.extend(has(8).then(|| "I4".to_owned()));
                expected.extend(has(16).then(|| "R8[8]".to_owned()));
                rig.cycles(1);
                assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
                assert_eq!(items(&answer), expected, "{send:#x} {receive:#x}");
            }
        }
    }
}

#[test]
fn the_answers_pose_is_where_the_robot_is_in_every_kind() {
    for (format, variables) in [
        (1, &["@CURRENT_POSITION"][..]),
        (2, &["@CURRENT_ANGLE"]),
        (3, &["@CURRENT_TRANS"]),
        (4, &["@CURRENT_POSITION", "@CURRENT_ANGLE"]),
        (5, &["@CURRENT_TRANS", "@CURRENT_ANGLE"]),
    ] {
        let mut rig = Rig::new();
        let other = rig.world.client(2);
        rig.execute("slvRecvFormat", format);
        rig.execute("slvChangeMode", 0x102);
        rig.slv_move([0.4, 45.1, 89.9, 0.2, 45.0, 0.3, 0.0, 0.0]);
        rig.world.pass(12);
        let (_, answer) = rig.slv_move(START);
        let told: Vec<f64> = variables.iter().flat_map(|name| doubles(&rig.world.robot_get(other, name).1)).collect();
        assert_close(&doubles(&answer), &told, 1e-12);
        assert!((rig.here()[0] - 0.2).abs() < 1e-12, "in the middle of a cycle");
    }
}

#[test]
fn poses_of_all_kinds_go_the_same_way() {
    let mut rig = Rig::new();
    let way: Vec<[f64; 8]> = (1..=5)
        .map(|n| f64::from(n * n) * 0.01)
        .map(|d| [d, 45.0 + d, 90.0 - d, d, 45.0 - d, 2.0 * d, 0.0, 0.0])
        .collect();
    let mut ends = Vec::new();
    for (mode, command) in [(0x101, "J2P"), (0x102, ""), (0x103, "J2T")] {
        let mut poses: Vec<Vec<f64>> = way.iter().map(|j| j.to_vec()).collect();
        if !command.is_empty() {
            poses = poses.iter().map(|j| doubles(&rig.execute(command, j.as_slice()).1)).collect();
        }
        let mut rig = Rig::enter(mode);
        for pose in &poses {
            assert_eq!(rig.slv_move(pose.as_slice()).0, HResult::S_OK);
            rig.cycles(1);
        }
        rig.cycles(1);
        ends.push(rig.here());
        assert_eq!(rig.errors(), []);
    }
    for end in ends {
        assert_close(&end, &way[4], 1e-9);
    }
}

#[test]
fn time_stamps_count_ms_or_us() {
    for (param, scale) in [(&[0x12, 0][..], 1), (&[0x12, 1], 1000), (&[0x12], 1)] {
        let mut rig = Rig::new();
        assert_eq!(rig.execute("slvRecvFormat", param), ok(&()));
        rig.execute("slvChangeMode", 0x102);
        rig.world.now = Instant::from_micros(1_234_567);
        let (_, answer) = rig.slv_move(START);
        let Variant::Array(answer) = answer.as_variant() else { panic!("no array") };
        let expected = if scale == 1 { 1234 } else { 1_234_567 };
        assert_eq!(answer.get(0).map(Variant::flatten), Some(Variant::I4(expected)), "{param:?}");
    }
}

#[test]
fn currents_tell_of_acceleration_and_speed() {
    let mut rig = Rig::new();
    rig.execute("slvRecvFormat", 0x42);
    rig.execute("slvChangeMode", 0x102);
    let current = |rig: &mut Rig, angle: f64| -> Vec<f64> {
        let (_, answer) = rig.slv_move(j1(angle));
        let Variant::Array(answer) = answer.as_variant() else { panic!("no array") };
        answer.get(1).unwrap().flatten().as_array().unwrap().items::<f64>().unwrap().iter().collect()
    };
    assert_eq!(current(&mut rig, 0.24), [0.0; 8]);
    rig.cycles(1);
    // half of the acceleration, and 30 of 450 degrees per second
    let percent = current(&mut rig, 0.48);
    assert_close(&percent, &[50.0 + 30.0 / 450.0 * 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1e-9);
}

fn io(rig: &Rig, n: u32) -> bool {
    rig.world.sim.variable::<16>(VariableKind::Io, n).unwrap().as_variant() == Variant::Bool(true)
}

#[test]
fn io_travels_inside_slv_move() {
    let mut rig = Rig::new();
    for n in [3, 50, 60, 200] {
        rig.world.sim.set_variable(VariableKind::Io, n, &Variant::Bool(true)).unwrap();
    }
    rig.execute("slvSendFormat", 0x0120);
    rig.execute("slvRecvFormat", 0x0322);
    rig.execute("slvChangeMode", 0x002);
    // MiniIO: outputs 16 and 31 and an input; user IO to be read: 200 to 215; HandIO: outputs 64 and 71, and 72
    let mini = (1_u32 << 16 | 1 << 31 | 1 << 5).cast_signed();
    let hand = 1_i32 << 16 | 1 << 23 | 1 << 24;
    let (result, answer) = rig.slv_move((START, mini, 200, 16, hand));
    assert_eq!(result, HResult::S_OK);
    let expected: &[&dyn Encode] =
        &[&START, &(1_u32 << 16 | 1 << 31 | 1 << 3).cast_signed(), &[1_u8, 0], &(1_i32 << 16 | 1 << 23 | 1 << 2)];
    assert_eq!(answer, value(expected));
    let on: Vec<u32> = (0..512).filter(|n| io(&rig, *n)).collect();
    assert_eq!(on, [3, 16, 31, 50, 60, 64, 71, 200]);

    // a pose that is not stored writes nothing
    for _ in 0..2 {
        rig.slv_move((START, mini, 200, 16, hand));
    }
    assert_eq!(rig.slv_move((START, 0, 200, 16, 0)).0, HResult::E_BUF_FULL);
    assert!(io(&rig, 16));
}

#[test]
fn user_io_is_written_and_read() {
    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0200);
    rig.execute("slvRecvFormat", 0x0202);
    rig.execute("slvChangeMode", 0x202);
    let (result, answer) = rig.slv_move((START, 136, 16, [0x81_u8, 0x02], 128, 32));
    assert_eq!((result, answer), ok(&(START, [0_u8, 0x81, 0x02, 0])));
    let on: Vec<u32> = (0..512).filter(|n| io(&rig, *n)).collect();
    assert_eq!(on, [136, 143, 145]);
    for (param, error) in [
        // the offset: from 128 on, a multiple of 8
        ((START, 120, 8, [1_u8].as_slice(), 128, 8), HResult::E_INVALIDARG),
        ((START, 129, 8, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 8, &[1], -8, 8), HResult::E_INVALIDARG),
        // the size counts bits
        ((START, 128, 1, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 16, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 8, &[1], 128, -8), HResult::E_INVALIDARG),
        // there are 512 IO
        ((START, 512, 8, &[1], 128, 8), HResult::DISP_E_BADINDEX),
        ((START, 504, 8, &[1], 504, 16), HResult::DISP_E_BADINDEX),
    ] {
        assert_eq!(rig.slv_move(param), code(error), "{param:?}");
    }
    assert_eq!(rig.slv_move((START, 504, 8, [0x80_u8], 504, 8)), ok(&(START, [0x80_u8])));
}

#[test]
fn a_withheld_pose_writes_its_io_when_it_is_stored() {
    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0100);
    rig.execute("slvChangeMode", 0x202);
    for _ in 0..3 {
        assert_eq!(rig.slv_move((START, 0)).0, HResult::S_OK);
    }
    let peer = rig.client.peer;
    let fourth = call::robot_execute(rig.client.robot, "slvMove", (START, 1 << 20));
    rig.world.begin(peer, &fourth);
    assert!(!io(&rig, 20));
    assert_eq!(rig.world.run_again(peer, &fourth), ok(&START));
    assert!(io(&rig, 20));
}

#[test]
fn parameters_that_do_not_fit_the_formats_are_refused_and_change_nothing() {
    let mut rig = Rig::enter(0x002);
    let wrong = HResult::E_INVALIDARGTYPE;
    assert_eq!(rig.slv_move((START, 1)), code(wrong));
    assert_eq!(rig.slv_move([0.0_f32; 8]), code(wrong));
    assert_eq!(rig.slv_move("J(0,45,90,0,45,0)"), code(wrong));
    assert_eq!(rig.slv_move(()), code(wrong));
    for pose in [&[0.0; 7][..], &[0.0; 10], &[]] {
        assert_eq!(rig.slv_move(pose), code(HResult::E_INVALIDARG), "{pose:?}");
    }
    let mut pose = START;
    pose[2] = f64::NAN;
    assert_eq!(rig.slv_move(pose), code(HResult::E_INVALIDARG));
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));

    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0100);
    rig.execute("slvChangeMode", 0x002);
    assert_eq!(rig.slv_move(START), code(wrong));
    assert_eq!(rig.slv_move((START, 1.0_f64)), code(wrong));
    assert_eq!(rig.slv_move((START, 1, 2)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(&[&START as &dyn Encode][..]), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move((START, 1)).0, HResult::S_OK);
}

#[test]
fn formats_are_checked_and_kept_for_each_client() {
    let mut rig = Rig::new();
    let other = rig.world.client(2);
    for format in [1, 0x10, 0x0300, 0x0320, 0x0040, 0x0400, -1] {
        assert_eq!(rig.execute("slvSendFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    for format in [0, 6, 0x10, 0x82, 0x402, -1] {
        assert_eq!(rig.execute("slvRecvFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvRecvFormat", [2, 2]), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvRecvFormat", [2, 0, 0]), code(HResult::E_INVALIDARG));
    // another client's formats are its own
    assert_eq!(rig.world.robot(other, "slvRecvFormat", 1), ok(&()));
    rig.execute("slvChangeMode", 0x102);
    assert_eq!(rig.slv_move(START), ok(&START));
}

#[test]
fn a_profile_has_not_every_format() {
    let mut rig = Rig::with(Config::new(Profile::Cobotta));
    for format in [0x0020, 0x0120, 0x0220] {
        assert_eq!(rig.execute("slvSendFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvRecvFormat", 0x22), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvRecvFormat", 0x0102), ok(&()));
    assert_eq!(rig.execute("slvSendFormat", 0x0100), ok(&()));
    let formats = SlaveFormats { user_io: false, current: false, mini_io: false, ..SlaveFormats::ALL };
    let slave = SlaveConfig { formats, ..SlaveConfig::default() };
    let mut rig = Rig::with(Config { slave, ..Config::new(Profile::Rc9) });
    for format in [0x0202, 0x0102, 0x0042] {
        assert_eq!(rig.execute("slvRecvFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvSendFormat", 0x0220), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvSendFormat", 0x0020), ok(&()));
}

// --- extended joints

const OPTION: f64 = 4_194_304.0; // 0x00400000

#[test]
fn extended_joints_follow_their_option() {
    let config = Config { extended_axes: 2, ..Config::default() };
    let step = |mode: i32, pose: &[f64]| -> Result<(f64, f64), HResult> {
        let mut rig = Rig::with(config.clone());
        rig.execute("slvChangeMode", mode);
        let (result, _) = rig.slv_move(pose);
        if result.is_err() {
            return Err(result);
        }
        rig.cycles(2);
        assert_eq!(rig.errors(), []);
        Ok((rig.here()[6], rig.here()[7]))
    };
    let trans = [364.16, 0.0, 278.5355, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 5.0];
    let of = |start: &[f64], more: &[f64]| [start, more].concat();
    // P: 7 + option + values
    assert_eq!(step(0x101, &POSE), Ok((0.0, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 64.0, 0.1])), Ok((0.1, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 128.0, 0.2])), Ok((0.0, 0.2)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 192.0, 0.1, 0.2])), Ok((0.1, 0.2)));
    // J: the values have their places
    let joints = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.1, 0.2];
    assert_eq!(step(0x102, &joints), Ok((0.0, 0.0)), "without the option they stay");
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 64.0])), Ok((0.1, 0.0)));
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 128.0])), Ok((0.0, 0.2)));
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 192.0])), Ok((0.1, 0.2)));
    // T: 10 + option + values
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 64.0, 0.1])), Ok((0.1, 0.0)));
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 128.0, 0.2])), Ok((0.0, 0.2)));
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 192.0, 0.1, 0.2])), Ok((0.1, 0.2)));
    // as the vendor's driver sends it: one element more, with a bit for each joint, or 0
    assert_eq!(step(0x102, &of(&START, &[OPTION + 63.0])), Ok((0.0, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[0.0])), Ok((0.0, 0.0)));
    // values without an option, options without values, no options
    for more in
        [&[OPTION + 64.0][..], &[OPTION + 192.0, 0.1], &[OPTION, 0.1], &[64.0, 0.1], &[OPTION + 0.5], &[0.0, 0.1]]
    {
        assert_eq!(step(0x101, &of(&POSE, more)), Err(HResult::E_INVALIDARG), "{more:?}");
    }
    assert_eq!(step(0x102, &of(&START, &[OPTION, 0.0])), Err(HResult::E_INVALIDARG));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 128.0, 1001.0])), Err(limit(0x8320_4070, 8)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 64.0, -1001.0])), Err(limit(0x8320_4070, 7)));
}

#[test]
fn an_arm_without_extended_joints_refuses_their_option() {
    let mut rig = Rig::enter(0x102);
    let with = |bits: f64| [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 1e-307, 3e-313, OPTION + bits];
    assert_eq!(rig.slv_move(with(64.0)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(with(63.0)).0, HResult::S_OK, "what is in unused joints is not looked at");
    let mut rig = Rig::with(Config { extended_axes: 1, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    assert_eq!(rig.slv_move(with(128.0)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(with(64.0)).0, HResult::S_OK);
}

#[test]
fn extended_joints_have_limits_and_are_told_afterwards() {
    let mut rig = Rig::with(Config { extended_axes: 2, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    let to = |j7: f64, j8: f64| [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, j7, j8, OPTION + 192.0];
    rig.slv_move(to(0.3, -0.3));
    rig.cycles(2);
    assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
    let expected = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.3, -0.3];
    assert_eq!(rig.execute("CurJnt", ()), ok(&expected));
    assert_eq!(rig.world.robot_get(rig.client, "@CURRENT_ANGLE"), ok(&expected));
    rig.execute("slvChangeMode", 0x102);
    rig.slv_move(to(0.3, 6.0));
    rig.cycles(1);
    assert_eq!(rig.errors(), [limit(0x8420_4050, 8)]);
}

// --- time

#[test]
fn steps_of_any_size_give_the_same_cycles() {
    let run = |step: u64| {
        let mut rig = Rig::enter(0x002);
        for n in [1.0, 2.0, 2.0] {
            rig.j1(n * 0.1);
        }
        let end = rig.world.now.as_micros() + 800_000;
        while rig.world.now.as_micros() < end {
            rig.world.now = Instant::from_micros((rig.world.now.as_micros() + step).min(end));
            rig.world.sim.advance(rig.world.now);
        }
        let record: Vec<_> = rig.world.sim.slave_record().collect();
        (record, rig.world.sim.slave_counters(), rig.here())
    };
    let expected = run(1000);
    assert_eq!(expected.1.cycles, 100);
    for step in [137, 7_999, 8_000, 8_001, 800_000] {
        assert_eq!(run(step), expected, "{step}");
    }
}

#[test]
fn years_and_the_end_of_time_pass_quickly() {
    let mut rig = Rig::enter(0x002);
    rig.world.sim.advance(Instant::from_millis(1000 * 86_400 * 3650));
    assert_eq!(rig.mode(), 0x002);
    rig.world.sim.advance(Instant::FAR_FUTURE);
    rig.world.sim.advance(Instant::FAR_FUTURE);
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));
}

#[test]
fn the_record_keeps_as_much_as_it_shall() {
    let slave = SlaveConfig { record: 3, ..SlaveConfig::default() };
    let mut rig = Rig::with(Config { slave, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    for n in 1..=5 {
        rig.j1(f64::from(n) * 0.1);
        rig.cycles(1);
    }
    let cycles: Vec<_> = rig.world.sim.slave_record().map(|c| c.cycle).collect();
    assert_eq!(cycles, [3, 4, 5]);
}
