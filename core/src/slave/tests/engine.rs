//! The engine against a scripted controller, under a simulated clock.

#![expect(clippy::arithmetic_side_effects, reason = "a test in which a sum overflows fails, as it should")]

use crate::endpoint::Endpoint;
use core::time::Duration;
use std::collections::VecDeque;
use std::string::{String, ToString};
use std::vec::Vec;

use super::*;
use crate::bcap::call::ControllerHandle;
use crate::bcap::client::Event;
use crate::bcap::{Frame, FrameWriter, FunctionId, StreamState};
use crate::hresult::HResult;
use crate::procedure::Effects;
use crate::time::Instant;

const CYCLE: Duration = Duration::from_millis(8);
const HANDLES: Handles = Handles { controller: ControllerHandle(1), robot: ROBOT };
const WATCH: Handles = Handles { controller: ControllerHandle(11), robot: RobotHandle(13) };
/// The one-way delay of a call.
const LATENCY: Duration = Duration::from_micros(150);

type Answer = (HResult, VariantBuf<512>);

fn ok(value: &dyn Encode) -> Answer {
    (HResult::S_OK, VariantBuf::new(value).unwrap())
}

fn refused(code: HResult) -> Answer {
    (code, VariantBuf::new(&()).unwrap())
}

/// A controller that executes a pose of its buffer every cycle, without lag of the joints.
struct Controller {
    now: Instant,
    next_cycle: Instant,
    mode: i32,
    buffer: VecDeque<Vec<f64>>,
    /// The position, and whether it changed in the last cycle.
    at: Vec<f64>,
    moving: bool,
    /// Poses in the order of their execution.
    done: Vec<Vec<f64>>,
    errors: Vec<(HResult, &'static str)>,
    system: i32,
    arm: bool,
    motor: bool,
    /// Scripted replies by command; each replaces one normal reply.
    script: Vec<(&'static str, Answer)>,
    /// Received commands, and their connection.
    log: Vec<(Channel, String)>,
    /// Cycles that execute no pose.
    asleep: u32,
}

impl Controller {
    fn new(at: &[f64]) -> Self {
        Self {
            now: Instant::ZERO,
            next_cycle: Instant::from_millis(3),
            mode: 0,
            buffer: VecDeque::new(),
            at: at.to_vec(),
            moving: false,
            done: Vec::new(),
            errors: Vec::new(),
            system: 0,
            arm: false,
            motor: false,
            script: Vec::new(),
            log: Vec::new(),
            asleep: 0,
        }
    }

    /// Advances the clock.
    fn advance(&mut self, now: Instant) {
        while self.next_cycle <= now {
            self.now = self.next_cycle;
            self.next_cycle = self.next_cycle + CYCLE;
            self.cycle();
        }
        self.now = self.now.max(now);
    }

    fn cycle(&mut self) {
        if self.mode == 0 {
            return;
        }
        if self.asleep > 0 {
            self.asleep -= 1;
            return;
        }
        match self.buffer.pop_front() {
            Some(pose) => {
                self.moving = pose != self.at;
                self.at.clone_from(&pose);
                self.done.push(pose);
            }
            None if self.moving && self.mode & 0xf00 != 0x100 => {
                self.fail(HResult::E_COMMAND_BUFFER_EMPTY, "Position command buffer is empty");
            }
            None => self.moving = false,
        }
    }

    fn fail(&mut self, code: HResult, text: &'static str) {
        self.mode = 0;
        self.moving = false;
        self.buffer.clear();
        self.errors.insert(0, (code, text));
    }

    fn answer(&mut self, channel: Channel, request: &Frame<'_>) -> Answer {
        let handle = request.args.get(0).and_then(|v| v.as_i32()).unwrap();
        let halts = request.function() == FunctionId::ROBOT_HALT;
        let name =
            request.args.get(1).and_then(|v| v.as_bstr()).unwrap().chars().map(Result::unwrap).collect::<String>();
        let handles = if channel == Channel::Motion { HANDLES } else { WATCH };
        let expected = match request.function().0 {
            64 | 70 => handles.robot.0,
            17 => handles.controller.0,
            other => panic!("function {other}"),
        };
        assert_eq!(handle, expected, "{name}");
        let name = if halts { "Robot_Halt".to_string() } else { name };
        self.log.push((channel, name.clone()));
        if let Some(at) = self.script.iter().position(|(command, _)| *command == name) {
            return self.script.remove(at).1;
        }
        let parameter = request.args.get(2).unwrap_or(Variant::Empty);
        match name.as_str() {
            "slvChangeMode" => self.change_mode(parameter.as_i32().unwrap()),
            "slvMove" => self.slv_move(parameter),
            "slvGetMode" => ok(&self.mode),
            "Robot_Halt" => ok(&()),
            _ if self.mode != 0 => refused(HResult::E_SLVMODE_ON),
            "slvSendFormat" | "slvRecvFormat" => ok(&()),
            "Motor" => {
                assert!(self.arm, "Motor without the arm");
                self.motor = parameter.as_array().unwrap().items::<i32>().unwrap().iter().next() == Some(1);
                ok(&())
            }
            "TakeArm" | "GiveArm" => {
                self.arm = name == "TakeArm";
                ok(&())
            }
            "CurJnt" | "CurPos" | "CurTrn" => ok(&self.at.as_slice()),
            "GetCurErrorCount" => ok(&i32::try_from(self.errors.len()).unwrap()),
            "GetCurErrorInfo" => {
                let (code, text) = self.errors[usize::try_from(parameter.as_i32().unwrap()).unwrap()];
                ok(&(code.0, text, 0_i32))
            }
            "SysState" => ok(&self.system),
            "ClearError" => {
                self.errors.clear();
                ok(&())
            }
            other => panic!("{other} is not a command of the engine"),
        }
    }

    fn change_mode(&mut self, code: i32) -> Answer {
        assert!(self.arm || code == 0, "slvChangeMode without the arm");
        while code == 0 && !self.buffer.is_empty() {
            self.advance(self.next_cycle);
        }
        self.mode = code;
        ok(&())
    }

    fn slv_move(&mut self, parameter: Variant<'_>) -> Answer {
        if self.mode == 0 {
            return refused(HResult::E_SLVMODE_OFF);
        }
        let pose: Vec<f64> = parameter.as_array().unwrap().items::<f64>().unwrap().iter().collect();
        let mut code = HResult::S_OK;
        match self.mode & 0xf00 {
            0 if self.buffer.len() == 3 => return refused(HResult::E_BUF_FULL),
            0 if self.buffer.len() == 2 => code = HResult::S_BUF_FULL,
            0x100 => self.buffer.clear(),
            0x200 => {
                while self.buffer.len() == 3 && self.mode != 0 {
                    self.advance(self.next_cycle);
                }
            }
            _ => {}
        }
        self.buffer.push_back(pose);
        (code, ok(&self.at.as_slice()).1)
    }
}

/// An engine with its clients and its controller.
struct Rig {
    engine: Engine,
    clients: [Client<[u8; 512]>; 2],
    controller: Controller,
    now: Instant,
    /// The slvMoves that fail, by their number, and their failure.
    failures: Vec<(usize, Failure)>,
    moves: usize,
}

impl Rig {
    fn new(config: Config, at: &[f64]) -> Self {
        let client = || Client::new(client::Config::TCP, [0; 512], [0; 512]);
        Self {
            engine: Engine::new(config).unwrap(),
            clients: [client(), client()],
            controller: Controller::new(at),
            now: Instant::from_millis(1),
            failures: Vec::new(),
            moves: 0,
        }
    }

    /// Makes the engine's call through the bytes of a client.
    fn call(&mut self) {
        let request = self.engine.request().unwrap();
        if request.step() == Step::Move {
            self.moves += 1;
            if let Some((_, failure)) = self.failures.iter().find(|(number, _)| *number == self.moves) {
                self.now = self.now + LATENCY;
                return self.engine.handle_failure(*failure, self.now);
            }
        }
        let channel = request.channel();
        let client = &mut self.clients[usize::from(channel == Channel::Watch)];
        client.start(&request, client.timing(), self.now).unwrap();
        let bytes = client.transmit().to_vec();
        client.transmitted(bytes.len());
        self.controller.advance(self.now + LATENCY);
        let request = Decoder::TCP.decode_datagram(&bytes).unwrap();
        let (code, value) = self.controller.answer(channel, &request);
        let mut buffer = [0; 512];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        frame.argument(&value).unwrap();
        let reply = frame.finish(request.serial, 0, code.0).unwrap();
        // a delayed reply arrives when it was sent
        self.now = self.controller.now.max(self.now + LATENCY) + LATENCY;
        client.receive_buffer()[..reply.len()].copy_from_slice(reply);
        client.received(reply.len());
        assert_eq!(client.poll_event(self.now), Some(Event::Replied(code)));
        let moved = self.engine.handle_reply(&client.reply().unwrap(), self.now);
        assert!(moved.is_none_or(|reply| reply.joints().is_some()));
    }

    /// Runs until the engine ends, with the poses of `next`; `None` stops the stream.
    fn run(&mut self, mut next: impl FnMut(&mut Self) -> Option<Pose>) -> Action {
        for _ in 0..20_000 {
            match self.engine.poll(self.now) {
                Action::Call(..) => self.call(),
                Action::Wait(until) => self.now = self.now.max(until),
                Action::Pose { .. } => match next(self) {
                    Some(pose) => self.engine.push(&pose).unwrap(),
                    None => self.engine.stop(),
                },
                end => {
                    self.controller.advance(self.now + CYCLE);
                    return end;
                }
            }
        }
        panic!("the engine does not end");
    }

    /// Moves without an end, and does something at a pose; the engine is faulted then.
    fn fault_at(&mut self, at: u32, act: impl Fn(&mut Self)) {
        let mut count = 0;
        let end = self.run(|rig| {
            count += 1;
            if count == at {
                act(rig);
            }
            Some(joints(f64::from(count) * 0.01))
        });
        assert_eq!(end, Action::Faulted);
    }

    fn fault(&self) -> &Fault {
        self.engine.fault().unwrap()
    }

    fn names(&self) -> Vec<&str> {
        self.controller.log.iter().map(|(_, name)| name.as_str()).filter(|name| *name != "slvMove").collect()
    }

    /// The first joint of each executed pose.
    fn path(&self) -> Vec<f64> {
        self.controller.done.iter().map(|pose| pose[0]).collect()
    }
}

fn config(mode: Mode) -> Config {
    Config { ramp: Duration::ZERO, ..Config::new(format(mode, PoseType::J), HANDLES) }
}

fn joints(first: f64) -> Pose {
    Pose::j([first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// A source of `count` poses, which starts and ends at rest.
fn trajectory(count: u16) -> impl FnMut(&mut Rig) -> Option<Pose> {
    let mut sent = 0;
    move |_| {
        sent += 1;
        (sent <= count).then(|| joints(smooth(sent, count)))
    }
}

/// Moves from 0 to 1 degree, with speed 0 at both ends.
fn smooth(at: u16, count: u16) -> f64 {
    let x = f64::from(at) / f64::from(count);
    x * x * (3.0 - 2.0 * x)
}

/// Moves without an end, and does something at a pose; returns when the engine is faulted.
fn disturbed(config: Config, at: u32, act: impl Fn(&mut Rig)) -> Rig {
    let mut rig = Rig::new(config, &[0.0; 8]);
    rig.fault_at(at, act);
    rig
}

/// Starts with a reply to one command; returns when the engine is faulted, without a pose.
fn refused_start(config: Config, command: &'static str, code: HResult) -> Rig {
    let mut rig = Rig::new(config, &[0.0; 8]);
    rig.controller.script.push((command, refused(code)));
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    rig
}

const START: [&str; 8] =
    ["slvGetMode", "slvSendFormat", "slvRecvFormat", "TakeArm", "Motor", "CurJnt", "slvChangeMode", "slvChangeMode"];

#[test]
fn every_mode_executes_every_pose_once_and_in_order() {
    for mode in [Mode::Mode0, Mode::Mode1, Mode::Mode2] {
        let mut rig = Rig::new(config(mode), &[0.0; 8]);
        assert_eq!(rig.run(trajectory(500)), Action::Finished, "{mode:?}: {:?}", rig.engine.fault());
        let path = rig.path();
        let expected: Vec<f64> = (1..=500).map(|n| smooth(n, 500)).collect();
        assert_eq!(path[..500], expected, "{mode:?}");
        // the stop repeats the last pose until the robot is at rest, and no longer
        assert!(
            path[500..].iter().all(|joint| *joint == 1.0) && (2..=8).contains(&(path.len() - 500)),
            "{}",
            path.len()
        );
        assert_eq!(rig.names()[..6], START[..6]);
        assert_eq!(rig.names()[6..], ["slvChangeMode", "slvChangeMode", "Motor", "GiveArm"]);
        assert!(
            !rig.controller.arm
                && !rig.controller.motor
                && rig.controller.mode == 0
                && rig.controller.errors.is_empty()
        );
        let stats = rig.engine.stats();
        assert_eq!((stats.underflows, stats.late), (0, 0), "{mode:?}");
        assert_eq!(usize::try_from(stats.cycles).unwrap(), path.len(), "{mode:?}");
        assert_eq!(stats.least_margin.is_some(), mode != Mode::Mode1);
        assert!(stats.least_margin.is_none_or(|least| least >= CYCLE), "{:?}", stats.least_margin);
    }
}

#[test]
fn mode_0_fills_the_buffer_and_then_keeps_the_cycle() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut dues = Vec::new();
    let mut next = trajectory(50);
    let _ = rig.run(|rig| {
        dues.push(rig.now);
        next(rig)
    });
    // the buffer is filled without waiting; after that, one pose is sent per cycle
    let filling = dues.iter().take_while(|at| at.saturating_since(dues[0]) < Duration::from_millis(2)).count();
    // (three in the buffer, one in execution, and one requested ahead)
    assert!((4..=5).contains(&filling), "{dues:?}");
    assert!(rig.engine.stats().jitter.max() == 0);
    assert_eq!(rig.engine.stats().rtt.max(), 300);
}

#[test]
fn a_pose_refused_with_e_buf_full_is_sent_again() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut next = trajectory(100);
    let mut count = 0;
    assert_eq!(
        rig.run(|rig| {
            count += 1;
            if count % 20 == 0 {
                // the controller executes no pose for this many cycles
                rig.controller.asleep = 3;
            }
            next(rig)
        }),
        Action::Finished
    );
    assert_eq!(rig.path()[..100], (1..=100).map(|n| smooth(n, 100)).collect::<Vec<_>>());
    let stats = rig.engine.stats();
    assert!((10..=20).contains(&stats.refused), "{}", stats.refused);
    assert_eq!(stats.cycles + stats.refused, u32::try_from(rig.moves).unwrap());
}

#[test]
fn a_controller_whose_buffer_stays_full_ends_the_stream() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        rig.controller.asleep = if count == 10 { 1000 } else { 0 };
        Some(joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, Action::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Stalled, Released::Yes));
    // one second of cycles
    assert!((120..=130).contains(&rig.engine.stats().refused), "{}", rig.engine.stats().refused);
}

#[test]
fn mode_1_leaves_cycles_out_that_were_missed() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    let mut count = 0;
    let mut sent = Vec::new();
    let end = rig.run(|rig| {
        count += 1;
        if count == 11 {
            rig.now = rig.now + Duration::from_millis(30);
        }
        sent.push(rig.now);
        (count <= 20).then(|| joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, Action::Finished);
    assert_eq!(rig.engine.stats().late, 1);
    assert!(rig.engine.stats().jitter.max() >= 22_000);
    // no burst catches up
    let gaps: Vec<_> = sent[12..20].windows(2).map(|pair| pair[1].saturating_since(pair[0])).collect();
    assert!(gaps.iter().all(|gap| *gap == CYCLE), "{gaps:?}");
}

#[test]
fn mode_2_is_paced_by_the_controller_alone() {
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    let mut next = trajectory(100);
    let mut asked = 0;
    let end = rig.run(|rig| {
        asked += 1;
        assert_eq!(rig.engine.poll(rig.now), Action::Pose { deadline: rig.now });
        next(rig)
    });
    assert_eq!((end, asked), (Action::Finished, 101));
    let stats = rig.engine.stats();
    assert!((7_000..=8_300).contains(&stats.rtt.quantile(500)), "{}", stats.rtt.quantile(500));
    assert!(stats.jitter.max() <= 300, "{}", stats.jitter.max());
}

#[test]
fn an_underflow_is_reported_by_its_first_cause() {
    for (mode, watch) in [(Mode::Mode0, None), (Mode::Mode2, Some(WATCH))] {
        let late = |rig: &mut Rig| rig.now = rig.now + Duration::from_millis(60);
        let rig = disturbed(Config { watch, ..config(mode) }, 30, late);
        let fault = rig.fault();
        // the reply to slvMove only says that Slave Mode is off
        assert_eq!((fault.step, fault.cause), (Step::Move, Cause::Refused(HResult::E_SLVMODE_OFF)));
        assert_eq!(fault.code(), Some(HResult::E_COMMAND_BUFFER_EMPTY));
        assert_eq!(fault.errors()[0].text(), "Position command buffer is empty");
        assert_eq!((fault.released, fault.emergency_stop), (Released::Yes, Some(false)));
        assert!(fault.to_string().contains("0x84201482 (E_COMMAND_BUFFER_EMPTY) Position command"), "{fault}");
        assert_eq!((rig.engine.stats().underflows, rig.engine.stats().late), (1, 1));
        // the errors are read over the second connection, if there is one
        let channel = if watch.is_some() { Channel::Watch } else { Channel::Motion };
        assert!(rig.controller.log.contains(&(channel, "GetCurErrorInfo".into())));
        assert!(rig.controller.log.contains(&(Channel::Motion, "slvGetMode".into())));
        assert!(!rig.controller.log.iter().any(|(_, name)| name == "ClearError"));
    }
}

/// A text that does not fit.
const LONG: &str = concat!(
    "J3 command accel limit over, J3 command accel limit over, J3 command accel limit over, ",
    "J3 command accel limit over, J3 command accel limit over, J3 command accel limit over"
);

#[test]
fn the_oldest_errors_are_read_first_up_to_the_maximum() {
    let rig = disturbed(config(Mode::Mode2), 10, |rig| {
        rig.controller.fail(HResult::from_u32(0x8420_4043), LONG);
        for _ in 0..6 {
            rig.controller.fail(HResult::E_COMMAND_BUFFER_EMPTY, "");
        }
    });
    let fault = rig.fault();
    assert_eq!(fault.errors().len(), ERRORS_MAX);
    assert_eq!(fault.code().and_then(HResult::axis), Some(3));
    let text = fault.errors()[0].text();
    assert!(text.starts_with("J3 command accel limit over, J3") && text.ends_with('…') && text.len() >= 158, "{text}");
    assert_eq!(rig.names().iter().filter(|name| **name == "GetCurErrorInfo").count(), ERRORS_MAX);
}

#[test]
fn recovery_happens_on_request_and_starts_at_the_position_of_the_robot() {
    let start = joints(0.0);
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &[0.0; 8]);
    assert_eq!(rig.engine.recover(), Err(RecoverError::NoFault));
    rig.fault_at(20, |rig| rig.controller.fail(HResult::from_u32(0x8420_4051), "J1 command speed limit over"));
    let stopped_at = rig.controller.at[0];
    assert!(stopped_at > 0.0);
    assert_eq!(rig.engine.poll(rig.now), Action::Faulted);
    let asked = rig.controller.log.len();
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| None), Action::Finished);
    let names: Vec<&str> = rig.controller.log[asked..].iter().map(|(_, name)| name.as_str()).collect();
    assert_eq!(names[..2], ["SysState", "ClearError"]);
    assert_eq!(names[2..8], START[..6]);
    assert_eq!(rig.engine.start_pose().unwrap().as_slice()[0], stopped_at);
    assert!(rig.engine.fault().is_none() && rig.controller.errors.is_empty());
}

