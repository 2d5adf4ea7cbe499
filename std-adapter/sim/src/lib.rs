//! A virtual DENSO RC8, RC9 or COBOTTA: what a program that talks to a robot controller meets, without the robot.
//!
//! [`Controller`] is a model, not a server. It has no socket, no thread and no clock; it implements
//! [`bcap_core::bcap::server::Handler`] and [`bcap_core::rac::server::Handler`], so that whatever drives the servers of
//! the two protocols can put it behind both, with one state, and every call brings the time with it. The same calls at
//! the same times give the same answers, in a test in no time and behind real sockets in real time.
//!
//! # What there is
//!
//! * The objects of the protocol: controller, robot, tasks, variables; handles that belong to the client that got them.
//! * The user variables I F D V P J T S IO, with wildcards and views of the IO bits, in the types a controller uses.
//! * The system variables of controller, robot and tasks, the error lists, the commands about them.
//! * An arm of six axes with its kinematics, and up to two extended axes.
//! * A motor, the arm authority, motions that take their time, Halt and Hold.
//! * Slave mode with its three modes, buffers, formats, limits and errors.
//! * Files below a folder of this machine.
//! * A hand, as an extension and by the commands of a COBOTTA; what a COBOTTA needs before it moves.
//! * Command objects, and messages about the controller's errors.
//! * Tasks that run on the clock that is given.
//! * The emergency stop, the mode switch, the executable token and any error, for a test to throw in.
//! * Faults by a scenario, on the wire as well as in the controller.
//!
//! # What answers `E_NOTIMPL`
//!
//! Arcs and free curves, Rotate, File_Run, Task_Delete, definitions of tools and work coordinates, logs of positions
//! and of operations, force control. A command that no controller is known to have answers `E_INVALID_CMD_NAME`.
//! Nothing answers `S_OK` without having done what it was asked.
//!
//! # Decisions, where the manuals are silent
//!
//! * Service_Start comes before everything else on a connection, on both profiles; without it: `E_NOT_CONNECTED`.
//! * Objects of a controller outlive its Controller_Disconnect until they are released themselves.
//! * A client that goes loses its arm authority, and its motion halts.
//! * Refused calls are in the error log only. Emergency stop, poses out of range and injected errors are errors that
//!   must be cleared: with level 1 and 2 they stop motion and suspend tasks; from level 3 on they also switch the motor
//!   off and reset the tasks.
//! * A robot's name may be anything; there is one arm, and a client's `ID=` other than 0 is `E_CAO_OBJECT_NOTFOUND`.
//! * GetAttribute answers 0, of a file the sum of 1 (read-only) and 16 (folder). GetTag and GetID answer what PutTag
//!   and PutID have set; a user variable's ID is its index.
//! * Variable_GetDateTime tells when the variable was last read or written through this handle.
//!
//! The tables of names, types and answers stand with the code: [`variables`], [`system`], [`arm`], [`execute`],
//! [`commands`], [`messages`], [`explain`], [`files`], [`hand`], [`preparation`], [`pose`], [`kinematics`],
//! [`scenario`], [`slave`], [`tasks`].
//!
//! # Examples
//!
//! ```
//! use bcap_core::time::Instant;
//! use bcap_core::variant::Variant;
//! use bcap_sim::{Config, Controller, EMERGENCY_STOP, Profile, VariableKind};
//!
//! let mut controller = Controller::new(Config::new(Profile::Rc8));
//! controller.set_variable(VariableKind::I, 10, &Variant::I4(123))?;
//! assert_eq!(controller.variable::<16>(VariableKind::I, 10)?.as_variant(), Variant::I4(123));
//!
//! controller.emergency_stop(true, Instant::from_millis(5));
//! assert_eq!(controller.errors().map(|e| e.code).collect::<Vec<_>>(), [EMERGENCY_STOP]);
//! # Ok::<(), bcap_core::hresult::HResult>(())
//! ```

mod answer;
pub mod arm;
pub mod commands;
mod config;
mod context;
mod controller;
mod drive;
mod errors;
mod executor;
pub mod explain;
pub mod files;
mod function;
pub mod hand;
pub mod kinematics;
pub mod messages;
pub mod motion;
mod objects;
mod options;
pub mod pose;
pub mod preparation;
mod robot;
pub mod scenario;
pub mod slave;
mod stream;
mod table;
pub mod tasks;
mod value;
pub mod variables;
mod waits;

pub use config::{Config, Mode, Permission, Profile, SlaveConfig, SlaveFormats, SpeedSetting, Token};
pub use controller::execute::Bit;
pub use controller::{Controller, EMERGENCY_STOP, execute, system};
pub use errors::ErrorEntry;
pub use scenario::Scenario;
pub use stream::{SlaveCounters, SlaveCycle};
pub use tasks::TaskStatus;
pub use variables::Sizes;
// the kinds of user variables, as both protocols name them
pub use bcap_core::rac::VariableKind;
