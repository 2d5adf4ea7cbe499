//! The table of conditions of docs/virtual-controller.md says what the controller answers: each call is made without each
//! condition.

use bcap_core::bcap::call::{self, Call};
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_sim::codes::{EMERGENCY_STOP, MANUAL_MODE};
use bcap_sim::{Config, Mode, Profile, Scenario, Token};

use crate::common::{Client, World, ok};

const PAGE: &str = include_str!("../../../docs/virtual-controller.md");

const START: [f64; 8] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];
const ERROR: HResult = HResult::from_u32(0x8150_0001);

/// A controller with everything that a call needs: its client owns the arm, the motor is on, the arm is at rest.
struct Rig {
    world: World,
    client: Client,
    /// Another client.
    other: Client,
    _files: tempfile::TempDir,
}

impl Rig {
    fn new() -> Self {
        let files = tempfile::tempdir().unwrap();
        std::fs::write(files.path().join("Pro1.pcs"), "").unwrap();
        let mut config = Config::new(Profile::Cobotta);
        (config.files, config.home) = (Some(files.path().to_owned()), [0.0, 45.0, 90.0, 0.0, 45.0, 0.0]);
        let mut world = World::with(config);
        let (client, other) = (world.mover(1), world.client(2));
        Self { world, client, other, _files: files }
    }

    fn now(&mut self, call: impl Call) -> HResult {
        match self.world.poll(self.client.peer, &call, false).0 {
            Outcome::Done(code) => code,
            // it has begun
            Outcome::Wait(_) => HResult::S_OK,
        }
    }

    fn robot(&mut self, command: &str, param: impl bcap_core::variant::Encode) -> HResult {
        let robot = self.client.robot;
        self.now(call::robot_execute(robot, command, param))
    }

    fn controller(&mut self, command: &str, param: impl bcap_core::variant::Encode) -> HResult {
        let controller = self.client.controller;
        self.now(call::controller_execute(controller, command, param))
    }

    fn put(&mut self, variable: &str, value: impl bcap_core::variant::Encode) -> HResult {
        let variable = self.world.robot_variable(self.client, variable);
        self.now(call::variable_put_value(variable, value))
    }

    fn hand(&mut self, command: &str, param: impl bcap_core::variant::Encode) -> HResult {
        let open = call::controller_get_extension(self.client.controller, "Hand0", "");
        let hand = call::ExtensionHandle(self.world.handle(self.client.peer, open));
        self.now(call::extension_execute(hand, command, param))
    }

