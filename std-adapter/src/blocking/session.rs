//! The session of a controller: its connection, and the objects that are open.

use std::collections::HashMap;
use std::time::Duration;

use bcap_core::bcap::call::{self, Any, Call, ControllerHandle, Reply, RobotHandle, VariableHandle};
use bcap_core::bcap::client::Timing;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::procedure::{self, Handles, Owner, PathError, PathStep, Procedure, Provider, StepError};
use bcap_core::variant::{Encode, FromVariant};

use super::Connection;
use super::socket::Socket;
use crate::error::Error;
use crate::settings::Settings;
use crate::{CallError, RunError};

/// A started session.
#[derive(Debug)]
pub(super) struct ControllerSession {
    connection: Connection<Socket, Vec<u8>>,
    pub(super) handle: ControllerHandle,
    robot: Option<RobotHandle>,
    /// The handles of variables, by their owner and by name.
    variables: HashMap<(Object, i32), HashMap<String, VariableHandle>>,
    /// All open objects, in the order in which they were opened, without service and controller.
    opened: Vec<(Object, i32)>,
    lost: bool,
}

impl ControllerSession {
    /// Starts the service and connects to the controller.
    pub(super) fn start(mut connection: Connection<Socket, Vec<u8>>, settings: &Settings) -> Result<Self, Error> {
        let service = settings.service.to_text();
        let handle = connection.run(procedure::open(provider(settings, &service)));
        let handle = handle.map_err(|error| Error::run(SESSION, error))?;
        let (variables, opened) = (HashMap::new(), Vec::new());
        Ok(Self { connection, handle, robot: None, variables, opened, lost: false })
    }

    /// Returns the handle of the robot, and opens it when it is first used.
    pub(super) fn robot(&mut self, name: Option<&str>) -> Result<RobotHandle, Error> {
        if let Some(handle) = self.robot {
            return Ok(handle);
        }
        let step = PathStep { object: Object::Robot, name };
        let handle = RobotHandle(self.open(Object::Controller, self.handle.0, step)?);
        self.robot = Some(handle);
        Ok(handle)
    }

    /// Makes a call; `object` is named in errors.
    pub(super) fn call<C: Call>(&mut self, object: &str, call: C) -> Result<<C::Reply as Reply>::Value<'_>, Error> {
        let function = call.function();
        let Self { connection, lost, .. } = self;
        connection.call(call).map_err(|error| {
            *lost |= !error.is_recoverable();
            Error::call(function, object, error)
        })
    }

    /// Makes a call and converts its value.
    pub(super) fn value<T, C>(&mut self, object: &str, call: C) -> Result<T, Error>
    where
        T: for<'a> FromVariant<'a>,
        C: Call<Reply = Any>,
    {
        let value = self.call(object, call)?;
        T::from_variant(value).map_err(|source| Error::Value { object: object.to_owned(), source })
    }

    /// Runs a procedure; `object` is named in errors.
    pub(super) fn run<P: Procedure<Error = StepError>>(
        &mut self,
        object: &str,
        procedure: P,
    ) -> Result<P::Output, Error> {
        self.connection.run(procedure).map_err(|error: RunError| {
            self.lost |= error.call.as_ref().is_some_and(|call| !call.is_recoverable());
            Error::run(object, error)
        })
    }

    /// Reads a variable of the controller or of a robot.
    pub(super) fn read_of<T: for<'a> FromVariant<'a>>(
        &mut self,
        object: Object,
        owner: i32,
        name: &str,
    ) -> Result<T, Error> {
        let variable = self.variable(object, owner, name)?;
        self.value(name, call::variable_get_value(variable))
    }

    /// Returns the handle of a variable, and opens it when it is first used.
    fn variable(&mut self, object: Object, owner: i32, name: &str) -> Result<VariableHandle, Error> {
        if let Some(known) = self.variables.get(&(object, owner)).and_then(|names| names.get(name)) {
            return Ok(*known);
        }
        let handle = VariableHandle(self.open(object, owner, PathStep::variable(name))?);
        self.variables.entry((object, owner)).or_default().insert(name.to_owned(), handle);
        Ok(handle)
    }

    /// Opens an object.
    fn open(&mut self, object: Object, owner: i32, step: PathStep<'_>) -> Result<i32, Error> {
        let name = step.name.unwrap_or("the first robot");
        let owner: Owner = match object {
            Object::Robot => RobotHandle(owner).into(),
            _ => ControllerHandle(owner).into(),
        };
        let function = step.object.opened_from(object).unwrap_or(FunctionId::CONTROLLER_GET_VARIABLE);
        let wrong = |error: PathError| Error::Reply { function, object: name.to_owned(), reason: error.to_string() };
        let opened = self.run(name, procedure::open_path(owner, &[step]).map_err(wrong)?)?;
        let handle = opened.last().map_or(0, |(_, handle)| *handle);
        self.opened.extend(opened);
        Ok(handle)
    }

    /// Releases all objects in reverse order and stops the service, once. It ends at the first call without a reply.
    pub(super) fn release(&mut self) -> Result<(), Error> {
        if std::mem::replace(&mut self.lost, true) {
            return Ok(());
        }
        let timing = self.connection.client().timing();
        let timing = Timing { attempt_timeout: timing.attempt_timeout.min(CLOSE), deadline: CLOSE, ..timing };
        let session = [(Object::Service, 0), (Object::Controller, self.handle.0)];
        for (object, handle) in session.iter().chain(&self.opened).rev() {
            let arguments: &[&dyn Encode] = if *object == Object::Service { &[] } else { &[handle] };
            let function = object.released_by();
            match self.connection.call_with(call::RawCall { function, arguments }, timing) {
                // an object that cannot be released does not exist
                Ok(_) | Err(CallError::Refused(_)) => {}
                Err(error) => return Err(Error::call(function, SESSION, error)),
            }
        }
        Ok(())
    }

    /// Writes a variable of the controller or of a robot.
    pub(super) fn write_of(&mut self, object: Object, owner: i32, name: &str, value: impl Encode) -> Result<(), Error> {
        let variable = self.variable(object, owner, name)?;
        self.call(name, call::variable_put_value(variable, value))
    }
}

/// The object that errors name when a session starts or ends.
const SESSION: &str = "the session";
/// How long a call at the end of a session may take.
const CLOSE: Duration = Duration::from_secs(1);

/// Returns the parameters of a session.
fn provider<'a>(settings: &'a Settings, service: &'a str) -> Provider<'a> {
    Provider { service, option: &settings.connect_option, ..Provider::new(settings.model.provider()) }
}

/// Opens a session with a robot, for another connection.
pub(super) fn open_robot(connection: &mut Connection<Socket, Vec<u8>>, settings: &Settings) -> Result<Handles, Error> {
    let service = settings.service.to_text();
    let session = procedure::open_robot(provider(settings, &service), settings.robot.as_deref());
    connection.run(session).map_err(|error| Error::run(SESSION, error))
}
