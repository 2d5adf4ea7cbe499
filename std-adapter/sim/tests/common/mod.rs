//! A client that calls a controller's handler directly, with a clock that only the test moves.

use bcap_core::bcap::call::{self, Call, ControllerHandle, RobotHandle, TaskHandle, VariableHandle};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant, VariantBuf};
use bcap_sim::{Config, Controller, Profile};

/// A reply: its code and its value.
pub(crate) type Reply = (HResult, Value);
/// A value of a reply.
pub(crate) type Value = VariantBuf<2048>;

/// A controller and the time.
pub(crate) struct World {
    pub(crate) sim: Controller,
    pub(crate) now: Instant,
}

/// A client with the handles it got.
#[derive(Clone, Copy)]
pub(crate) struct Client {
    pub(crate) peer: PeerId,
    pub(crate) controller: ControllerHandle,
    pub(crate) robot: RobotHandle,
}

/// A value to compare with.
pub(crate) fn value(value: &(impl Encode + ?Sized)) -> Value {
    Value::new(value).unwrap()
}

/// The reply `S_OK` with a value.
pub(crate) fn ok(v: &(impl Encode + ?Sized)) -> Reply {
    (HResult::S_OK, value(v))
}

/// A reply without a value.
pub(crate) fn code(code: HResult) -> Reply {
    (code, Value::EMPTY)
}

impl World {
    pub(crate) fn new() -> Self {
        Self::with(Config::new(Profile::Rc8))
    }

    pub(crate) fn with(config: Config) -> Self {
        Self { sim: Controller::new(config), now: Instant::ZERO }
    }

    /// Calls the handler once.
    pub(crate) fn poll(&mut self, peer: PeerId, call: &impl Call, resumed: bool) -> (Outcome, Value) {
        let mut frame = vec![0; 1 << 18];
        let mut writer = FrameWriter::new(&mut frame).unwrap();
        call.arguments(&mut writer).unwrap();
        let bytes = writer.finish(1, 0, call.function().0).unwrap();
        let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
        let request = Request::new(frame.function(), frame.args);
        let mut buffer = vec![0; 1 << 18];
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = match resumed {
            false => self.sim.call(peer, &request, &mut reply, self.now),
            true => self.sim.resume(peer, &request, &mut reply, self.now),
        };
        let value = match reply.as_bytes() {
            [] => Value::EMPTY,
            bytes => Value::decode(bytes, &Limits::STREAM, Strictness::Strict).unwrap(),
        };
        (outcome, value)
    }

    /// Calls, and expects the answer immediately.
    pub(crate) fn call(&mut self, peer: PeerId, call: impl Call) -> Reply {
        match self.poll(peer, &call, false) {
            (Outcome::Done(code), value) => (code, value),
            (Outcome::Wait(at), _) => panic!("{:?} waits until {at}", call.function()),
        }
    }

    /// Calls, moving the clock to each time at which the handler wants to be polled again.
    pub(crate) fn run(&mut self, peer: PeerId, call: impl Call) -> Reply {
        self.run_from(peer, &call, false)
    }

    /// Polls a call until it is answered, moving the clock.
    pub(crate) fn run_again(&mut self, peer: PeerId, call: &impl Call) -> Reply {
        self.run_from(peer, call, true)
    }

    fn run_from(&mut self, peer: PeerId, call: &impl Call, mut resumed: bool) -> Reply {
        for _ in 0..10_000 {
            match self.poll(peer, call, resumed) {
                (Outcome::Done(code), value) => return (code, value),
                (Outcome::Wait(at), _) => {
                    assert!(at > self.now, "asked to come again at {at}, now is {}", self.now);
                    self.now = at;
                }
            }
            resumed = true;
        }
        panic!("{:?} never ends", call.function())
    }

    /// Begins a call that has to wait.
    pub(crate) fn begin(&mut self, peer: PeerId, call: &impl Call) {
        let (outcome, _) = self.poll(peer, call, false);
        assert!(matches!(outcome, Outcome::Wait(_)), "{:?} answered {outcome:?}", call.function());
    }

    /// Polls a waiting call again.
    pub(crate) fn again(&mut self, peer: PeerId, call: &impl Call) -> (Outcome, Value) {
        self.poll(peer, call, true)
    }

    /// Sends a line of RAC, without its CR.
    pub(crate) fn rac(&mut self, line: &str) -> Reply {
        let (mut memory, mut buffer) = ([0; 512], [0; 512]);
        let request = rac::Request::parse(line.as_bytes(), &mut memory).unwrap();
        let mut reply = ReplyValue::new(&mut buffer);
        match rac::server::Handler::call(&mut self.sim, PeerId(1), &request, &mut reply, self.now) {
            Outcome::Done(code) => (code, reply.get().map_or(Value::EMPTY, |v| value(&v))),
            Outcome::Wait(at) => panic!("{line} waits until {at}"),
        }
    }

    /// Moves the clock.
    pub(crate) fn pass(&mut self, millis: u64) {
        self.now = Instant::from_micros(self.now.as_micros() + millis * 1000);
        self.sim.advance(self.now);
    }

