//! Reading and writing a variable by its name.

use core::convert::identity;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::path::{Owner, PathError, PathStep, PathSteps};
use super::sequence::{NextStep, Sequence, StepCall, Steps};
use crate::bcap::{Frame, FunctionId};
use crate::time::Instant;
use crate::variant::{Encode, Variant};

/// Opens a variable, reads its value and releases it; returns what `read` makes of the value.
///
/// The variable belongs to a controller (`I1`), a robot (`@SERVO_ON`), a task, a file or an extension. This makes three
/// calls for each value; a program that reads a variable often should keep its handle.
///
/// # Errors
///
/// A [`PathError`] for an owner that has no variables.
pub fn read_variable<T: Default>(
    owner: impl Into<Owner>,
    name: &str,
    read: impl FnMut(Variant<'_>) -> T,
) -> Result<impl Procedure<Output = T, Error = StepError>, PathError> {
    let path = PathSteps::from(owner.into(), &[PathStep::variable(name)])?;
    Ok(Sequence::new(ReadSteps { path, read, value: None }, Option::unwrap_or_default))
}

struct ReadSteps<'a, F, T> {
    path: PathSteps<'a>,
    read: F,
    value: Option<T>,
}

impl<F: FnMut(Variant<'_>) -> T, T> Steps for ReadSteps<'_, F, T> {
    type Output = Option<T>;
    const KEEPS_OBJECTS: bool = false;

    fn next(&self) -> NextStep<'_> {
        match (self.path.next(), &self.value) {
            (NextStep::End, None) => {
                NextStep::Call(StepCall::new(FunctionId::VARIABLE_GET_VALUE).with(self.path.last_handle()))
            }
            (next, _) => next,
        }
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        if matches!(self.path.next(), NextStep::End) {
            self.value = Some((self.read)(reply.value().unwrap_or(Variant::Empty)));
            return Ok(());
        }
        self.path.succeeded(reply, now)
    }

    fn output(&mut self) -> Option<T> {
        self.value.take()
    }
}

/// Opens a variable, writes its value and releases it.
///
/// A write that has no reply may have been carried out; it is not repeated.
///
/// # Errors
///
/// A [`PathError`] for an owner that has no variables.
pub fn write_variable<'a, O: Into<Owner>>(
    owner: O,
    name: &'a str,
    value: &'a dyn Encode,
) -> Result<impl Procedure<Output = (), Error = StepError> + use<'a, O>, PathError> {
    let path = PathSteps::from(owner.into(), &[PathStep::variable(name)])?;
    Ok(Sequence::new(WriteSteps { path, value, written: false }, identity))
}

struct WriteSteps<'a> {
    path: PathSteps<'a>,
    value: &'a dyn Encode,
    written: bool,
}

impl Steps for WriteSteps<'_> {
    type Output = ();
    const KEEPS_OBJECTS: bool = false;

    fn next(&self) -> NextStep<'_> {
        match (self.path.next(), self.written) {
            (NextStep::End, false) => {
                let put = StepCall::new(FunctionId::VARIABLE_PUT_VALUE).with(self.path.last_handle());
                NextStep::Call(put.with(self.value))
            }
            (next, _) => next,
        }
    }

    fn succeeded(&mut self, reply: &Frame<'_>, now: Instant) -> Result<(), StepCause> {
        if matches!(self.path.next(), NextStep::End) {
            self.written = true;
            return Ok(());
        }
        self.path.succeeded(reply, now)
    }

    fn output(&mut self) {}
}
