//! Whatever is called in whatever order: nothing panics, the same calls give the same answers, the arm stays in its
//! ranges, moves only with its motor on, and a client that goes leaves nothing behind.

use std::collections::BTreeMap;
use std::time::Duration;

use bcap_core::bcap::server::{Handler as _, Request};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Kind, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};
use bcap_sim::kinematics::RANGES;
use bcap_sim::{Config, Controller, Mode, Permission, Profile, Token};
use proptest::prelude::*;

const CLIENTS: u32 = 3;

/// An argument that fits any kind.
#[derive(Clone, Debug)]
enum Arg {
    Int(i32),
    Float(f64),
    Text(&'static str),
    Floats(Vec<f64>),
    Pair(i32, i32),
    Pose(&'static str),
    Nothing,
}

impl Encode for Arg {
    fn encode(&self, out: &mut bcap_core::variant::Writer<'_>) -> Result<(), bcap_core::error::EncodeError> {
        match self {
            Self::Int(n) => n.encode(out),
            Self::Float(x) => x.encode(out),
            Self::Text(text) | Self::Pose(text) => text.encode(out),
            Self::Floats(list) => list.as_slice().encode(out),
            Self::Pair(a, b) => [*a, *b].encode(out),
            Self::Nothing => ().encode(out),
        }
    }
}

/// One thing that happens.
#[derive(Clone, Debug)]
enum Step {
    Call {
        peer: u32,
        function: i32,
        handle: i32,
        ints: (i32, i32),
        float: f32,
        name: &'static str,
        arg: Arg,
    },
    /// TakeArm, Motor and a motion, which may or may not be possible.
    Move {
        peer: u32,
        interpolation: i32,
        pose: &'static str,
        option: &'static str,
    },
    /// TakeArm, Motor, slvChangeMode and a pose, which may or may not be possible.
    Slave {
        peer: u32,
        mode: i32,
        pose: [f64; 8],
    },
    Again {
        peer: u32,
    },
    Pass(u64),
    EmergencyStop(bool),
    Mode(Mode),
    Error(u32),
    Token(Token),
    Permission(Permission),
    Abandon(u32),
    Leave(u32),
}

/// Names of variables, commands, tasks and options; a call takes any of them for any text.
const NAMES: &[&str] = &[
    "",
    "I1",
    "I*",
    "P1",
    "IOF500",
    "S5",
    "@MODE",
    "@LOCK",
    "@ERROR_CODE",
    "@SERVO_ON",
    "@EXTSPEED",
    "@CURRENT_TOOL",
    "@CURRENT_POSITION",
    "@START",
    "@STATUS",
    "Pro1",
    "Pro2",
    "Arm",
    "Tool3",
    "TakeArm",
    "TakeArm",
    "GiveArm",
    "Motor",
    "Motor",
    "ExtSpeed",
    "CurPos",
    "J2P",
    "P2J",
    "SysState",
    "ClearError",
    "ClearError",
    "GetCurErrorInfo",
    "GetErrorDescription",
    "GetErrorLog",
    "ManualReset",
    "GetStatus",
    "slvMove",
    "slvMove",
    "slvGetMode",
    "slvChangeMode",
    "slvSendFormat",
    "slvRecvFormat",
    "NEXT",
    "SPEED=20",
    "SPEED=50,NEXT",
    "Hand0",
    "Chuck",
    "UnChuck",
    "HandMoveA",
    "HandStop",
    "ManualResetPreparation",
    "MotionPreparation",
];

const POSES: &[&str] = &[
    "J(0,45,90,0,45,0)",
    "J(90,10,100,20,-30,200)",
    "J(-170,0,0,-270,0,-360)",
    "P(300,100,300,180,0,180,5)",
    "P(0,0,0,0,0,0,-1)",
    "P(350,-50,300,170,10,180)",
    "J1",
    "P1",
    "T1",
    "J(1e300,0,0,0,0,0)",
    "P(1e300,0,0,1e300,0,0,0)",
];

fn arg() -> impl Strategy<Value = Arg> {
    prop_oneof![
        (-3..130_i32).prop_map(Arg::Int),
        any::<f64>().prop_map(Arg::Float),
        proptest::sample::select(NAMES).prop_map(Arg::Text),
        proptest::collection::vec(-200.0..400.0_f64, 0..11).prop_map(Arg::Floats),
        (0..2_i32, 0..2_i32).prop_map(|(a, b)| Arg::Pair(a, b)),
        proptest::sample::select(POSES).prop_map(Arg::Pose),
        Just(Arg::Nothing),
    ]
}

fn call() -> impl Strategy<Value = Step> {
    // most of what is interesting is about robots and variables
    let function = prop_oneof![
        3 => 1..138_i32,
        2 => Just(FunctionId::ROBOT_EXECUTE.0),
        2 => Just(FunctionId::ROBOT_MOVE.0),
        1 => Just(FunctionId::CONTROLLER_GET_VARIABLE.0),
        1 => Just(FunctionId::VARIABLE_PUT_VALUE.0),
    ];
    let float = prop_oneof![-1.0..120.0_f32, 0.0..0.001_f32, any::<f32>()];
    let name = proptest::sample::select(NAMES);
    (0..CLIENTS, function, 2..20_i32, (-1..5_i32, -1..5_i32), float, name, arg()).prop_map(
        |(peer, function, handle, ints, float, name, arg)| Step::Call {
            peer,
            function,
            handle,
            ints,
            float,
            name,
            arg,
        },
    )
}

fn motion() -> impl Strategy<Value = Step> {
    let (pose, option) = (proptest::sample::select(POSES), proptest::sample::select(&["", "NEXT", "SPEED=5"][..]));
    (0..CLIENTS, 1..3_i32, pose, option).prop_map(|(peer, interpolation, pose, option)| Step::Move {
        peer,
        interpolation,
        pose,
        option,
    })
}

fn slave() -> impl Strategy<Value = Step> {
    let mode = proptest::sample::select(&[0x001, 0x002, 0x102, 0x202, 0x202, 0][..]);
    let turn = prop_oneof![4 => -0.2..0.2_f64, 1 => -200.0..200.0_f64];
    (0..CLIENTS, mode, turn.clone(), turn).prop_map(|(peer, mode, a, b)| {
        let pose = [a, 45.0 + b, 90.0, 0.0, 45.0 + a, b, 0.0, 0.0];
        Step::Slave { peer, mode, pose }
    })
}

fn step() -> impl Strategy<Value = Step> {
    let mode = proptest::sample::select(&[Mode::Auto, Mode::Auto, Mode::Manual][..]);
    let error = proptest::sample::select(&[0x8150_0001, 0x8320_0001, 0x8420_1482, 0x8000_4005][..]);
    let token = proptest::sample::select(&[Token::Any, Token::Any, Token::TeachPendant, Token::Client(PeerId(1))][..]);
    let permission = proptest::sample::select(&[Permission::ReadWrite, Permission::ReadOnly][..]);
    prop_oneof![
        40 => call(),
        10 => motion(),
        15 => slave(),
        10 => (0..CLIENTS).prop_map(|peer| Step::Again { peer }),
        10 => (0..2000_u64).prop_map(Step::Pass),
        10 => (0..30_u64).prop_map(Step::Pass),
        1 => any::<bool>().prop_map(Step::EmergencyStop),
        1 => mode.prop_map(Step::Mode),
        1 => error.prop_map(Step::Error),
        1 => token.prop_map(Step::Token),
        1 => permission.prop_map(Step::Permission),
        1 => (0..CLIENTS).prop_map(Step::Abandon),
        1 => (0..CLIENTS).prop_map(Step::Leave),
    ]
}

/// Encodes a request.
fn frame(function: FunctionId, arguments: &[&dyn Encode]) -> Option<Vec<u8>> {
    let mut buffer = vec![0; 2048];
    let mut frame = FrameWriter::new(&mut buffer).ok()?;
    arguments.iter().try_for_each(|argument| frame.argument(*argument)).ok()?;
    Some(frame.finish(1, 0, function.0).ok()?.to_vec())
}

/// What a run has shown of itself.
type Trace = Vec<(Outcome, Vec<u8>)>;

struct Run {
    sim: Controller,
    now: Instant,
    /// The request that each client waits for.
    waiting: [Option<Vec<u8>>; CLIENTS as usize],
    /// The last handle of each kind that each client has got.
    handles: BTreeMap<(u32, &'static str), i32>,
    trace: Trace,
}

impl Run {
    fn new(profile: Profile) -> Self {
        let mut run = Self {
            sim: Controller::new(Config { max_objects: 10, motor_on_delay: Duration::ZERO, ..Config::new(profile) }),
            now: Instant::ZERO,
            waiting: [const { None }; CLIENTS as usize],
            handles: BTreeMap::new(),
            trace: Trace::new(),
        };
        for peer in 0..CLIENTS {
            run.open(peer);
        }
        run
    }

    /// Gives a client a session, a controller, a robot, a task and a variable.
    fn open(&mut self, peer: u32) {
        let provider = self.sim.config().profile.provider();
        self.request(peer, FunctionId::SERVICE_START, &[&""]);
        self.request(peer, FunctionId::CONTROLLER_CONNECT, &[&"", &provider, &"", &""]);
        let controller = self.handle(peer, Object::Controller);
        self.request(peer, FunctionId::CONTROLLER_GET_ROBOT, &[&controller, &"Arm", &""]);
        self.request(peer, FunctionId::CONTROLLER_GET_TASK, &[&controller, &"Pro1", &""]);
        self.request(peer, FunctionId::CONTROLLER_GET_VARIABLE, &[&controller, &"P1", &""]);
        self.request(peer, FunctionId::CONTROLLER_GET_EXTENSION, &[&controller, &"Hand0", &""]);
        self.request(peer, FunctionId::CONTROLLER_GET_COMMAND, &[&controller, &"Motor", &""]);
    }

    fn handle(&self, peer: u32, object: Object) -> i32 {
        self.handles.get(&(peer, object.name())).copied().unwrap_or(0)
    }

    /// Makes a call, unless the client waits for another.
    fn request(&mut self, peer: u32, function: FunctionId, arguments: &[&dyn Encode]) {
        if let (None, Some(bytes)) = (&self.waiting[peer as usize], frame(function, arguments)) {
            self.call(peer, &bytes, false);
        }
    }

    /// Makes a call with arguments that the server would let pass; `guess` stands for handles that this client has not.
    fn any_call(&mut self, step: &Step) {
        let Step::Call { peer, function, handle: guess, ints, float, name, arg } = step else { return };
        let function = FunctionId(*function);
        let Some(signature) = function.signature() else { return };
        let known = self.handle(*peer, signature.object);
        let handle = if known == 0 || guess % 5 == 0 { guess } else { &known };
        let mut ints = [&ints.0, &ints.1].into_iter().cycle();
        let argument = |kind: &Kind| -> &dyn Encode {
            match kind {
                Kind::Handle(_) => handle,
                Kind::Int => ints.next().unwrap_or(&0),
                Kind::Float => float,
                Kind::Text => name,
                _ => arg,
            }
        };
        let arguments: Vec<_> = signature.arguments.iter().map(argument).collect();
        self.request(*peer, function, &arguments);
    }

    fn call(&mut self, peer: u32, bytes: &[u8], resumed: bool) {
        let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
        let request = Request { function: frame.function(), args: frame.args, resumed };
        let mut buffer = [0; 8192];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = self.sim.call(PeerId(peer), &request, &mut reply, self.now);
        let waits = match outcome {
            Outcome::Wait(at) => {
                assert!(at > self.now, "{:?} asks to come again at {at}, at {}", frame.function(), self.now);
                true
            }
            Outcome::Done(code) => {
                if let (HResult::S_OK, Some(object), Some(value)) = (code, frame.function().opens(), reply.get()) {
                    let Variant::I4(handle @ 2..) = value else { panic!("{value:?} is no handle") };
                    self.handles.insert((peer, object.name()), handle);
                }
                false
            }
        };
        self.trace.push((outcome, reply.as_bytes().to_vec()));
        self.waiting[peer as usize] = waits.then(|| bytes.to_vec());
    }

    fn apply(&mut self, step: &Step) {
        match step {
            Step::Call { .. } => self.any_call(step),
            Step::Move { peer, interpolation, pose, option } => {
                let robot = self.handle(*peer, Object::Robot);
                self.take_arm(*peer, robot);
                self.request(*peer, FunctionId::ROBOT_MOVE, &[&robot, interpolation, pose, option]);
            }
            Step::Slave { peer, mode, pose } => {
                let robot = self.handle(*peer, Object::Robot);
                self.take_arm(*peer, robot);
                self.request(*peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"slvChangeMode", mode]);
                self.request(*peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"slvMove", pose]);
            }
            Step::Again { peer } => {
                if let Some(bytes) = self.waiting[*peer as usize].take() {
                    self.call(*peer, &bytes, true);
                }
            }
            Step::Pass(millis) => {
                self.now = Instant::from_micros(self.now.as_micros() + millis * 1000);
                self.sim.advance(self.now);
            }
            Step::EmergencyStop(pressed) => self.sim.emergency_stop(*pressed, self.now),
            Step::Mode(mode) => self.sim.set_mode(*mode, self.now),
            Step::Error(code) => self.sim.inject_error(HResult::from_u32(*code), self.now),
            Step::Token(token) => self.sim.set_token(*token),
            Step::Permission(permission) => self.sim.set_permission(*permission),
            Step::Abandon(peer) => {
                if self.waiting[*peer as usize].take().is_some() {
                    self.sim.abandoned(PeerId(*peer), self.now);
                }
            }
            Step::Leave(peer) => {
                self.leave(*peer);
                self.open(*peer);
            }
        }
        self.check();
    }

    /// Takes the arm and switches its motor on, if that is possible.
    fn take_arm(&mut self, peer: u32, robot: i32) {
        let commands: [(&str, &dyn Encode); 4] =
            [("ManualResetPreparation", &()), ("MotionPreparation", &()), ("TakeArm", &[0, 1]), ("Motor", &[1, 1])];
        for (command, param) in commands {
            self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &command, &param]);
        }
    }

    fn leave(&mut self, peer: u32) {
        if self.waiting[peer as usize].take().is_some() {
            self.sim.abandoned(PeerId(peer), self.now);
        }
        self.sim.left(PeerId(peer), self.now);
        assert_ne!(self.sim.arm_owner(), Some(PeerId(peer)));
    }

    fn check(&self) {
        for (angle, (low, high)) in self.sim.joints().iter().zip(RANGES) {
            assert!((low - 1e-3..=high + 1e-3).contains(angle), "{:?}", self.sim.joints());
        }
        assert!(self.sim.motor_is_on() || (!self.sim.is_moving() && self.sim.slave_mode() == 0));
        assert!((0.0..=bcap_sim::hand::STROKE).contains(&self.sim.hand_position()), "{}", self.sim.hand_position());
        assert!(self.sim.slave_mode() == 0 || (self.sim.arm_owner().is_some() && self.sim.errors().count() == 0));
        assert!(!self.sim.emergency_stopped() || (!self.sim.motor_is_on() && self.sim.errors().count() > 0));
    }
}

fn run(steps: &[Step], profile: Profile) -> Trace {
    let mut run = Run::new(profile);
    steps.iter().for_each(|step| run.apply(step));
    for peer in 0..CLIENTS {
        run.leave(peer);
    }
    run.now = run.now + Duration::from_secs(60);
    run.sim.advance(run.now);
    assert!(!run.sim.is_moving() && run.sim.slave_mode() == 0);
    let limits = run.sim.slave_limits();
    let cycles: Vec<_> = run.sim.slave_record().collect();
    for pair in cycles.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
        for (axis, limit) in limits.speed.iter().enumerate() {
            let way = pair[1].axes[axis] - pair[0].axes[axis];
            assert!(way.abs() <= limit * 0.008 * 1.000_01, "{pair:?}");
        }
    }
    assert_eq!((run.sim.open_objects(), run.sim.arm_owner()), (0, None));
    run.trace
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_calls_keep_the_controller_sound(steps in proptest::collection::vec(step(), 0..120), model in 0..3_usize) {
        let profile = [Profile::Rc8, Profile::Rc9, Profile::Cobotta][model];
        prop_assert_eq!(run(&steps, profile), run(&steps, profile));
    }
}
