//! A virtual DENSO RC8, RC9 or COBOTTA controller, to test programs that talk to a robot controller without a robot.
//!
//! [`Controller`] is a model, not a server. It has no socket, no thread and no clock. It implements
//! [`bcap_core::bcap::server::Handler`] and [`bcap_core::rac::server::Handler`], so that one controller can serve both
//! protocols. Every call brings the time with it, and the same calls at the same times give the same answers: in a test
//! without waiting, and over sockets in real time.
//!
//! # Features
//!
//! * The objects of the protocol: controller, robot, tasks, variables; handles that belong to the client that opened them.
//! * The user variables I F D V P J T S IO, with wildcards and views of the IO bits, in the types of a real controller.
//! * The system variables of controller, robot and tasks, the error lists, and the commands that read them.
//! * An arm of six axes with its kinematics, and up to two extended axes.
//! * A motor, the arm authority, motions that take time, Halt and Hold.
//! * Slave Mode with its three modes, buffers, formats, limits and errors.
//! * Files below a folder of this machine.
//! * A hand, as an extension and with the commands of a COBOTTA; the preparation that a COBOTTA needs before it moves.
//! * Lines of data communication, on which a scenario sends texts.
//! * Command objects, and messages about the controller's errors.
//! * Tasks with programs that a scenario defines, on the injected clock.
//! * Logs of errors, of operations and of positions.
//! * The emergency stop, the mode switch, the executable token and errors, set by a test.
//! * Faults of the controller and of the wire, set by a scenario.
//! * [`memory`]: connections without sockets and a clock that never waits, for tests of drivers.
//!
//! # What answers `E_NOTIMPL`
//!
//! Motions of two robots, force control, and the calculator of paths; `docs/virtual-controller.md` has the whole table. A
//! command that no known controller has answers `E_INVALID_CMD_NAME`. A call that answers `S_OK` has had its effect.
//!
//! # Decisions of this model, where the manuals are silent
//!
//! * Service_Start is the first call of a connection, on all profiles; other calls before it answer `E_NOT_CONNECTED`.
//! * Objects of a controller remain open after its Controller_Disconnect, until they are released themselves.
//! * A client that disconnects loses its arm authority, and its motion halts.
//! * The code of a refused call, if it is one of the controller (0x81 to 0x85), is an error that must be cleared. Its level
//!   says what it stops: level 1 nothing, level 2 motions and tasks, level 3 to 5 also the motor. The stop of a client's motion
//!   is an error of that client.
//! * A client may give the robot any name; there is one arm, and an `ID=` other than 0 is `E_CAO_OBJECT_NOTFOUND`.
//! * GetAttribute answers 0; for a file, the sum of 1 (read-only) and 16 (folder). GetTag and GetID answer the values of
//!   PutTag and PutID; the ID of a user variable is its index.
//! * Variable_GetDateTime answers when the variable was last read or written through this handle.
//!
//! The tables of names, types and answers are with the code: [`variables`], [`system`], [`arm`],
//! [`controller_execute`], [`command_objects`], [`comm`], [`messages`], [`trace`], [`explain`], [`files`], [`hand`],
//! [`preparation`], [`pose`], [`kinematics`], [`scenario`], [`slave`], [`tasks`], [`model`].
//!
//! # Examples
//!
//! ```
//! use bcap_core::time::Instant;
//! use bcap_core::variant::Variant;
//! use bcap_sim::{Config, Controller, Profile, VariableKind};
//!
//! let mut controller = Controller::new(Config::new(Profile::Rc8));
//! controller.set_variable(VariableKind::I, 10, &Variant::I4(123))?;
//! assert_eq!(controller.variable::<16>(VariableKind::I, 10)?.as_variant(), Variant::I4(123));
//!
//! controller.emergency_stop(true, Instant::from_millis(5));
//! assert!(controller.emergency_stopped() && !controller.motor_is_on());
//! # Ok::<(), bcap_core::hresult::HResult>(())
//! ```
#![cfg_attr(docsrs, feature(doc_cfg))]

mod answer;
mod areas;
pub mod arm;
pub mod codes;
pub mod comm;
mod command_name;
pub mod command_objects;
mod config;
mod context;
mod controller;
mod coordinates;
mod curve;
mod drive;
mod errors;
mod executor;
pub mod explain;
pub mod files;
pub mod hand;
pub mod kinematics;
mod levels;
pub mod memory;
pub mod messages;
pub mod model;
pub mod motion;
mod objects;
mod operations;
mod options;
pub mod pace;
mod path;
mod path_points;
pub mod pose;
pub mod preparation;
pub mod program;
mod queue;
mod robot;
mod route;
mod rules;
pub mod scenario;
pub mod slave;
mod stream;
mod table;
pub mod tasks;
pub mod trace;
mod value;
pub mod variables;
mod waits;

pub use config::{Config, Mode, Permission, SlaveConfig, SpeedSetting, Token};
pub use controller::controller_execute::SysStateBit;
pub use controller::{Controller, controller_execute, system};
pub use errors::ErrorEntry;
pub use model::{ArmModel, ArmProfile, Model, Profile, SlaveFormats};
pub use scenario::Scenario;
pub use stream::{SlaveCounters, SlaveCycle};
pub use tasks::TaskStatus;
pub use variables::Sizes;
// the kinds of user variables, as both protocols name them
pub use bcap_core::rac::VariableKind;

/// The examples of the crate's page.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
