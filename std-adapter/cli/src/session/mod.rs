//! A session with a controller within the time limits of the command line.
//!
//! Controller_Connect is called when a command first needs the controller. At the end of the session, even after a
//! refusal, all objects are released in reverse order. After a call without a reply, nothing more is sent.

pub(crate) mod budget;
pub(crate) mod confirm;
pub(crate) mod connect;
pub(crate) mod traffic;
pub(crate) mod variables;

use std::collections::HashMap;
use std::time::{Duration, Instant};

use bcap_capture::trace::Packets;
use bcap_capture::value::describe;
use bcap_core::bcap::client::Timing;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::calls::needs_reconnect;
use bcap_std::blocking::Controller;
use bcap_std::{Address, Error, Model, ObjectPath, Settings};

use crate::failure::{Failure, with_finding};
use crate::interrupt::{Interrupt, State};
use crate::link::{LinkArgs, profiles};
use crate::output::note;
use crate::session::budget::Budget;
use crate::session::connect::{failure, open};
use crate::session::traffic::packets;

/// A session, from Service_Start to Service_Stop. It connects when it is first used.
pub(crate) struct Session {
    link: LinkArgs,
    /// The connection, which exists from the first use on.
    open: Option<Open>,
    /// Whether the connection was lost.
    lost: bool,
    /// The provider for the next Controller_Connect.
    pub(crate) provider: String,
    /// The objects that stay open for the next use, by path.
    objects: HashMap<String, i32>,
    /// The handling of signals while this session may move the robot.
    pub(crate) interrupt: Option<Interrupt>,
    /// Whether this session halts the robot for another session; then no signal interrupts its calls.
    is_stopper: bool,
    /// Whether an earlier session has opened the halting session, and closes it.
    shares_stopper: bool,
    /// The bytes of the last packets.
    pub(crate) packets: Packets,
    /// The scripts that run each other now.
    pub(crate) scripts: u8,
    /// The variables of the shell or of the scripts.
    pub(crate) variables: HashMap<String, String>,
}

/// An open connection.
struct Open {
    controller: Controller,
    target: Address,
    budget: Budget,
}

impl Drop for Session {
    /// Ends this session, and then the session that halts the robot. The end has its full time limit, however long the session
    /// was idle.
    fn drop(&mut self) {
        self.close();
    }
}

/// Runs `body` with a started session, then releases its objects and stops the service.
pub(crate) fn with_session<T>(
    link: &LinkArgs,
    body: impl FnOnce(&mut Session) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut session = Session::new(link);
    session.connect()?;
    body(&mut session)
}

/// Returns whether a halt that failed must be made over a new session.
fn needs_new_session(failure: &Failure) -> bool {
    needs_reconnect(failure) || matches!(failure, Failure::Refused { code: HResult::E_NOT_CONNECTED, .. })
}

/// Returns the settings of the library for a provider.
fn settings(link: &LinkArgs) -> Settings {
    let is_rc9 = link.provider().eq_ignore_ascii_case(Model::Rc9.provider());
    Settings::new(if is_rc9 { Model::Rc9 } else { Model::Rc8 }).connect_option(link.option())
}

impl Session {
    /// Returns a session that connects when it is first used.
    pub(crate) fn new(link: &LinkArgs) -> Self {
        Self {
            link: link.clone(),
            open: None,
            lost: false,
            provider: link.provider().to_owned(),
            objects: HashMap::new(),
            interrupt: None,
            is_stopper: false,
            shares_stopper: false,
            packets: packets(link.trace),
            scripts: 0,
            variables: HashMap::new(),
        }
    }

    /// Returns how the session connects.
    pub(crate) const fn link(&self) -> &LinkArgs {
        &self.link
    }

    /// Connects and starts the service, unless that has been done.
    pub(crate) fn connect(&mut self) -> Result<(), Failure> {
        if self.open.is_none() {
            self.open_connection()?;
            let link = self.link.clone();
            self.start(&link)?;
        }
        Ok(())
    }

    /// Ends the connection, and connects again.
    pub(crate) fn reconnect(&mut self) -> Result<(), Failure> {
        self.close();
        self.controller().map(drop)
    }

    /// Ends the session, and prints a failure of that.
    pub(crate) fn close(&mut self) {
        if let Err(failure) = self.end() {
            failure.print(false, None);
        }
    }

