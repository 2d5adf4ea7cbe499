//! Scenarios: faults that happen by themselves, each time at the same places.
//!
//! ```toml
//! seed = 7                                        # of everything that is left to chance; 0 unless given
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
//! when = { cycle = 250 }                          # two seconds after slave mode was entered
//! then = { error = "0x84204043" }
//! ```
//!
//! | `when`            | it happens                                                                             |
//! |-------------------|----------------------------------------------------------------------------------------|
//! | `call = n`        | at the n-th call, from 1; with `to = m` at each up to the m-th                         |
//! | `every = n`       | at every n-th call                                                                     |
//! | `chance = p`      | at a call with the probability p, 0 to 1                                               |
//! | `cycle = n`       | when the n-th cycle of slave mode begins, counted from entering it; once               |
//! | `at_ms = t`       | at the time t of the controller's clock, in milliseconds; once                         |
//!
//! Calls are counted of all clients, each repetition that the link asks for as the one call it is. `of` counts those of
//! one function (`"Robot_Move"`) or one command (`"slvMove"`) only.
//!
//! | `then`                  | what happens                                                                     |
//! |-------------------------|----------------------------------------------------------------------------------|
//! | `{ refuse = code }`     | the call is not carried out, and answered with this code; only calls             |
//! | `{ delay_ms = t }`      | the call is carried out, and answered that much later; only calls                |
//! | `"drop"`                | the answer is lost on the wire; only calls                                       |
//! | `"wrong_serial"`        | the answer has another serial; only calls                                        |
//! | `"corrupt"`             | one bit of the answer is wrong, by chance any; only calls                        |
//! | `"disconnect"`          | the connection is closed instead of the answer; only calls                       |
//! | `{ error = code }`      | an error of the controller occurs; at a call, before it is carried out           |
//! | `{ emergency_stop = b }`| the emergency stop is pressed (true) or released (false)                         |
//! | `{ link_loss_ms = t }`  | for this time nothing arrives and nothing is answered; 0 is for good             |
//! | `{ mode = m }`          | the mode switch is turned: `"auto"`, `"manual"`, `"teach_check"`                 |
//! | `{ token = t }`         | the executable token goes to `"any"`, the `"pendant"` or an `"other"` client     |
//! | `{ motor = b }`         | the motor is switched on or off from outside                                     |
//!
//! A code is a name or a number: `"E_BUF_FULL"`, `"0x83201483"`. `bcap sim --scenario FILE` plays a file.
//!
//! # How the controller begins
//!
//! The section `[controller]` says what the controller is like when the scenario begins; what it does not name stays as
//! it is. So each thing that a motion needs can be missing:
//!
//! ```toml
//! [controller]
//! mode = "manual"             # auto, manual, teach_check
//! token = "pendant"           # any; pendant: with the teach pendant; other: with a client that is not here
//! permission = "read_only"    # read_write
//! emergency_stop = true       # pressed, which is an error that cannot be cleared
//! errors = ["0x84201482"]     # present errors, the first cause first
//! arm = "taken"               # free; taken: by a client that is not here, and never gives it back
//! motor = false               # off; it cannot begin on with the emergency stop pressed or an error present
//! licence = false             # of slave mode
//! formats = ["mini_io"]       # of slave mode there are only these: mini_io, hand_io, user_io, current
//! version = "1.2.0"           # @VERSION
//! robot_type = "CVR038A1"     # @TYPE_NAME
//! arm_name = "Arm0"           # the robot's name
//! axes = 8                    # 6, 7 or 8: with J7 and J8
//! servo_on_waits = false      # writing @SERVO_ON answers at once, and the motor comes on later
//! slave_speed = { j1 = 500.0 }            # limits of slave mode for single axes, in degrees or mm per second,
//! slave_acceleration = { j2 = 10000.0 }   # and per second squared
//! ```
//!
//! A service that refuses everybody is a fault of every call: `when = { every = 1, of = "Service_Start" }` with
//! `then = { refuse = "E_MAX_CONNECT" }`.
//!
//! # On the wire
//!
//! The controller has no wire. Whoever moves its replies asks
//! [`Controller::deliver`](crate::Controller::deliver) about each one, with its bytes: it says whether they go out, and
//! changes them where the scenario wants that. Without being asked, `"drop"`, `"wrong_serial"`, `"corrupt"` and
//! `"disconnect"` have no effect; during a link loss calls are not carried out and not answered in any case.

mod file;
mod run;
mod section;
mod setup;

use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use serde::Deserialize;

use crate::config::{Mode, Token};

pub(crate) use run::{Running, Step};
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
    /// The seed of what is left to chance.
    pub seed: u64,
    /// What the controller is like at the beginning.
    pub controller: Setup,
    /// The faults; of several that one call has met, all happen, in this order.
    pub faults: Vec<Fault>,
}

/// A fault: when it happens, and what does.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
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
        /// Which of those that are counted.
        which: Which,
        /// The function or the command that is counted; `None` counts all.
        of: Option<String>,
    },
    /// When this cycle of slave mode begins, from 1.
    Cycle(u64),
    /// At this time.
    At(Instant),
}

/// At which calls a fault happens, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Which {
    /// From the first to the last of these.
    Range(u64, u64),
    /// Every n-th.
    Every(u64),
    /// Any, with this probability.
    Chance(f64),
}

/// What happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Effect {
    /// The call is not carried out, and answered with this code.
    Refuse(HResult),
    /// The answer comes so much later.
    Delay(Duration),
    /// The answer suffers on the wire.
    Wire(WireFault),
    /// An error of the controller.
    Error(HResult),
    /// The emergency stop is pressed or released.
    EmergencyStop(bool),
    /// The link is lost for a time, or for good.
    LinkLoss(Option<Duration>),
    /// The mode switch is turned.
    Mode(Mode),
    /// The executable token goes to somebody.
    Token(Token),
    /// The motor is switched on or off.
    Motor(bool),
}

/// What happens to an answer on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WireFault {
    /// It is lost.
    Drop,
    /// Its serial is another.
    WrongSerial,
    /// One of its bits is wrong.
    Corrupt,
    /// The connection is closed in its place.
    Disconnect,
}

/// What is to be done with the bytes of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Delivery {
    /// They are to be sent.
    Send,
    /// They are not.
    Drop,
    /// They are not, and the connection is to be closed.
    Disconnect,
}

/// Why a text is no scenario.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// It is not the TOML that is expected; the message says where.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// The section of the controller does not make sense.
    #[error("controller: {0}")]
    Controller(&'static str),
    /// A fault does not make sense.
    #[error("fault {number}: {problem}")]
    Fault {
        /// Its number in the file, from 1.
        number: usize,
        /// What is wrong, and what would be right.
        problem: &'static str,
    },
}
