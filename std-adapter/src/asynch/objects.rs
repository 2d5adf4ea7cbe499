//! Tasks and files of a controller as objects for tokio.

use bcap_core::variant::{Encode, FromVariant};

use super::handle::{Handle, owned};
use crate::error::Error;
use crate::task::{TaskStart, TaskStatus, TaskStop};

/// A task of a controller, from [`Controller::task`](super::Controller::task).
#[derive(Clone, Debug)]
pub struct Task {
    handle: Handle,
    name: String,
}

impl Task {
    pub(super) const fn new(handle: Handle, name: String) -> Self {
        Self { handle, name }
    }

    /// Starts the task. Its program may move the robot, and continues when this object is dropped.
    ///
    /// # Errors
    ///
    /// An [`Error`]. The controller must be in Auto mode and give this client the executable token (b-CAP
    /// specification, sections 3.1 and 3.2).
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn start(&self, mode: TaskStart) -> Result<(), Error> {
        let name = self.name.clone();
        self.handle.run(move |session| Box::pin(async move { session.start_task(&name, mode).await })).await
    }

    /// Stops the task.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// The task is stopped even if the future is dropped after its first poll.
    pub async fn stop(&self, mode: TaskStop) -> Result<(), Error> {
        let name = self.name.clone();
        self.handle.run_always(move |session| Box::pin(async move { session.stop_task(&name, mode).await })).await
    }

    /// Reads the status of the task.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn status(&self) -> Result<TaskStatus, Error> {
        let name = self.name.clone();
        self.handle.run(move |session| Box::pin(async move { session.task_status(&name).await })).await
    }
}

/// A file of a controller, from [`Controller::file`](super::Controller::file).
#[derive(Clone, Debug)]
pub struct File {
    handle: Handle,
    name: String,
}

impl File {
    pub(super) const fn new(handle: Handle, name: String) -> Self {
        Self { handle, name }
    }

    /// Reads the content: a `String` for text, `Vec<u8>` for a controller that sends bytes.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the content has another type.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn read<T: for<'v> FromVariant<'v>>(&self) -> Result<T, Error> {
        let name = self.name.clone();
        let read = self.handle.run(move |session| Box::pin(async move { session.read_file(&name).await }));
        read.await?.convert().map_err(|source| Error::Value { object: self.name.clone(), source })
    }

    /// Replaces the content.
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the content may have been replaced.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn write(&self, content: impl Encode) -> Result<(), Error> {
        let (name, content) = (self.name.clone(), owned(&content)?);
        self.handle.run(move |session| Box::pin(async move { session.write_file(&name, content).await })).await
    }
}
