//! Every row of the specification's underflow table and every code of Slave Mode: the controller produces it, and the
//! engine reports it by name, the first cause first.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::slave::{
    AxisLimits, Cause, Config as Stream, Engine, EngineAction, Extended, ExtendedAxes, Format, Handles, Mode, Pose,
    PoseError, PoseType, Released, SendFormat, Step,
};
use bcap_core::variant::Encode;
use bcap_sim::codes::MANUAL_MODE;
use bcap_sim::kinematics::EXTENDED_SPEED;
use bcap_sim::kinematics::SPEEDS;
use bcap_sim::{Config, Profile, Scenario};

use crate::common::{Client, World};
use crate::engine::wire::{LINKS, Link};
use crate::engine::{MODES, Rig, format, from_start};

/// How a stream that paused has ended.
#[derive(Debug, PartialEq)]
struct Paused {
    end: EngineAction,
    code: Option<HResult>,
    /// The refusal of slvMove, which hides the cause.
    refused: Option<HResult>,
    /// Whether slave mode was on until the engine left it.
    kept: bool,
    underflows: (u32, u64),
}

/// Streams, moving or at rest, and skips poses for 80 ms in the middle.
fn pause(link: Link, mode: Mode, running: bool) -> Paused {
    let mut rig = Rig::new(link, format(mode, PoseType::J));
    let (mut count, mut kept) = (0, false);
    let end = rig.run(|rig| {
        count += 1;
        if count == 50 {
            assert_eq!(rig.world.sim.is_moving(), running);
            rig.world.pass(80);
            kept = rig.world.sim.slave_mode() != 0;
        }
        (count <= 100).then(|| from_start(rig, 0, if running { f64::from(count) * 0.01 } else { 0.0 }))
    });
    let refused = rig.engine.fault().and_then(|fault| match fault.cause {
        Cause::Refused(code) => Some(code),
        _ => None,
    });
    let underflows = (rig.engine.stats().underflows, rig.world.sim.slave_counters().underflows);
    Paused { end, code: rig.engine.fault().and_then(|fault| fault.code()), refused, kept, underflows }
}

#[test]
fn each_row_of_the_underflow_table() {
    let goes_on = || Paused { end: EngineAction::Finished, code: None, refused: None, kept: true, underflows: (0, 0) };
    let released = || Paused {
        end: EngineAction::Faulted,
        code: Some(HResult::E_COMMAND_BUFFER_EMPTY),
        refused: Some(HResult::E_SLVMODE_OFF),
        kept: false,
        underflows: (1, 1),
    };
    let table = [
        (Mode::Mode0, true, released()),
        (Mode::Mode0, false, goes_on()),
        (Mode::Mode1, true, goes_on()),
        (Mode::Mode1, false, goes_on()),
        (Mode::Mode2, true, released()),
        (Mode::Mode2, false, goes_on()),
    ];
    for (mode, running, expected) in table {
        for link in LINKS {
            let state = if running { "running" } else { "stopped" };
            assert_eq!(pause(link, mode, running), expected, "{mode:?}, {state}, {link:?}");
        }
    }
}

#[test]
fn holding_in_mode_1_out_of_fast_motion_is_too_hard_a_stop() {
    let mut rig = Rig::new(Link::Tcp, format(Mode::Mode1, PoseType::J));
    let (mut count, mut at) = (0, 0.0);
    let end = rig.run(|rig| {
        count += 1;
        at += 0.02 * f64::from(count);
        if count == 50 {
            rig.world.pass(80);
        }
        Some(from_start(rig, 0, at))
    });
    let fault = rig.engine.fault().unwrap();
    assert_eq!((end, fault.code()), (EngineAction::Faulted, Some(HResult::from_u32(0x8420_4041))));
    assert_eq!(fault.cause, Cause::Refused(HResult::E_SLVMODE_OFF));
}

