//! The diagnosis of a fault: the mode, the errors and the state of the controller, over a connection that works.

use super::{EMERGENCY_STOP, Engine, Phase};
use crate::hresult::HResult;
use crate::procedure::Failure;
use crate::slave::call::Step;
use crate::slave::fault::{ControllerError, ERRORS_MAX, Fault, Released};
use crate::variant::Variant;

impl<const N: usize> Engine<N> {
    /// Moves to a query, or to the next query that has a connection.
    pub(super) fn diagnose(&mut self, step: Step) {
        let mut step = step;
        while self.channel_for(step).is_none() {
            step = match step {
                Step::GetMode | Step::Leave => Step::ErrorCount,
                Step::ErrorCount | Step::ErrorInfo => Step::SystemState,
                _ => return self.end_diagnosis(),
            };
        }
        self.step = step;
    }

    fn end_diagnosis(&mut self) {
        if self.fault.as_ref().is_some_and(Fault::is_underflow) {
            self.stats.underflows = self.stats.underflows.saturating_add(1);
        }
        self.phase = Phase::Faulted;
    }

    /// Continues without a reply: with the same query over the other connection, or with the next query.
    pub(super) fn skip_diagnosis(&mut self, failure: Failure) {
        let other = self.channel_for(self.step).filter(|channel| *channel != self.channel);
        match (self.step, other) {
            (step, Some(_)) if failure != Failure::NotSent => self.diagnose(step),
            (Step::GetMode | Step::Leave, _) => self.diagnose(Step::ErrorCount),
            (Step::ErrorCount | Step::ErrorInfo, _) => self.diagnose(Step::SystemState),
            _ => self.end_diagnosis(),
        }
    }

    pub(super) fn handle_diagnosis(&mut self, code: HResult, value: Variant<'_>) {
        let Some(fault) = &mut self.fault else { return self.end_diagnosis() };
        let int = value.as_i32().filter(|_| code.is_ok());
        match self.step {
            Step::GetMode => match int {
                Some(0) => {
                    fault.released = Released::Yes;
                    self.may_be_in_mode = false;
                    self.diagnose(Step::ErrorCount);
                }
                Some(_) => {
                    fault.released = Released::No;
                    // the other queries would end the stream of another client
                    if self.may_be_in_mode { self.diagnose(Step::Leave) } else { self.end_diagnosis() }
                }
                None => self.diagnose(Step::ErrorCount),
            },
            Step::Leave => {
                if code.is_ok() || code == HResult::E_SLVMODE_OFF {
                    fault.released = Released::Yes;
                    self.may_be_in_mode = false;
                }
                self.diagnose(Step::ErrorCount);
            }
            Step::ErrorCount => {
                // the last error of the list is the oldest, so the first cause
                self.error_index = int.unwrap_or(0).saturating_sub(1);
                self.diagnose(if self.error_index >= 0 { Step::ErrorInfo } else { Step::SystemState });
            }
            Step::ErrorInfo => {
                let error = ControllerError::read(value).filter(|_| code.is_ok());
                let more =
                    error.is_some() && self.error_index > 0 && fault.errors().len() < ERRORS_MAX.saturating_sub(1);
                error.into_iter().for_each(|error| fault.push(error));
                self.error_index = self.error_index.saturating_sub(1);
                self.diagnose(if more { Step::ErrorInfo } else { Step::SystemState });
            }
            _ => {
                fault.emergency_stop = int.map(|bits| bits & EMERGENCY_STOP != 0);
                self.end_diagnosis();
            }
        }
    }
}