    /// Ends the session after a command. A failure of the end is the command's, unless the command has failed itself.
    pub(crate) fn end_after(&mut self, done: Result<(), Failure>) -> Result<(), Failure> {
        match done {
            // a closed output does not affect the robot
            Err(failure) if !failure.is_closed_output() => {
                self.close();
                Err(failure)
            }
            done => with_finding(done, self.end()),
        }
    }

    /// Ends the session: gives the arm back, releases all objects and stops the service. Fails if the robot may still move, or its
    /// motor be on.
    pub(crate) fn end(&mut self) -> Result<(), Failure> {
        if !self.lost {
            self.restart_budget();
        }
        let ended = self.disconnect();
        self.lost = false;
        if let Some(interrupt) = self.interrupt.as_ref().filter(|_| !self.shares_stopper) {
            interrupt.dismiss();
        }
        ended
    }

    /// Undoes the effects of this session on the robot, over a new connection if this one was lost, and closes the connection.
    fn disconnect(&mut self) -> Result<(), Failure> {
        let undone = self.undo();
        self.objects.clear();
        let closed = self.open.take().map_or(Ok(()), |open| open.controller.end());
        undone.and(closed.map_err(|error| {
            let message = format!("it is unknown whether the robot rests and its motor is off: {error}");
            Failure::unfit(message, "look at the robot; if it moves, use the emergency stop")
        }))
    }

    /// Runs `body` before a question to the user, who may take hours to answer: only a session that was open before stays open,
    /// and a lost session stays lost.
    pub(crate) fn before_question<T>(
        &mut self,
        body: impl FnOnce(&mut Self) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let is_own = !self.is_open() && !self.lost;
        let done = body(self);
        if is_own {
            self.close();
        }
        done
    }

    /// Undoes the effects of this session on the robot. That has a separate time limit, however long the command took.
    fn undo(&mut self) -> Result<(), Failure> {
        let has_arm = self.has_arm();
        let has_motor = self.is_open() && self.open.as_ref().is_some_and(|open| open.controller.has_motor());
        if !has_arm && !has_motor {
            return Ok(());
        }
        self.allow_time();
        // not `with`, which a signal prevents
        match self.open.as_mut().map_or(Ok(()), |open| open.controller.end_arm()) {
            Ok(()) if has_arm => Ok(()),
            Ok(()) => {
                note("the motor is switched off now, because this session has switched it on");
                Ok(())
            }
            Err(error) => {
                note(
                    "the robot may still move, or its motor be on: look at it, and use the emergency stop if it moves",
                );
                Err(self.ended(error))
            }
        }
    }

    /// Leaves the motor on, if this session has switched it on without taking the arm. Returns whether that was so.
    pub(crate) fn leave_motor(&mut self) -> bool {
        self.open.as_mut().is_some_and(|open| open.controller.leave_motor())
    }

    /// Opens the connection without starting the service. From then on a signal ends the command after the running call.
    pub(crate) fn open_connection(&mut self) -> Result<(), Failure> {
        self.check_signal()?;
        let (target, budget) = (self.link.target()?, Budget::start(&self.link));
        let interrupt = if self.is_stopper { None } else { Some(Interrupt::of_session()?) };
        let controller = open(&target, &budget, &self.packets)?.recover_at(target.clone(), settings(&self.link));
        if let Some(interrupt) = interrupt {
            interrupt.raise(State::Calling);
        }
        self.open = Some(Open { controller, target, budget });
        self.set_budget(budget);
        Ok(())
    }

    /// Returns the open connection; connects first if necessary.
    fn opened(&mut self) -> Result<&mut Open, Failure> {
        self.check_signal()?;
        if self.lost {
            return Err(Failure::Connection {
                message: "the connection is lost".into(),
                hint: "`connect` connects again; look where the robot is before it moves".into(),
            });
        }
        self.connect()?;
        self.open.as_mut().ok_or_else(|| Failure::Connection {
            message: "there is no connection".into(),
            hint: "`connect` connects again".into(),
        })
    }

    /// Connects and starts the service unless that has been done; fails after a lost connection. A command that takes refusals for
    /// results begins with this, because Service_Start may be refused too.
    pub(crate) fn begin(&mut self) -> Result<(), Failure> {
        self.opened().map(drop)
    }

