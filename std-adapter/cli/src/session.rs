//! A session with a controller: connects, opens the objects that a command needs, and releases them at the end.
//!
//! ```text
//!  connect ─ Service_Start ─ [ Controller_Connect ─ [ Get objects ─ calls ─ release ] ─ Controller_Disconnect ] ─ Service_Stop
//! ```
//!
//! Controller_Connect is called when a command first needs the controller. At the end of the session, also after a refusal,
//! the objects are released in reverse order. After a failed connection nothing is sent.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;

use crate::args::LinkArgs;
use crate::budget::Budget;
use crate::connection::Connection;
use crate::error::Failure;
use crate::object::{Path, opened_by, word};
use crate::value::{Value, described};

/// A session, from Service_Start to Service_Stop.
pub(crate) struct ControllerSession {
    connection: Connection,
    provider: String,
    started: bool,
    controller: Option<i32>,
    /// The objects to release, in the order in which they were opened.
    opened: Vec<(Object, i32)>,
}

/// Runs `body` with a started session, then releases its objects and stops the service.
pub(crate) fn with_session<T>(
    link: &LinkArgs,
    body: impl FnOnce(&mut ControllerSession) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut session = ControllerSession::open(link)?;
    let result = session.start(link).and_then(|()| body(&mut session));
    if result.as_ref().err().is_none_or(Failure::leaves_the_session_alive) {
        session.close();
    }
    result
}

impl ControllerSession {
    /// Connects without starting the service.
    pub(crate) fn open(link: &LinkArgs) -> Result<Self, Failure> {
        let connection = Connection::open(&link.target()?, Budget::start(link))?;
        let provider = link.provider.clone();
        Ok(Self { connection, provider, started: false, controller: None, opened: Vec::new() })
    }

    /// Starts the service, with keep-alives for long calls.
    pub(crate) fn start(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        let option = link.start_option();
        self.call(FunctionId::SERVICE_START, &[text(&option)?])?;
        self.started = true;
        Ok(())
    }

    /// Restarts the time limit of the command.
    pub(crate) fn restart_budget(&mut self) {
        self.connection.budget.restart();
    }

    /// Replaces the time limits.
    pub(crate) fn set_budget(&mut self, budget: Budget) {
        self.connection.budget = budget;
    }

    /// Sets the provider for the next Controller_Connect.
    pub(crate) fn set_provider(&mut self, provider: &str) {
        provider.clone_into(&mut self.provider);
    }

    /// Calls a function; returns the code, which may be an error, and the value.
    pub(crate) fn call_for_code(
        &mut self,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        self.connection.call(function, arguments)
    }

    /// Calls a function.
    pub(crate) fn call(&mut self, function: FunctionId, arguments: &[Value]) -> Result<Option<Value>, Failure> {
        match self.connection.call(function, arguments)? {
            (code, _) if code.is_err() => Err(Failure::Refused { doing: function.to_string(), code }),
            (_, value) => Ok(value),
        }
    }

