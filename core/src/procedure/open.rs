//! Opening a session: the service, the controller, and a robot.

use super::path::{Opened, PathStep, PathSteps};
use super::sequence::Sequence;
use super::{Procedure, StepError};
use crate::bcap::Object;
use crate::bcap::call::{ControllerHandle, RobotHandle};

/// What Service_Start and Controller_Connect are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Provider<'a> {
    /// The option of Service_Start: `WDT=400` asks for a keep-alive every 400 ms while a call runs.
    pub service: &'a str,
    /// The name of the controller object; any name will do.
    pub name: &'a str,
    /// The provider: `CaoProv.DENSO.VRC` (RC8, COBOTTA), `CaoProv.DENSO.VRC9` (RC9, COBOTTA PRO).
    pub provider: &'a str,
    /// The machine that the provider runs on, seen from the controller.
    pub machine: &'a str,
    /// The option of Controller_Connect.
    pub option: &'a str,
}

impl Provider<'static> {
    /// The provider of an RC8 or a COBOTTA.
    pub const RC8: Self = Self::new("CaoProv.DENSO.VRC");
    /// The provider of an RC9 or a COBOTTA PRO.
    pub const RC9: Self = Self::new("CaoProv.DENSO.VRC9");
}

impl<'a> Provider<'a> {
    /// A provider on the controller itself, with a keep-alive every 400 ms.
    #[must_use]
    pub const fn new(provider: &'a str) -> Self {
        Self { service: "WDT=400", name: "", provider, machine: "localhost", option: "" }
    }
}

/// The handles of a controller and of one of its robots. They are valid only on the connection that opened them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Handles {
    /// The controller.
    pub controller: ControllerHandle,
    /// The robot.
    pub robot: RobotHandle,
}

/// Starts the service and connects to the controller; returns its handle.
///
/// [`release_controller`](super::release_controller) is the way back.
pub fn open<'a>(provider: Provider<'a>) -> impl Procedure<Output = ControllerHandle, Error = StepError> + use<'a> {
    Sequence::new(PathSteps::session(provider, None), |opened: Opened| ControllerHandle(handle_at(&opened, 1)))
}

/// Starts the service, connects to the controller and gets a robot; returns both handles.
///
/// Without a name it is the first robot that the controller lists, or `Arm0` when it refuses to list them.
/// [`release_robot`](super::release_robot) is the way back.
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