    /// Returns whether the connection was lost.
    pub(crate) const fn is_lost(&self) -> bool {
        self.lost
    }

    /// Returns whether there is a connection.
    pub(crate) const fn is_open(&self) -> bool {
        self.open.is_some() && !self.lost
    }

    /// Returns whether this session has taken the arm.
    pub(crate) fn has_arm(&self) -> bool {
        self.is_open() && self.open.as_ref().is_some_and(|open| open.controller.has_arm())
    }

    /// Starts the service, with keep-alives for long calls.
    pub(crate) fn start(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        self.call("", FunctionId::SERVICE_START, &[Value::new(&link.start_option())?]).map(drop)
    }

    /// Restarts the time limit of the command.
    pub(crate) fn restart_budget(&mut self) {
        if let Some(Open { controller, budget, .. }) = &mut self.open {
            budget.restart();
            controller.set_deadline(budget.deadline());
        }
    }

    /// Sets the time limit of a halt, at least the time limit of the command.
    fn allow_time(&mut self) {
        if let Some(Open { controller, .. }) = &mut self.open {
            controller.set_deadline(Some(bcap_std::now() + self.link.for_halt().timeout()));
        }
    }

    /// Removes the time limit of the command for a motion, which has a separate limit. Otherwise the command's limit could end
    /// the connection during the motion, and nothing could halt it.
    pub(crate) fn suspend_budget(&mut self) {
        if let Some(Open { controller, .. }) = &mut self.open {
            controller.set_deadline(None);
        }
    }

    /// Replaces the time limits.
    pub(crate) fn set_budget(&mut self, budget: Budget) {
        if let Some(open) = &mut self.open {
            open.budget = budget;
            let timing = budget.timing(open.controller.timing(), &open.target);
            open.controller.set_timing(timing);
            open.controller.set_deadline(budget.deadline());
        }
    }

    /// Limits each call with its keep-alives.
    pub(crate) fn limit_calls(&mut self, most: Duration) {
        if let Some(Open { controller, .. }) = &mut self.open {
            let timing = controller.timing();
            controller.set_timing(Timing { deadline: most, keep_alive: most, ..timing });
        }
    }

    /// Uses the library's objects after Controller_Connect, and converts their error.
    pub(crate) fn with<T>(&mut self, body: impl FnOnce(&mut Controller) -> Result<T, Error>) -> Result<T, Failure> {
        self.controller()?;
        body(&mut self.opened()?.controller).map_err(|error| self.ended(error))
    }

