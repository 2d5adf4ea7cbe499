//! One connection to the device: calls, their replies, and the handles that they give.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use bcap_core::bcap::{FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::variant::VarType;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::text;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Link, Wire};

use crate::device::{Options, Refusals};
use crate::language::{Arg, Model, Setup, Slot, Want};
use crate::reply::{Came, hex, oracle, request_text};

/// Why a case ends early.
#[derive(Clone, Debug)]
pub(crate) enum Stop {
    Fail { expected: String, came: String },
    Skip(String),
}

pub(crate) fn fail<T>(expected: impl Into<String>, came: impl Into<String>) -> Result<T, Stop> {
    Err(Stop::Fail { expected: expected.into(), came: came.into() })
}

pub(crate) fn skip<T>(why: impl Into<String>) -> Result<T, Stop> {
    Err(Stop::Skip(why.into()))
}

/// The last call, to send copies of it.
#[derive(Clone, Debug)]
pub(crate) struct Sent {
    pub(crate) function: FunctionId,
    pub(crate) args: Vec<Value>,
    pub(crate) marker: u16,
    pub(crate) serial: u16,
    pub(crate) reply: Option<TestFrame>,
}

/// The number of retries of a call or a case when the device ended its connection without any reply: a small device may have no
/// free slot yet. A device in an emulator on a busy machine needs a second or two.
pub(crate) const REFUSALS: usize = 5;
pub(crate) const REFUSAL_PAUSE: Duration = Duration::from_millis(400);

/// The number of probes of a device over UDP, because a network may lose datagrams.
const PROBES: usize = 3;

/// The external speed, acceleration and deceleration of cases, in percent.
const SLOW: &str = "8196,10,10,10";

/// The connection of a case, and the objects that it has opened.
pub(crate) struct Bench<'a> {
    pub(crate) options: &'a Options,
    pub(crate) link: Link,
    pub(crate) wire: Option<Wire>,
    pub(crate) serial: u16,
    handles: [Option<i32>; Slot::COUNT],
    pub(crate) last: Option<Sent>,
    /// The values of scratch variables before the case.
    pub(crate) saved: Vec<(String, Value)>,
    /// The joints that a step of the case has stored.
    pub(crate) here: Option<Value>,
    /// The external speed before the first case that changed it; `None` when it is restored.
    pub(crate) speed: Option<[f64; 3]>,
    /// Whether the arm was taken, so that the case must give it back.
    pub(crate) armed: bool,
    /// The argument of DriveAEx that turns the axis of the case back.
    pub(crate) way_back: Option<Value>,
    /// Whether a call may have started the task.
    pub(crate) task_started: bool,
    /// The codes of the controller with which calls of the case were refused. They are errors of the controller.
    pub(crate) caused: Vec<HResult>,
    /// Returns whether the run is to end, so that nothing may move any more.
    pub(crate) is_interrupted: Option<&'a dyn Fn() -> bool>,
    /// Whether nothing was sent on the connection.
    is_fresh: bool,
    /// Whether a reply has arrived on the connection.
    answered: bool,
    /// Whether the device ended the connection before any reply.
    pub(crate) refused: bool,
    /// Whether a first call got no reply although it was repeated.
    has_no_slot: bool,
    /// Whether the device did not accept the first connection of the case, or over UDP does not answer.
    pub(crate) unreachable: bool,
    /// Whether the port of RAC did not accept the first connection of the case.
    pub(crate) has_no_line: bool,
    /// Whether it has accepted a connection of the case.
    pub(crate) has_line: bool,
    /// Whether any reply has arrived in this case.
    pub(crate) has_reply: bool,
    /// The number of repetitions of a first call or the case since the device last had a free slot.
    pub(crate) repeats: usize,
    /// The sent and received frames, one line each.
    pub(crate) log: Vec<String>,
}

impl<'a> Bench<'a> {
    pub(crate) fn new(options: &'a Options, link: Link) -> Self {
        // over UDP a stale reply to an earlier client of the same port must not match; and 65534, and 1 after 65535, must not
        // look like late copies of calls, as they would before a low serial
        let serial = if link.repeats() { fastrand::u16(10_000..30_000) } else { 1 };
        let (handles, log) = ([None; Slot::COUNT], Vec::new());
        Self {
            options,
            link,
            wire: None,
            serial,
            handles,
            last: None,
            saved: Vec::new(),
            here: None,
            speed: None,
            armed: false,
            way_back: None,
            task_started: false,
            caused: Vec::new(),
            is_interrupted: None,
            is_fresh: false,
            answered: false,
            refused: false,
            has_no_slot: false,
            unreachable: false,
            has_no_line: false,
            has_line: false,
            has_reply: false,
            repeats: 0,
            log,
        }
    }