    /// Makes a call of the table with valid arguments.
    fn call(&mut self, name: &str) -> HResult {
        let Client { robot, controller, peer } = self.client;
        match name {
            "Robot_Move" => self.now(call::robot_move(robot, 1, "J(5,45,90,0,45,0)", "")),
            "Robot_Drive" => self.now(call::robot_drive(robot, 1, 5.0, "")),
            "Robot_Rotate" => self.now(call::robot_rotate(robot, "XY", 5.0, "V(0,0,0)", "")),
            "Robot_GoHome" => self.now(call::robot_go_home(robot)),
            "Robot_Unhold" => self.now(call::robot_unhold(robot, "")),
            "Robot_Chuck" => self.now(call::robot_chuck(robot, "")),
            "Robot_Unchuck" => self.now(call::robot_unchuck(robot, "")),
            "Robot_Speed" => self.now(call::robot_speed(robot, -1, 50.0)),
            "Robot_Accelerate" => self.now(call::robot_accelerate(robot, -1, 50.0, 50.0)),
            "Robot_Change" => self.now(call::robot_change(robot, "Tool1")),
            "Task_Start" => {
                let task = self.world.task(self.client, "Pro1");
                self.now(call::task_start(task, 1, ""))
            }
            "File_Run" => {
                let file = self.world.handle(peer, call::controller_get_file(controller, "Pro1.pcs", ""));
                self.now(call::file_run(call::FileHandle(file), ""))
            }
            "DriveEx" | "DriveAEx" => self.robot(name, "@0 (1, 5)"),
            "Approach" => self.robot(name, (1, "J(5,45,90,0,45,0)", 5.0)),
            "Depart" => self.robot(name, (1, 5.0)),
            "RotateH" => self.robot(name, 5.0),
            "Draw" => self.robot(name, (1, "V(0,0,5)")),
            "ArchMove" => self.robot(name, ("J(5,45,90,0,45,0)", 5.0)),
            "Arrive" => self.robot(name, 50.0),
            "GrvCtrl" | "GrvOffset" | "HighPathAccuracy" | "Zforce" | "MotionTimeout" | "SingularAvoid" => {
                self.robot(name, 0)
            }
            "CrtMotionAllow" | "EncMotionAllow" | "EncMotionAllowJnt" | "ErAlw" | "CurLmt" => self.robot(name, [0, 1]),
            "SetAreaDef" => self.robot(name, (1, [0.0_f64; 11])),
            "SetArea" | "ResetArea" | "ClrPathPoint" | "LoadPathPoint" => self.robot(name, 1),
            "SetAreaEnabled" => self.robot(name, (1, true)),
            "AddPathPoint" => self.robot(name, (1, "J(5,45,90,0,45,0)")),
            "slvChangeMode" => self.robot(name, 0x002),
            "slvMove" => self.robot(name, START),
            "TakeArm" | "MotionSkip" => self.robot(name, ()),
            "Motor 1" => self.robot("Motor", 1),
            "Motor 0" => self.robot("Motor", 0),
            "@SERVO_ON true" => self.put("@SERVO_ON", true),
            "@SERVO_ON false" => self.put("@SERVO_ON", false),
            "@CURRENT_TOOL" | "@CURRENT_WORK" => self.put(name, 1),
            "@SPEED" | "@ACCEL" | "@DECEL" | "@JSPEED" | "@JACCEL" | "@JDECEL" => self.put(name, 50.0),
            "HandMoveA" | "HandMoveR" => self.controller(name, [1.0, 50.0]),
            "HandMoveH" => self.controller(name, [10.0, 1.0]),
            "HandMoveAH" => self.controller(name, [5.0, 50.0, 10.0]),
            "HandMoveVH" => self.controller(name, [50.0, 1.0]),
            "Chuck" | "UnChuck" | "MoveP" => self.hand(name, 1),
            "Org" => self.hand(name, ()),
            "MoveA" | "MoveR" => self.hand(name, [1.0, 50.0]),
            "MoveAH" | "MoveRH" => self.hand(name, [1.0, 50.0, 50.0]),
            "MoveH" => self.hand(name, [50, 50, 1]),
            "MoveZH" => self.hand(name, [0, 10, 50, 50, 1]),
            "MotionPreparation" | "AutoCal" => self.robot(name, ()),
            "PayLoad" => self.robot(name, 100),
            "SpeedMode" => self.robot(name, 1),
            "SetToolDef" | "SetWorkDef" | "SetBaseDef" => self.robot(name, (1, "P(0,0,10,0,0,0)")),
            _ => panic!("the test has no arguments for {name}"),
        }
    }

    /// Frees the arm, and gives it to the other client if `taken`.
    fn give(&mut self, taken: bool) {
        assert_eq!(self.world.robot(self.client, "GiveArm", ()), ok(&()));
        if taken {
            assert_eq!(self.world.robot(self.other, "TakeArm", [0, 1]), ok(&()));
        }
    }

    /// Makes the arm brake: a motion that a client commands now does not join a queue.
    fn brake(&mut self) {
        assert_eq!(self.world.move_to(self.client, 1, "J(90,45,90,0,45,0)", "NEXT"), HResult::S_OK);
        self.world.pass(200);
        self.world.begin(self.other.peer, &call::robot_halt(self.other.robot, ""));
    }
}

/// Returns the cells of the table.
fn rows() -> Vec<Vec<&'static str>> {
    let section = PAGE.split("\n## ").find(|section| section.starts_with("Conditions")).expect("the heading exists");
    let table = section.lines().filter(|line| line.starts_with('|')).skip(2);
    table.map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// The conditions: the column, the cells that need it, the code without it, and what removes it.
type Condition = (usize, &'static [&'static str], HResult, fn(&mut Rig));

