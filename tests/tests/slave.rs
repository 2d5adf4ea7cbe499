//! Tests the streams of `bcap-std` with the virtual controller over real sockets. They assert counts and positions, not
//! times; the controller's clock is slow enough for a busy machine.

use std::{fmt, io};

use bcap_core::hresult::HResult;
use bcap_core::procedure::{Provider, open_robot, release_robot};
use bcap_core::slave::{
    AxisLimits, Cause, Config, Cycle, Engine, Fault, Format, Handles, MOVE_FRAME, Mode, MoveReply, Next, Pose,
    PoseError, PoseType, ReceiveFormat, ReceivePose, RecoverError, Released, SlaveMode, Stats, Step, StreamError,
    Trajectory,
};
use bcap_core::time::Instant;
use bcap_sim::{Controller, Profile};
use bcap_std::blocking::Connection;
use bcap_std::server::Limits;
use bcap_std::{Options, asynch, blocking};
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::simulated::quick;
use bcap_tests::slowed::{CYCLE, Slowed, inner};

const MODES: [Mode; 3] = [Mode::Mode0, Mode::Mode1, Mode::Mode2];

fn controller() -> Served<Slowed> {
    Served::of(Slowed(Controller::new(quick(Profile::Rc8))), Limits::default())
}

fn format(mode: Mode) -> Format {
    Format::new(SlaveMode { mode, pose: PoseType::J }, ReceiveFormat::pose(ReceivePose::J))
}

fn set_up(mode: Mode, handles: Handles, watch: Option<Handles>) -> Config {
    let times = Config { cycle: CYCLE, late_after: CYCLE / 2, ..Config::new(format(mode), handles) };
    Config { watch, stall: CYCLE * 100, ramp: CYCLE * 25, ..times }
}

/// Moves joint 1 by two degrees and back, at rest at both ends; counts the answers.
#[derive(Default)]
struct Wave {
    cycles: u32,
    answers: u32,
    stop_at: Option<u32>,
}

impl Trajectory for Wave {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        if self.stop_at == Some(cycle.number) {
            return Next::Stop;
        }
        if cycle.number == self.cycles {
            return Next::Finish;
        }
        let turn = f64::from(cycle.number + 1) / f64::from(self.cycles) * std::f64::consts::TAU;
        Next::Pose(turned(cycle.start, 1.0 - turn.cos()))
    }

    fn moved(&mut self, reply: &MoveReply<'_>, _: Instant) {
        assert!(reply.joints().is_some());
        self.answers += 1;
    }
}

/// Returns a pose whose first joint is turned by this angle.
fn turned(pose: &Pose, by: f64) -> Pose {
    let mut joints: [f64; 8] = pose.numbers().try_into().unwrap();
    joints[0] += by;
    Pose::j(joints)
}

/// Checks that a wave went as it should: every pose once, no underflow, back where it began.
fn assert_wave(sim: &Served<Slowed>, wave: &Wave, stats: &Stats, what: impl fmt::Display) {
    let controller = &sim.application().0;
    // the stop repeats the last pose at least five times
    assert!(stats.cycles >= wave.cycles + 5, "{what}: {stats:?}");
    assert_eq!(wave.answers, stats.cycles, "{what}");
    assert_eq!((stats.underflows, controller.slave_counters().underflows), (0, 0), "{what}");
    assert_eq!(stats.rtt.count(), stats.cycles + stats.refused, "{what}");
    assert_eq!(controller.errors().count(), 0, "{what}");
    assert_eq!((controller.slave_mode(), controller.arm_owner()), (0, None), "{what}");
    assert!(controller.joints()[0].abs() < 1e-9, "{what}: {:?}", controller.joints());
    let highest = controller.slave_record().map(|cycle| cycle.axes[0]).fold(0.0, f64::max);
    assert!((1.9..=2.0 + 1e-9).contains(&highest), "{what}: {highest}");
}

/// An engine with the connections of its stream.
struct Rig<X> {
    engine: Engine,
    motion: Connection<X, Vec<u8>>,
    watch: blocking::TcpClient,
}

impl<X: blocking::Transport<Error = io::Error>> Rig<X> {
    fn new(mut motion: Connection<X, Vec<u8>>, sim: &Served<Slowed>, change: impl FnOnce(&mut Config)) -> Self {
        let mut watch = blocking::connect_tcp(sim.tcp, &Options::default()).unwrap();
        let handles = motion.run(open_robot(Provider::RC8, None)).unwrap();
        let watching = watch.run(open_robot(Provider::RC8, None)).unwrap();
        let mut config = set_up(Mode::Mode2, handles, Some(watching));
        change(&mut config);
        Self { engine: Engine::new(config).unwrap(), motion, watch }
    }

