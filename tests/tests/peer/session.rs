//! A session with a controller, made of frames.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::oracle::Oracle;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Link, Received, Wire};
use bcap_tests::serial::SerialServer;
use bcap_tests::served::Served;

/// The time limit of each reply.
pub(crate) const LIMIT: Duration = Duration::from_secs(20);

/// A client that has connected to the controller.
pub(crate) struct Session {
    pub(crate) wire: Wire,
    link: Link,
    serial: u16,
    pub(crate) controller: Value,
    arm: Value,
}

pub(crate) fn controller() -> Controller {
    Controller::new(Config::new(Profile::Rc8))
}

/// Starts a virtual controller at TCP, UDP and RAC.
pub(crate) fn served() -> Served<Controller> {
    Served::of(controller(), Limits::default())
}

/// Runs a check over each link.
pub(crate) fn on_every_link(check: impl Fn(Session)) {
    let served = served();
    check(Session::start(Link::Tcp, served.tcp));
    check(Session::start(Link::Udp, served.udp));
    let line = SerialServer::start(Arc::new(Mutex::new(controller())));
    check(Session::start(Link::Serial, line.address));
}

impl Session {
    pub(crate) fn start(link: Link, address: SocketAddr) -> Self {
        Self::start_after(0, link, address)
    }

    /// Starts a session whose first request has the next serial.
    pub(crate) fn start_after(serial: u16, link: Link, address: SocketAddr) -> Self {
        let wire = Wire::connect(link, address, LIMIT).unwrap();
        let mut session = Self { wire, link, serial, controller: Value::Empty, arm: Value::Empty };
        session.ok(F::SERVICE_START, &[Value::text("")]);
        let texts = ["b-CAP", "CaoProv.DENSO.VRC", "localhost", ""].map(Value::text);
        session.controller = session.ok(F::CONTROLLER_CONNECT, &texts);
        session
    }

    fn oracle(&self) -> Oracle {
        Oracle { crc: self.link == Link::Serial, ..TCP }
    }

    pub(crate) fn next_serial(&mut self) -> u16 {
        self.serial = self.serial.checked_add(1).unwrap_or(1);
        self.serial
    }

    /// Makes a call; returns its code and value.
    pub(crate) fn call(&mut self, function: F, args: &[Value]) -> (HResult, Value) {
        let serial = self.next_serial();
        self.send(serial, function, args);
        self.reply(serial)
    }

    /// Sends a request with this serial.
    pub(crate) fn send(&mut self, serial: u16, function: F, args: &[Value]) {
        let reserved = if self.link.repeats() { serial } else { 0 };
        let frame = TestFrame { serial, reserved, code: function.0, args: args.to_vec() };
        let _ = self.wire.send(&frame.to_wire(self.oracle().crc));
    }

    /// Returns the code and the value of the reply with this serial.
    pub(crate) fn reply(&mut self, serial: u16) -> (HResult, Value) {
        loop {
            let Received::Packet(bytes) = self.wire.receive(LIMIT) else { panic!("no reply to #{serial}") };
            let reply = self.oracle().decode_packet(&bytes).unwrap_or_else(|| panic!("malformed: {bytes:02x?}"));
            assert_eq!((reply.serial, reply.reserved), (serial, 0), "{reply:?}");
            assert!(reply.args.len() < 2, "{reply:?}");
            if reply.code != HResult::S_EXECUTING.0 {
                return (HResult(reply.code), reply.args.into_iter().next().unwrap_or(Value::Empty));
            }
        }
    }

    /// Makes a call that succeeds; returns its value.
    pub(crate) fn ok(&mut self, function: F, args: &[Value]) -> Value {
        let (code, value) = self.call(function, args);
        assert_eq!(code, HResult::S_OK, "{function} {args:?} over {:?}", self.link);
        value
    }

    pub(crate) fn variable(&mut self, name: &str) -> Value {
        let args = [self.controller.clone(), Value::text(name), Value::text("")];
        self.ok(F::CONTROLLER_GET_VARIABLE, &args)
    }

    pub(crate) fn get(&mut self, name: &str) -> Value {
        let variable = self.variable(name);
        self.ok(F::VARIABLE_GET_VALUE, &[variable])
    }

    /// Clears errors, takes the arm and switches the motor on.
    pub(crate) fn take_arm(&mut self) {
        let args = [self.controller.clone(), Value::text("Arm"), Value::text("")];
        self.arm = self.ok(F::CONTROLLER_GET_ROBOT, &args);
        let args = [self.controller.clone(), Value::text("ClearError"), Value::Empty];
        self.ok(F::CONTROLLER_EXECUTE, &args);
        self.robot("TakeArm", Value::Array(3, vec![Value::I4(0); 2]));
        self.robot("Motor", Value::Array(3, vec![Value::I4(1), Value::I4(0)]));
    }

    /// Executes a command of the robot that succeeds.
    pub(crate) fn robot(&mut self, command: &str, value: Value) -> Value {
        let (code, value) = self.robot_command(command, value);
        assert_eq!(code, HResult::S_OK, "{command} over {:?}", self.link);
        value
    }

    pub(crate) fn robot_command(&mut self, command: &str, value: Value) -> (HResult, Value) {
        let args = [self.arm.clone(), Value::text(command), value];
        self.call(F::ROBOT_EXECUTE, &args)
    }

    pub(crate) fn stop(mut self) {
        self.ok(F::SERVICE_STOP, &[]);
        self.wire.close(Duration::ZERO);
    }
}
