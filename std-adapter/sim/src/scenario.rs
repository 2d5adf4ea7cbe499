//! Scenarios: faults that happen at given calls, cycles or times, the same in each run.
//!
//! ```toml
//! seed = 7                                        # of the random numbers; default 0
//!
//! [[fault]]
//! when = { call = 3, of = "slvMove" }             # the third slvMove
//! then = { refuse = "E_BUF_FULL" }
//!
//! [[fault]]
//! when = { chance = 0.01 }                        # one in a hundred calls
//! then = "drop"
//!
//! [[fault]]
//! when = { cycle = 250 }                          # two seconds after Slave Mode was entered
//! then = { error = "0x84204043" }
//! ```
//!
//! | `when`            | when the fault happens                                                                 |
//! |-------------------|----------------------------------------------------------------------------------------|
//! | `call = n`        | at the n-th call, from 1; with `to = m` at each up to the m-th                         |
//! | `every = n`       | at every n-th call                                                                     |
//! | `chance = p`      | at a call with the probability p, 0 to 1                                               |
//! | `cycle = n`       | when the n-th cycle of Slave Mode begins, counted from entering it; once               |
//! | `at_ms = t`       | at the time t of the controller's clock, in milliseconds; once                         |
//!
//! The calls of all clients count; a call that is sent again counts once. The releases that the server makes when a client
//! ends its session or disconnects do not count. `of` counts only those of one function (`"Robot_Move"`) or one command
//! (`"slvMove"`).
//!
//! | `then`                  | what happens                                                                     |
//! |-------------------------|----------------------------------------------------------------------------------|
//! | `{ refuse = code }`     | the call is not executed, and answered with this code; only calls                |
//! | `{ delay_ms = t }`      | the call is executed, and answered this long after its end; only calls           |
//! | `"drop"`                | the answer is lost on the wire; only calls                                       |
//! | `"wrong_serial"`        | the answer has another serial; only calls                                        |
//! | `"corrupt"`             | one random bit of the answer is wrong; only calls                                |
//! | `"disconnect"`          | the connection is closed instead of the answer; only calls                       |
//! | `{ error = code }`      | an error of the controller occurs; at a call, before it is executed              |
//! | `{ emergency_stop = b }`| the emergency stop is pressed (true) or released (false)                         |
//! | `{ link_loss_ms = t }`  | for this time no call arrives and no answer is sent; 0 means forever             |
//! | `{ mode = m }`          | the mode switch is turned: `"auto"`, `"manual"`, `"teach_check"`                 |
//! | `{ token = t }`         | the executable token goes to `"any"`, the `"pendant"`, an `"other"` client, an address |
//! | `{ permission = p }`    | the communication permission becomes `"read_write"`, `"read_only"`, `"none"`     |
//! | `{ motor = b }`         | the motor is switched on or off from outside                                     |
//! | `{ message = text }`    | a message is posted to the clients, see [`messages`](crate::messages)            |
//! | `{ comm = { line = n, text = t } }` | a device sends a text on a line, see [`comm`](crate::comm)           |
//!
//! A code is a name or a number: `"E_BUF_FULL"`, `"0x83201483"`. `bcap sim --scenario FILE` plays a file.
//!
//! # Initial state
//!
//! The section `[controller]` sets the state of the controller when the scenario begins; keys that it lacks change
//! nothing. So each requirement of a motion can be missing:
//!
//! ```toml
//! [controller]
//! mode = "manual"             # auto, manual, teach_check
//! token = "pendant"           # any; pendant: the teach pendant; other: a client that is not connected; or an IP address
//! permission = "read_only"    # read_write, read_only, none
//! emergency_stop = true       # pressed, which is an error that cannot be cleared
//! torque_off = true           # as after an emergency stop that was released; only of models that have StoState
//! prepared = true             # a COBOTTA: ManualResetPreparation and MotionPreparation are done
//! battery_low = true          # the battery is exhausted: SysState, SysInfo 15
//! warning = true              # the robot warns: SysState
//! protective_stop = true      # is shown by SysState and @PROTECTIVE_STOP; it stops nothing
//! errors = ["0x84201482"]     # current errors, in order of occurrence
//! arm = "taken"               # free; taken: permanently, by a client that is not connected
//! motor = false               # off; true is refused with emergency_stop or errors; a controller that has them keeps it off
//! licence = false             # of Slave Mode
//! slave_speed_setting = 2     # parameter 153, the limits of Slave Mode: 0 to 3, see `SpeedSetting`
//! formats = ["mini_io"]       # of Slave Mode: any of mini_io, hand_io, user_io, current
//! version = "1.2.0"           # @VERSION
//! robot_type = "CVR038A1"     # @TYPE_NAME
//! arm_name = "Arm0"           # the robot's name
//! axes = 8                    # 6, 7 or 8: with J7 and J8
//! servo_on_waits = false      # writing @SERVO_ON answers immediately, and the motor switches on later
//! slave_speed = { j1 = 500.0 }            # limits of Slave Mode for single axes, in degrees or mm per second,
//! slave_acceleration = { j2 = 10000.0 }   # and per second squared
//! ```
//!
//! # Tasks
//!
//! A section `[[task]]` defines a [task](crate::tasks) with a program, in place of one with the same name:
//!
//! ```toml
//! [[task]]
//! name = "Feeder"
//! start = 2                             # runs from the beginning: 1 one cycle, 2 continuously; without it, a client starts it
//! line_ms = 10                          # the least time of a step; default 10
//! steps = [
//!     { wait = { IO128 = true } },      # until all these variables have these values
//!     { set = { IO24 = true, I5 = 7 } },
//!     { move = "@P J(0,45,90,0,45,0)" },                                    # Robot_Move with the joints
//!     { move = { pose = "@E P1", interpolation = 2, option = "SPEED=50" } },
//!     { wait_ms = 500 },
//!     { add = { I10 = 1 } },            # to variables I, F and D
//!     { message = "one part fed" },
//!     { set = { IO24 = false } },
//!     { error = "0x81501003" },         # an error of the controller
//! ]
//! ```
//!
//! Each step is a line. Values are numbers, BOOLs for IO, texts for S, and arrays for V, P, J and T. A variable that waits
//! is checked every `line_ms`. A wait for a value that its variable never has is an error: `E_INVALIDARGTYPE` for another type,
//! `E_INVALIDARG` for another count of numbers.
//!
//! To refuse all clients, refuse each Service_Start: `when = { every = 1, of = "Service_Start" }` with
//! `then = { refuse = "E_MAX_CONNECT" }`.
//!
//! # On the wire
//!
//! The controller has no wire. The server that sends its replies passes the bytes of each one to
//! [`Controller::deliver`](crate::Controller::deliver), which applies the fault and returns whether to send them. In a server
//! that does not, `"drop"`, `"wrong_serial"`, `"corrupt"` and `"disconnect"` have no effect. During a link loss, calls are
//! neither executed nor answered in any case.

