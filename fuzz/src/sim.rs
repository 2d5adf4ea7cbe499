//! Fuzzes the virtual controller with arbitrary calls of several clients and arbitrary external events.

use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::variant::{Encode, VariantBuf};
use bcap_sim::{Mode, Permission, Profile, Scenario, Token};
use bcap_testkit::value::{VARIANT, Value};

use crate::world::{CLIENTS, Trace, World};

/// An operation.
#[derive(Arbitrary, Clone, Debug)]
enum Step {
    Call {
        peer: u8,
        function: u8,
        guess: u8,
        args: [Arg; 3],
    },
    Execute {
        peer: u8,
        robot: bool,
        command: u8,
        arg: Arg,
    },
    Variable {
        peer: u8,
        name: u8,
    },
    Move {
        peer: u8,
        interpolation: u8,
        pose: Pose,
        option: u8,
    },
    /// TakeArm, Motor, slvChangeMode and a pose; each may fail.
    Slave {
        peer: u8,
        mode: u8,
        pose: Vec<i8>,
    },
    Again(u8),
    Rac {
        kind: u8,
        index: u8,
        value: Option<Arg>,
    },
    Pass(u16),
    EmergencyStop(bool),
    Mode(u8),
    Error(i32),
    Token(u8),
    Permission(bool),
    Abandon(u8),
    Leave(u8),
}

/// An argument of a call.
#[derive(Arbitrary, Clone, Debug)]
enum Arg {
    Small(i8),
    Float(f32),
    Word(u8),
    Text(String),
    Numbers(Vec<f32>),
    Mixed(Vec<(bool, i8)>),
    Pose(Pose),
    Any(Value),
}

/// A pose as text or as values.
#[derive(Arbitrary, Clone, Debug)]
enum Pose {
    Text { letter: u8, numbers: Vec<i16> },
    Values { kind: i8, pass: i8, numbers: Vec<i16> },
    Nested(Vec<f64>, i32, i32),
}

/// Names of variables, commands, tasks and options.
const WORDS: &[&str] = &[
    "",
    "I1",
    "I*",
    "I[5]",
    "P1",
    "J2",
    "T1",
    "V3",
    "S5",
    "D7",
    "F8",
    "IO*",
    "IO24",
    "IOB500",
    "IOW496",
    "IOD480",
    "IOF500",
    "@MODE",
    "@LOCK",
    "@TIME",
    "@ERROR_CODE",
    "@ERROR_DESCRIPTION",
    "@SERVO_ON",
    "@EXTSPEED",
    "@SPEED",
    "@CURRENT_TOOL",
    "@CURRENT_WORK",
    "@CURRENT_POSITION",
    "@CURRENT_ANGLE",
    "@START",
    "@STATUS",
    "@CYCLE_TIME",
    "@VAR_I_LEN",
    "@TYPE",
    "Pro1",
    "Pro2",
    "Arm",
    "Tool3",
    "Work1",
    "ID=1",
    "NEXT",
    "SPEED=20",
    "SPEED=50,NEXT",
    "Speed=(1,2)",
    "@P",
    "1",
    "TakeArm",
    "GiveArm",
    "Motor",
    "ExtSpeed",
    "ArmGroup",
    "CurPos",
    "CurJnt",
    "CurTrn",
    "CurTool",
    "HighCurJntEx",
    "Draw",
    "Approach",
    "Depart",
    "DriveEx",
    "DriveAEx",
    "Dev",
    "DevH",
    "J2P",
    "P2J",
    "J2T",
    "T2J",
    "P2T",
    "T2P",
    "OutRange",
    "MotionComplete",
    "MotionSkip",
    "SetTool",
    "GetTool",
    "ToolChange",
    "SysState",
    "SysInfo",
    "ClearError",
    "GetCurErrorCount",
    "GetCurErrorInfo",
    "GetErrorDescription",
    "GetErrorLogCount",
    "GetErrorLog",
    "ManualReset",
    "ResetStoState",
    "StoState",
    "KillAll",
    "SuspendAll",
    "StepStopAll",
    "ContinueStartAll",
    "GetStatus",
    "slvChangeMode",
    "slvGetMode",
    "slvSendFormat",
    "slvRecvFormat",
    "slvMove",
    "Hand0",
    "Chuck",
    "UnChuck",
    "HandMoveA",
    "HandMoveR",
    "HandMoveH",
    "HandStop",
    "HandCurPos",
    "ManualResetPreparation",
    "MotionPreparation",
    "GetMotionPreparationState",
    "AutoCal",
    "@EventDisable=true",
];