    /// Returns whether a device over UDP answers a new client. Over TCP the connection shows it.
    pub(crate) fn answers(options: &'a Options, link: Link) -> bool {
        let answers = |_| {
            let mut bench = Self::new(options, link);
            let (serial, bytes) = bench.request(FunctionId::SERVICE_START, &[Value::text("")]);
            let sent = bench.connect().and_then(|()| bench.send(&bytes, &format!("#{serial} Service_Start")));
            // even a device that answers wrongly
            let came = sent.is_ok().then(|| bench.receive());
            bench.close();
            matches!(came, Some(Came::Reply(_) | Came::Invalid(_)))
        };
        link != Link::Udp || (0..PROBES).any(answers)
    }

    pub(crate) fn setup(&mut self, setup: Setup) -> Result<(), Stop> {
        if setup == Setup::Rac {
            return Ok(());
        }
        self.connect()?;
        if setup == Setup::Connected {
            return Ok(());
        }
        self.must(FunctionId::SERVICE_START, &[Arg::S("")], Want::NoValue)?;
        if setup == Setup::Started {
            return Ok(());
        }
        self.open_controller()?;
        match setup {
            Setup::Robot | Setup::Arm => self.open_robot()?,
            Setup::Task => self.open_task()?,
            _ => {}
        }
        if setup == Setup::Arm { self.take_arm(SLOW) } else { Ok(()) }
    }

    pub(crate) fn open_controller(&mut self) -> Result<(), Stop> {
        // a name that is in use is refused
        static CONNECTED: AtomicU32 = AtomicU32::new(1);
        let options = self.options;
        let name = format!("b-CAP {}", CONNECTED.fetch_add(1, Ordering::Relaxed));
        let args = [name.as_str(), &options.provider, &options.machine, &options.option].map(Value::text);
        let reply = self.exchange(FunctionId::CONTROLLER_CONNECT, args.to_vec())?;
        self.check(FunctionId::CONTROLLER_CONNECT, &reply, Want::Ok, Refusals::Fail)?;
        self.keep(Slot::Controller, &reply)
    }

    pub(crate) fn open_robot(&mut self) -> Result<(), Stop> {
        let args = [Arg::H(Slot::Controller), Arg::S("Arm"), Arg::S("")];
        self.open(Slot::Robot, FunctionId::CONTROLLER_GET_ROBOT, &args)
    }

    /// Returns the model of the device, by the type of its robot and the provider.
    pub(crate) fn model(&mut self) -> Option<Model> {
        self.setup(Setup::Robot).ok()?;
        let reply = self.robot_command("GetRobotTypeName", "0,").ok().filter(|reply| reply.result().is_ok())?;
        let Some(Value::Bstr(units)) = reply.value() else { return None };
        Some(match String::from_utf16_lossy(units) {
            name if name.starts_with("CVRB") => Model::CobottaPro,
            name if name.starts_with("CVR") => Model::Cobotta,
            _ if self.options.provider.to_ascii_uppercase().ends_with("VRC9") => Model::Rc9,
            _ => Model::Rc8,
        })
    }

    fn open_task(&mut self) -> Result<(), Stop> {
        let args = vec![self.argument(&Arg::H(Slot::Controller))?, Value::text(&self.options.task), Value::text("")];
        let reply = self.exchange(FunctionId::CONTROLLER_GET_TASK, args)?;
        self.check(FunctionId::CONTROLLER_GET_TASK, &reply, Want::Ok, Refusals::Skip)?;
        self.keep(Slot::Task, &reply)
    }

    /// Takes the arm and switches the motor on, after the preparation of a COBOTTA.
    pub(crate) fn take_arm(&mut self, speed: &'static str) -> Result<(), Stop> {
        let refused = self.robot_command("ManualResetPreparation", "0,")?.result();
        if refused.is_ok() {
            self.robot_command("MotionPreparation", "0,")?;
        }
        let taken = self.robot_command("TakeArm", "8195,0,0")?;
        if taken.result().is_err() {
            return skip(format!("TakeArm: {}", taken.text()));
        }
        self.armed = true;
        if self.speed.is_none() {
            let Some(speed) = self.external_speed()? else {
                return skip("the external speed cannot be read, so it could not be restored");
            };
            self.speed = Some(speed);
        }
        // slow, whatever speed the robot's program has set
        let slow = self.robot_command("ExtSpeed", speed)?;
        if slow.result().is_err() {
            return skip(format!("ExtSpeed: {}", slow.text()));
        }
        let motor = self.robot_command("Motor", "8195,1,0")?;
        if motor.result().is_err() { skip(format!("Motor on: {}", motor.text())) } else { Ok(()) }
    }