#[test]
fn a_robot_without_a_finite_position_is_not_moved() {
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let limited = Config { limits: AxisLimits::uniform(10.0, 100.0), ..config(Mode::Mode0) };
        let mut rig = Rig::new(limited, &[0.0, number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.cause, rig.moves), (Step::Position, Cause::NoValue, 0));
        // joints that it does not have may have any value
        let mut rig = Rig::new(limited, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, number, number]);
        assert_eq!(rig.run(|_| None), Action::Finished);
        assert_eq!(*rig.engine.start_pose().unwrap(), joints(0.0));
    }
}

#[test]
fn nan_bounds_are_refused() {
    let nan = |axis: usize| {
        let mut limits = AxisLimits::uniform(10.0, 100.0);
        limits.speed[axis] = f64::NAN;
        limits
    };
    let good = config(Mode::Mode0);
    let acceleration = AxisLimits { acceleration: [f64::NAN; 8], ..AxisLimits::NONE };
    for bad in [
        Config { limits: nan(0), ..good },
        Config { limits: nan(7), ..good },
        Config { limits: acceleration, ..good },
        Config { tolerance: f64::NAN, ..good },
        Config { start: Some(joints(f64::NAN)), ..good },
        Config { start: Some(joints(f64::INFINITY)), ..good },
    ] {
        assert_eq!(Engine::<256>::new(bad).unwrap_err(), ConfigError::Number);
    }
    assert!(Engine::<256>::new(Config { limits: AxisLimits::NONE, ..good }).is_ok(), "infinite limits are valid");
}