/// Scenarios: faults from the start, and faults at a time.
const SCENARIOS: &[&str] = &[
    "",
    "[controller]\nmotor = true",
    "[controller]\nemergency_stop = true\nlicence = false\nformats = ['mini_io']",
    "[controller]\nerrors = ['0x84201482', '0x81500001']\ntoken = 'other'",
    "[controller]\nmode = 'manual'\n[[fault]]\nwhen = { at_ms = 50 }\nthen = { mode = 'auto' }",
    "[[fault]]\nwhen = { cycle = 5 }\nthen = { error = '0x84204043' }
     [[fault]]\nwhen = { every = 5 }\nthen = { delay_ms = 20 }
     [[fault]]\nwhen = { chance = 0.1 }\nthen = { refuse = 'E_FAIL' }",
    "[[fault]]\nwhen = { call = 12 }\nthen = { link_loss_ms = 100 }
     [[fault]]\nwhen = { at_ms = 300 }\nthen = { emergency_stop = true }
     [[fault]]\nwhen = { at_ms = 500 }\nthen = { emergency_stop = false }
     [[fault]]\nwhen = { at_ms = 600 }\nthen = { motor = true }",
];

fn word(index: u8) -> &'static str {
    WORDS[usize::from(index) % WORDS.len()]
}

impl Pose {
    fn value(&self) -> Value {
        let degrees = |numbers: &[i16]| numbers.iter().take(12).map(|n| f64::from(*n) / 64.0).collect::<Vec<_>>();
        match self {
            Self::Text { letter, numbers } => {
                let numbers: Vec<_> = degrees(numbers).iter().map(f64::to_string).collect();
                let letter = ["J", "P", "T", "@P P", "@E J", "@0 T"][usize::from(*letter) % 6];
                Value::text(&format!("{letter}({})", numbers.join(",")))
            }
            Self::Values { kind, pass, numbers } => {
                let numbers = degrees(numbers).iter().map(|n| Value::R8(n.to_bits())).collect();
                let items =
                    vec![Value::Array(5, numbers), Value::I4(i32::from(*kind % 5)), Value::I4(i32::from(*pass))];
                Value::Array(VARIANT, items)
            }
            Self::Nested(numbers, kind, pass) => {
                let numbers = numbers.iter().take(12).map(|n| Value::R8(n.to_bits())).collect();
                Value::Array(VARIANT, vec![Value::Array(5, numbers), Value::I4(*kind), Value::I4(*pass)])
            }
        }
    }
}

impl Arg {
    fn value(&self) -> Value {
        match self {
            Self::Small(n) => Value::I4(i32::from(*n)),
            Self::Float(x) => Value::R4(x.to_bits()),
            Self::Word(index) => Value::text(word(*index)),
            Self::Text(text) => Value::text(text),
            Self::Numbers(list) => {
                Value::Array(5, list.iter().take(12).map(|x| Value::R8(f64::from(*x).to_bits())).collect())
            }
            Self::Mixed(list) => {
                let item = |(int, n): &(bool, i8)| match int {
                    true => Value::I4(i32::from(*n)),
                    false => Value::R8(f64::from(*n).to_bits()),
                };
                Value::Array(VARIANT, list.iter().take(12).map(item).collect())
            }
            Self::Pose(pose) => pose.value(),
            Self::Any(value) => value.clone(),
        }
    }
}

/// Runs a controller twice through the operations that the bytes encode, and compares the answers.
///
/// # Panics
///
/// When an assertion about the controller fails.
pub fn sim(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let mut u = Unstructured::new(rest);
    let mut steps = Vec::new();
    while let (true, Ok(step)) = (!u.is_empty() && steps.len() < 200, Step::arbitrary(&mut u)) {
        steps.push(step);
    }
    let profile = [Profile::Rc8, Profile::Rc9, Profile::Cobotta][usize::from(options % 3)];
    let scenario = SCENARIOS[usize::from(options / 3) % SCENARIOS.len()];
    let scenario = Scenario::parse(scenario).expect("a scenario of the list");
    assert_eq!(run(&steps, profile, &scenario), run(&steps, profile, &scenario), "the controller is not deterministic");
}

fn run(steps: &[Step], profile: Profile, scenario: &Scenario) -> Trace {
    let mut world = World::new(profile, scenario);
    for step in steps {
        step.apply(&mut world);
        world.check();
    }
    world.finish()
}

/// Returns the client that a byte selects.
fn client(byte: u8) -> u32 {
    u32::from(byte) % CLIENTS
}

