//! User variables and system variables.

use std::borrow::Cow;

use bcap_core::bcap::FunctionId as F;

use crate::case::Arg::{H, S};
use crate::case::Setup::{Controller, Robot, Task};
use crate::case::{Arg, Body, Case, Group, Level, Setup, Slot, Step, Want};

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const R: Slot = Slot::Robot;

/// The system variables, their objects, and the VARTYPE of their values; 0x2000 marks an array.
const SYSTEM: &[(Setup, &str, u16)] = &[
    (Controller, "@MODE", 3),
    (Controller, "@LOCK", 11),
    (Controller, "@TIME", 3),
    (Controller, "@CURRENT_TIME", 7),
    (Controller, "@BUSY_STATUS", 11),
    (Controller, "@NORMAL_STATUS", 11),
    (Controller, "@ERROR_CODE", 3),
    (Controller, "@ERROR_DESCRIPTION", 8),
    (Controller, "@EMERGENCY_STOP", 11),
    (Controller, "@DEADMAN_SW", 11),
    (Controller, "@AUTO_ENABLE", 11),
    (Controller, "@PROTECTIVE_STOP", 11),
    (Controller, "@MAKER_NAME", 8),
    (Controller, "@TYPE", 8),
    (Controller, "@VERSION", 8),
    (Controller, "@SERIAL_NO", 8),
    (Robot, "@CURRENT_POSITION", 0x2005),
    (Robot, "@CURRENT_ANGLE", 0x2005),
    (Robot, "@CURRENT_TRANS", 0x2005),
    (Robot, "@SERVO_ON", 11),
    (Robot, "@BUSY_STATUS", 11),
    (Robot, "@TYPE_NAME", 8),
    (Robot, "@CURRENT_TOOL", 3),
    (Robot, "@CURRENT_WORK", 3),
    (Robot, "@SPEED", 4),
    (Robot, "@EXTSPEED", 4),
    (Task, "@STATUS", 3),
];

/// Returns the cases of the types of system variables (b-CAP specification, section 4.1.6; names and types from the vendor's open drivers).
pub(super) fn system() -> impl Iterator<Item = Case> {
    SYSTEM.iter().map(|(setup, name, vartype)| {
        let (object, opens, slot) = match setup {
            Robot => ("robot", F::ROBOT_GET_VARIABLE, R),
            Task => ("task", F::TASK_GET_VARIABLE, Slot::Task),
            _ => ("controller", F::CONTROLLER_GET_VARIABLE, C),
        };
        let want = match vartype & 0x2000 {
            0 => Want::Type(*vartype),
            _ => Want::Array(vartype & 0xfff, 0),
        };
        let arguments: &'static [Arg] = vec![H(slot), S(name), S("")].leak();
        let table = vec![Step::Open(A, opens, arguments), Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], want)];
        Case {
            name: Cow::Owned(format!("system/{object}/{name}")),
            group: if *setup == Task { Group::Tasks } else { Group::Variables },
            level: Level::Read,
            source: "b-CAP specification, section 4.1.6",
            rule: "a system variable has the type of the provider guide",
            only: None,
            models: Vec::new(),
            setup: *setup,
            body: Body::Steps(Cow::Owned(table)),
        }
    })
}