/// The step of one axis in one cycle that trips its limit of speed, or only its limit of acceleration.
fn jump(axis: usize, of_speed: bool) -> f64 {
    let top = SPEEDS.get(axis - 1).copied().unwrap_or(EXTENDED_SPEED);
    top * if of_speed { 0.02 } else { 0.005 }
}

#[test]
fn each_limit_of_each_axis_is_named_with_its_axis() {
    for (base, of_speed) in [(0x8420_4050, true), (0x8420_4040, false)] {
        for (axis, mode) in (1..=8).flat_map(|axis| MODES.map(|mode| (axis, mode))) {
            let format = Format { extended: ExtendedAxes::Both, ..format(mode, PoseType::J) };
            let mut rig = Rig::new(Link::Tcp, format);
            let end = rig.run(|rig| Some(with_axis(rig, axis, jump(axis, of_speed))));
            let fault = rig.engine.fault().unwrap();
            let expected = HResult::from_u32(base + u32::try_from(axis).unwrap());
            assert_eq!(
                (end, fault.code(), fault.step),
                (EngineAction::Faulted, Some(expected), Step::Move),
                "{mode:?}"
            );
            assert_eq!((fault.released, fault.emergency_stop), (Released::Yes, Some(false)));
            assert_eq!(expected.axis().map(usize::from), Some(axis));
            let text = fault.to_string();
            let named = format!("the controller's first error is {expected} J{axis}: {}", expected.meaning().unwrap());
            assert!(text.ends_with(&named), "{text}");
        }
    }
}

/// Says where the stream began, with something added to one axis.
fn with_axis(rig: &Rig, axis: usize, by: f64) -> Pose {
    let mut numbers: [f64; 8] = rig.engine.start_pose().unwrap().numbers().try_into().unwrap();
    numbers[axis - 1] += by;
    Pose::j(numbers).with_extended(Extended::Both(numbers[6], numbers[7]))
}

#[test]
fn the_engine_refuses_what_would_trip_the_controller_with_axis_and_figures() {
    for of_speed in [true, false] {
        for axis in 1..=6 {
            // the controller's own limits, as a caller would enter them
            let mut rig = Rig::with(Link::Tcp, format(Mode::Mode0, PoseType::J), Config::default(), |_| {});
            let limits = rig.world.sim.slave_limits();
            let config = Stream {
                limits: AxisLimits { speed: limits.speed, acceleration: limits.acceleration },
                ..*rig.engine.config()
            };
            rig.engine = Engine::new(config).unwrap();
            let mut refused = None;
            let end = rig.run(|rig| {
                let mut numbers: [f64; 8] = rig.engine.start_pose().unwrap().numbers().try_into().unwrap();
                numbers[axis - 1] += jump(axis, of_speed);
                refused = rig.engine.push(&Pose::j(numbers)).err();
                None
            });
            assert_eq!(
                (end, rig.errors(), rig.sent(Step::Move)),
                (EngineAction::Finished, vec![], 0),
                "nothing was sent"
            );
            let (named, value, limit) = match refused.unwrap() {
                PoseError::Speed { axis, speed, limit } if of_speed => (axis, speed, limit),
                PoseError::Acceleration { axis, acceleration, limit } if !of_speed => (axis, acceleration, limit),
                other => panic!("{other}"),
            };
            let expected = if of_speed { limits.speed } else { limits.acceleration };
            assert_eq!((usize::from(named), limit), (axis, expected[axis - 1]));
            assert!(value > limit);
        }
    }
}

/// A way to make the controller answer a code.
struct Row {
    code: HResult,
    name: Option<&'static str>,
    /// Makes the call that is answered with it.
    cause: fn(&mut World, Client) -> HResult,
}

fn slv_move(world: &mut World, client: Client, j1: f64) -> HResult {
    let pose = [j1, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];
    world.call(client.peer, call::robot_execute(client.robot, "slvMove", pose)).0
}

fn robot(world: &mut World, client: Client, command: &str, param: impl Encode) -> HResult {
    world.robot(client, command, param).0
}