impl Step {
    fn apply(&self, world: &mut World) {
        match self {
            Self::Call { peer, function, guess, args } => any_call(world, client(*peer), *function, *guess, args),
            Self::Execute { peer, robot, command, arg } => {
                let (function, object) = match robot {
                    true => (FunctionId::ROBOT_EXECUTE, Object::Robot),
                    false => (FunctionId::CONTROLLER_EXECUTE, Object::Controller),
                };
                let handle = world.handle(client(*peer), object);
                world.request(client(*peer), function, &[&handle, &word(*command), &arg.value()]);
            }
            Self::Variable { peer, name } => {
                let controller = world.handle(client(*peer), Object::Controller);
                let function = FunctionId::CONTROLLER_GET_VARIABLE;
                world.request(client(*peer), function, &[&controller, &word(*name), &""]);
            }
            Self::Move { peer, interpolation, pose, option } => {
                world.move_arm(client(*peer), i32::from(interpolation % 4), &pose.value(), word(*option));
            }
            Self::Slave { peer, mode, pose } => {
                let mode = [0x001, 0x002, 0x101, 0x102, 0x202, 0][usize::from(mode % 6)];
                // near the arm's initial pose
                let mut at = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];
                at.iter_mut().zip(pose).for_each(|(angle, turn)| *angle += f64::from(*turn) / 512.0);
                world.slave(client(*peer), mode, at);
            }
            Self::Again(peer) => world.resume(client(*peer)),
            Self::Rac { kind, index, value } => any_rac(world, *kind, *index, value.as_ref()),
            Self::Pass(millis) => world.pass(Duration::from_millis(u64::from(*millis) / 8)),
            Self::Abandon(peer) => world.abandon(client(*peer)),
            Self::Leave(peer) => world.reconnect(client(*peer)),
            other => other.disturb(world),
        }
    }

    /// Applies an external event to the controller.
    fn disturb(&self, world: &mut World) {
        let (sim, now) = (&mut world.sim, world.now);
        match self {
            Self::EmergencyStop(pressed) => sim.emergency_stop(*pressed, now),
            Self::Mode(mode) => {
                let modes = [Mode::Auto, Mode::Auto, Mode::Manual, Mode::TeachCheck];
                sim.set_mode(modes[usize::from(mode % 4)], now);
            }
            Self::Error(code) => sim.inject_error(HResult(*code | i32::MIN), now),
            Self::Token(token) => {
                let tokens = [Token::Any, Token::Any, Token::TeachPendant, Token::Client(PeerId(1))];
                sim.set_token(tokens[usize::from(token % 4)]);
            }
            Self::Permission(write) => {
                sim.set_permission(if *write { Permission::ReadWrite } else { Permission::ReadOnly });
            }
            _ => {}
        }
    }
}

/// Sends a call with arguments of the kinds in the function table.
fn any_call(world: &mut World, peer: u32, function: u8, guess: u8, args: &[Arg; 3]) {
    let function = FunctionId(i32::from(function % 140));
    let Some(signature) = function.signature() else { return };
    let known = world.handle(peer, signature.object);
    let mut args = args.iter().cycle();
    let mut argument = |kind: &Kind| {
        let arg = args.next().map_or(Value::Empty, Arg::value);
        match (kind, arg) {
            (Kind::Handle(_), _) if guess < 200 => Value::I4(known),
            (Kind::Handle(_), _) => Value::I4(i32::from(guess - 200)),
            (Kind::Int, Value::I4(n)) => Value::I4(n),
            (Kind::Int, _) => Value::I4(i32::from(guess % 8) - 1),
            (Kind::Float, Value::R4(bits)) => Value::R4(bits),
            (Kind::Float, _) => Value::R4(f32::from(guess).to_bits()),
            (Kind::Text, Value::Bstr(units)) => Value::Bstr(units),
            (Kind::Text, _) => Value::text(word(guess)),
            (_, arg) => arg,
        }
    };
    let args: Vec<_> = signature.arguments.iter().map(&mut argument).collect();
    world.request(peer, function, &args.iter().map(|arg| arg as &dyn Encode).collect::<Vec<_>>());
}

/// Reads or writes a variable by RAC.
fn any_rac(world: &mut World, kind: u8, index: u8, value: Option<&Arg>) {
    let kinds = rac::VariableKind::ALL;
    let variable = rac::Variable::new(kinds[usize::from(kind) % kinds.len()], u32::from(index));
    let value = value.and_then(|arg| VariantBuf::<2048>::new(&arg.value()).ok());
    world.rac(&match &value {
        Some(value) => rac::Request::Put(variable, value.as_variant()),
        None => rac::Request::Get(variable),
    });
}
