//! A virtual controller and its clients without sockets: calls go directly to the handler, and the caller moves the clock.
//!
//! The fuzz target `sim` and the property test in `tests/tests/invariants.rs` use it. [`World::check`] asserts the
//! invariants after every step, [`World::finish`] the invariants after the last step.

use std::collections::BTreeMap;
use std::time::Duration;

use bcap_core::bcap::server::{Handler as _, Request};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Object, Progress};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};
use bcap_sim::kinematics::RANGES;
use bcap_sim::{Config, Controller, Profile, Scenario, hand};

/// The number of clients; their indices are below this.
pub const CLIENTS: u32 = 3;
/// The number of objects that each client may open.
const MAX_OBJECTS: usize = 10;
/// Bytes of the largest request and of the largest reply.
const BUFFER: usize = 8192;
/// The decoder of requests; it accepts values as deep as the core allows.
const DECODER: Decoder = Decoder { limits: Limits { depth: MAX_DEPTH, ..Limits::STREAM }, ..Decoder::TCP };

/// The trace of a run: the outcome of every call, and the bytes of its value.
pub type Trace = Vec<(Outcome, Vec<u8>)>;

/// A controller, its clients and the time.
#[derive(Debug)]
pub struct World {
    /// The controller.
    pub sim: Controller,
    /// The time.
    pub now: Instant,
    /// The waiting request of each client that has one.
    waiting: BTreeMap<u32, Vec<u8>>,
    /// The latest handle of each kind that each client received.
    handles: BTreeMap<(u32, &'static str), i32>,
    trace: Trace,
}

impl World {
    /// Starts a controller with a scenario, and opens a session for each client.
    #[must_use]
    pub fn new(profile: Profile, scenario: &Scenario) -> Self {
        let config = Config { max_objects: MAX_OBJECTS, motor_on_delay: Duration::ZERO, ..Config::new(profile) };
        let mut world = Self {
            sim: Controller::new(config),
            now: Instant::ZERO,
            waiting: BTreeMap::new(),
            handles: BTreeMap::new(),
            trace: Trace::new(),
        };
        world.sim.play(scenario.clone());
        (0..CLIENTS).for_each(|peer| world.open(peer));
        world
    }

    /// Opens a session with a controller, a robot, a task, a variable, an extension and a command.
    fn open(&mut self, peer: u32) {
        let provider = self.sim.config().model.provider.clone();
        self.request(peer, FunctionId::SERVICE_START, &[&""]);
        self.request(peer, FunctionId::CONTROLLER_CONNECT, &[&"", &provider, &"", &""]);
        let controller = self.handle(peer, Object::Controller);
        for (function, name) in [
            (FunctionId::CONTROLLER_GET_ROBOT, "Arm"),
            (FunctionId::CONTROLLER_GET_TASK, "Pro1"),
            (FunctionId::CONTROLLER_GET_VARIABLE, "P1"),
            (FunctionId::CONTROLLER_GET_EXTENSION, "Hand0"),
            (FunctionId::CONTROLLER_GET_COMMAND, "Motor"),
        ] {
            self.request(peer, function, &[&controller, &name, &""]);
        }
    }

    /// Returns the latest handle of this kind that the client received; 0 without one.
    #[must_use]
    pub fn handle(&self, peer: u32, object: Object) -> i32 {
        self.handles.get(&(peer, object.name())).copied().unwrap_or(0)
    }

    /// Sends a call. Skips calls that a server would refuse, that do not fit into a frame, or whose client has a waiting call.
    pub fn request(&mut self, peer: u32, function: FunctionId, arguments: &[&dyn Encode]) {
        if let (false, Some(bytes)) = (self.waiting.contains_key(&peer), frame(function, arguments)) {
            self.call(peer, &bytes, false);
        }
    }

    /// Resumes the waiting call of a client.
    pub fn resume(&mut self, peer: u32) {
        if let Some(bytes) = self.waiting.remove(&peer) {
            self.call(peer, &bytes, true);
        }
    }

    fn call(&mut self, peer: u32, bytes: &[u8], resumed: bool) {
        let Ok(Progress::Complete(frame, _)) = DECODER.decode(bytes) else { panic!("{:?}", DECODER.decode(bytes)) };
        let function = frame.function();
        let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
        if kinds.len() != frame.args.len() || !frame.args.iter().zip(kinds).all(|(value, kind)| kind.accepts(&value)) {
            return;
        }
        let request = Request::new(function, frame.args);
        let mut buffer = vec![0; BUFFER];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = match resumed {
            false => self.sim.call(PeerId(peer), &request, &mut reply, self.now),
            true => self.sim.resume(PeerId(peer), &request, &mut reply, self.now),
        };
        if let Some(value) = reply.get() {
            assert_eq!(Variant::decode(reply.as_bytes(), &DECODER.limits, Strictness::Strict), Ok(value));
        }
        match outcome {
            Outcome::Wait(at) => {
                assert!(at > self.now, "{function:?} waits until {at}, which is not after {}", self.now);
                self.waiting.insert(peer, bytes.to_vec());
            }
            Outcome::Done(code) => {
                if let (HResult::S_OK, Some(object), Some(value)) = (code, function.opens(), reply.get()) {
                    let Variant::I4(handle @ 2..) = value else { panic!("{value:?} is not a valid handle") };
                    self.handles.insert((peer, object.name()), handle);
                }
            }
        }
        self.trace.push((outcome, reply.as_bytes().to_vec()));
    }

