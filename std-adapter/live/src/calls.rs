//! The calls of a session, so that the readers work over the sessions of several programs.

use std::fmt;

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, OwnedVariant};
use bcap_std::{ObjectPath, ObjectPathError, TaskStatus};

/// A session with a controller.
pub trait Calls {
    /// The error of a call.
    type Error: Failure;

    /// Opens an object, which stays open for the next time, and returns its handle.
    ///
    /// # Errors
    ///
    /// The error of the call that opens it.
    fn object(&mut self, path: &ObjectPath) -> Result<i32, Self::Error>;

    /// Returns whether an object is open already, so that [`object`](Self::object) makes no call.
    fn is_open(&self, path: &ObjectPath) -> bool {
        let _ = path;
        false
    }

    /// Calls a function; `subject` names its object in errors.
    ///
    /// # Errors
    ///
    /// A refusal, or the loss of the connection.
    fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[OwnedVariant],
    ) -> Result<(HResult, Option<OwnedVariant>), Self::Error>;

    /// Releases an object.
    ///
    /// # Errors
    ///
    /// The error of the call.
    fn release(&mut self, object: Object, handle: i32) -> Result<(), Self::Error>;

    /// Reads the status of a task.
    ///
    /// # Errors
    ///
    /// The error of a call.
    fn task_status(&mut self, name: &str) -> Result<TaskStatus, Self::Error>;

    /// Restarts the time limit of the session, if it has one, before the next reading.
    fn restart_limit(&mut self) {}
}

/// The error of a [`Calls`].
pub trait Failure: fmt::Display + From<EncodeError> + From<ObjectPathError> {
    /// Returns the code of a refused call.
    fn code(&self) -> Option<HResult>;

    /// Returns whether nothing more can be called over this session.
    fn is_lost(&self) -> bool;

    /// Creates the error of a call that was not made, because it would end a stream of Slave Mode.
    fn skipped(message: String) -> Self;

    /// Returns whether [`skipped`](Self::skipped) created it.
    fn is_skipped(&self) -> bool;

    /// Creates the error of a reply that does not match the call.
    fn unexpected(message: String) -> Self;

    /// Creates the error of an invalid input of the user.
    fn invalid(message: String) -> Self;

    /// Creates the error of a controller whose state does not permit the operation.
    fn unfit(message: String) -> Self;

    /// Adds the remedy.
    #[must_use]
    fn with_hint(self, hint: &str) -> Self;

    /// Returns the reason why a read failed, if the session can continue without it: a refusal, or an unexpected reply.
    fn omission(&self) -> Option<String>;
}

/// Returns whether the session must be opened again: the connection is lost, or a handle no longer exists because the
/// controller has restarted or has ended the session.
pub fn needs_reconnect(failure: &impl Failure) -> bool {
    failure.is_lost() || failure.code() == Some(HResult::E_HANDLE)
}

/// Returns `None` if the controller refuses or answers with an unexpected value.
///
/// # Errors
///
/// The loss of the session: it must be opened again.
pub fn unless_refused<T, F: Failure>(result: Result<T, F>) -> Result<Option<T>, F> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(failure) if needs_reconnect(&failure) => Err(failure),
        Err(_) => Ok(None),
    }
}

/// Executes a command of the controller.
///
/// # Errors
///
/// The error of the call.
pub fn execute<C: Calls>(calls: &mut C, command: &str, parameter: &impl Encode) -> Result<OwnedVariant, C::Error> {
    let controller = calls.object(&ObjectPath::controller())?;
    let arguments = [OwnedVariant::new(&controller)?, OwnedVariant::new(command)?, OwnedVariant::new(parameter)?];
    let (_, value) = calls.call(command, FunctionId::CONTROLLER_EXECUTE, &arguments)?;
    Ok(value.unwrap_or_default())
}
