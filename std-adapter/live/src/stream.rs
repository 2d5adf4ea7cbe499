//! The check before a call that would end a stream of Slave Mode.
//!
//! On a real controller a call that Slave Mode refuses ends Slave Mode, even when another client sends it. So a program that
//! only reads queries the mode first, and skips calls that Slave Mode refuses. A stream may still begin between the query and
//! the call; this cannot be prevented.

use bcap_core::bcap::{FunctionId, Object, StreamState};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::{ObjectPath, TaskStatus};

use crate::calls::{Calls, Failure};

/// Checks calls before they are sent.
#[derive(Debug, Default)]
pub struct StreamCheck {
    /// Whether the controller has reported that it has no Slave Mode. The query is not repeated, because a refusal may be an
    /// entry in its log.
    is_absent: bool,
}

impl StreamCheck {
    /// Queries whether a stream of Slave Mode runs.
    ///
    /// # Errors
    ///
    /// The loss of the session.
    pub fn ask<C: Calls>(&mut self, calls: &mut C) -> Result<StreamState, C::Error> {
        if self.is_absent {
            return Ok(StreamState::Absent);
        }
        let robot = match calls.object(&"robot".parse::<ObjectPath>()?) {
            Ok(robot) => robot,
            Err(failure) => return refused(failure).map(|code| StreamState::from_reply(code, None)),
        };
        let arguments = [OwnedVariant::new(&robot)?, OwnedVariant::new(StreamState::COMMAND)?, OwnedVariant::default()];
        let (code, value) = match calls.call(StreamState::COMMAND, FunctionId::ROBOT_EXECUTE, &arguments) {
            // the session has ended
            Err(failure) if failure.code() == Some(HResult::E_HANDLE) => return Err(failure),
            Err(failure) => (refused(failure)?, None),
            Ok(reply) => reply,
        };
        let state = StreamState::from_reply(code, value.and_then(|value| value.as_variant().as_i32()));
        self.is_absent = state == StreamState::Absent;
        Ok(state)
    }

    /// Returns why a call must not be sent; `None` if it may. Calls that Slave Mode allows need no query.
    ///
    /// # Errors
    ///
    /// The loss of the session.
    pub fn skip<C: Calls>(
        &mut self,
        calls: &mut C,
        function: FunctionId,
        command: Option<&str>,
    ) -> Result<Option<String>, C::Error> {
        let properties = function.properties(command, None);
        if properties.in_slave_mode.is_allowed() {
            return Ok(None);
        }
        let state = self.ask(calls)?;
        let name = command.map_or_else(|| function.to_string(), str::to_owned);
        Ok(state.skip(&name, properties).map(|skipped| format!("skipped: {skipped}")))
    }

    /// Fails if a call must not be sent.
    ///
    /// # Errors
    ///
    /// [`Failure::skipped`], or the loss of the session.
    pub fn require<C: Calls>(
        &mut self,
        calls: &mut C,
        function: FunctionId,
        command: Option<&str>,
    ) -> Result<(), C::Error> {
        self.skip(calls, function, command)?.map_or(Ok(()), |message| Err(C::Error::skipped(message)))
    }

    /// Fails if an object is not open and must not be opened now.
    ///
    /// # Errors
    ///
    /// Same as [`require`](Self::require).
    pub fn require_open<C: Calls>(&mut self, calls: &mut C, path: &ObjectPath) -> Result<(), C::Error> {
        if calls.is_open(path) {
            return Ok(());
        }
        let mut path = path.clone();
        while let Some((owner, _)) = path.split_last() {
            if let Some(function) = path.object().opened_from(owner.object()) {
                self.require(calls, function, None)?;
            }
            path = owner;
        }
        Ok(())
    }
}

/// A session whose calls fail with [`Failure::skipped`] where they would end a stream of Slave Mode. It queries the mode before
/// each call that Slave Mode does not allow.
#[derive(Debug)]
pub struct CheckedCalls<'a, C> {
    calls: &'a mut C,
    check: StreamCheck,
}

impl<'a, C> CheckedCalls<'a, C> {
    /// Checks the calls of a session.
    pub fn new(calls: &'a mut C) -> Self {
        Self { calls, check: StreamCheck::default() }
    }
}

impl<C: Calls> Calls for CheckedCalls<'_, C> {
    type Error = C::Error;

    fn object(&mut self, path: &ObjectPath) -> Result<i32, C::Error> {
        self.check.require_open(self.calls, path)?;
        self.calls.object(path)
    }

    fn is_open(&self, path: &ObjectPath) -> bool {
        self.calls.is_open(path)
    }

    fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[OwnedVariant],
    ) -> Result<(HResult, Option<OwnedVariant>), C::Error> {
        let command = arguments.get(1).and_then(|command| command.as_variant().as_bstr());
        let command = command.filter(|_| function.executes()).map(|command| command.to_string());
        self.check.require(self.calls, function, command.as_deref())?;
        self.calls.call(subject, function, arguments)
    }

    fn release(&mut self, object: Object, handle: i32) -> Result<(), C::Error> {
        self.calls.release(object, handle)
    }

    fn task_status(&mut self, name: &str) -> Result<TaskStatus, C::Error> {
        self.check.require(self.calls, FunctionId::CONTROLLER_GET_TASK, None)?;
        self.calls.task_status(name)
    }

    fn restart_limit(&mut self) {
        self.calls.restart_limit();
    }
}

/// Fails if a stream of Slave Mode runs that this call would end. For several calls use one [`StreamCheck`].
///
/// # Errors
///
/// [`Failure::skipped`], or the loss of the session.
pub fn spare<C: Calls>(calls: &mut C, function: FunctionId, command: Option<&str>) -> Result<(), C::Error> {
    StreamCheck::default().require(calls, function, command)
}

/// Returns the code of a refusal; fails for other errors.
fn refused<F: Failure>(failure: F) -> Result<HResult, F> {
    failure.code().filter(|_| !failure.is_lost()).ok_or(failure)
}
