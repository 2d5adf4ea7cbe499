//! Property tests of the virtual controller with arbitrary calls: it does not panic, it is deterministic, and the invariants
//! of [`World`] hold.

use std::time::Duration;

use bcap_core::bcap::{FunctionId, Kind};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::Encode;
use bcap_fuzz::world::{CLIENTS, Trace, World};
use bcap_sim::{Mode, Permission, Profile, Scenario, Token};
use proptest::prelude::*;

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
    // most interesting calls concern robots and variables
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

/// Sends a call with arguments that pass the checks of the server; `guess` stands for handles that this client does not have.
fn any_call(world: &mut World, step: &Step) {
    let Step::Call { peer, function, handle: guess, ints, float, name, arg } = step else { return };
    let function = FunctionId(*function);
    let Some(signature) = function.signature() else { return };
    let known = world.handle(*peer, signature.object);
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
    world.request(*peer, function, &arguments);
}

impl Step {
    fn apply(&self, world: &mut World) {
        let now = world.now;
        match self {
            Self::Call { .. } => any_call(world, self),
            Self::Move { peer, interpolation, pose, option } => world.move_arm(*peer, *interpolation, pose, option),
            Self::Slave { peer, mode, pose } => world.slave(*peer, *mode, *pose),
            Self::Again { peer } => world.resume(*peer),
            Self::Pass(millis) => world.pass(Duration::from_millis(*millis)),
            Self::EmergencyStop(pressed) => world.sim.emergency_stop(*pressed, now),
            Self::Mode(mode) => world.sim.set_mode(*mode, now),
            Self::Error(code) => world.sim.inject_error(HResult::from_u32(*code), now),
            Self::Token(token) => world.sim.set_token(*token),
            Self::Permission(permission) => world.sim.set_permission(*permission),
            Self::Abandon(peer) => world.abandon(*peer),
            Self::Leave(peer) => world.reconnect(*peer),
        }
    }
}

fn run(steps: &[Step], profile: Profile) -> Trace {
    let mut world = World::new(profile, &Scenario::default());
    for step in steps {
        step.apply(&mut world);
        world.check();
    }
    world.finish()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_calls_keep_the_controller_sound(steps in proptest::collection::vec(step(), 0..120), model in 0..3_usize) {
        let profile = [Profile::Rc8, Profile::Rc9, Profile::Cobotta][model];
        prop_assert_eq!(run(&steps, profile), run(&steps, profile));
    }
}
