//! The parameters of a session, and its handles.

use crate::bcap::call::{ControllerHandle, RobotHandle};

/// The parameters of Service_Start and Controller_Connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Provider<'a> {
    /// The option of Service_Start: `WDT=400` requests a keep-alive every 400 ms while a call runs.
    pub service: &'a str,
    /// The name of the controller object; any text.
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
    /// Returns a provider on the controller itself, with a keep-alive every 400 ms.
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