    /// Returns the external speed, acceleration and deceleration; `None` if the controller does not return them.
    fn external_speed(&mut self) -> Result<Option<[f64; 3]>, Stop> {
        let mut speed = [0.0; 3];
        for (place, command) in speed.iter_mut().zip(["CurExtSpd", "CurExtAcc", "CurExtDec"]) {
            let reply = self.robot_command(command, "0,")?;
            match reply.value().and_then(Value::as_f64) {
                Some(percent) if reply.result().is_ok() => *place = percent,
                _ => return Ok(None),
            }
        }
        Ok(Some(speed))
    }

    /// Calls Robot_Execute.
    pub(crate) fn robot_command(&mut self, command: &'static str, value: &'static str) -> Result<TestFrame, Stop> {
        self.call(FunctionId::ROBOT_EXECUTE, &[Arg::H(Slot::Robot), Arg::S(command), Arg::V(value)])
    }

    /// Opens a variable of the controller, and returns its handle.
    pub(crate) fn variable(&mut self, name: &str) -> Result<Value, Stop> {
        let args = vec![self.argument(&Arg::H(Slot::Controller))?, Value::text(name), Value::text("")];
        let reply = self.exchange(FunctionId::CONTROLLER_GET_VARIABLE, args)?;
        self.check(FunctionId::CONTROLLER_GET_VARIABLE, &reply, Want::Ok, Refusals::Skip)?;
        let Some(value) = reply.args.into_iter().next() else { return fail("a handle", "no value") };
        Ok(value)
    }

    /// Keeps the value of a scratch variable. Without the variable, or if it cannot be written, the case is skipped.
    pub(crate) fn save(&mut self, kind: &str) -> Result<(), Stop> {
        let name = self.options.scratch(kind);
        let variable = self.variable(&name)?;
        let reply = self.exchange(FunctionId::VARIABLE_GET_VALUE, vec![variable.clone()])?;
        self.check(FunctionId::VARIABLE_GET_VALUE, &reply, Want::Ok, Refusals::Skip)?;
        let Some(value) = reply.args.into_iter().next() else {
            return fail(format!("the value of {name}"), "no value");
        };
        // the same value, to detect a device that does not allow writes
        let reply = self.exchange(FunctionId::VARIABLE_PUT_VALUE, vec![variable, value.clone()])?;
        if reply.result() == HResult::E_ACCESSDENIED {
            return skip(format!("{name} cannot be written: {}", reply.result()));
        }
        self.saved.push((name, value));
        Ok(())
    }

    /// Keeps the value of a scratch variable for a case of RAC, if the device has an address of b-CAP.
    pub(crate) fn save_over_bcap(&mut self, kind: &str) -> Result<(), Stop> {
        if self.options.target.bcap.is_none() {
            return Ok(());
        }
        let saved = self.setup(Setup::Controller).and_then(|()| self.save(kind));
        self.attempt(FunctionId::SERVICE_STOP, Vec::new(), self.options.timeout);
        self.close();
        match saved {
            Err(Stop::Fail { came, .. }) => skip(format!("the value of {kind} is not saved over b-CAP: {came}")),
            other => other,
        }
    }

    /// Ends the connection; over UDP the session, because the device would keep its slot for the port.
    pub(crate) fn close(&mut self) {
        let Some(mut wire) = self.wire.take() else { return };
        if self.link.repeats() {
            let (serial, bytes) = self.request(FunctionId::SERVICE_STOP, &[]);
            let sent = wire.send(&bytes);
            // the next socket may get this port, and would mistake the answer for its own; without an answer the device drops
            // the peer later
            let until = Instant::now() + self.options.quiet;
            let is_other = |came| matches!(came, Came::Reply(reply) if reply.serial != serial);
            while sent.is_ok()
                && Instant::now() < until
                && is_other(Came::of(self.link, wire.receive(self.options.quiet)))
            {}
        }
        wire.close(self.options.quiet);
    }

