//! Releasing opened objects.

use core::convert::identity;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::provider::Handles;
use super::sequence::{NextStep, Sequence, Steps, Undo};
use crate::bcap::call::ControllerHandle;
use crate::bcap::{Frame, Object};
use crate::time::Instant;

/// Releases up to eight objects in reverse order; of a longer list it uses the first eight. A refusal is ignored, because
/// an object that cannot be released does not exist.
///
/// When the connection is lost it ends immediately, and the controller releases the remaining objects.
#[must_use]
pub fn release(opened: &[(Object, i32)]) -> impl Procedure<Output = (), Error = StepError> + use<> {
    let undo = opened.iter().map(|(object, handle)| Undo::Release(*object, *handle));
    Sequence::new(NoSteps, identity).with_undo(undo)
}

/// Disconnects from the controller and stops the service.
#[must_use]
pub fn release_controller(controller: ControllerHandle) -> impl Procedure<Output = (), Error = StepError> + use<> {
    release(&[(Object::Service, 0), (Object::Controller, controller.0)])
}

/// Releases the robot, disconnects from the controller and stops the service.
#[must_use]
pub fn release_robot(handles: Handles) -> impl Procedure<Output = (), Error = StepError> + use<> {
    release(&[(Object::Service, 0), (Object::Controller, handles.controller.0), (Object::Robot, handles.robot.0)])
}

/// No steps forward: the sequence consists of its undo entries.
struct NoSteps;

impl Steps for NoSteps {
    type Output = ();
    const KEEPS_OBJECTS: bool = false;

    fn next(&self) -> NextStep<'_> {
        NextStep::End
    }

    fn succeeded(&mut self, _reply: &Frame<'_>, _now: Instant) -> Result<(), StepCause> {
        Ok(())
    }

    fn output(&mut self) {}
}