#[test]
fn a_stop_during_a_recovery_is_not_forgotten() {
    let mut rig = refused_start(config(Mode::Mode2), "Motor", HResult::from_u32(0x8350_106e));
    rig.engine.recover().unwrap();
    assert!(matches!(rig.engine.poll(rig.now), Action::Call(Step::SystemState, _)));
    rig.engine.stop();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Finished);
    assert_eq!((rig.names().last(), rig.moves), (Some(&"GiveArm"), 0));
    // a stop requested before the fault ends with it
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    rig.controller.script.push(("slvGetMode", refused(HResult::E_FAIL)));
    rig.engine.stop();
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    rig.engine.recover().unwrap();
    let mut poses = 0;
    let _ = rig.run(|_| {
        poses += 1;
        (poses < 3).then(|| joints(0.0))
    });
    assert_eq!(poses, 3);
}

#[test]
fn recovery_is_refused_after_an_emergency_stop() {
    let mut rig = disturbed(config(Mode::Mode2), 20, |rig| {
        rig.controller.system = 1 << 10;
        rig.controller.fail(HResult::from_u32(0x8350_0001), "Emergency stop");
    });
    assert_eq!(rig.fault().emergency_stop, Some(true));
    let (calls, done) = (rig.controller.log.len(), rig.path().len());
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    rig.controller.system = 0;
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    assert_eq!(rig.engine.poll(rig.now), Action::Faulted);
    assert_eq!((rig.controller.log.len(), rig.path().len()), (calls, done));
    // the arm can still be given back
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), Action::Finished);
    assert_eq!(rig.names().last(), Some(&"GiveArm"));
}

