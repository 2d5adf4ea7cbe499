//! The check before a call that would end a stream of Slave Mode.
//!
//! On a real controller a call that Slave Mode refuses ends Slave Mode, even when another client sends it. So a command
//! that only reads asks for the mode first, and skips what Slave Mode refuses. A stream may begin between the question
//! and the call; only its end could prevent that.

use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::hresult::HResult;

use crate::failure::Failure;
use crate::session::Session;
use crate::values::{Value, integer, text};

/// The hint for a command that would end a stream.
pub(crate) const AFTER_STREAM: &str =
    "wait for the end of the stream; `bcap get @ERROR_CODE` reads the latest error and does not end it";

/// Checks calls before they are sent.
#[derive(Debug, Default)]
pub(crate) struct StreamCheck {
    /// Whether the controller has said that it has no Slave Mode. It is not asked again: a refusal may be an entry in its log.
    is_absent: bool,
}

impl StreamCheck {
    /// Asks the controller whether a stream of Slave Mode runs.
    pub(crate) fn ask(&mut self, session: &mut Session) -> Result<StreamState, Failure> {
        if self.is_absent {
            return Ok(StreamState::Absent);
        }
        let robot = match session.object(&"robot".parse()?) {
            Ok(robot) => robot,
            Err(Failure::Refused { code, .. }) => return Ok(StreamState::from_reply(code, None)),
            Err(failure) => return Err(failure),
        };
        let arguments = [integer(robot)?, text(StreamState::COMMAND)?, Value::default()];
        let (code, value) = session.call_for_code(FunctionId::ROBOT_EXECUTE, &arguments)?;
        if code == HResult::E_HANDLE {
            // the session has ended
            return Err(Failure::Refused { doing: StreamState::COMMAND.into(), code });
        }
        let state = StreamState::from_reply(code, value.and_then(|value| value.as_variant().as_i32()));
        self.is_absent = state == StreamState::Absent;
        Ok(state)
    }

    /// Returns why a call must not be sent; `None` if it may. Calls that Slave Mode allows need no question.
    pub(crate) fn skip(
        &mut self,
        session: &mut Session,
        function: FunctionId,
        command: Option<&str>,
    ) -> Result<Option<String>, Failure> {
        let properties = function.properties(command, None);
        if properties.in_slave_mode.is_allowed() {
            return Ok(None);
        }
        let state = self.ask(session)?;
        let name = command.map_or_else(|| function.to_string(), str::to_owned);
        Ok(state.skip(&name, properties).map(|skipped| format!("skipped: {skipped}")))
    }

    /// Fails if a call must not be sent.
    pub(crate) fn require(
        &mut self,
        session: &mut Session,
        function: FunctionId,
        command: Option<&str>,
    ) -> Result<(), Failure> {
        let Some(message) = self.skip(session, function, command)? else { return Ok(()) };
        Err(Failure::Unfit { message, code: Some(HResult::E_SLVMODE_ON), hint: Some(AFTER_STREAM.into()) })
    }
}

/// Fails if a stream of Slave Mode runs that a call would end: the check of a command that makes many such calls.
pub(crate) fn spare(session: &mut Session, function: FunctionId, command: Option<&str>) -> Result<(), Failure> {
    StreamCheck::default().require(session, function, command)
}
