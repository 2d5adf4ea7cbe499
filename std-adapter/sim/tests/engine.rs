//! The core's engine of slave mode against the virtual controller: two sides that were written apart must agree.

mod common;

use bcap_core::bcap::slave::{
    Action, AxisLimits, Cause, Channel, Config as Stream, Engine, Extended, ExtendedAxes, Format, Handles, Mode, Pose,
    PoseType, ReceiveFormat, ReceivePose, RecoverError, Released, SendFormat, SendIo, SlaveMode, Step, TimeUnit,
    UserIo,
};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_sim::{Config, EMERGENCY_STOP, VariableKind};

use common::{Client, World};

const MODES: [Mode; 3] = [Mode::Mode0, Mode::Mode1, Mode::Mode2];

/// An engine, its two clients and their controller.
struct Rig {
    world: World,
    clients: [Client; 2],
    engine: Engine,
    moves: u32,
}

impl Rig {
    fn new(format: Format) -> Self {
        Self::with(format, |_| {})
    }

    fn with(format: Format, change: impl FnOnce(&mut Stream)) -> Self {
        let mut world = World::with(Config { extended_axes: 2, ..Config::default() });
        let clients = [world.client(1), world.client(2)];
        let [motion, watch] = clients.map(|c| Handles { controller: c.controller, robot: c.robot });
        let mut config = Stream { watch: Some(watch), ..Stream::new(format, motion) };
        change(&mut config);
        Self { world, clients, engine: Engine::new(config).unwrap(), moves: 0 }
    }

    /// Makes the engine's call.
    fn call(&mut self, channel: Channel) {
        let peer = self.clients[usize::from(channel == Channel::Watch)].peer;
        let (code, value) = self.world.run(peer, self.engine.request().unwrap());
        let mut buffer = [0; 2048];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        frame.argument(&value).unwrap();
        let reply = Decoder::TCP.decode_datagram(frame.finish(1, 0, code.0).unwrap()).unwrap();
        if let Some(moved) = self.engine.handle_reply(&reply, self.world.now) {
            self.moves += 1;
            let receive = self.engine.config().format.receive;
            assert_eq!(moved.pose().len(), receive.pose.len());
            assert_eq!(moved.timestamp().map(|t| t.unit), receive.time);
            assert_eq!(moved.user_io().map(<[u8]>::len), receive.user_io.map(|range| usize::from(range.bytes())));
            let there = (moved.mini_io().is_some(), moved.hand_io().is_some(), moved.current().is_some());
            assert_eq!(there, (receive.mini_io, receive.hand_io, receive.current));
        }
    }

    /// Runs until the engine ends; `next` gives poses, `None` finishes.
    fn run(&mut self, mut next: impl FnMut(&mut Self) -> Option<Pose>) -> Action {
        for _ in 0..20_000 {
            match self.engine.poll(self.world.now) {
                Action::Call(_, channel) => self.call(channel),
                Action::Wait(until) => {
                    self.world.now = self.world.now.max(until);
                    self.world.sim.advance(self.world.now);
                }
                Action::Pose { .. } => match next(self) {
                    Some(pose) => self.engine.push(&pose).unwrap(),
                    None => self.engine.finish(),
                },
                end => return end,
            }
        }
        panic!("the engine does not end");
    }

    fn errors(&self) -> Vec<HResult> {
        self.world.sim.errors().map(|e| e.code).collect()
    }
}

fn format(mode: Mode, pose: PoseType) -> Format {
    Format::new(SlaveMode { mode, pose }, ReceiveFormat::pose(ReceivePose::J))
}

/// Says where the stream began, with something added to one number.
fn from_start(rig: &Rig, number: usize, by: f64) -> Pose {
    let start = rig.engine.start_pose().unwrap();
    let mut numbers = start.numbers().to_vec();
    numbers[number] += by;
    let pose = Pose::from_numbers(start.shape().pose, &numbers).unwrap();
    match start.shape().extended {
        ExtendedAxes::None => pose,
        ExtendedAxes::Seven => pose.with_extended(Extended::Seven(0.0)),
        ExtendedAxes::Eight => pose.with_extended(Extended::Eight(0.0)),
        ExtendedAxes::Both => pose.with_extended(Extended::Both(0.0, 0.0)),
    }
}