#[test]
fn a_later_emergency_stop_prevents_a_recovery() {
    let mut rig = refused_start(config(Mode::Mode2), "Motor", HResult::from_u32(0x8350_106e));
    assert_eq!(rig.fault().code(), Some(HResult::from_u32(0x8350_106e)));
    rig.controller.system = 1 << 10;
    rig.engine.recover().unwrap();
    assert_eq!(rig.run(|_| None), Action::Faulted);
    assert_eq!(rig.fault().cause, Cause::EmergencyStop);
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    assert!(!rig.names().contains(&"ClearError"));
}

#[test]
fn each_refused_step_ends_the_start() {
    let code = HResult::E_ARM_NOT_TAKEN;
    for (command, step) in [
        ("slvSendFormat", Step::SendFormat),
        ("slvRecvFormat", Step::ReceiveFormat),
        ("TakeArm", Step::TakeArm),
        ("Motor", Step::Motor),
        ("CurJnt", Step::Position),
        ("slvChangeMode", Step::Enter),
    ] {
        let rig = refused_start(config(Mode::Mode1), command, code);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.cause, fault.released), (step, Cause::Refused(code), Released::Yes));
        assert_eq!(rig.names().last(), Some(&"SysState"));
        assert_eq!(rig.moves, 0);
    }
}