    /// Starts a session of another client during this session; a device that has no slot for it skips the case.
    pub(crate) fn another(&self) -> Result<Self, Stop> {
        if self.link == Link::Serial {
            return skip("a serial line has one client");
        }
        let mut other = Self::new(self.options, self.link);
        other.serial = self.serial;
        other.connect()?;
        let started = other.must(FunctionId::SERVICE_START, &[Arg::S("")], Want::NoValue);
        if other.has_no_slot {
            return skip("the device has no slot for another client at the same time");
        }
        started.map(|_| other)
    }

    pub(crate) fn connect(&mut self) -> Result<(), Stop> {
        self.close();
        let address = match self.options.target.bcap {
            Some((_, address)) => address,
            None => return skip("the address of b-CAP is not given"),
        };
        match Wire::connect(self.link, address, self.options.timeout) {
            Ok(wire) => (self.wire, self.is_fresh, self.answered) = (Some(wire), true, false),
            Err(error) => {
                self.unreachable = self.log.is_empty();
                return fail(format!("{address} accepts the connection"), error.to_string());
            }
        }
        Ok(())
    }

    /// Sends bytes.
    pub(crate) fn send(&mut self, bytes: &[u8], text: &str) -> Result<(), Stop> {
        self.log.push(format!("-> {text} [{}]", hex(bytes)));
        self.is_fresh = false;
        let Some(wire) = &mut self.wire else { return fail("a connection", "the connection has ended") };
        match wire.send(bytes) {
            Ok(()) => Ok(()),
            Err(error) => {
                self.refused |= !self.answered;
                fail("the device receives the request", error.to_string())
            }
        }
    }

    /// Receives bytes within the time limit of a reply.
    pub(crate) fn receive(&mut self) -> Came {
        self.receive_within(self.options.timeout)
    }

    pub(crate) fn receive_within(&mut self, limit: Duration) -> Came {
        let came = self.wire.as_mut().map_or(Came::Closed, |wire| Came::of(self.link, wire.receive(limit)));
        match came {
            Came::Reply(ref reply) => {
                (self.answered, self.has_reply) = (true, true);
                self.caused.extend(reply.result().level().is_some_and(|level| level > 0).then_some(reply.result()));
            }
            Came::Closed => self.refused |= !self.answered,
            Came::Invalid(_) | Came::Nothing => {}
        }
        self.log.push(format!("<- {}", came.text()));
        came
    }

    /// Returns the serial of the next request.
    pub(crate) fn next_serial(&mut self) -> u16 {
        let serial = self.serial;
        self.serial = serial.checked_add(1).unwrap_or(1);
        serial
    }

    /// Encodes a call with the next serial; returns both.
    pub(crate) fn request(&mut self, function: FunctionId, args: &[Value]) -> (u16, Vec<u8>) {
        let serial = self.next_serial();
        let marker = if self.link.repeats() { serial } else { 0 };
        (serial, self.encode(serial, marker, function, args))
    }

    pub(crate) fn encode(&self, serial: u16, marker: u16, function: FunctionId, args: &[Value]) -> Vec<u8> {
        let frame = TestFrame { serial, reserved: marker, code: function.0, args: args.to_vec() };
        frame.to_wire(oracle(self.link).crc)
    }

    /// Makes a call, and returns its reply whatever its code.
    pub(crate) fn call(&mut self, function: FunctionId, args: &[Arg]) -> Result<TestFrame, Stop> {
        let args = args.iter().map(|arg| self.argument(arg)).collect::<Result<Vec<_>, _>>()?;
        self.exchange(function, args)
    }

    /// Makes a call, and returns its reply whatever its code. The rules of all replies are checked.
    ///
    /// The first call of a connection is repeated on a new connection while the device has no free slot: it ends the connection
    /// without a reply, or answers E_MAX_CONNECT.
    pub(crate) fn exchange(&mut self, function: FunctionId, args: Vec<Value>) -> Result<TestFrame, Stop> {
        loop {
            let is_first = self.is_fresh;
            self.refused = false;
            let outcome = self.exchange_once(function, args.clone());
            let has_slot = outcome.as_ref().map_or(!self.refused, |reply| reply.result() != HResult::E_MAX_CONNECT);
            if has_slot && outcome.is_ok() {
                self.repeats = 0;
            }
            if !is_first || has_slot {
                return outcome;
            }
            if self.repeats == REFUSALS {
                // the retries are exhausted, so the case does not run again
                (self.refused, self.has_no_slot) = (false, true);
                return outcome;
            }
            self.repeats += 1;
            std::thread::sleep(REFUSAL_PAUSE);
            self.connect()?;
        }
    }