    fn run(&mut self, trajectory: &mut impl Trajectory) -> Result<(), StreamError> {
        let stream = self.engine.stream(trajectory);
        self.motion.run_watched(&mut self.watch, stream).map_err(|error| error.error)
    }

    fn fault(&self) -> &Fault {
        self.engine.fault().unwrap()
    }
}

fn over_tcp(sim: &Served<Slowed>, change: impl FnOnce(&mut Config)) -> Rig<blocking::TcpTransport> {
    Rig::new(blocking::connect_tcp(sim.tcp, &Options::default()).unwrap(), sim, change)
}

fn over_udp(sim: &Served<Slowed>, change: impl FnOnce(&mut Config)) -> Rig<blocking::UdpTransport> {
    Rig::new(blocking::connect_udp(sim.udp, &Options::default()).unwrap(), sim, change)
}

#[test]
fn every_mode_streams_over_both_links_blocking() {
    repeated(|| {
        for mode in MODES {
            let sim = controller();
            let set = |config: &mut Config| config.format = format(mode);
            let mut wave = Wave { cycles: 25, ..Wave::default() };
            let mut rig = over_tcp(&sim, set);
            rig.run(&mut wave).unwrap();
            assert_wave(&sim, &wave, rig.engine.stats(), format_args!("{mode:?} over TCP"));
            let Rig { engine, mut motion, watch } = rig;
            motion.run(release_robot(engine.config().motion)).unwrap();
            drop((motion, watch));

            let mut wave = Wave { cycles: 25, ..Wave::default() };
            let mut rig = over_udp(&sim, set);
            rig.run(&mut wave).unwrap();
            assert_wave(&sim, &wave, rig.engine.stats(), format_args!("{mode:?} over UDP"));
        }
    });
}

#[test]
fn every_mode_streams_over_both_links_under_tokio() {
    repeated(|| tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(streamed()));
}

async fn streamed() {
    let options = Options::default();
    for mode in MODES {
        let sim = controller();
        let mut motion = asynch::connect_tcp(sim.tcp, &options).await.unwrap();
        let handles = motion.run(open_robot(Provider::RC8, None)).await.unwrap();
        let mut engine = Engine::<MOVE_FRAME>::new(set_up(mode, handles, None)).unwrap();
        let mut wave = Wave { cycles: 25, ..Wave::default() };
        motion.run(engine.stream(&mut wave)).await.unwrap();
        assert_wave(&sim, &wave, engine.stats(), format_args!("{mode:?} over TCP"));
        motion.run(release_robot(handles)).await.unwrap();

        let mut motion = asynch::connect_udp(sim.udp, &options).await.unwrap();
        let mut watch = asynch::connect_tcp(sim.tcp, &options).await.unwrap();
        let handles = motion.run(open_robot(Provider::RC8, None)).await.unwrap();
        let watching = watch.run(open_robot(Provider::RC8, None)).await.unwrap();
        let mut engine = Engine::<MOVE_FRAME>::new(set_up(mode, handles, Some(watching))).unwrap();
        let mut wave = Wave { cycles: 25, ..Wave::default() };
        motion.run_watched(&mut watch, engine.stream(&mut wave)).await.unwrap();
        assert_wave(&sim, &wave, engine.stats(), format_args!("{mode:?} over UDP"));
    }
}

#[test]
fn a_stop_ramps_within_the_limits_and_gives_the_arm_back() {
    repeated(|| {
        let sim = controller();
        let mut rig = over_tcp(&sim, |config| {
            config.limits = AxisLimits::uniform(100.0, 500.0);
        });
        let mut wave = Wave { cycles: 100, stop_at: Some(25), ..Wave::default() };
        rig.run(&mut wave).unwrap();
        let controller = &sim.application().0;
        let axes: Vec<f64> = controller.slave_record().map(|cycle| cycle.axes[0]).collect();
        let steps: Vec<f64> = axes.windows(2).map(|pair| (pair[1] - pair[0]) / CYCLE.as_secs_f64()).collect();
        assert!(steps[20] > 0.75, "it was moving: {steps:?}");
        assert_eq!(steps.last(), Some(&0.0), "and stands");
        for pair in steps.windows(2) {
            assert!(((pair[1] - pair[0]) / CYCLE.as_secs_f64()).abs() <= 500.0, "{pair:?}");
        }
        assert!(steps[26..].windows(2).all(|pair| pair[1] <= pair[0] + 1e-9), "ever slower: {steps:?}");
        assert_eq!((controller.slave_mode(), controller.arm_owner(), controller.errors().count()), (0, None, 0));
    });
}