    /// Calls a function; `subject` names its object in the error of a refused call.
    pub(crate) fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        let open = self.opened()?;
        let called = open.controller.call_any(subject, function, arguments);
        if function.releases().is_some() {
            self.objects.clear();
        }
        called.map_err(|error| self.ended(error))
    }

    /// Calls a function; returns the code, which may be an error, and the value.
    pub(crate) fn call_for_code(
        &mut self,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        match self.call("", function, arguments) {
            Err(Failure::Refused { code, .. }) => Ok((code, None)),
            called => called,
        }
    }

    /// Executes a command of an object; returns the code, which may be an error, and the value.
    pub(crate) fn execute(
        &mut self,
        function: FunctionId,
        object: i32,
        command: &str,
        parameter: Value,
    ) -> Result<(HResult, Option<Value>), Failure> {
        self.call_for_code(function, &[Value::new(&object)?, Value::new(command)?, parameter])
    }

    /// Returns the handle of the controller; calls Controller_Connect first if necessary.
    pub(crate) fn controller(&mut self) -> Result<i32, Failure> {
        if !self.opened()?.controller.is_connected() {
            let function = FunctionId::CONTROLLER_CONNECT;
            let reply = match self.connect_provider() {
                Err(refused @ Failure::Refused { .. }) if self.link.has_default_provider() => {
                    self.connect_as_rc9(refused)?
                }
                connected => connected?,
            };
            if !self.opened()?.controller.is_connected() {
                let reason = format!("the reply carries {} instead of a handle", describe(reply.as_ref()));
                return Err(self.ended(Error::Reply { function, object: String::new(), reason }));
            }
        }
        Ok(self.opened()?.controller.handle().0)
    }

    /// Calls Controller_Connect, and returns its reply.
    fn connect_provider(&mut self) -> Result<Option<Value>, Failure> {
        let link = self.link.clone();
        let arguments =
            [Value::new("")?, Value::new(&self.provider)?, Value::new(&link.machine())?, Value::new(link.option())?];
        self.call("", FunctionId::CONTROLLER_CONNECT, &arguments).map(|(_, reply)| reply)
    }

    /// Connects with the provider of an RC9, because the controller has refused the default one, which an RC8 has.
    fn connect_as_rc9(&mut self, refused: Failure) -> Result<Option<Value>, Failure> {
        let link = self.link.clone();
        self.use_link(link.with_provider(Model::Rc9.provider()));
        let connected = self.connect_provider();
        if matches!(connected, Err(Failure::Refused { .. })) {
            self.use_link(link);
            return Err(refused);
        }
        if let (Ok(_), Some(name)) = (&connected, link.profile()) {
            match profiles::remember(name, &self.provider) {
                Ok(()) => note(&format!("the profile {name} connects to {}", self.provider)),
                Err(failure) => note(&format!("write provider = {:?} in the profile {name}: {failure}", self.provider)),
            }
        }
        connected
    }

    /// Returns the options with the provider that the controller accepts, for a command that connects by other means.
    pub(crate) fn settled(link: &LinkArgs) -> Result<LinkArgs, Failure> {
        let mut session = Self::new(link);
        if link.has_default_provider() {
            session.controller()?;
        }
        Ok(session.link.clone())
    }

    /// Connects with other arguments from now on, even after a lost connection.
    fn use_link(&mut self, link: LinkArgs) {
        link.provider().clone_into(&mut self.provider);
        self.open = self.open.take().map(|Open { controller, target, budget }| {
            let controller = controller.recover_at(target.clone(), settings(&link));
            Open { controller, target, budget }
        });
        self.link = link;
    }

    /// Opens all objects of a path, and returns the handle of the last object. Each path is opened once.
    pub(crate) fn object(&mut self, path: &ObjectPath) -> Result<i32, Failure> {
        let name = path.to_string();
        if let Some(handle) = self.objects.get(&name) {
            return Ok(*handle);
        }
        let owner = path.split_last().filter(|(owner, _)| owner.object() != Object::Controller);
        let handle = match owner {
            // the owner stays open for its next variable
            Some((owner, Some(variable))) => self.member(&owner, path, variable)?,
            _ => self.with(|controller| controller.open(path))?,
        };
        if path.object() != Object::Controller {
            self.objects.insert(name, handle);
        }
        Ok(handle)
    }

    /// Opens an object of another object, and returns its handle.
    fn member(&mut self, owner: &ObjectPath, path: &ObjectPath, name: &str) -> Result<i32, Failure> {
        let function = path.object().opened_from(owner.object()).unwrap_or(FunctionId::CONTROLLER_GET_VARIABLE);
        let arguments = [Value::new(&self.object(owner)?)?, Value::new(name)?, Value::new("")?];
        let (_, reply) = self.call(&path.to_string(), function, &arguments)?;
        let handle = reply.as_ref().and_then(|value| value.as_variant().as_i32());
        handle.ok_or_else(|| {
            let reason = format!("the reply carries {} instead of a handle", describe(reply.as_ref()));
            self.ended(Error::Reply { function, object: path.to_string(), reason })
        })
    }

    /// Handles signals from now on: the command looks for them between its steps.
    pub(crate) fn handle_signals(&mut self) -> Result<Interrupt, Failure> {
        let interrupt = Interrupt::install(|_| {})?;
        self.shares_stopper |= self.interrupt.is_none() && interrupt.can_halt();
        self.interrupt = Some(interrupt.clone());
        Ok(interrupt)
    }

    /// Repeats a step of the command until a signal arrives or the time is over. Each step has the command's time limit.
    pub(crate) fn repeat(
        &mut self,
        interval: Duration,
        time: Option<Duration>,
        mut step: impl FnMut(&mut Self) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let interrupt = self.handle_signals()?;
        let began = Instant::now();
        loop {
            self.restart_budget();
            step(self)?;
            let left = time.map_or(interval, |time| time.saturating_sub(began.elapsed()));
            if left.is_zero() || interrupt.sleep(interval.min(left)).is_err() {
                return Ok(());
            }
        }
    }

    /// Refuses a call after a signal, if the command does not look for signals itself.
    fn check_signal(&self) -> Result<(), Failure> {
        if !self.is_stopper && Interrupt::of_process().is_some_and(|interrupt| interrupt.forbids_calls()) {
            return Err(Failure::Interrupted("interrupted".into()));
        }
        Ok(())
    }

    /// Gives the arm back after a signal that ended a command between two calls, and reports that.
    pub(crate) fn finish(&mut self, done: Result<(), Failure>) -> Result<(), Failure> {
        let Some(interrupt) = Interrupt::of_process().filter(Interrupt::forbids_calls) else { return done };
        // the calls that end the session are allowed
        interrupt.enter(State::Stepping);
        if matches!(done, Err(Failure::Connection { .. } | Failure::Timeout { .. })) {
            return done;
        }
        if !self.has_arm() {
            return Err(Failure::Interrupted("interrupted".into()));
        }
        self.give_arm()?;
        Err(Failure::Interrupted("interrupted: the arm was given back".into()))
    }

    /// Opens the session that halts the robot while this one waits for a reply. Call it before the arm is taken.
    pub(crate) fn prepare_halt(&self, interrupt: &Interrupt) -> Result<(), Failure> {
        let mut link = self.link.for_halt();
        link.trace = None;
        interrupt.prepare(|| {
            if link.is_serial() {
                note("a serial line carries one session, so Ctrl-C cannot halt the robot here");
                return Ok(None);
            }
            let mut stopper = Self::new(&link);
            stopper.is_stopper = true;
            // the handle must exist before it is needed
            stopper.with(|controller| controller.robot().map(drop))?;
            Ok(Some(Box::new(move || match stopper.halt() {
                // the controller may have ended a session that was idle, above all over UDP
                Err(failure) if needs_new_session(&failure) => {
                    stopper.reconnect()?;
                    stopper.halt()
                }
                halted => halted,
            })))
        })
    }

    /// Halts the robot over this session.
    pub(crate) fn halt(&mut self) -> Result<(), Failure> {
        self.restart_budget();
        self.with(|controller| controller.robot()?.halt().map(drop))
    }

    /// Gives the arm back if this session has it.
    pub(crate) fn give_arm(&mut self) -> Result<(), Failure> {
        if !self.has_arm() {
            return Ok(());
        }
        self.allow_time();
        let given = self.with(|controller| controller.arm()?.give());
        self.restart_budget();
        given
    }

    /// Gives the arm back as [`give_arm`](Self::give_arm), which halts a motion of this session. Returns whether the robot moved
    /// before, or did not say so.
    pub(crate) fn stop(&mut self) -> Result<bool, Failure> {
        self.allow_time();
        let moved = self.has_arm() && self.with(|controller| controller.robot()?.read("@BUSY_STATUS")).unwrap_or(true);
        self.give_arm().map(|()| moved)
    }

    /// Closes a lost connection, so that the controller releases its resources, such as the arm. If this session owned the arm,
    /// the robot is first halted over another connection, because it may be moving.
    pub(crate) fn abandon(&mut self) {
        if !self.lost {
            return;
        }
        if self.open.as_ref().is_some_and(|open| open.controller.has_arm()) {
            match self.interrupt.as_ref().map_or(Ok(false), Interrupt::halt) {
                Ok(true) => note("the robot was halted over another connection"),
                Ok(false) => {
                    note("the robot was NOT halted, because there is no other connection; use the emergency stop")
                }
                Err(failure) => {
                    failure.print(false, None);
                    note("the robot may still move; use the emergency stop");
                }
            }
        }
        if let Err(failure) = self.disconnect() {
            failure.print(false, None);
        }
    }

    /// Releases an object before the end of the session.
    pub(crate) fn release(&mut self, object: Object, handle: i32) -> Result<(), Failure> {
        self.objects.retain(|_, open| *open != handle);
        let released = self.opened()?.controller.release(object, handle);
        released.map_err(|error| self.ended(error))
    }

    /// Converts an error. After a call without a reply, nothing more is sent.
    pub(crate) fn ended(&mut self, error: Error) -> Failure {
        let Some(Open { controller, target, budget }) = &mut self.open else {
            return Failure::Connection { message: error.to_string(), hint: "`connect` connects again".into() };
        };
        let failure = failure(error, target, budget);
        if !failure.leaves_the_session_alive() {
            controller.set_deadline(Some(bcap_std::now()));
            self.lost = true;
        }
        failure
    }
}