    fn exchange_once(&mut self, function: FunctionId, args: Vec<Value>) -> Result<TestFrame, Stop> {
        let (serial, bytes) = self.request(function, &args);
        self.send(&bytes, &request_text(serial, function, &args))?;
        let task = self.handles[Slot::Task as usize];
        let is_of_task = task.is_some_and(|task| args.first() == Some(&Value::I4(task)));
        self.last = Some(Sent { function, args, marker: serial, serial, reply: None });
        // until a reply says otherwise
        self.task_started |= function == FunctionId::TASK_START;
        let reply = self.reply(function, serial)?;
        match function {
            // a faulty device may have started it nevertheless
            FunctionId::TASK_START if reply.result().is_err() && !is_of_task => self.task_started = false,
            FunctionId::TASK_STOP if reply.result().is_ok() => self.task_started = false,
            _ => {}
        }
        if let Some(last) = &mut self.last {
            last.reply = Some(reply.clone());
        }
        Ok(reply)
    }

    /// Receives the reply with this serial; keep-alives are checked and skipped.
    pub(crate) fn reply(&mut self, function: FunctionId, serial: u16) -> Result<TestFrame, Stop> {
        // a device that keeps a call alive must still answer it
        let until = Instant::now() + self.options.timeout.saturating_mul(4);
        loop {
            let came = self.receive();
            let Came::Reply(reply) = came else {
                return fail(format!("a reply to {function} with the serial {serial}"), came.text());
            };
            self.check_reply(function, serial, &reply)?;
            if reply.result() != HResult::S_EXECUTING {
                return Ok(reply);
            }
            if Instant::now() > until {
                return fail(format!("a reply to {function} after the keep-alives"), reply.text());
            }
        }
    }

    /// Checks the rules of every reply (b-CAP specification, sections 4.1.1 to 4.1.5).
    fn check_reply(&self, function: FunctionId, serial: u16, reply: &TestFrame) -> Result<(), Stop> {
        let expected = |what: &str| format!("the reply to {function} {what}");
        if reply.serial != serial {
            return fail(expected(&format!("has the serial {serial} of its request")), reply.text());
        }
        if reply.reserved != 0 {
            return fail(expected("has 0 in the reserved field"), reply.text());
        }
        if reply.args.len() > 1 {
            return fail(expected("has at most one value"), reply.text());
        }
        let result = function.signature().map(|signature| signature.result);
        match (result, reply.value()) {
            (_, None) | (None, _) => Ok(()),
            (_, Some(_)) if reply.result() == HResult::S_EXECUTING => {
                fail("S_EXECUTING has no value (b-CAP specification, Table 4-1)", reply.text())
            }
            (Some(Kind::Nothing), Some(value)) if *value != Value::Empty => {
                fail(expected("has no value"), reply.text())
            }
            (Some(Kind::Handle(_) | Kind::Int), Some(value)) if reply.result().is_ok() => match value {
                Value::I4(_) | Value::Ui4(_) => Ok(()),
                Value::Empty if function == FunctionId::SERVICE_START => Ok(()),
                _ => fail(expected("is an I4"), reply.text()),
            },
            (Some(Kind::Text), Some(value)) if reply.result().is_ok() && !matches!(value, Value::Bstr(_)) => {
                fail(expected("is a BSTR"), reply.text())
            }
            _ => Ok(()),
        }
    }

    /// Returns whether the run is to end, so that no motion may begin.
    pub(crate) fn was_interrupted(&self) -> bool {
        self.is_interrupted.is_some_and(|is_interrupted| is_interrupted())
    }

    pub(crate) fn argument(&self, arg: &Arg) -> Result<Value, Stop> {
        let handle = |slot: Slot| match self.handles[slot as usize] {
            Some(handle) => Ok(handle),
            None => skip(format!("the handle {slot:?} is missing")),
        };
        Ok(match *arg {
            Arg::H(slot) => Value::I4(handle(slot)?),
            Arg::Unsigned(slot) => Value::Ui4(handle(slot)?.cast_unsigned()),
            Arg::I(number) => Value::I4(number),
            Arg::S(text) => Value::text(text),
            Arg::Scratch(kind) => Value::text(&self.options.scratch(kind)),
            Arg::V(text) => return value_of(text),
        })
    }