    /// Calls a function on an object; `subject` names it when the call is refused.
    pub(crate) fn call_on(
        &mut self,
        subject: &Path,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<Option<Value>, Failure> {
        self.call(function, arguments).map_err(|failure| about(failure, subject))
    }

    /// Returns the handle of the controller; calls Controller_Connect first if necessary.
    pub(crate) fn controller(&mut self) -> Result<i32, Failure> {
        if let Some(handle) = self.controller {
            return Ok(handle);
        }
        let arguments = [text("")?, text(&self.provider)?, text("localhost")?, text("")?];
        let handle = self.open_with(FunctionId::CONTROLLER_CONNECT, &arguments)?;
        self.controller = Some(handle);
        Ok(handle)
    }

    /// Opens all objects of a path, and returns the handle of the last one.
    pub(crate) fn object(&mut self, path: &Path) -> Result<i32, Failure> {
        let mut handle = self.controller()?;
        let mut owner = Object::Controller;
        for step in &path.steps {
            let function = opened_by(owner, step.object)
                .ok_or_else(|| Failure::Input(format!("a {} has no {}", word(owner), word(step.object))))?;
            let name = match &step.name {
                Some(name) => name.clone(),
                None => self.first_robot(handle)?,
            };
            let arguments = [integer(handle)?, text(&name)?, text("")?];
            handle = self.open_with(function, &arguments).map_err(|failure| about(failure, path))?;
            owner = step.object;
        }
        Ok(handle)
    }

    /// Returns the name of the controller's first robot.
    fn first_robot(&mut self, controller: i32) -> Result<String, Failure> {
        let arguments = [integer(controller)?, text("")?];
        let names = match self.call(FunctionId::CONTROLLER_GET_ROBOT_NAMES, &arguments) {
            Err(failure) if !failure.leaves_the_session_alive() => return Err(failure),
            names => names.ok().flatten(),
        };
        let name = names.and_then(|names| strings(&names).into_iter().next());
        // a controller without a list of names accepts the name of the samples
        Ok(name.unwrap_or_else(|| "Arm0".into()))
    }

    /// Calls a function that opens an object, and records its handle for the release.
    fn open_with(&mut self, function: FunctionId, arguments: &[Value]) -> Result<i32, Failure> {
        let reply = self.call(function, arguments)?;
        let value = reply.as_ref().map(Value::as_variant);
        let handle = value.and_then(|value| match value {
            bcap_core::variant::Variant::Ui4(handle) => Some(handle.cast_signed()),
            value => value.as_i32(),
        });
        let Some(handle) = handle else {
            let found = described(reply.as_ref());
            let message = format!("{function}: the reply carries {found} instead of a handle");
            let hint = "check that the other end is a b-CAP server".into();
            return Err(Failure::Connection { message, hint });
        };
        if let Some(object) = function.opens() {
            self.opened.push((object, handle));
        }
        Ok(handle)
    }

    /// Releases the object that was opened last.
    pub(crate) fn release(&mut self, handle: i32) -> Result<(), Failure> {
        let Some(at) = self.opened.iter().rposition(|(_, opened)| *opened == handle) else { return Ok(()) };
        let (object, handle) = self.opened.remove(at);
        self.call(object.released_by(), &[integer(handle)?])?;
        Ok(())
    }

    /// Records the objects that a user's call has opened or released.
    pub(crate) fn record(&mut self, function: FunctionId, arguments: &[Value], reply: Option<&Value>) {
        match (function.opens(), function.releases()) {
            (_, Some(Object::Service)) => {
                self.opened.clear();
                self.started = false;
            }
            (Some(Object::Service), _) => self.started = true,
            (Some(object), _) => {
                let handle = reply.and_then(|value| value.as_variant().as_i64()).and_then(|n| i32::try_from(n).ok());
                self.opened.extend(handle.map(|handle| (object, handle)));
            }
            (_, Some(_)) => {
                let handle = arguments.first().and_then(|value| value.as_variant().as_i32());
                self.opened.retain(|(_, opened)| Some(*opened) != handle);
            }
            (None, None) => {}
        }
    }

    /// Releases all objects in reverse order and stops the service. Refusals are ignored: the user cannot act on them.
    pub(crate) fn close(mut self) {
        while let Some((_, handle)) = self.opened.last().copied() {
            if self.release(handle).is_err_and(|failure| !failure.leaves_the_session_alive()) {
                return;
            }
        }
        if self.started {
            let _ = self.call(FunctionId::SERVICE_STOP, &[]);
        }
    }
}

/// Returns the strings of an array of strings, or of an array of values that are strings.
pub(crate) fn strings(names: &Value) -> Vec<String> {
    let elements = names.as_variant().as_array().into_iter().flatten();
    elements.filter_map(|name| name.as_bstr().map(|name| name.to_string())).collect()
}

/// Adds the name of an object to a refusal.
fn about(failure: Failure, subject: &Path) -> Failure {
    match failure {
        Failure::Refused { doing, code } => Failure::Refused { doing: format!("{subject}: {doing}"), code },
        other => other,
    }
}

/// Encodes a string argument.
pub(crate) fn text(text: &str) -> Result<Value, Failure> {
    Ok(Value::new(text)?)
}

/// Encodes an I4 argument, such as a handle.
pub(crate) fn integer(number: i32) -> Result<Value, Failure> {
    Ok(Value::new(&number)?)
}