/// Goes up by so much in so many cycles, at rest at both ends.
fn smooth(at: u16, count: u16) -> f64 {
    let x = f64::from(at) / f64::from(count);
    x * x * (3.0 - 2.0 * x)
}

/// Streams a small motion and checks that all of it happened.
fn stream(format: Format) {
    let mut rig = Rig::new(format);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        if format.send.io == SendIo::Mini {
            rig.engine.set_mini_io(0x0005_0000).unwrap();
        }
        if matches!(format.send.io, SendIo::User(_)) {
            rig.engine.set_user_io(&[0xa5, 0x3c]).unwrap();
        }
        if format.send.hand_io {
            rig.engine.set_hand_io(0x0003_0000).unwrap();
        }
        (count <= 20).then(|| from_start(rig, 0, smooth(count, 20) * 0.02))
    });
    assert_eq!(end, Action::Finished, "{format:?}: {:?}", rig.engine.fault());
    assert_eq!((rig.errors(), rig.world.sim.slave_mode(), rig.world.sim.arm_owner()), (vec![], 0, None));
    assert!(rig.moves >= 22, "{format:?}: {}", rig.moves);
    let bit =
        |rig: &Rig, number| rig.world.sim.variable::<16>(VariableKind::Io, number).unwrap().as_variant().as_bool();
    let on = |port: u32| bit(&rig, port) == Some(true);
    assert_eq!(
        (on(16), on(17), on(18)),
        if format.send.io == SendIo::Mini { (true, false, true) } else { Default::default() }
    );
    assert_eq!((on(64), on(65), on(66)), if format.send.hand_io { (true, true, false) } else { Default::default() });
    let user = matches!(format.send.io, SendIo::User(_));
    assert_eq!((on(136), on(138), on(139), on(146)), (user, user, false, user));
}

#[test]
fn every_mode_send_format_and_extended_axis_is_understood() {
    let user = SendIo::User(UserIo::new(136, 2).unwrap());
    let axes = [ExtendedAxes::None, ExtendedAxes::Seven, ExtendedAxes::Eight, ExtendedAxes::Both];
    for mode in MODES {
        for pose in [PoseType::P, PoseType::J, PoseType::T] {
            for (extended, io) in axes.into_iter().flat_map(|e| [SendIo::None, SendIo::Mini, user].map(|io| (e, io))) {
                for (hand_io, user_io) in
                    [(false, None), (true, None), (false, UserIo::new(128, 4).ok()), (true, UserIo::new(160, 1).ok())]
                {
                    let receive = ReceiveFormat { user_io, ..ReceiveFormat::pose(ReceivePose::PJ) };
                    stream(Format { extended, send: SendFormat { io, hand_io }, receive, ..format(mode, pose) });
                }
            }
        }
    }
}

#[test]
fn every_receive_format_is_answered_as_it_is_read() {
    for pose in [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ] {
        for time in [None, Some(TimeUnit::Millis), Some(TimeUnit::Micros)] {
            for bits in 0..16 {
                let on = |bit: u8| bits & bit != 0;
                let user_io = on(1).then(|| UserIo::new(128, 3).unwrap());
                let receive = ReceiveFormat { pose, time, mini_io: on(2), user_io, hand_io: on(4), current: on(8) };
                stream(Format { receive, ..format(Mode::Mode2, PoseType::J) });
            }
        }
    }
}

#[test]
fn a_trajectory_arrives_without_an_error_in_every_mode() {
    for mode in MODES {
        let mut rig = Rig::new(format(mode, PoseType::J));
        let mut count = 0;
        let end = rig.run(|rig| {
            count += 1;
            (count <= 500).then(|| from_start(rig, 0, 30.0 * smooth(count, 500)))
        });
        assert_eq!((end, rig.errors()), (Action::Finished, vec![]), "{mode:?}");
        assert!((rig.world.sim.axes()[0] - rig.engine.start_pose().unwrap().as_slice()[0] - 30.0).abs() < 1e-9);
        let (stats, counters) = (rig.engine.stats(), rig.world.sim.slave_counters());
        assert_eq!((stats.underflows, stats.late, stats.refused), (0, 0, 0), "{mode:?}");
        assert_eq!(u64::from(stats.cycles), counters.taken, "{mode:?}");
        assert!(stats.least_margin.is_none_or(|least| least.as_millis() >= 8), "{mode:?}: {:?}", stats.least_margin);
    }
}

