//! The engine against a scripted controller, under a simulated clock.

#![expect(clippy::arithmetic_side_effects, reason = "a test in which a sum overflows fails, as it should")]

mod diagnosis;
mod motion;
mod release;
mod start;

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

    /// Sends the engine's call through the bytes of a client.
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
    fn run(&mut self, mut next: impl FnMut(&mut Self) -> Option<Pose>) -> EngineAction {
        for _ in 0..20_000 {
            match self.engine.poll(self.now) {
                EngineAction::Call(..) => self.call(),
                EngineAction::Wait(until) => self.now = self.now.max(until),
                EngineAction::Pose { .. } => match next(self) {
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
        assert_eq!(end, EngineAction::Faulted);
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
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    rig
}

const START: [&str; 8] =
    ["slvGetMode", "slvSendFormat", "slvRecvFormat", "TakeArm", "Motor", "CurJnt", "slvChangeMode", "slvChangeMode"];