#[test]
fn each_code_of_slave_mode_is_answered_under_its_name() {
    let table = [
        Row {
            code: HResult::S_BUF_FULL,
            name: Some("S_BUF_FULL"),
            cause: |world, client| {
                robot(world, client, "slvChangeMode", 0x002);
                (0..3).map(|_| slv_move(world, client, 0.0)).last().unwrap()
            },
        },
        Row {
            code: HResult::E_BUF_FULL,
            name: Some("E_BUF_FULL"),
            cause: |world, client| {
                robot(world, client, "slvChangeMode", 0x002);
                (0..4).map(|_| slv_move(world, client, 0.0)).last().unwrap()
            },
        },
        Row {
            code: HResult::E_SLVMODE_OFF,
            name: Some("E_SLVMODE_OFF"),
            cause: |world, client| slv_move(world, client, 0.0),
        },
        Row {
            code: HResult::E_SLVMODE_ON,
            name: Some("E_SLVMODE_ON"),
            cause: |world, client| {
                robot(world, client, "slvChangeMode", 0x002);
                robot(world, client, "TakeArm", ())
            },
        },
        Row {
            code: HResult::E_NO_LICENSE,
            name: Some("E_NO_LICENSE"),
            cause: |world, client| {
                world.sim.play(Scenario::parse("[controller]\nlicence = false").unwrap());
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_ARM_NOT_TAKEN,
            name: Some("E_ARM_NOT_TAKEN"),
            cause: |world, client| {
                robot(world, client, "GiveArm", ());
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_MOTOR_OFF,
            name: Some("E_MOTOR_OFF"),
            cause: |world, client| {
                robot(world, client, "Motor", 0);
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_TOKEN_NOT_ETHERNET,
            name: Some("E_TOKEN_NOT_ETHERNET"),
            cause: |world, client| {
                world.sim.play(Scenario::parse("[controller]\ntoken = 'pendant'").unwrap());
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_TOKEN_ADDRESS,
            name: Some("E_TOKEN_ADDRESS"),
            cause: |world, client| {
                world.sim.play(Scenario::parse("[controller]\ntoken = 'other'").unwrap());
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_ERROR_PRESENT,
            name: Some("E_ERROR_PRESENT"),
            cause: |world, client| {
                world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::E_ROBOTISBUSY,
            name: Some("E_ROBOTISBUSY"),
            cause: |world, client| {
                world.call(client.peer, call::robot_move(client.robot, 1, "J(10,45,90,0,45,0)", "NEXT"));
                robot(world, client, "slvChangeMode", 0x002)
            },
        },
        Row {
            code: HResult::from_u32(0x8320_4071),
            name: None,
            cause: |world, client| {
                robot(world, client, "slvChangeMode", 0x002);
                slv_move(world, client, 200.0)
            },
        },
    ];
    for row in table {
        let mut world = World::with(Config::new(Profile::Rc8));
        let client = world.mover(1);
        assert_eq!((row.cause)(&mut world, client), row.code);
        assert_eq!(row.code.name(), row.name);
        assert!(row.code.hint().is_some(), "{}", row.code);
    }
}

#[test]
fn what_stands_in_the_way_at_the_start_is_reported_at_its_step() {
    for (section, step, code) in [
        ("mode = 'manual'", Step::TakeArm, MANUAL_MODE),
        ("token = 'pendant'", Step::TakeArm, HResult::E_TOKEN_NOT_ETHERNET),
        ("token = 'other'", Step::TakeArm, HResult::E_TOKEN_ADDRESS),
        ("arm = 'taken'", Step::TakeArm, HResult::E_ARM_NOT_TAKEN),
        ("licence = false", Step::Enter, HResult::E_NO_LICENSE),
        ("formats = ['mini_io']", Step::SendFormat, HResult::E_INVALIDARG),
    ] {
        let mut rig = Rig::with(
            Link::Udp,
            Format { send: SendFormat { hand_io: true, ..SendFormat::POSE }, ..format(Mode::Mode0, PoseType::J) },
            Config::default(),
            |_| {},
        );
        rig.world.sim.play(Scenario::parse(&format!("[controller]\n{section}")).unwrap());
        let end = rig.run(|_| panic!("no pose is wanted"));
        let fault = rig.engine.fault().unwrap();
        assert_eq!((end, fault.step, fault.code()), (EngineAction::Faulted, step, Some(code)), "{section}: {fault}");
        assert_eq!(fault.cause, Cause::Refused(code));
        let errors: Vec<_> = fault.errors().iter().map(|error| error.code).collect();
        let expected: &[HResult] = if code.level().is_some() { &[code] } else { &[] };
        assert_eq!((fault.released, &errors[..]), (Released::Yes, expected), "{section}");
    }
}

#[test]
fn an_error_before_the_start_is_the_first_cause_of_the_refusal() {
    let mut rig = Rig::new(Link::Tcp, format(Mode::Mode0, PoseType::J));
    rig.world.sim.play(Scenario::parse("[controller]\nerrors = ['0x84204043', '0x83500121']").unwrap());
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!(fault.cause, Cause::Refused(HResult::E_ERROR_PRESENT));
    let codes: Vec<_> = fault.errors().iter().map(|error| error.code).collect();
    assert_eq!(
        codes,
        [HResult::from_u32(0x8420_4043), HResult::E_SLVMODE_OFF, HResult::E_ERROR_PRESENT],
        "the first cause first"
    );
}

#[test]
fn a_cobotta_wants_its_preparations_and_the_engine_says_which() {
    let cobotta = || Rig::with(Link::Udp, format(Mode::Mode0, PoseType::J), Config::new(Profile::Cobotta), |_| {});
    let mut rig = cobotta();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!((fault.step, fault.code()), (Step::Motor, Some(HResult::E_MOTION_UNPREPARED)));

    // by hand, as its user would
    let prepare = |rig: &mut Rig, command| {
        let Handles { robot, .. } = rig.engine.config().motion;
        rig.wires[0].call(&mut rig.world, &call::robot_execute(robot, command, ()))
    };
    let mut rig = cobotta();
    for command in ["ManualResetPreparation", "MotionPreparation"] {
        assert_eq!(prepare(&mut rig, command), Ok(HResult::S_OK), "{command}");
    }
    let text = "[[fault]]\nwhen = { cycle = 20 }\nthen = { error = '0x84204043' }";
    rig.world.sim.play(Scenario::parse(text).unwrap());
    assert_eq!(rig.run(|rig| Some(from_start(rig, 0, 0.0))), EngineAction::Faulted);
    assert_eq!(rig.engine.fault().unwrap().code(), Some(HResult::from_u32(0x8420_4043)));

    // a stop ends the preparation
    rig.world.sim.emergency_stop(true, rig.world.now);
    rig.world.sim.emergency_stop(false, rig.world.now);
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!((fault.step, fault.cause), (Step::ClearError, Cause::Refused(HResult::E_MANUAL_RESET_UNPREPARED)));
    assert_eq!(fault.code(), Some(HResult::from_u32(0x8420_4043)), "the first cause is still there");

    assert_eq!(prepare(&mut rig, "ManualResetPreparation"), Ok(HResult::S_OK));
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!((fault.step, fault.cause), (Step::Motor, Cause::Refused(HResult::E_MOTION_UNPREPARED)));
    let controller = rig.engine.config().motion.controller;
    let clear = call::controller_execute(controller, "ClearError", ());
    assert_eq!(rig.wires[0].call(&mut rig.world, &clear), Ok(HResult::S_OK));
    assert_eq!(prepare(&mut rig, "MotionPreparation"), Ok(HResult::S_OK));
    rig.engine.recover().unwrap();
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        (count <= 20).then(|| from_start(rig, 0, 0.0))
    });
    assert_eq!((end, rig.errors()), (EngineAction::Finished, vec![]));
}
