//! Opening a session: the service, the controller, and a robot.

use super::action::Procedure;
use super::failure::StepError;
use super::path::{Opened, PathStep, PathSteps};
use super::provider::{Handles, Provider};
use super::sequence::Sequence;
use crate::bcap::Object;
use crate::bcap::call::{ControllerHandle, RobotHandle};

/// Starts the service and connects to the controller; returns its handle.
///
/// [`release_controller`](super::release_controller) undoes it.
pub fn open<'a>(provider: Provider<'a>) -> impl Procedure<Output = ControllerHandle, Error = StepError> + use<'a> {
    Sequence::new(PathSteps::session(provider, None), |opened: Opened| ControllerHandle(handle_at(&opened, 1)))
}

/// Starts the service, connects to the controller and gets a robot; returns both handles.
///
/// Without a name it is `Arm0`, or the first robot that the controller lists when it refuses that name.
/// [`release_robot`](super::release_robot) undoes it.
pub fn open_robot<'a>(
    provider: Provider<'a>,
    robot: Option<&'a str>,
) -> impl Procedure<Output = Handles, Error = StepError> + use<'a> {
    let robot = PathStep { object: Object::Robot, name: robot };
    Sequence::new(PathSteps::session(provider, Some(robot)), |opened: Opened| Handles {
        controller: ControllerHandle(handle_at(&opened, 1)),
        robot: RobotHandle(handle_at(&opened, 2)),
    })
}

/// Returns a handle of a session's path: 1 is the controller, 2 its robot.
fn handle_at(opened: &[(Object, i32)], index: usize) -> i32 {
    opened.get(index).map_or(0, |(_, handle)| *handle)
}
