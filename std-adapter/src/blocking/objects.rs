//! Tasks, files and scans of a controller as objects.

use bcap_core::bcap::Object;
use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};

use super::limited::Limited;
use super::socket::{Blocking, ready};
use crate::error::Error;
use crate::session::Session;
use crate::task::{TaskStart, TaskStatus, TaskStop};

/// A task of a controller, from [`Controller::task`](super::Controller::task).
#[derive(Debug)]
pub struct Task<'a> {
    calls: Limited<'a>,
    name: String,
}

impl<'a> Task<'a> {
    pub(super) fn new(calls: Limited<'a>, name: &str) -> Self {
        Self { calls, name: name.to_owned() }
    }

    /// Starts the task. Its program may move the robot, and continues when this object is dropped.
    ///
    /// # Errors
    ///
    /// An [`Error`]. The controller must be in Auto mode and give this client the executable token (b-CAP
    /// specification, sections 3.1 and 3.2).
    pub fn start(&mut self, mode: TaskStart) -> Result<(), Error> {
        self.calls.run(async |session| session.start_task(&self.name, mode).await)
    }

    /// Stops the task. The limit of [`ControllerRef::within`](super::ControllerRef::within) does not apply.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn stop(&mut self, mode: TaskStop) -> Result<(), Error> {
        ready(self.calls.session().stop_task(&self.name, mode))
    }

    /// Reads the status of the task.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn status(&mut self) -> Result<TaskStatus, Error> {
        self.calls.run(async |session| session.task_status(&self.name).await)
    }
}

/// A file of a controller, from [`Controller::file`](super::Controller::file).
#[derive(Debug)]
pub struct File<'a> {
    calls: Limited<'a>,
    name: String,
}

impl<'a> File<'a> {
    pub(super) fn new(calls: Limited<'a>, name: &str) -> Self {
        Self { calls, name: name.to_owned() }
    }

    /// Reads the content: a `String` for text, `Vec<u8>` for a controller that sends bytes.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the content has another type.
    pub fn read<T: for<'v> FromVariant<'v>>(&mut self) -> Result<T, Error> {
        let content = self.calls.run(async |session| session.read_file(&self.name).await)?;
        content.convert().map_err(|source| Error::Value { object: self.name.clone(), source })
    }

    /// Replaces the content.
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the content may have been replaced.
    pub fn write(&mut self, content: impl Encode) -> Result<(), Error> {
        self.calls.run(async |session| session.write_file(&self.name, content).await)
    }
}

/// Variables that are opened once and read often, from [`Controller::scan`](super::Controller::scan).
///
/// It contains its session. Handles are numbers which another session gives to other objects, so a scan that is used
/// with another controller is an error and not a wrong value.
///
/// # Examples
///
/// ```no_run
/// # use bcap_std::{Settings, blocking::Controller};
/// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
/// let scan = cell.scan(&["I1", "robot/@SERVO_ON"])?;
/// for _ in 0..10 {
///     let values = scan.read(&mut cell)?;
///     println!("{values:?}");
/// }
/// # Ok::<(), bcap_std::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Scan {
    session: u64,
    variables: Vec<(String, VariableHandle)>,
}

impl Scan {
    pub(super) async fn open(session: &mut Session<Blocking>, names: &[&str]) -> Result<Self, Error> {
        let mut variables = Vec::with_capacity(names.len());
        for name in names {
            variables.push((String::from(*name), session.variable(Object::Controller, name).await?));
        }
        Ok(Self { session: session.id, variables })
    }

    /// Reads the variables in their order, if this is their session.
    pub(super) async fn read_in(&self, session: &mut Session<Blocking>) -> Result<Vec<OwnedVariant>, Error> {
        if session.id != self.session {
            return Err(Error::OtherSession);
        }
        let mut values = Vec::with_capacity(self.variables.len());
        for (name, handle) in &self.variables {
            values.push(session.value(name, call::variable_get_value(*handle)).await?);
        }
        Ok(values)
    }
}