    /// Opens a session with controller and robot.
    pub(crate) fn client(&mut self, peer: u32) -> Client {
        let peer = PeerId(peer);
        assert_eq!(self.call(peer, call::service_start("")), code(HResult::S_OK));
        let provider = self.sim.config().model.provider.clone();
        let name = if peer.0 == 1 { "b-CAP".to_owned() } else { format!("b-CAP {}", peer.0) };
        let controller = self.handle(peer, call::controller_connect(&name, &provider, "localhost", "@IfNotMember"));
        let controller = ControllerHandle(controller);
        let robot = RobotHandle(self.handle(peer, call::controller_get_robot(controller, "Arm", "")));
        Client { peer, controller, robot }
    }

    /// Removes the errors.
    pub(crate) fn clear(&mut self, client: Client) {
        if self.sim.config().model.functions.preparation {
            assert_eq!(self.robot(client, "ManualResetPreparation", ()), ok(&()));
        }
        assert_eq!(self.execute(client, "ClearError", ()), ok(&()));
    }

    /// Returns the codes of the current errors, in reverse order.
    pub(crate) fn errors(&self) -> Vec<HResult> {
        self.sim.errors().map(|error| error.code).collect()
    }

    /// Opens a session that holds the arm, with the motor on and the external speed at 100 %.
    pub(crate) fn mover(&mut self, peer: u32) -> Client {
        let client = self.client(peer);
        if self.sim.config().model.functions.preparation {
            assert_eq!(self.robot(client, "ManualResetPreparation", ()), ok(&()));
            assert_eq!(self.robot(client, "MotionPreparation", ()), ok(&()));
        }
        assert_eq!(self.robot(client, "TakeArm", [0, 1]), ok(&()));
        assert_eq!(self.robot(client, "Motor", [1, 0]), ok(&()));
        assert_eq!(self.robot(client, "ExtSpeed", 100), ok(&()));
        client
    }

    /// Makes a call that returns a handle.
    pub(crate) fn handle(&mut self, peer: PeerId, call: impl Call) -> i32 {
        let (code, value) = self.call(peer, call);
        assert_eq!(code, HResult::S_OK);
        match value.as_variant() {
            Variant::I4(handle) => handle,
            other => panic!("{other:?} is no handle"),
        }
    }

    pub(crate) fn variable(&mut self, client: Client, name: &str) -> VariableHandle {
        VariableHandle(self.handle(client.peer, call::controller_get_variable(client.controller, name, "")))
    }

    pub(crate) fn robot_variable(&mut self, client: Client, name: &str) -> VariableHandle {
        VariableHandle(self.handle(client.peer, call::robot_get_variable(client.robot, name, "")))
    }

    pub(crate) fn task(&mut self, client: Client, name: &str) -> TaskHandle {
        TaskHandle(self.handle(client.peer, call::controller_get_task(client.controller, name, "@IfNotMember")))
    }

    /// Reads a variable through a temporary handle.
    pub(crate) fn get(&mut self, client: Client, name: &str) -> Reply {
        let handle = self.variable(client, name);
        let reply = self.call(client.peer, call::variable_get_value(handle));
        assert_eq!(self.call(client.peer, call::variable_release(handle)), code(HResult::S_OK));
        reply
    }

    /// Writes a variable through a temporary handle.
    pub(crate) fn put(&mut self, client: Client, name: &str, value: impl Encode) -> HResult {
        let handle = self.variable(client, name);
        let (result, _) = self.call(client.peer, call::variable_put_value(handle, value));
        assert_eq!(self.call(client.peer, call::variable_release(handle)), code(HResult::S_OK));
        result
    }

    pub(crate) fn robot_get(&mut self, client: Client, name: &str) -> Reply {
        let handle = self.robot_variable(client, name);
        let reply = self.call(client.peer, call::variable_get_value(handle));
        assert_eq!(self.call(client.peer, call::variable_release(handle)), code(HResult::S_OK));
        reply
    }

    pub(crate) fn execute(&mut self, client: Client, command: &str, param: impl Encode) -> Reply {
        self.call(client.peer, call::controller_execute(client.controller, command, param))
    }

    /// Executes a command of the robot to its end.
    pub(crate) fn robot(&mut self, client: Client, command: &str, param: impl Encode) -> Reply {
        self.run(client.peer, call::robot_execute(client.robot, command, param))
    }

    /// Moves to the end of the motion.
    pub(crate) fn move_to(&mut self, client: Client, interpolation: i32, pose: impl Encode, option: &str) -> HResult {
        self.run(client.peer, call::robot_move(client.robot, interpolation, pose, option)).0
    }
}

/// Returns the doubles of a value.
pub(crate) fn doubles(value: &Value) -> Vec<f64> {
    let array = value.as_variant().as_array().expect("an array");
    array.items::<f64>().expect("an array of R8").iter().collect()
}

/// Returns whether numbers are close to others.
pub(crate) fn close(a: &[f64], b: &[f64], tolerance: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}