mod parse;
mod parse_setup;
mod parse_task;
mod playback;
mod setup;

use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use serde::Deserialize;

use crate::config::{Mode, Permission, Token};
use crate::program::Program;

pub(crate) use playback::{CallPlan, Playback};
pub use setup::Setup;

/// A list of faults.
///
/// # Examples
///
/// ```
/// use bcap_core::hresult::HResult;
/// use bcap_core::time::Instant;
/// use bcap_sim::{Config, Controller, Scenario};
///
/// let scenario = Scenario::parse(
///     r#"
///     [[fault]]
///     when = { at_ms = 40 }
///     then = { error = "E_COMMAND_BUFFER_EMPTY" }
///     "#,
/// )?;
/// let mut controller = Controller::new(Config::default());
/// controller.play(scenario);
/// controller.advance(Instant::from_millis(100));
/// let error = controller.errors().next().map(|error| (error.code, error.at));
/// assert_eq!(error, Some((HResult::E_COMMAND_BUFFER_EMPTY, Instant::from_millis(40))));
/// # Ok::<(), bcap_sim::scenario::ScenarioError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scenario {
    /// The seed of the random numbers.
    pub seed: u64,
    /// The initial state of the controller.
    pub controller: Setup,
    /// The tasks.
    pub tasks: Vec<Program>,
    /// The faults. If a call meets several, all happen, in this order.
    pub faults: Vec<ScenarioFault>,
}

/// A fault: its trigger and its effect.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioFault {
    /// When.
    pub when: Trigger,
    /// What.
    pub then: Effect,
}

/// When a fault happens.
#[derive(Clone, Debug, PartialEq)]
pub enum Trigger {
    /// At calls.
    Call {
        /// Selects among the counted calls.
        filter: CallFilter,
        /// The function or the command that counts; `None` counts all calls.
        of: Option<String>,
    },
    /// When this cycle of Slave Mode begins, from 1.
    Cycle(u64),
    /// At this time.
    At(Instant),
}

/// The calls at which a fault happens, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CallFilter {
    /// From the first to the last.
    Range(u64, u64),
    /// Every n-th.
    Every(u64),
    /// Each, with this probability.
    Chance(f64),
}

/// The effect of a fault.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// The call is not executed, and answered with this code.
    Refuse(HResult),
    /// The answer is sent with this delay after the end of the call. Several delays of a call add up.
    Delay(Duration),
    /// The answer is damaged or lost on the wire.
    Wire(WireFault),
    /// An error of the controller.
    Error(HResult),
    /// The emergency stop is pressed or released.
    EmergencyStop(bool),
    /// The link is lost for a time, or forever.
    LinkLoss(Option<Duration>),
    /// The mode switch is turned.
    Mode(Mode),
    /// The executable token gets another holder.
    Token(Token),
    /// The communication permission is changed.
    Permission(Permission),
    /// The motor is switched on or off.
    Motor(bool),
    /// A message is posted to the clients.
    Message(String),
    /// A device sends a text on a line of data communication.
    Comm {
        /// The line, 1 to 16.
        line: i32,
        /// The text.
        text: String,
    },
}

/// The fault of an answer on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WireFault {
    /// It is lost.
    Drop,
    /// It has another serial.
    WrongSerial,
    /// One of its bits is wrong.
    Corrupt,
    /// The connection is closed instead.
    Disconnect,
}

/// The treatment of the bytes of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Delivery {
    /// Send them.
    Send,
    /// Do not send them.
    Drop,
    /// Do not send them, and close the connection.
    Disconnect,
}

/// The error of an invalid scenario.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// Invalid TOML, or an unknown key; the message says where.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// The section `[controller]` is invalid.
    #[error("controller: {0}")]
    Controller(&'static str),
    /// A task is invalid.
    #[error("task {name:?}, step {step}: {problem}")]
    Task {
        /// Its name.
        name: String,
        /// The number of the step, from 1; 0 for the task itself.
        step: usize,
        /// The fault, and the accepted values.
        problem: String,
    },
    /// A fault is invalid.
    #[error("fault {number}: {problem}")]
    Fault {
        /// Its number in the file, from 1.
        number: usize,
        /// The fault, and the accepted values.
        problem: &'static str,
    },
}