    pub(crate) fn keep(&mut self, slot: Slot, reply: &TestFrame) -> Result<(), Stop> {
        let handle = match reply.value() {
            Some(Value::I4(handle)) => *handle,
            Some(Value::Ui4(handle)) => handle.cast_signed(),
            _ => return fail("a handle (I4)", reply.text()),
        };
        self.handles[slot as usize] = Some(handle);
        Ok(())
    }

    pub(crate) fn handle(&self, slot: Slot) -> i32 {
        self.handles[slot as usize].unwrap_or_default()
    }

    pub(crate) fn set_handle(&mut self, slot: Slot, handle: i32) {
        self.handles[slot as usize] = Some(handle);
    }

    /// Makes a call and checks its reply; skips the case if the device does not have the function.
    pub(crate) fn want(&mut self, function: FunctionId, args: &[Arg], want: Want) -> Result<TestFrame, Stop> {
        let reply = self.call(function, args)?;
        self.check(function, &reply, want, Refusals::Skip)?;
        Ok(reply)
    }

    /// Makes a call that every device has, and checks its reply.
    pub(crate) fn must(&mut self, function: FunctionId, args: &[Arg], want: Want) -> Result<TestFrame, Stop> {
        let reply = self.call(function, args)?;
        self.check(function, &reply, want, Refusals::Fail)?;
        Ok(reply)
    }

    /// Opens an object, and stores its handle.
    pub(crate) fn open(&mut self, slot: Slot, function: FunctionId, args: &[Arg]) -> Result<(), Stop> {
        let reply = self.want(function, args, Want::Ok)?;
        self.keep(slot, &reply)
    }

    /// Checks a reply.
    pub(crate) fn check(
        &self,
        function: FunctionId,
        reply: &TestFrame,
        want: Want,
        refusals: Refusals,
    ) -> Result<(), Stop> {
        let wants_success = !matches!(want, Want::Code(_) | Want::Refused);
        let is_missing = [HResult::E_NOTIMPL, HResult::E_INVALID_CMD_NAME, HResult::E_CAO_OBJECT_NOTFOUND];
        let opens = function.opens().is_some();
        // a device may lack an object or a function, but must not refuse an existing one
        if refusals == Refusals::Skip
            && (is_missing[..2].contains(&reply.result()) || wants_success && opens && reply.result() == is_missing[2])
            && !matches!(want, Want::Code(codes) if codes.contains(&reply.result()))
        {
            return skip(format!("the device does not have it: {function} answered {}", reply.result()));
        }
        match matches(want, reply) {
            true => Ok(()),
            false => fail(format!("{function}: {}", want_text(want)), reply.text()),
        }
    }
}

impl Drop for Bench<'_> {
    fn drop(&mut self) {
        self.close();
    }
}

pub(crate) fn value_of(text: &str) -> Result<Value, Stop> {
    match text::parse(text.as_bytes()) {
        Some(value) => Ok(value),
        None => fail(format!("the text {text:?} is a value"), "it is none"),
    }
}

/// Returns whether a reply meets the condition of a case.
fn matches(want: Want, reply: &TestFrame) -> bool {
    let value = reply.value();
    let is_ok = reply.result().is_ok();
    match want {
        Want::Ok => is_ok,
        Want::NoValue => is_ok && value.is_none_or(|value| *value == Value::Empty),
        Want::Type(vartype) => is_ok && value.is_some_and(|value| value.vartype() == vartype),
        Want::Array(element, count) => {
            is_ok
                && matches!(value, Some(Value::Array(found, items)) if *found == element && (count == 0 || items.len() == count))
        }
        Want::Value(text) => is_ok && value_of(text).is_ok_and(|wanted| value == Some(&wanted)),
        Want::Code(codes) => codes.contains(&reply.result()),
        Want::Refused => reply.result().is_err(),
    }
}

pub(crate) fn want_text(want: Want) -> String {
    match want {
        Want::Ok => "success".into(),
        Want::NoValue => "success without a value".into(),
        Want::Type(vartype) => format!("success with {}", VarType(vartype)),
        Want::Array(element, 0) => format!("success with an array of {}", VarType(element)),
        Want::Array(element, count) => format!("success with {count} elements of {}", VarType(element)),
        Want::Value(text) => match value_of(text) {
            Ok(value) => format!("success with {}", value.short()),
            Err(_) => text.into(),
        },
        Want::Code(codes) => codes.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or "),
        Want::Refused => "an error".into(),
    }
}