#[test]
fn a_pose_that_is_too_far_is_not_sent_and_the_stream_stops() {
    repeated(|| {
        let sim = controller();
        let mut rig = over_tcp(&sim, |config| {
            config.limits = AxisLimits::uniform(50.0, 4000.0);
        });
        let mut far = |cycle: &Cycle<'_>| Next::Pose(turned(cycle.start, if cycle.number < 30 { 0.0 } else { 5.0 }));
        let error = rig.run(&mut far).unwrap_err();
        let StreamError::Pose { number: 30, error: PoseError::Speed { axis: 1, speed, limit: 50.0 } } = error else {
            panic!("{error}")
        };
        assert!((speed - 5.0 / CYCLE.as_secs_f64()).abs() < 1e-6, "{speed}");
        let controller = &sim.application().0;
        assert!(controller.slave_record().all(|cycle| cycle.axes[0] == 0.0), "nothing moved");
        assert_eq!((controller.slave_mode(), controller.arm_owner(), controller.errors().count()), (0, None, 0));
    });
}

/// Holds the pose for 20 cycles, then disturbs the controller with `act`, and continues.
fn disturbed<'a>(sim: &'a Served<Slowed>, act: impl Fn(&mut Controller) + 'a) -> impl FnMut(&Cycle<'_>) -> Next + 'a {
    move |cycle| {
        if cycle.number == 20 {
            act(&mut sim.application().0);
        }
        if cycle.number < 40 { Next::Pose(*cycle.start) } else { Next::Finish }
    }
}

#[test]
fn the_first_error_is_reported_and_recovery_is_explicit() {
    repeated(|| {
        let sim = controller();
        let mut rig = over_udp(&sim, |_| {});
        let code = HResult::from_u32(0x8420_4043);
        let inject = |sim: &mut Controller| sim.inject_error(code, inner(bcap_std::now()));
        rig.run(&mut disturbed(&sim, inject)).unwrap_err();
        let fault = rig.fault();
        assert_eq!((fault.step, fault.code(), fault.released), (Step::Move, Some(code), Released::Yes));
        assert!(matches!(fault.cause, Cause::Refused(refused) if refused != code), "{fault}");
        let after = rig.engine.stats().cycles;
        // the robot does not move and no error is cleared automatically
        let error = rig.run(&mut Wave { cycles: 10, ..Wave::default() }).unwrap_err();
        assert!(matches!(error, StreamError::Fault { code: Some(told), .. } if told == code), "{error}");
        assert_eq!(
            (rig.engine.stats().cycles, sim.application().0.errors().last().map(|error| error.code)),
            (after, Some(code))
        );

        rig.engine.recover().unwrap();
        rig.run(&mut Wave { cycles: 10, ..Wave::default() }).unwrap();
        assert!(rig.engine.stats().cycles >= after + 10);
        let controller = &sim.application().0;
        assert_eq!((controller.errors().count(), controller.arm_owner()), (0, None));
    });
}

#[test]
fn after_an_emergency_stop_there_is_no_recovery_and_the_arm_can_be_given_back() {
    repeated(|| {
        let sim = controller();
        let mut rig = over_tcp(&sim, |_| {});
        let press = |sim: &mut Controller| sim.emergency_stop(true, inner(bcap_std::now()));
        rig.run(&mut disturbed(&sim, press)).unwrap_err();
        let fault = rig.fault();
        assert_eq!((fault.code(), fault.emergency_stop), (Some(HResult::E_COMMAND_POSITION_GEN_STOPPED), Some(true)));
        assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
        let giving_up = rig.engine.give_up();
        rig.motion.run_watched(&mut rig.watch, giving_up).unwrap();
        assert_eq!(sim.application().0.arm_owner(), None);
    });
}

#[test]
fn a_disconnected_controller_is_a_fault() {
    repeated(|| {
        let sim = controller();
        let mut rig = over_tcp(&sim, |_| {});
        let mut sim = Some(sim);
        rig.run(&mut |cycle: &Cycle<'_>| {
            if cycle.number == 20 {
                sim = None;
            }
            Next::Pose(*cycle.start)
        })
        .unwrap_err();
        let fault = rig.fault();
        assert_eq!((fault.step, fault.released), (Step::Move, Released::Unknown), "{fault}");
        assert_eq!(rig.engine.recover(), Err(RecoverError::Lost));
    });
}