    /// Sends a request over RAC.
    pub fn rac(&mut self, request: &rac::Request<'_>) {
        let mut buffer = vec![0; BUFFER];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = rac::server::Handler::call(&mut self.sim, PeerId(9), request, &mut reply, self.now);
        self.trace.push((outcome, reply.as_bytes().to_vec()));
    }

    /// Takes the arm, switches its motor on and moves it; each call may fail.
    pub fn move_arm(&mut self, peer: u32, interpolation: i32, pose: &dyn Encode, option: &str) {
        let robot = self.take_arm(peer);
        self.request(peer, FunctionId::ROBOT_MOVE, &[&robot, &interpolation, &pose, &option]);
    }

    /// Takes the arm, switches its motor on, changes the Slave Mode and sends a pose; each call may fail.
    pub fn slave(&mut self, peer: u32, mode: i32, pose: [f64; 8]) {
        let robot = self.take_arm(peer);
        self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"slvChangeMode", &mode]);
        self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"slvMove", &pose]);
    }

    fn take_arm(&mut self, peer: u32) -> i32 {
        let robot = self.handle(peer, Object::Robot);
        if self.sim.config().model.functions.preparation {
            self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"ManualResetPreparation", &()]);
            self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"MotionPreparation", &()]);
        }
        self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"TakeArm", &[0, 1]]);
        self.request(peer, FunctionId::ROBOT_EXECUTE, &[&robot, &"Motor", &[1, 1]]);
        robot
    }

    /// Moves the clock.
    pub fn pass(&mut self, time: Duration) {
        self.now = self.now + time;
        self.sim.advance(self.now);
    }

    /// Abandons the waiting call of a client.
    pub fn abandon(&mut self, peer: u32) {
        if self.waiting.remove(&peer).is_some() {
            self.sim.abandoned(PeerId(peer), self.now);
        }
    }

    /// Ends the session of a client and opens another.
    pub fn reconnect(&mut self, peer: u32) {
        self.leave(peer);
        self.open(peer);
    }

    fn leave(&mut self, peer: u32) {
        self.abandon(peer);
        self.sim.left(PeerId(peer), self.now);
        self.handles.retain(|(owner, _), _| *owner != peer);
        assert_ne!(self.sim.arm_owner(), Some(PeerId(peer)));
    }

    /// Asserts the invariants: the arm and the hand are within their ranges, the arm does not move without its motor, an
    /// error that switches the motor off or an emergency stop ends Slave Mode, and no client has more objects than it may open.
    ///
    /// # Panics
    ///
    /// When an invariant does not hold.
    pub fn check(&self) {
        let sim = &self.sim;
        for (angle, (low, high)) in sim.joints().iter().zip(RANGES) {
            assert!((low - 1e-3..=high + 1e-3).contains(angle), "{:?}", sim.joints());
        }
        assert!((0.0..=hand::STROKE).contains(&sim.hand_position()), "{}", sim.hand_position());
        assert!(sim.motor_is_on() || (!sim.is_moving() && sim.slave_mode() == 0));
        assert!(sim.slave_mode() == 0 || (sim.arm_owner().is_some() && sim.motor_is_on()));
        assert!(!sim.emergency_stopped() || !sim.motor_is_on());
        assert!(sim.open_objects() <= MAX_OBJECTS * CLIENTS as usize);
    }

    /// Ends all sessions, and returns the trace of the run.
    ///
    /// # Panics
    ///
    /// When an object of a client remains open, or when Slave Mode moved an axis faster than its limit.
    #[must_use]
    pub fn finish(mut self) -> Trace {
        (0..CLIENTS).for_each(|peer| self.leave(peer));
        self.pass(Duration::from_secs(5));
        assert!(!self.sim.is_moving() && self.sim.slave_mode() == 0);
        let limits = self.sim.slave_limits();
        let cycles: Vec<_> = self.sim.slave_record().collect();
        for pair in cycles.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
            for (axis, limit) in limits.speed.iter().enumerate() {
                let way = pair[1].axes[axis] - pair[0].axes[axis];
                assert!(way.abs() <= limit * 0.008 * 1.000_01, "axis {axis} is too fast: {pair:?}");
            }
        }
        assert_eq!((self.sim.open_objects(), self.sim.arm_owner()), (0, None));
        self.trace
    }
}

/// Encodes a request.
fn frame(function: FunctionId, arguments: &[&dyn Encode]) -> Option<Vec<u8>> {
    let mut buffer = vec![0; BUFFER];
    let mut frame = FrameWriter::new(&mut buffer).ok()?;
    arguments.iter().try_for_each(|argument| frame.argument(*argument)).ok()?;
    Some(frame.finish(1, 0, function.0).ok()?.to_vec())
}
