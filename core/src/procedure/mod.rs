//! Procedures: sequences of calls as values, without socket, clock or allocation.
//!
//! ```text
//!             poll ──► Call ──► make request() over its channel ──► handle_reply, or handle_failure ──┐
//!              ▲  ├──► Wait ──► until then ───────────────────────────────────────────────────────────┤
//!              │  │                                                                                   │
//!              │  └──► Done(result)                                                                   │
//!              └──────────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! A job that takes several calls is written once, as a [`Procedure`]: it determines the next call and takes the reply.
//! [`io::blocking::Connection::run`](crate::io::blocking::Connection::run) and
//! [`io::asynch::Connection::run`](crate::io::asynch::Connection::run) run any of them.
//!
//! | procedure                                          | effect                                                       |
//! |----------------------------------------------------|--------------------------------------------------------------|
//! | [`open`]                                           | starts the service and connects to the controller            |
//! | [`open_robot`]                                     | the same, and gets a robot                                   |
//! | [`open_path`]                                      | opens an object and the objects on the way to it             |
//! | [`release`], [`release_controller`], [`release_robot`] | releases in reverse order and stops the service          |
//! | [`read_variable`], [`write_variable`]              | opens a variable, reads or writes it, releases it            |
//! | [`examine`]                                        | reads what is wrong, and what a recovery needs               |
//! | [`recover`], [`prepare`]                           | ends errors, prepares a COBOTTA, takes the arm; switches the motor on |
//! | [`prepare_robot`], [`give_arm`]                    | takes the arm and switches the motor on; gives the arm back  |
//! | [`reclaim`]                                        | ends the effects of a session that does not own the arm (any more) |
//! | [`move_and_wait`]                                  | starts a motion and waits for its end                        |
//! | [`halt`]                                           | halts the robot and stops tasks that own the arm, verifies rest |
//! | [`run_queue`]                                      | lets motions follow each other, and waits for the last motion |
//! | [`slave::Stream`](crate::slave::Stream)      | streams poses in Slave Mode                                  |
//!
//! A procedure that fails undoes its effects before it reports the failure, as far as the connection still works: it
//! releases handles, gives the arm back, halts a motion.

mod action;
mod examine;
mod failure;
mod halt;
mod motion;
mod open;
mod path;
mod provider;
mod queue;
mod reclaim;
mod recover;
mod release;
mod robot;
mod sequence;
mod target;
mod variable;

pub use self::action::{Action, Channel, Procedure};
pub use self::examine::{Examination, Obstacle, RecoveryStep, RecoveryStepSet, SysState, examine};
pub use self::failure::{Failure, StepCause, StepError};
pub use self::halt::{Halt, HaltAnswer, HaltConfig, StoppedTasks, halt};
pub use self::motion::{MotionStart, Until, move_and_wait, run_queue};
pub use self::open::{open, open_robot};
pub use self::path::{Opened, Owner, PATH_MAX, PathError, PathStep, open_path};
pub use self::provider::{Handles, Provider};
pub use self::queue::{Motion, MotionConfig, MotionQueue};
pub use self::reclaim::{ArmOwner, Claim, Effects, Reclaimed, reclaim};
pub use self::recover::{NotRecovered, Recovered, RecoveryConfig, prepare, recover};
pub use self::release::{release, release_controller, release_robot};
pub use self::robot::{give_arm, prepare_robot};
pub use self::target::Target;
pub use self::variable::{read_variable, write_variable};

pub(crate) use self::sequence::{BUSY_LIMIT, BUSY_PAUSE};

#[cfg(test)]
mod tests;