/// Every call of a start but slvGetMode would end the other stream.
#[test]
fn a_stream_of_another_client_is_left_alone() {
    let mut rig = Rig::new(Config { watch: Some(WATCH), ..config(Mode::Mode0) }, &[0.0; 8]);
    rig.controller.mode = 0x202;
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.step, fault.cause), (Step::GetMode, Cause::Occupied(StreamState::Runs)));
    assert_eq!(
        (fault.to_string().as_str(), fault.released),
        ("slvGetMode: a stream of Slave Mode runs already", Released::No)
    );
    rig.engine.stop();
    assert_eq!(
        (rig.run(|_| None), rig.names(), rig.controller.mode),
        (Action::Finished, ["slvGetMode"].to_vec(), 0x202)
    );
    // a controller that does not say it may have a stream; one without Slave Mode has none
    let rig = refused_start(config(Mode::Mode0), "slvGetMode", HResult::E_FAIL);
    let fault = rig.fault();
    assert_eq!(fault.cause, Cause::Occupied(StreamState::Unknown(HResult::E_FAIL)));
    assert!(fault.to_string().ends_with("so the stream of another client may run"), "{fault}");
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.controller.script.push(("slvGetMode", refused(HResult::E_NOTIMPL)));
    assert_eq!(rig.run(trajectory(10)), Action::Finished);
}

/// A stream that has ended with an error of the controller.
fn faulted(config: Config) -> Rig {
    let fail = |rig: &mut Rig| rig.controller.fail(HResult::from_u32(0x8350_0001), "an error");
    let mut rig = disturbed(config, 20, fail);
    rig.controller.log.clear();
    rig
}

#[test]
fn after_a_fault_the_robot_is_halted_and_the_motor_switched_off_before_the_arm_is_given_back() {
    let mut rig = faulted(config(Mode::Mode2));
    assert_eq!(rig.engine.effects(), Effects { moving: true, motor: true, ..Effects::default() });
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), Action::Finished);
    assert_eq!(rig.names(), ["Robot_Halt", "Motor", "GiveArm"]);
    assert!(!rig.controller.motor && !rig.controller.arm);
    assert_eq!(rig.engine.effects(), Effects::default());
}

