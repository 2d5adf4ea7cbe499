//! The check before a call that would end a stream of Slave Mode.
//!
//! On a real controller a call that Slave Mode refuses ends Slave Mode, even when another client sends it. So the mode is
//! queried before each such call, and the call is skipped while a stream runs or may run. A stream that begins between the
//! query and the call can still be ended.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::variant::OwnedVariant;
use bcap_std::Error;
use bcap_std::asynch::Controller;

/// Why there is no value.
#[derive(Debug)]
pub(crate) enum ReadError {
    Failed(Error),
    /// The call was not sent; the reason.
    Skipped(String),
}

impl From<Error> for ReadError {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Failed(error) => error.fmt(f),
            Self::Skipped(why) => f.write_str(why),
        }
    }
}

/// Checks the calls for a controller.
#[derive(Debug, Default)]
pub(crate) struct StreamCheck {
    /// Whether the controller has answered that it has no Slave Mode. It is not queried again: a refusal may be an entry in its
    /// log.
    is_absent: AtomicBool,
}

impl StreamCheck {
    /// Fails with [`ReadError::Skipped`] if a call must not be sent. Calls that Slave Mode allows need no query.
    pub(crate) async fn require(
        &self,
        controller: &Controller,
        function: FunctionId,
        command: Option<&str>,
    ) -> Result<(), ReadError> {
        let properties = function.properties(command, None);
        if properties.in_slave_mode.is_allowed() || self.is_absent.load(Ordering::Relaxed) {
            return Ok(());
        }
        let state = state(controller).await?;
        self.is_absent.store(state == StreamState::Absent, Ordering::Relaxed);
        let name = command.map_or_else(|| function.to_string(), str::to_owned);
        match state.skip(&name, properties) {
            Some(skipped) => Err(ReadError::Skipped(format!("skipped: {skipped}"))),
            None => Ok(()),
        }
    }
}

/// Queries whether a stream runs.
async fn state(controller: &Controller) -> Result<StreamState, Error> {
    let asked = async { controller.robot().await?.execute::<OwnedVariant>(StreamState::COMMAND, ()).await };
    match asked.await {
        Ok(mode) => Ok(StreamState::from_reply(Default::default(), mode.as_variant().as_i32())),
        Err(Error::Refused { code, .. }) => Ok(StreamState::from_reply(code, None)),
        Err(error) => Err(error),
    }
}
