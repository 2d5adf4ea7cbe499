//! A session with a controller within the time limits of the command line.
//!
//! Controller_Connect is called when a command first needs the controller. At the end of the session, also after a refusal,
//! all objects are released in reverse order. After a call without a reply nothing is sent.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_std::blocking::Controller;
use bcap_std::{Address, Error, ObjectPath};

use crate::args::LinkArgs;
use crate::budget::Budget;
use crate::connection::{failure, open};
use crate::error::Failure;
use crate::value::{Value, described, text};

/// A session, from Service_Start to Service_Stop.
pub(crate) struct Session {
    controller: Controller,
    target: Address,
    budget: Budget,
    /// The provider for the next Controller_Connect.
    pub(crate) provider: String,
    /// The option of Controller_Connect.
    option: String,
}

/// Runs `body` with a started session, then releases its objects and stops the service.
pub(crate) fn with_session<T>(
    link: &LinkArgs,
    body: impl FnOnce(&mut Session) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut session = Session::open(link)?;
    session.start(link)?;
    body(&mut session)
}

impl Session {
    /// Connects without starting the service.
    pub(crate) fn open(link: &LinkArgs) -> Result<Self, Failure> {
        let (target, budget) = (link.target()?, Budget::start(link));
        let controller = open(&target, &budget)?;
        let mut session = Self {
            controller,
            target,
            budget,
            provider: link.provider().to_owned(),
            option: link.connect_option().to_owned(),
        };
        session.set_budget(budget);
        Ok(session)
    }

    /// Starts the service, with keep-alives for long calls.
    pub(crate) fn start(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        self.call("", FunctionId::SERVICE_START, &[text(&link.start_option())?]).map(drop)
    }

    /// Restarts the time limit of the command.
    pub(crate) fn restart_budget(&mut self) {
        self.budget.restart();
        self.controller.set_deadline(self.budget.deadline());
    }

    /// Replaces the time limits.
    pub(crate) fn set_budget(&mut self, budget: Budget) {
        self.budget = budget;
        let timing = budget.timing(self.controller.timing(), &self.target);
        self.controller.set_timing(timing);
        self.controller.set_deadline(budget.deadline());
    }

    /// Returns the library's controller after Controller_Connect.
    pub(crate) fn connected(&mut self) -> Result<&mut Controller, Failure> {
        self.controller().map(|_| &mut self.controller)
    }

    /// Calls a function; `subject` names what it is called on when the call is refused.
    pub(crate) fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        let called = self.controller.call_any(subject, function, arguments);
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

    /// Returns the handle of the controller; calls Controller_Connect first if necessary.
    pub(crate) fn controller(&mut self) -> Result<i32, Failure> {
        if !self.controller.is_connected() {
            let (function, provider) = (FunctionId::CONTROLLER_CONNECT, text(&self.provider)?);
            let (_, reply) =
                self.call("", function, &[text("")?, provider, text("localhost")?, text(&self.option)?])?;
            if !self.controller.is_connected() {
                let reason = format!("the reply carries {} instead of a handle", described(reply.as_ref()));
                return Err(self.ended(Error::Reply { function, object: String::new(), reason }));
            }
        }
        Ok(self.controller.handle().0)
    }

    /// Opens all objects of a path, and returns the handle of the last one.
    pub(crate) fn object(&mut self, path: &ObjectPath) -> Result<i32, Failure> {
        self.connected()?.open(path).map_err(|error| self.ended(error))
    }

    /// Releases an object before the end of the session.
    pub(crate) fn release(&mut self, object: Object, handle: i32) -> Result<(), Failure> {
        self.controller.release(object, handle).map_err(|error| self.ended(error))
    }

    /// Converts an error. After a call without a reply, nothing more is sent.
    pub(crate) fn ended(&mut self, error: Error) -> Failure {
        let failure = failure(error, &self.target, &self.budget);
        if !failure.leaves_the_session_alive() {
            self.controller.set_deadline(Some(bcap_std::now()));
        }
        failure
    }
}
