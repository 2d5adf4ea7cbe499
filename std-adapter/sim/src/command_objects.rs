//! Command objects: a command of Controller_Execute with its parameters and its result, for repeated execution.
//!
//! | function                                 | effect                                                          |
//! |------------------------------------------|-----------------------------------------------------------------|
//! | Controller_GetCommand                    | opens a command by the name that Controller_Execute takes       |
//! | Controller_GetCommandNames               | BSTR array: the commands of this controller                     |
//! | Command_PutParameters, -GetParameters    | the parameter of Controller_Execute; initially EMPTY            |
//! | Command_Execute 0                        | executes it and answers its result                              |
//! | Command_Execute 1                        | starts it and answers; `E_CAO_CMD_EXECUTE` while it runs        |
//! | Command_GetState                         | I4: 0 not executed yet, 1 running, 2 done, 3 failed, cancelled  |
//! | Command_GetResult                        | the result, or the code with which it failed; initially EMPTY   |
//! | Command_PutTimeout, -GetTimeout          | I4, ms that Execute 0 waits, then `E_TIMEOUT`; 0: no limit      |
//! | Command_Cancel                           | stops the motor or the hand; `S_FALSE` when nothing runs        |
//!
//! Motor, the motions of a COBOTTA's hand, and KillAll, SuspendAll and StepStopAll with 1 take time; all other commands are
//! done immediately. After Cancel the tasks stop nevertheless. The numbers of the states and of the modes are decisions of this
//! model: no public client uses command objects.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;

use crate::answer::{Answer, Answered};
use crate::value::{ValueResult, keep};
use crate::waits::Wait;

/// The state of a command object.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct CommandObject {
    parameters: OwnedVariant,
    /// Zero for no limit.
    timeout: Duration,
    progress: Progress,
    /// When Execute stops waiting.
    deadline: Option<Instant>,
}

/// The progress of a command.
#[derive(Clone, Debug, Default, PartialEq)]
enum Progress {
    #[default]
    NotYet,
    /// It runs until this event.
    Running(Wait),
    /// With its result.
    Done(OwnedVariant),
    Failed(HResult),
}

impl CommandObject {
    /// Executes a function of the command object that only reads or sets its state.
    pub(crate) fn call(&mut self, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::COMMAND_GET_TIMEOUT => Answer::of(i32::try_from(self.timeout.as_millis()).unwrap_or(i32::MAX)),
            FunctionId::COMMAND_PUT_TIMEOUT => {
                let millis = u64::try_from(request.int(1)).map_err(|_| HResult::E_INVALIDARG)?;
                self.timeout = Duration::from_millis(millis);
                Ok(Answer::Done)
            }
            FunctionId::COMMAND_GET_STATE => Answer::of(match self.progress {
                Progress::NotYet => 0,
                Progress::Running(_) => 1,
                Progress::Done(_) => 2,
                Progress::Failed(_) => 3,
            }),
            FunctionId::COMMAND_GET_PARAMETERS => Ok(self.parameters.clone().into()),
            FunctionId::COMMAND_PUT_PARAMETERS => {
                self.parameters = keep(&request.value(1))?;
                Ok(Answer::Done)
            }
            FunctionId::COMMAND_GET_RESULT => Ok(match &self.progress {
                Progress::Done(result) => result.clone().into(),
                Progress::Failed(code) => Answer::Code(*code),
                Progress::NotYet | Progress::Running(_) => OwnedVariant::EMPTY.into(),
            }),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Starts an execution and returns its parameters.
    ///
    /// # Errors
    ///
    /// `E_CAO_CMD_EXECUTE` while it runs.
    pub(crate) fn begin(&mut self, now: Instant) -> ValueResult {
        if self.running().is_some() {
            return Err(HResult::E_CAO_CMD_EXECUTE);
        }
        self.deadline = (!self.timeout.is_zero()).then(|| now.saturating_add(self.timeout));
        Ok(self.parameters.clone())
    }

    /// Returns the event at which the command ends; `None` if it does not run.
    pub(crate) fn running(&self) -> Option<Wait> {
        match self.progress {
            Progress::Running(wait) => Some(wait),
            _ => None,
        }
    }

    /// Returns when Execute stops waiting.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Returns whether Execute has waited for its timeout.
    pub(crate) fn is_overdue(&self, now: Instant) -> bool {
        self.deadline.is_some_and(|at| at <= now)
    }

    /// Records the progress of an execution.
    pub(crate) fn record(&mut self, answered: &Answered) {
        self.progress = match answered {
            Ok(Answer::Until(wait)) => Progress::Running(*wait),
            Ok(Answer::Value(value) | Answer::Coded(_, value)) => Progress::Done(value.clone()),
            Ok(Answer::Code(code)) if code.is_err() => Progress::Failed(*code),
            Ok(_) => Progress::Done(OwnedVariant::EMPTY),
            Err(code) => Progress::Failed(*code),
        };
    }

    /// Records how a command has ended without a waiting call.
    pub(crate) fn end(&mut self, outcome: Result<(), HResult>) {
        self.progress = match outcome {
            Ok(()) => Progress::Done(OwnedVariant::EMPTY),
            Err(code) => Progress::Failed(code),
        };
    }
}