#[test]
fn a_stop_in_motion_is_within_the_controllers_own_limits() {
    for mode in MODES {
        let limits = AxisLimits::uniform(100.0, 400.0);
        let mut rig = Rig::with(format(mode, PoseType::J), |config| config.limits = limits);
        let (mut speed, mut at, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|rig| {
            count += 1;
            speed = f64::min(speed + 0.02, 0.6);
            at += speed;
            if count == 60 {
                rig.engine.stop();
            }
            (count < 60).then(|| from_start(rig, 0, at))
        });
        assert_eq!((end, rig.errors()), (Action::Finished, vec![]), "{mode:?}");
        let axes: Vec<f64> = rig.world.sim.slave_record().map(|cycle| cycle.axes[0]).collect();
        let speeds: Vec<f64> = axes.windows(2).map(|pair| (pair[1] - pair[0]) / 0.008).collect();
        assert!(speeds.iter().any(|speed| *speed > 70.0) && speeds.last().is_some_and(|speed| speed.abs() < 1e-9));
        let hardest = speeds.windows(2).map(|pair| ((pair[1] - pair[0]) / 0.008).abs()).fold(0.0, f64::max);
        assert!(hardest <= 400.0, "{mode:?}: {hardest}");
    }
}

#[test]
fn an_underflow_and_a_limit_are_reported_as_the_first_cause() {
    for (jump, wait, expected) in [(0.0, 60, 0x8420_1482), (5.0, 0, 0x8420_4051), (0.5, 0, 0x8420_4041)] {
        let mut rig = Rig::new(format(Mode::Mode2, PoseType::J));
        let (mut count, mut at) = (0, 0.0);
        let end = rig.run(|rig| {
            count += 1;
            at += 0.01;
            if count == 50 {
                at += jump;
                rig.world.pass(wait);
            }
            Some(from_start(rig, 0, at))
        });
        assert_eq!(end, Action::Faulted);
        let fault = rig.engine.fault().unwrap();
        assert_eq!(fault.step, Step::Move);
        assert_eq!(fault.code(), Some(HResult::from_u32(expected)), "{fault}");
        assert_eq!((fault.released, fault.emergency_stop), (Released::Yes, Some(false)));
        assert_eq!(rig.engine.stats().underflows, u32::from(wait > 0));
    }
}

#[test]
fn an_emergency_stop_ends_the_stream_for_good_and_other_errors_until_it_is_recovered() {
    for code in [EMERGENCY_STOP, HResult::from_u32(0x8350_0001)] {
        let mut rig = Rig::new(format(Mode::Mode0, PoseType::J));
        let mut count = 0;
        let end = rig.run(|rig| {
            count += 1;
            let now: Instant = rig.world.now;
            match code {
                EMERGENCY_STOP if count == 50 => rig.world.sim.emergency_stop(true, now),
                code if count == 50 => rig.world.sim.inject_error(code, now),
                _ => {}
            }
            Some(from_start(rig, 0, f64::from(count) * 0.01))
        });
        assert_eq!((end, rig.engine.fault().unwrap().code()), (Action::Faulted, Some(code)));
        let (stood, errors) = (rig.world.sim.axes(), rig.errors());
        if code == EMERGENCY_STOP {
            assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
            rig.world.pass(1000);
            assert_eq!((rig.world.sim.axes(), rig.errors(), rig.world.sim.motor_is_on()), (stood, errors, false));
        } else {
            rig.engine.recover().unwrap();
            let mut count = 0;
            let end = rig.run(|rig| {
                count += 1;
                (count <= 20).then(|| from_start(rig, 0, smooth(count, 20) * 0.02))
            });
            assert_eq!((end, rig.errors()), (Action::Finished, vec![]));
            assert!((rig.world.sim.axes()[0] - stood[0] - 0.02).abs() < 1e-9);
        }
    }
}

#[test]
fn the_controllers_refusals_name_the_step() {
    let mut rig = Rig::with(format(Mode::Mode1, PoseType::J), |config| config.motor = false);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!((fault.step, fault.released), (Step::Enter, Released::Yes));
    assert!(matches!(fault.cause, Cause::Refused(_)), "{fault}");

    let mut rig = Rig::with(format(Mode::Mode1, PoseType::J), |config| config.arm = None);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    assert_eq!(rig.engine.fault().unwrap().code(), Some(HResult::E_ARM_NOT_TAKEN));
}