#[test]
fn a_motor_that_is_to_stay_on_is_not_switched_off() {
    let config = Config { motor_off: false, ..config(Mode::Mode0) };
    let mut rig = Rig::new(config, &[0.0; 8]);
    assert_eq!(rig.run(trajectory(20)), Action::Finished);
    assert_eq!((rig.names().last(), rig.controller.motor), (Some(&"GiveArm"), true));
    let mut rig = faulted(config);
    rig.engine.stop();
    assert_eq!((rig.run(|_| None), rig.names()), (Action::Finished, ["Robot_Halt", "GiveArm"].to_vec()));
    assert_eq!(rig.engine.effects(), Effects::default());
}

#[test]
fn a_refused_step_of_the_end_prevents_none_after_it() {
    for (refuses, left) in [
        ("Robot_Halt", Effects { moving: true, ..Effects::default() }),
        ("Motor", Effects { motor: true, ..Effects::default() }),
        ("GiveArm", Effects::default()),
    ] {
        let mut rig = faulted(config(Mode::Mode2));
        let before = rig.fault().to_string();
        rig.controller.script.push((refuses, refused(HResult::E_FAIL)));
        rig.engine.stop();
        assert_eq!(rig.run(|_| None), Action::Faulted, "{refuses}");
        assert_eq!(rig.names(), ["Robot_Halt", "Motor", "GiveArm"]);
        assert_eq!((rig.fault().to_string(), rig.engine.effects()), (before, left));
        // again, only the missing step
        rig.controller.log.clear();
        rig.engine.stop();
        rig.controller.arm = true;
        assert_eq!((rig.run(|_| None), rig.names()), (Action::Finished, [refuses].to_vec()));
    }
}

#[test]
fn a_motor_that_stays_on_at_the_end_of_a_stream_is_a_fault() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    let mut poses = trajectory(20);
    let end = rig.run(|rig| {
        let pose = poses(rig);
        if pose.is_none() {
            rig.controller.script.push(("Motor", refused(HResult::E_FAIL)));
        }
        pose
    });
    assert_eq!(end, Action::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.step, fault.cause), (Step::MotorOff, Cause::Refused(HResult::E_FAIL)));
    assert!(rig.controller.motor && !rig.controller.arm);
    assert_eq!(rig.engine.effects(), Effects { motor: true, ..Effects::default() });
}

#[test]
fn a_stream_that_begins_during_the_start_is_left_alone() {
    for (command, step) in [("TakeArm", Step::TakeArm), ("slvChangeMode", Step::Enter)] {
        let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
        rig.controller.script.push((command, refused(HResult::E_ARM_NOT_TAKEN)));
        rig.controller.script.push(("slvGetMode", ok(&0)));
        rig.controller.script.push(("slvGetMode", ok(&0x102)));
        assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
        let fault = rig.fault();
        assert_eq!((fault.step, fault.released), (step, Released::No));
        assert_eq!(rig.names().last(), Some(&"slvGetMode"));
        rig.engine.stop();
        assert_eq!((rig.run(|_| None), rig.names().last()), (Action::Finished, Some(&"slvGetMode")));
    }
}

#[test]
fn an_arm_whose_taking_has_no_reply_is_given_back() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    loop {
        let Action::Call(step, _) = rig.engine.poll(rig.now) else { panic!("no call") };
        if step == Step::TakeArm {
            break rig.engine.handle_failure(Failure::Timeout, rig.now);
        }
        rig.call();
    }
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    rig.engine.stop();
    assert_eq!((rig.run(|_| None), rig.names().last()), (Action::Finished, Some(&"GiveArm")));
}

#[test]
fn a_lost_connection_is_diagnosed_over_the_other_one() {
    let mut rig = Rig::new(Config { watch: Some(WATCH), ..config(Mode::Mode0) }, &[0.0; 8]);
    rig.failures.push((20, Failure::Lost));
    rig.fault_at(0, |_| {});
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Failed(Failure::Lost), Released::Yes));
    let after: Vec<_> = rig.controller.log.iter().skip_while(|(channel, _)| *channel == Channel::Motion).collect();
    assert!(after.iter().all(|(channel, _)| *channel == Channel::Watch));
    assert_eq!(after[0].1, "slvGetMode");
    assert_eq!(after[1].1, "slvChangeMode");
    assert_eq!(rig.engine.recover(), Err(RecoverError::Lost));
    rig.engine.stop();
    assert_eq!(rig.engine.poll(rig.now), Action::Finished);
}

#[test]
fn without_a_connection_the_state_is_unknown() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.failures.push((20, Failure::Lost));
    assert_eq!(rig.run(trajectory(100)), Action::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.released, fault.emergency_stop, fault.code()), (Released::Unknown, None, None));
    assert_eq!(fault.to_string(), "slvMove: the connection is lost");
}

#[test]
fn a_call_without_a_reply_ends_slave_mode() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    rig.failures.push((20, Failure::Timeout));
    assert_eq!(rig.run(trajectory(100)), Action::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Failed(Failure::Timeout), Released::Yes));
    assert_eq!(rig.controller.mode, 0);
    assert_eq!(rig.names()[7..9], ["slvGetMode", "slvChangeMode"]);
    assert_eq!(rig.moves, 20);
}

#[test]
fn a_reply_of_another_format_ends_the_stream() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.controller.script.push(("slvMove", ok(&[0.0; 7])));
    assert_eq!(rig.run(trajectory(10)), Action::Faulted);
    let kind = MoveReplyErrorKind::Length { expected: 8, found: 7 };
    assert_eq!(rig.fault().cause, Cause::Reply(MoveReplyError { part: ReplyPart::Pose, kind }));
    assert_eq!((rig.controller.mode, rig.moves), (0, 1));
}

