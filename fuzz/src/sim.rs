//! The virtual controller: any calls of any clients, with anything happening around it.

use std::collections::BTreeMap;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::server::{Handler as _, Request};
use bcap_core::bcap::{Decoder, FunctionId, Kind, Object, Progress};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_core::{rac, variant::VariantBuf};
use bcap_sim::kinematics::RANGES;
use bcap_sim::{Config, Controller, Mode, Permission, Profile, Scenario, Token};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::value::{VARIANT, Value};

use crate::input::AnyValue;

const CLIENTS: u8 = 3;

/// One thing that happens.
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
    /// TakeArm, Motor, slvChangeMode and a pose, which may or may not be possible.
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
    Any(AnyValue),
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

/// What may be wrong from the beginning, or go wrong by the clock.
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
            Self::Any(AnyValue(value)) => value.clone(),
        }
    }
}

/// What a run has shown of itself.
type Trace = Vec<(Outcome, Vec<u8>)>;

struct Run {
    sim: Controller,
    now: Instant,
    /// The request that each client waits for.
    waiting: BTreeMap<u8, Vec<u8>>,
    /// The last handle of each kind that each client has got.
    handles: BTreeMap<(u8, &'static str), i32>,
    trace: Trace,
}

/// Runs a controller through what the bytes say, twice.
///
/// # Panics
///
/// When the controller is wrong.
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
    assert_eq!(
        run(&steps, profile, &scenario),
        run(&steps, profile, &scenario),
        "the same steps give the same answers"
    );
}

fn run(steps: &[Step], profile: Profile, scenario: &Scenario) -> Trace {
    let mut run = Run {
        sim: Controller::new(Config { max_objects: 10, motor_on_delay: Duration::ZERO, ..Config::new(profile) }),
        now: Instant::ZERO,
        waiting: BTreeMap::new(),
        handles: BTreeMap::new(),
        trace: Trace::new(),
    };
    run.sim.play(scenario.clone());
    (0..CLIENTS).for_each(|peer| run.open(peer));
    for step in steps {
        run.apply(step);
        run.check();
    }
    (0..CLIENTS).for_each(|peer| run.leave(peer));
    run.now = run.now + Duration::from_secs(5);
    run.sim.advance(run.now);
    assert!(!run.sim.is_moving() && run.sim.slave_mode() == 0);
    let limits = run.sim.slave_limits();
    let cycles: Vec<_> = run.sim.slave_record().collect();
    for pair in cycles.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
        for (axis, limit) in limits.speed.iter().enumerate() {
            let way = pair[1].axes[axis] - pair[0].axes[axis];
            assert!(way.abs() <= limit * 0.008 * 1.000_01, "axis {axis} is too fast: {pair:?}");
        }
    }
    assert_eq!((run.sim.open_objects(), run.sim.arm_owner()), (0, None));
    run.trace
}

impl Run {
    /// Gives a client a session, a controller, a robot, a task and a variable.
    fn open(&mut self, peer: u8) {
        let provider = Value::text(self.sim.config().profile.provider());
        let text = Value::text;
        self.request(peer, FunctionId::SERVICE_START, vec![text("")]);
        self.request(peer, FunctionId::CONTROLLER_CONNECT, vec![text(""), provider, text(""), text("")]);
        let controller = Value::I4(self.handle(peer, Object::Controller));
        for (function, name) in [
            (FunctionId::CONTROLLER_GET_ROBOT, "Arm"),
            (FunctionId::CONTROLLER_GET_TASK, "Pro1"),
            (FunctionId::CONTROLLER_GET_VARIABLE, "P1"),
            (FunctionId::CONTROLLER_GET_EXTENSION, "Hand0"),
            (FunctionId::CONTROLLER_GET_COMMAND, "Motor"),
        ] {
            self.request(peer, function, vec![controller.clone(), text(name), text("")]);
        }
    }

    fn handle(&self, peer: u8, object: Object) -> i32 {
        self.handles.get(&(peer, object.name())).copied().unwrap_or(0)
    }

    /// Makes a call, unless the client waits for another or the server would not let it pass.
    fn request(&mut self, peer: u8, function: FunctionId, args: Vec<Value>) {
        if self.waiting.contains_key(&peer) {
            return;
        }
        let wire = TestFrame { serial: 1, reserved: 0, code: function.0, args }.to_wire(false);
        self.call(peer, &wire, false);
    }

