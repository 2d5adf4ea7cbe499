//! Fuzzes an engine of Slave Mode with arbitrary replies, failures, poses and times.

use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::call::{Call, ControllerHandle, RobotHandle};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::slave::{
    AxisLimits, Channel, Config, Engine, EngineAction, ExtendedAxes, Failure, Format, Handles, Mode, Pose, PoseType,
    ReceiveFormat, ReceivePose, SendFormat, SendIo, SlaveMode, Step, TimeUnit,
};
use bcap_core::time::Instant;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::{VARIANT, Value};

/// The configuration of the stream and of the robot.
#[derive(Arbitrary, Debug)]
struct Plan {
    mode: u8,
    receive: u8,
    parts: u8,
    options: u8,
    speed: u8,
}

/// An operation.
#[derive(Arbitrary, Debug)]
enum Op {
    /// The controller executes the call; the robot is at this position, in hundredths.
    Obey(i16),
    /// The controller answers with one of the codes that the engine distinguishes.
    Answer(u8),
    /// The controller answers with any code.
    Any(i32, Value),
    Value(Value),
    /// The call fails without an answer.
    Fail(u8),
    /// A pose near the last pose, by hundredths of an axis's maximum motion in a cycle.
    Push([i8; 10]),
    /// Any pose of any kind.
    PushAny(u8, Vec<f64>),
    Stop,
    Finish,
    Recover,
    Pass(u16),
    /// This many steps of a regular stream, a few for each cycle.
    Stream(u8),
}

const ROBOT: f64 = 0.0;
const CYCLE: Duration = Duration::from_millis(8);

/// Runs an engine through the operations that the bytes encode.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn slave(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let Ok(plan) = Plan::arbitrary(&mut u) else { return };
    let mut run = Run::new(&plan);
    while let (false, Ok(op)) = (u.is_empty(), Op::arbitrary(&mut u)) {
        run.apply(op);
        let _ = run.poll();
    }
    run.finish(plan.options);
}

struct Run {
    engine: Engine,
    now: Instant,
    /// The requested call without an answer.
    flight: Option<(Step, Channel)>,
    /// Slave Mode was entered and not left.
    entered: bool,
    /// A call failed, and the stream was not restarted.
    failed: bool,
    /// The restart after a failure is in progress.
    recovering: bool,
    /// The last call was refused because the controller executes an earlier one.
    is_busy: bool,
}

fn config(plan: &Plan) -> Config {
    let pick = |of: u8, count: u8| usize::from(of % count);
    let mode = SlaveMode {
        mode: [Mode::Mode0, Mode::Mode1, Mode::Mode2][pick(plan.mode, 3)],
        pose: [PoseType::P, PoseType::J, PoseType::T][pick(plan.mode / 3, 3)],
    };
    let receive = ReceiveFormat {
        pose: [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ][pick(plan.receive, 5)],
        time: [None, Some(TimeUnit::Millis), Some(TimeUnit::Micros)][pick(plan.receive / 5, 3)],
        mini_io: plan.parts & 1 != 0,
        user_io: None,
        hand_io: plan.parts & 2 != 0,
        current: plan.parts & 4 != 0,
    };
    let send =
        SendFormat { io: if plan.parts & 8 == 0 { SendIo::None } else { SendIo::Mini }, hand_io: plan.parts & 16 != 0 };
    let extended =
        [ExtendedAxes::None, ExtendedAxes::Seven, ExtendedAxes::Eight, ExtendedAxes::Both][pick(plan.parts / 32, 4)];
    let extended = if mode.pose == PoseType::J { ExtendedAxes::None } else { extended };
    let motion = Handles { controller: ControllerHandle(1), robot: RobotHandle(2) };
    let watch = Handles { controller: ControllerHandle(3), robot: RobotHandle(4) };
    let speed = f64::from(plan.speed) * 10.0;
    Config {
        watch: (plan.options & 1 != 0).then_some(watch),
        arm: (plan.options & 2 != 0).then_some([0, 1]),
        motor: plan.options & 4 != 0,
        limits: if plan.speed == 0 { AxisLimits::NONE } else { AxisLimits::uniform(speed, 10.0 * speed) },
        cycle: CYCLE,
        ..Config::new(Format { mode, extended, send, receive }, motion)
    }
}

impl Run {
    fn new(plan: &Plan) -> Self {
        let engine = Engine::new(config(plan)).expect("the configuration is valid");
        let now = Instant::from_millis(1);
        Self { engine, now, flight: None, entered: false, failed: false, recovering: false, is_busy: false }
    }