#[test]
fn a_robot_that_is_not_at_the_start_is_not_moved() {
    let start = Pose::j([10.0, 20.0, 30.0, 0.0, 0.0, 0.0, 99.0, 99.0]);
    let at = [10.0, 20.04, 30.5, 0.0, 0.0, 0.0, 1e-307, 3e-313];
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &at);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), Action::Faulted);
    let fault = rig.fault();
    assert_eq!(fault.cause, Cause::NotAtStart { number: 3, actual: 30.5, expected: 30.0 });
    assert_eq!((rig.names().last(), rig.controller.mode), (Some(&"CurJnt"), 0));
    // within the tolerance, with any value of joints that the robot does not have
    let at = [10.0, 20.04, 29.96, 0.0, 0.0, 0.0, 1e-307, 3e-313];
    let mut rig = Rig::new(Config { start: Some(start), ..config(Mode::Mode0) }, &at);
    assert_eq!(rig.run(|_| None), Action::Finished);
    assert_eq!(rig.engine.start_pose(), Some(&start));
    assert_eq!(rig.names(), [&START[..], &["Motor", "GiveArm"]].concat());
}

#[test]
fn poses_beyond_the_limits_are_refused_with_axis_and_values() {
    let limits = AxisLimits { speed: [100.0; 8], acceleration: [5000.0; 8] };
    let mut rig = Rig::new(Config { limits, ..config(Mode::Mode2) }, &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        match count {
            // from rest, 0.4 degrees in 8 ms are 6250 deg/s^2
            1 => {
                let error = rig.engine.push(&Pose::j([0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap_err();
                let PoseError::Acceleration { axis: 3, acceleration, limit: 5000.0 } = error else {
                    panic!("{error:?}")
                };
                assert!((acceleration - 6250.0).abs() < 1e-6);
            }
            2 => {
                let error = rig.engine.push(&joints(1.0)).unwrap_err();
                assert_eq!(
                    error.to_string(),
                    "axis 1 would move at 125 per second, its limit is 100: put the poses closer"
                );
            }
            3 => {
                let error = rig.engine.push(&Pose::j([0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap_err();
                assert_eq!(error, PoseError::NotFinite { number: 2 });
                let error = rig.engine.push(&spec_pose()).unwrap_err();
                assert!(matches!(error, PoseError::Format(FormatError::Shape { .. })));
            }
            _ => {}
        }
        (count <= 10).then(|| joints(0.0))
    });
    assert_eq!(end, Action::Finished);
    assert!(rig.path().iter().all(|joint| *joint == 0.0));
}

#[test]
fn a_stop_in_motion_slows_down_within_the_limits() {
    let limits = AxisLimits { speed: [120.0; 8], acceleration: [1000.0; 8] };
    for (mode, ramp) in [(Mode::Mode0, 0), (Mode::Mode1, 100), (Mode::Mode2, 400)] {
        let ramp = Duration::from_millis(ramp);
        let mut rig = Rig::new(Config { limits, ramp, ..config(mode) }, &[0.0; 8]);
        let (mut at, mut speed, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|_| {
            count += 1;
            speed = f64::min(speed + 0.06, 0.9);
            at += speed;
            (count <= 60).then(|| joints(at))
        });
        assert_eq!(end, Action::Finished);
        let path = rig.path();
        let speeds: Vec<f64> = path.windows(2).map(|pair| (pair[1] - pair[0]) / 0.008).collect();
        let hardest = speeds.windows(2).map(|pair| ((pair[1] - pair[0]) / 0.008).abs()).fold(0.0, f64::max);
        assert!(hardest <= 1000.0, "{hardest}");
        assert_eq!(speeds.last(), Some(&0.0));
        let slowing = speeds[59..].iter().filter(|speed| **speed > 0.0).count();
        // 112.5 deg/s at 900 deg/s^2 are 125 ms
        let least = ramp.as_millis().max(125) / 8;
        assert!((least - 1..=least + 1).contains(&u128::try_from(slowing).unwrap()), "{slowing}");
    }
}

#[test]
fn a_stop_before_the_first_pose_moves_nothing() {
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    assert_eq!(rig.run(|_| None), Action::Finished);
    assert_eq!((rig.moves, rig.names()), (0, [&START[..], &["Motor", "GiveArm"]].concat()));
    // also before Slave Mode is entered
    let mut rig = Rig::new(config(Mode::Mode2), &[0.0; 8]);
    let _ = rig.engine.poll(rig.now);
    rig.engine.stop();
    assert_eq!(rig.run(|_| None), Action::Finished);
    assert_eq!(rig.names(), ["slvGetMode"]);
}

#[test]
fn the_stop_waits_for_a_robot_that_still_moves() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        if count == 11 {
            // the replies lag for a while
            for n in (1..=20).rev() {
                rig.controller.script.insert(0, ("slvMove", ok(&[f64::from(n), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
            }
        }
        (count <= 10).then(|| joints(f64::from(count) * 1e-3))
    });
    assert_eq!(end, Action::Finished);
    assert!((10 + 20..10 + 25).contains(&rig.moves), "{}", rig.moves);
    // joints that the robot does not have may have any value
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    for n in 0..30 {
        rig.controller.script.push(("slvMove", ok(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f64::from(n), f64::NAN])));
    }
    assert_eq!(rig.run(trajectory(10)), Action::Finished);
    assert!(rig.moves < 20, "{}", rig.moves);
}

#[test]
fn cartesian_streams_wrap_angles_and_command_extended_joints() {
    let axes = |j8| Extended::Eight(j8);
    let format = Format { extended: ExtendedAxes::Eight, ..format(Mode::Mode2, PoseType::P) };
    let limits = AxisLimits::uniform(100.0, 20_000.0);
    let at = [300.0, 0.0, 200.0, 179.9, 0.0, 180.0, 5.0];
    let config = Config { limits, ramp: Duration::from_millis(40), ..Config::new(format, HANDLES) };
    let mut rig = Rig::new(config, &at);
    rig.controller.script.push(("CurJnt", ok(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 40.0])));
    for _ in 0..100 {
        rig.controller.script.push(("slvMove", ok(&[0.0; 8])));
    }
    let mut count = 0;
    let mut last = None;
    let end = rig.run(|rig| {
        count += 1;
        last = Some(*rig.engine.last_pose());
        let angle = 179.9 + f64::from(count) * 0.1;
        let angle = if angle > 180.0 { angle - 360.0 } else { angle };
        let pose = Pose::p([300.0, 0.0, 200.0, angle, 0.0, 180.0, 5.0]);
        (count <= 5).then(|| pose.with_extended(axes(40.0 + f64::from(count) * 0.2)))
    });
    assert_eq!(end, Action::Finished);
    assert_eq!(rig.names()[5..7], ["CurPos", "CurJnt"]);
    assert_eq!(rig.engine.start_pose(), Some(&Pose::p(at).with_extended(axes(40.0))));
    let (last, end) = (last.unwrap(), *rig.engine.last_pose());
    assert!((last.as_slice()[3] + 179.6).abs() < 1e-9);
    // a ramp of 40 ms: 0.8 + 0.6 + 0.4 + 0.2 of the last step
    assert!((end.as_slice()[3] - last.as_slice()[3] - 0.2).abs() < 1e-9, "{end:?}");
    assert!((end.as_slice()[8] - last.as_slice()[8] - 0.4).abs() < 1e-9, "{end:?}");
    assert_eq!(end.as_slice()[6..8], [5.0, 4_194_432.0]);
}

#[test]
fn transforms_keep_their_vectors_at_length_one() {
    let (sin, cos) = (0.02_f64.sin(), 0.02_f64.cos());
    let before = Pose::t([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 5.0]);
    let now = Pose::t([1.0, 0.0, 0.0, cos, sin, 0.0, 0.0, 0.0, 1.0, 5.0]);
    let next = now.shifted(&now.since(&before));
    let [_, _, _, o1, o2, o3, a1, a2, a3, fig] = next.as_slice().try_into().unwrap();
    assert_eq!((next.as_slice()[0], fig), (2.0, 5.0));
    assert!((o1 * o1 + o2 * o2 + o3 * o3 - 1.0_f64).abs() < 1e-12);
    assert!((a1 * a1 + a2 * a2 + a3 * a3 - 1.0_f64).abs() < 1e-12);
    assert!((o2 - 0.04_f64.sin()).abs() < 1e-4);
}

#[test]
fn an_inconsistent_configuration_is_refused() {
    let wrong = Config { start: Some(spec_pose()), ..config(Mode::Mode0) };
    assert_eq!(
        Engine::<256>::new(wrong).unwrap_err().to_string(),
        "the start of the stream: the format has poses of type J, this pose is P"
    );
    let wrong = Config { cycle: Duration::ZERO, ..config(Mode::Mode0) };
    assert_eq!(Engine::<256>::new(wrong).unwrap_err(), ConfigError::Cycle);
    assert!(matches!(Engine::<64>::new(config(Mode::Mode0)).unwrap_err(), ConfigError::Frame(_)));
}

#[test]
fn unrequested_input_changes_nothing() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    assert_eq!(rig.engine.push(&joints(0.0)), Err(PoseError::NotNow));
    assert!(rig.engine.request().is_none());
    rig.engine.handle_failure(Failure::Lost, rig.now);
    assert_eq!(rig.engine.poll(rig.now), Action::Call(Step::GetMode, Channel::Motion));
    // polling again returns the same call
    assert_eq!(rig.engine.poll(rig.now), Action::Call(Step::GetMode, Channel::Motion));
    assert_eq!(rig.run(trajectory(5)), Action::Finished);
    assert_eq!(rig.engine.poll(rig.now), Action::Finished);
    assert_eq!(rig.names().iter().filter(|name| **name == "slvGetMode").count(), 1);
}

#[test]
fn finishing_ends_in_the_last_pose_if_the_limits_allow_it() {
    for (acceleration, ends) in [(f64::INFINITY, true), (100.0, false)] {
        let limits = AxisLimits { speed: [f64::INFINITY; 8], acceleration: [acceleration; 8] };
        let mut rig = Rig::new(Config { limits, ramp: Duration::from_secs(1), ..config(Mode::Mode2) }, &[0.0; 8]);
        let (mut at, mut speed, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|rig| {
            count += 1;
            speed += 0.005;
            at += speed;
            if count > 10 {
                rig.engine.finish();
            }
            (count <= 10).then(|| joints(at))
        });
        assert_eq!(end, Action::Finished);
        let (last, commanded) = (rig.engine.last_pose().as_slice()[0], 0.005 * 55.0);
        assert_eq!((last - commanded).abs() < 1e-12, ends, "{last}");
    }
}