    fn call(&mut self, peer: u8, wire: &[u8], resumed: bool) {
        let decoder = Decoder { limits: Limits { depth: MAX_DEPTH, ..Limits::STREAM }, ..Decoder::TCP };
        let Ok(Progress::Complete(frame, _)) = decoder.decode(wire) else { panic!("{:?}", decoder.decode(wire)) };
        let function = frame.function();
        let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
        if kinds.len() != frame.args.len() || !frame.args.iter().zip(kinds).all(|(value, kind)| kind.accepts(&value)) {
            return;
        }
        let request = Request { function, args: frame.args, resumed };
        let mut buffer = vec![0; 8192];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = self.sim.call(PeerId(u32::from(peer)), &request, &mut reply, self.now);
        if let Some(value) = reply.get() {
            let bytes = reply.as_bytes();
            assert_eq!(Variant::decode(bytes, &decoder.limits, Strictness::Strict), Ok(value));
        }
        match outcome {
            Outcome::Wait(at) => {
                assert!(at > self.now, "{function:?} asks to come again at {at}, at {}", self.now);
                self.waiting.insert(peer, wire.to_vec());
            }
            Outcome::Done(code) => {
                if let (HResult::S_OK, Some(object), Some(value)) = (code, function.opens(), reply.get()) {
                    let Variant::I4(handle @ 2..) = value else { panic!("{value:?} is no handle") };
                    self.handles.insert((peer, object.name()), handle);
                }
            }
        }
        self.trace.push((outcome, reply.as_bytes().to_vec()));
    }