    fn apply(&mut self, op: Op) {
        match op {
            Op::Obey(hundredths) => self.obey(f64::from(hundredths) / 100.0),
            Op::Answer(index) => {
                const CODES: [HResult; 8] = [
                    HResult::S_OK,
                    HResult::S_BUF_FULL,
                    HResult::E_BUF_FULL,
                    HResult::E_COMMAND_BUFFER_EMPTY,
                    HResult::E_SLVMODE_OFF,
                    HResult::E_TIMEOUT,
                    HResult::S_EXECUTING,
                    HResult::E_FAIL,
                ];
                let value = self.flight.map_or(Value::Empty, |(step, _)| self.value(step, ROBOT));
                self.reply(CODES[usize::from(index) % CODES.len()], value);
            }
            Op::Any(code, value) => self.reply(HResult(code), value),
            Op::Value(value) => self.reply(HResult::S_OK, value),
            Op::Fail(index) => {
                self.fail([Failure::Timeout, Failure::NotSent, Failure::Lost][usize::from(index % 3)]);
            }
            Op::Push(steps) => self.push_near_last(steps),
            Op::PushAny(kind, numbers) => {
                let kind = [PoseType::P, PoseType::J, PoseType::T][usize::from(kind % 3)];
                if let Some(pose) = Pose::from_numbers(kind, &numbers) {
                    self.push(&pose);
                }
            }
            Op::Stop => self.engine.stop(),
            Op::Finish => self.engine.finish(),
            Op::Recover => {
                let stopped = self.engine.fault().and_then(|fault| fault.emergency_stop) == Some(true);
                if self.engine.recover().is_ok() {
                    assert!(self.failed && self.flight.is_none() && !stopped);
                    (self.failed, self.recovering, self.entered) = (false, true, false);
                }
            }
            Op::Pass(millis) => self.now = self.now + Duration::from_millis(u64::from(millis)),
            Op::Stream(cycles) => {
                for _ in 0..cycles {
                    self.run_engine();
                }
            }
        }
    }

    /// Polls the engine, and checks that its action is allowed.
    fn poll(&mut self) -> EngineAction {
        let action = self.engine.poll(self.now);
        let call = match action {
            EngineAction::Call(step, channel) => Some((step, channel)),
            _ => None,
        };
        if self.flight.is_some() {
            assert_eq!(call, self.flight, "the engine requests a call until it is answered");
            return action;
        }
        match action {
            EngineAction::Call(step, channel) => self.check_call(step, channel),
            EngineAction::Pose { .. } => assert!(self.entered && !self.failed),
            EngineAction::Wait(until) => assert!(until > self.now && (self.is_busy || (self.entered && !self.failed))),
            EngineAction::Finished => {}
            EngineAction::Faulted => assert!(self.failed && self.engine.fault().is_some()),
        }
        assert_eq!(self.engine.request().is_some(), call.is_some());
        self.flight = call;
        action
    }

