//! The orders of a page, as JSON: `{"id":1,"do":"take","robot":0,"name":"Anna"}`.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::job::Work;

/// The screens of a page.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Screen {
    #[default]
    Cell,
    Variables,
    Alarms,
    Arm,
    Plots,
    Packets,
    Jog,
    Tasks,
    Raw,
    Panel,
    Backup,
    Session,
}

/// An order of a page. `revoked` is the revocation count that the robot's tile showed when the user was asked. A HALT after
/// that makes the server refuse the order, no matter how late it arrives.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub(crate) enum Order {
    /// Shows a screen of a robot.
    Show { robot: usize, screen: Screen },
    /// Selects the variables of a robot.
    Select { robot: usize, names: Vec<String> },
    /// Takes the control of a robot.
    Take { robot: usize, name: String },
    /// Releases the control of a robot.
    Release { robot: usize },
    /// Checks a value for a variable.
    Check { robot: usize, name: String, text: String },
    /// Checks the position of the resting robot for a variable of type P.
    Teach { robot: usize, name: String },
    /// Writes the value of the check with this number, which must be the last check.
    Write { robot: usize, check: u64, revoked: u64 },
    /// Clears the errors.
    Clear { robot: usize, revoked: u64 },
    /// Begins a jog of the robot with this name, for which the user has agreed.
    Grip { robot: usize, name: String, revoked: u64 },
    /// A button is held: the robot moves by steps. `press` is the number of this press, which heartbeats repeat.
    Press { robot: usize, axis: String, by: f64, percent: f64, press: u64 },
    /// The button is lifted.
    Lift { robot: usize },
    /// Ends the jog.
    EndJog { robot: usize, why: String },
    /// Begins a recovery of the robot with this name, and plans its steps.
    Recover { robot: usize, name: String, revoked: u64 },
    /// Makes the next step of the recovery.
    Step { robot: usize, step: String, revoked: u64 },
    /// Ends the recovery.
    EndRecovery { robot: usize },
    /// Reads the logs of the controller.
    Log { robot: usize },
    /// Starts or stops a task of the robot with the name `of`. A stop needs no `revoked`.
    Task { robot: usize, of: String, name: String, what: What, revoked: Option<u64> },
    /// Reads the line of a task.
    Line { robot: usize, name: String },
    /// Lists a folder of the controller.
    Files { robot: usize, folder: String },
    /// Reads a file of the controller.
    View { robot: usize, path: String },
    /// Returns the function table.
    Functions {},
    /// Makes a call.
    Call { agreed: Agreed, function: String, arguments: Vec<String> },
    /// Makes the call of a packet in hexadecimal.
    Bytes { agreed: Agreed, packet: String },
    /// Returns the packets of a call, whose row has the time `at`.
    Packet { robot: usize, serial: u16, at: f64 },
    /// Returns the calls by function and object.
    Calls { robot: usize },
    /// Lists the backups of this server.
    Backups {},
    /// Begins a dump, a comparison, or the plan of a restore.
    Work { robot: usize, work: Work },
    /// Ends a dump, a comparison, the plan of a restore, or a restore.
    EndWork { robot: usize },
    /// Restores the backup that was planned, on the robot with this name.
    Restore { robot: usize, name: String, folder: String, revoked: u64 },
    /// Starts or ends the recordings.
    Record { starts: bool },
    /// Lists the recordings of this server.
    Recordings {},
    /// Plays a scenario on the virtual controller.
    Play { robot: usize, text: String },
    /// Changes the time factor of the virtual controller.
    Pace { robot: usize, factor: f64 },
}

impl Order {
    /// Returns whether it may move a robot or change the controller, so that it must not be late.
    pub(crate) const fn changes(&self) -> bool {
        match self {
            Self::Task { what, .. } => matches!(what, What::Once | What::Forever | What::Step),
            Self::Write { .. } | Self::Clear { .. } | Self::Restore { .. } => true,
            Self::Grip { .. } | Self::Press { .. } | Self::Recover { .. } | Self::Step { .. } => true,
            Self::Call { .. } | Self::Bytes { .. } | Self::Play { .. } | Self::Pace { .. } => true,
            _ => false,
        }
    }

    /// Parses an order with its number.
    pub(crate) fn parse(text: &str) -> Option<(u64, Self)> {
        let mut order: Map<_, _> = serde_json::from_str(text).ok()?;
        let number = order.remove("id")?.as_u64()?;
        let Value::String(what) = order.remove("do")? else { return None };
        // an internally tagged enum needs 250 KB of code
        let order = Map::from_iter([(what, Value::Object(order))]);
        Some((number, Self::deserialize(Value::Object(order)).ok()?))
    }
}

/// A call that the user has confirmed; one confirmation covers all calls of a loop.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Agreed {
    pub(crate) robot: usize,
    /// The name of the robot in the question.
    pub(crate) name: String,
    /// The revocation count that the robot's tile showed at the question.
    pub(crate) revoked: u64,
    /// Whether the loop has made this call before.
    pub(crate) repeats: bool,
}

/// An order for a task.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum What {
    /// Runs the program once.
    Once,
    /// Runs the program again and again.
    Forever,
    /// Runs one step of the program.
    Step,
    /// Stops immediately.
    Stop,
    /// Stops after the current cycle.
    Cycle,
    /// Stops immediately; the next start begins at the first line.
    Reset,
}