const CONDITIONS: &[Condition] = &[
    (1, &["yes"], MANUAL_MODE, |rig| rig.world.sim.set_mode(Mode::Manual, rig.world.now)),
    (2, &["yes"], HResult::E_TOKEN_NOT_ETHERNET, |rig| rig.world.sim.set_token(Token::TeachPendant)),
    (2, &["yes"], HResult::E_TOKEN_ADDRESS, |rig| rig.world.sim.set_token(Token::Client(rig.other.peer))),
    (3, &["yes"], EMERGENCY_STOP, |rig| rig.world.sim.emergency_stop(true, rig.world.now)),
    (3, &["yes"], HResult::E_ERROR_PRESENT, |rig| rig.world.sim.inject_error(ERROR, rig.world.now)),
    (4, &["own"], HResult::E_ARM_NOT_TAKEN, |rig| rig.give(false)),
    (4, &["own", "free"], HResult::E_ARM_NOT_TAKEN, |rig| rig.give(true)),
    (5, &["yes"], HResult::E_MOTOR_OFF, |rig| {
        assert_eq!(rig.world.robot(rig.client, "Motor", 0), ok(&()));
    }),
    (6, &["yes"], HResult::E_ROBOTISBUSY, Rig::brake),
];

#[test]
fn the_communication_permission_holds_for_every_function() {
    let text = "[controller]\npermission = 'read_only'
        [[fault]]\nwhen = { at_ms = 1000 }\nthen = { permission = 'none' }
        [[fault]]\nwhen = { at_ms = 2000 }\nthen = { permission = 'read_write' }";
    let mut world = World::new();
    world.sim.play(Scenario::parse(text).unwrap());
    let client = world.client(1);
    let codes = |world: &mut World| {
        let move_to = call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "");
        [
            world.get(client, "I1").0,
            world.robot(client, "CurJnt", ()).0,
            world.put(client, "I1", 1),
            world.robot(client, "TakeArm", [0, 1]).0,
            world.robot(client, "ExtSpeed", [50.0]).0,
            world.run(client.peer, move_to).0,
            world.execute(client, "ClearError", ()).0,
        ]
    };
    let (ok, denied, read_only) = (HResult::S_OK, HResult::E_ACCESSDENIED, HResult::E_CAO_NOT_WRITABLE);
    assert_eq!(codes(&mut world), [ok, ok, read_only, denied, denied, denied, denied]);
    world.pass(1000);
    assert_eq!(codes(&mut world), [denied; 7]);
    assert!(world.call(client.peer, call::robot_halt(client.robot, "")).0.is_ok(), "a stop is never refused");
    world.pass(1000);
    assert_eq!(codes(&mut world), [ok, ok, ok, ok, ok, HResult::E_MOTOR_OFF, ok]);
}

#[test]
fn each_call_is_refused_without_each_of_its_conditions() {
    for row in rows() {
        for name in row[0].split(", ") {
            let answer = prepared(name).call(name);
            assert!(answer.is_ok(), "{name} with all conditions: {answer}");
            for (column, needs, expected, remove) in CONDITIONS {
                // Slave Mode needs the arm, and the arm at rest
                if name == "slvMove" && *column >= 4 {
                    continue;
                }
                let mut rig = prepared(name);
                remove(&mut rig);
                let refused = rig.call(name) == *expected;
                // MotionPreparation is accepted with an error, but not in an emergency stop
                let is_prepared = name == "MotionPreparation" && *expected == EMERGENCY_STOP;
                assert_eq!(refused, is_prepared || needs.contains(&row[*column]), "{name}: {expected}");
            }
        }
    }
}

/// Returns a controller in which a call has all its conditions.
fn prepared(name: &str) -> Rig {
    let mut rig = Rig::new();
    for command in ["Motor", "Org"] {
        assert_eq!(rig.hand(command, 1), HResult::S_OK);
    }
    if name == "slvMove" {
        assert_eq!(rig.world.robot(rig.client, "slvChangeMode", 0x002), ok(&()));
    }
    if name == "MotionPreparation" {
        assert_eq!(rig.world.robot(rig.client, "ManualResetPreparation", ()), ok(&()));
    }
    rig
}