    fn check_call(&self, step: Step, channel: Channel) {
        assert!(channel == Channel::Motion || self.engine.config().watch.is_some());
        let may = match step {
            // the robot must not move after an error
            Step::Move => self.entered && !self.failed,
            Step::Motor | Step::TakeArm | Step::Enter => !self.failed && !self.entered,
            Step::ClearError => self.recovering && !self.failed,
            _ => true,
        };
        assert!(may, "{step:?}: entered {}, failed {}", self.entered, self.failed);
        let request = self.engine.request().expect("the engine requests a call");
        assert_eq!((request.step(), request.channel()), (step, channel));
        let mut buffer = [0; 512];
        let mut frame = FrameWriter::new(&mut buffer).expect("there is room");
        request.arguments(&mut frame).expect("the arguments fit");
        let bytes = frame.finish(7, 0, request.function().0).expect("the frame fits");
        let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: false };
        let Verdict::Frame(frame, used) = oracle.decode(bytes) else {
            panic!("the call is not a valid frame: {bytes:02x?}")
        };
        let count = if step == Step::Halt { 2 } else { 3 };
        assert_eq!((used, frame.args.len()), (bytes.len(), count));
        if step == Step::Move {
            assert!(self.engine.last_pose().as_slice().iter().all(|number| number.is_finite()));
        }
    }

    /// Delivers an answer, and checks that it counts only for a call in flight.
    fn reply(&mut self, code: HResult, value: Value) {
        let wire = TestFrame { serial: 7, reserved: 0, code: code.0, args: vec![value] }.to_wire(false);
        let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(&wire) else { return };
        let answered = self.engine.handle_reply(&frame, self.now).is_some();
        let Some((step, _)) = self.flight.take() else {
            assert!(!answered, "an answer without a call");
            return;
        };
        assert!(!answered || (step == Step::Move && code.is_ok()));
        let full = step == Step::Move && code == HResult::E_BUF_FULL;
        self.failed |= self.engine.fault().is_some() && !self.recovering;
        self.is_busy = code == HResult::E_BUSY_PROC;
        // a recovery continues after refusals of slvGetMode that mean that no stream runs
        if code.is_err() && !full && !(step == Step::GetMode && self.recovering) {
            (self.failed, self.recovering) = (true, false);
        }
        match step {
            Step::Enter => self.entered = code.is_ok(),
            Step::Leave => self.entered &= code.is_err(),
            Step::ClearError => self.recovering = false,
            Step::GetMode | Step::SystemState if self.recovering => {
                // the stream of another client, an emergency stop, or an answer without a state, ends the recovery
                let expected = if step == Step::GetMode { Step::SystemState } else { Step::ClearError };
                let next = self.engine.poll(self.now);
                self.flight = match next {
                    EngineAction::Call(step, channel) => Some((step, channel)),
                    _ => None,
                };
                if self.flight.is_none_or(|(step, _)| step != expected) {
                    (self.failed, self.recovering) = (true, false);
                }
            }
            _ => {}
        }
    }

    fn fail(&mut self, failure: Failure) {
        self.engine.handle_failure(failure, self.now);
        if self.flight.take().is_some() {
            (self.failed, self.recovering) = (true, false);
        }
    }

    /// Lets the controller execute the call; every axis of the robot is at `position`.
    fn obey(&mut self, position: f64) {
        if let Some((step, _)) = self.flight {
            let value = self.value(step, position);
            self.reply(HResult::S_OK, value);
        }
    }

    /// Returns the value of a successful reply.
    fn value(&self, step: Step, position: f64) -> Value {
        let numbers = |count: usize| Value::Array(5, vec![Value::R8(position.to_bits()); count]);
        let format = &self.engine.config().format;
        match step {
            Step::Position => numbers(format.mode.pose.len()),
            Step::Joints => numbers(PoseType::J.len()),
            Step::GetMode => Value::I4(if self.entered { format.mode.code() } else { SlaveMode::OFF }),
            Step::ErrorCount | Step::SystemState => Value::I4(0),
            Step::Move => {
                let receive = &format.receive;
                let mut parts = Vec::new();
                parts.extend(receive.time.map(|_| Value::I4(7)));
                parts.push(numbers(receive.pose.len()));
                parts.extend(receive.mini_io.then_some(Value::I4(1)));
                parts.extend(receive.hand_io.then_some(Value::I4(2)));
                parts.extend(receive.current.then(|| numbers(8)));
                if parts.len() == 1 { parts.remove(0) } else { Value::Array(VARIANT, parts) }
            }
            _ => Value::Empty,
        }
    }

    /// Pushes a pose, and checks whether the engine may accept it.
    fn push(&mut self, pose: &Pose) {
        let before = *self.engine.last_pose();
        let wanted = self.flight.is_none() && matches!(self.engine.poll(self.now), EngineAction::Pose { .. });
        if !wanted {
            // the next poll checks the action that the engine requests instead
            if self.flight.is_none() {
                let _ = self.poll();
            }
            assert!(self.engine.push(pose).is_err(), "the engine requested no pose");
            return;
        }
        match self.engine.push(pose) {
            Ok(()) => {
                assert_eq!(self.engine.last_pose(), pose);
                assert!(pose.as_slice().iter().all(|number| number.is_finite()));
                let limits = self.engine.config().limits;
                if pose.layout().pose == PoseType::J {
                    for ((from, to), limit) in before.as_slice().iter().zip(pose.as_slice()).zip(limits.speed) {
                        assert!((to - from).abs() / CYCLE.as_secs_f64() <= limit, "{from} to {to}");
                    }
                }
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                assert_eq!(self.engine.last_pose(), &before);
            }
        }
    }

    fn push_near_last(&mut self, steps: [i8; 10]) {
        let last = *self.engine.last_pose();
        let speed = self.engine.config().limits.speed[0].min(1000.0);
        let part = speed * CYCLE.as_secs_f64() / 100.0;
        let mut numbers = last.numbers().to_vec();
        for (number, step) in numbers.iter_mut().zip(steps) {
            *number += f64::from(step) * part;
        }
        if let Some(pose) = Pose::from_numbers(last.layout().pose, &numbers) {
            self.push(&pose);
        }
    }

    /// Performs one step of a regular stream.
    fn run_engine(&mut self) {
        match self.poll() {
            EngineAction::Call(..) => self.obey(ROBOT),
            EngineAction::Pose { .. } => {
                let last = *self.engine.last_pose();
                self.push(&last);
            }
            EngineAction::Wait(until) => self.now = until,
            EngineAction::Finished | EngineAction::Faulted => {}
        }
    }

    /// Checks that a stream ends when requested: with a controller that executes calls, that does not answer, or whose
    /// buffer stays full.
    fn finish(mut self, options: u8) {
        self.engine.stop();
        for _ in 0..5000 {
            match self.poll() {
                EngineAction::Call(..) if options & 8 != 0 => self.fail(Failure::Timeout),
                EngineAction::Call(Step::Move, _) if options & 16 != 0 => {
                    self.now = self.now + Duration::from_millis(50);
                    self.reply(HResult::E_BUF_FULL, Value::Empty);
                }
                EngineAction::Call(..) => self.obey(ROBOT),
                EngineAction::Pose { .. } => panic!("the engine requests a pose after the end was requested"),
                EngineAction::Wait(until) => self.now = until,
                EngineAction::Finished | EngineAction::Faulted => return,
            }
        }
        panic!("the stream does not end");
    }
}