    fn apply(&mut self, step: &Step) {
        match step {
            Step::Call { peer, function, guess, args } => self.any_call(peer % CLIENTS, *function, *guess, args),
            Step::Execute { peer, robot, command, arg } => {
                let (peer, command) = (peer % CLIENTS, Value::text(word(*command)));
                let (function, object) = match robot {
                    true => (FunctionId::ROBOT_EXECUTE, Object::Robot),
                    false => (FunctionId::CONTROLLER_EXECUTE, Object::Controller),
                };
                self.request(peer, function, vec![Value::I4(self.handle(peer, object)), command, arg.value()]);
            }
            Step::Variable { peer, name } => {
                let controller = Value::I4(self.handle(peer % CLIENTS, Object::Controller));
                let args = vec![controller, Value::text(word(*name)), Value::text("")];
                self.request(peer % CLIENTS, FunctionId::CONTROLLER_GET_VARIABLE, args);
            }
            Step::Move { peer, interpolation, pose, option } => {
                let peer = peer % CLIENTS;
                let robot = Value::I4(self.handle(peer, Object::Robot));
                self.take_arm(peer, &robot);
                let how = Value::I4(i32::from(interpolation % 4));
                self.request(peer, FunctionId::ROBOT_MOVE, vec![robot, how, pose.value(), Value::text(word(*option))]);
            }
            Step::Slave { peer, mode, pose } => {
                let peer = peer % CLIENTS;
                let robot = Value::I4(self.handle(peer, Object::Robot));
                self.take_arm(peer, &robot);
                let mode = [0x001, 0x002, 0x101, 0x102, 0x202, 0][usize::from(mode % 6)];
                // near to where the arm stands at first
                let home = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];
                let turns = pose.iter().map(|n| f64::from(*n) / 512.0).chain(std::iter::repeat(0.0));
                let pose = home.iter().zip(turns).map(|(at, turn)| Value::R8((at + turn).to_bits())).collect();
                for (command, arg) in [("slvChangeMode", Value::I4(mode)), ("slvMove", Value::Array(5, pose))] {
                    self.request(peer, FunctionId::ROBOT_EXECUTE, vec![robot.clone(), Value::text(command), arg]);
                }
            }
            Step::Again(peer) => {
                if let Some(wire) = self.waiting.remove(&(peer % CLIENTS)) {
                    self.call(peer % CLIENTS, &wire, true);
                }
            }
            Step::Rac { kind, index, value } => self.rac(*kind, *index, value.as_ref()),
            Step::Pass(millis) => {
                self.now = self.now + Duration::from_millis(u64::from(*millis) / 8);
                self.sim.advance(self.now);
            }
            other => self.disturb(other),
        }
    }

    /// Takes the arm and switches its motor on, if that is possible.
    fn take_arm(&mut self, peer: u8, robot: &Value) {
        for command in ["ManualResetPreparation", "MotionPreparation"] {
            if self.sim.config().profile == Profile::Cobotta {
                self.request(peer, FunctionId::ROBOT_EXECUTE, vec![robot.clone(), Value::text(command), Value::Empty]);
            }
        }
        let pair = |a, b| Value::Array(3, vec![Value::I4(a), Value::I4(b)]);
        for (command, arg) in [("TakeArm", pair(0, 1)), ("Motor", pair(1, 1))] {
            self.request(peer, FunctionId::ROBOT_EXECUTE, vec![robot.clone(), Value::text(command), arg]);
        }
    }

    /// What is done to the controller from outside.
    fn disturb(&mut self, step: &Step) {
        match step {
            Step::EmergencyStop(pressed) => self.sim.emergency_stop(*pressed, self.now),
            Step::Mode(mode) => {
                let modes = [Mode::Auto, Mode::Auto, Mode::Manual, Mode::TeachCheck];
                self.sim.set_mode(modes[usize::from(mode % 4)], self.now);
            }
            Step::Error(code) => self.sim.inject_error(HResult(*code | i32::MIN), self.now),
            Step::Token(token) => {
                let tokens = [Token::Any, Token::Any, Token::TeachPendant, Token::Client(PeerId(1))];
                self.sim.set_token(tokens[usize::from(token % 4)]);
            }
            Step::Permission(write) => {
                self.sim.set_permission(if *write { Permission::ReadWrite } else { Permission::ReadOnly });
            }
            Step::Abandon(peer) => {
                let peer = peer % CLIENTS;
                let Some(_) = self.waiting.remove(&peer) else { return };
                self.sim.abandoned(PeerId(u32::from(peer)), self.now);
            }
            Step::Leave(peer) => {
                self.leave(peer % CLIENTS);
                self.open(peer % CLIENTS);
            }
            _ => {}
        }
    }

    /// Makes a call with arguments of the kinds that the table wants.
    fn any_call(&mut self, peer: u8, function: u8, guess: u8, args: &[Arg; 3]) {
        let function = FunctionId(i32::from(function % 140));
        let Some(signature) = function.signature() else { return };
        let known = self.handle(peer, signature.object);
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
        let args = signature.arguments.iter().map(&mut argument).collect();
        self.request(peer, function, args);
    }

    /// Reads or writes a variable by RAC.
    fn rac(&mut self, kind: u8, index: u8, value: Option<&Arg>) {
        let kinds = rac::VariableKind::ALL;
        let variable = rac::Variable::new(kinds[usize::from(kind) % kinds.len()], u32::from(index));
        let value = value.and_then(|arg| VariantBuf::<2048>::new(&arg.value()).ok());
        let request = match &value {
            Some(value) => rac::Request::Put(variable, value.as_variant()),
            None => rac::Request::Get(variable),
        };
        let mut buffer = vec![0; 8192];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = rac::server::Handler::call(&mut self.sim, PeerId(9), &request, &mut reply, self.now);
        self.trace.push((outcome, reply.as_bytes().to_vec()));
    }

    fn leave(&mut self, peer: u8) {
        let id = PeerId(u32::from(peer));
        if self.waiting.remove(&peer).is_some() {
            self.sim.abandoned(id, self.now);
        }
        self.sim.left(id, self.now);
        self.handles.retain(|(owner, _), _| *owner != peer);
        assert_ne!(self.sim.arm_owner(), Some(id));
    }

    fn check(&self) {
        for (angle, (low, high)) in self.sim.joints().iter().zip(RANGES) {
            assert!((low - 1e-3..=high + 1e-3).contains(angle), "{:?}", self.sim.joints());
        }
        assert!(self.sim.motor_is_on() || (!self.sim.is_moving() && self.sim.slave_mode() == 0));
        assert!(self.sim.slave_mode() == 0 || (self.sim.arm_owner().is_some() && self.sim.errors().count() == 0));
        assert!(!self.sim.emergency_stopped() || (!self.sim.motor_is_on() && self.sim.errors().count() > 0));
        let (least, most) = (0.0, bcap_sim::hand::STROKE);
        assert!((least..=most).contains(&self.sim.hand_position()), "{}", self.sim.hand_position());
        assert!(self.sim.open_objects() <= 10 * usize::from(CLIENTS));
    }
}
