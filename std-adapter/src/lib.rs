//! DENSO robot controllers from Rust, over the sockets of an operating system.
//!
//! A [`Controller`](blocking::Controller) is a session with a controller. It reads and writes variables, and its
//! [`Arm`](blocking::Arm) moves the robot:
//!
//! ```no_run
//! use std::time::Duration;
//!
//! use bcap_std::blocking::Controller;
//! use bcap_std::{Motion, Move, Settings};
//!
//! let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
//! let count: i32 = cell.read("I1")?;
//! cell.write("I1", count + 1)?;
//!
//! let mut arm = cell.robot()?.take_arm()?; // given back on drop, with the motor off
//! arm.motor_on()?;
//! match arm.move_to(&Move::line("P1").speed_percent(10.0), Duration::from_secs(30))? {
//!     Motion::Arrived => println!("the robot rests at P1"),
//!     other => println!("it does not: {other:?}"),
//! }
//! # Ok::<(), bcap_std::Error>(())
//! ```
//!
//! | to                          | read                                                                                    |
//! |-----------------------------|-----------------------------------------------------------------------------------------|
//! | move a robot                | [`blocking::Arm::move_to`], [`Move`], [`Motion`]                                        |
//! | follow a path without stops | [`blocking::Arm::start`], [`blocking::Moving`]                                          |
//! | recover it after an error   | [`blocking::Robot::examine`], [`recover`](blocking::Robot::recover); for a COBOTTA [`prepare`](blocking::Robot::prepare) |
//! | stop it                     | [`blocking::Stopper`]; what a drop does: [`blocking::Arm`], [`blocking::Moving`]        |
//! | read and write              | [`blocking::Controller::read`], [`write`](blocking::Controller::write), [`scan`](blocking::Controller::scan) |
//! | use tokio                   | `asynch::Controller`: many tasks, reconnection, subscriptions                           |
//! | stream poses                | [`blocking::Arm::stream`], [`slave`]                                                    |
//! | test without a robot        | `Controller::over` with a `Wire` of the crate `bcap-sim`                                |
//! | call any of 137 functions   | [`blocking::Controller::call`] with a call of [`core::bcap::call`]                      |
//! | be a controller             | `server::Server`, with [`core::device::Device`] or your own handler                     |
//! | wait for an input           | [`blocking::Controller::read_until`]                                                    |
//! | understand an error         | [`Error`], [`core::hresult::HResult`]; [`MainError`] for the result of `main`           |
//!
//! | module       | feature   | content                                                                 |
//! |--------------|-----------|-------------------------------------------------------------------------|
//! | [`blocking`] |           | objects and clients that block: b-CAP over TCP, UDP and serial lines, RAC over TCP |
//! | `asynch`     | `tokio`   | the same for tokio                                                      |
//! | [`slave`]    |           | Slave Mode; its real-time settings of Linux need the feature `realtime` |
//! | `server`     | `server`  | a server for any handler: b-CAP over TCP and UDP, RAC over TCP          |
//! | `gateway`    | `gateway` | RAC for PLCs on one side, b-CAP to a robot on the other                 |
//!
//! The protocol is in [`bcap_core`], which does no I/O. This crate connects it to sockets and a clock. The feature `serial`
//! adds serial lines, `serde` serialises values.
#![cfg_attr(docsrs, feature(doc_cfg))]

pub use bcap_core as core;
pub use bcap_core::position::{Joints, Position, Transform};
pub use bcap_core::procedure::{
    Examination, Halt, HaltAnswer, Motion, NotRecovered, Obstacle, RecoveryConfig, RecoveryStep, StoppedTasks,
};

/// Defines a setter for each field of a struct that may grow.
macro_rules! setters {
    ($name:ident { $($field:ident: $type:ty;)* }) => {
        impl $name {
            $(
                #[doc = concat!("Returns it with another value of the field `", stringify!($field), "`.")]
                #[must_use]
                pub const fn $field(mut self, $field: $type) -> Self {
                    self.$field = $field;
                    self
                }
            )*
        }
    };
}

mod address;
#[cfg(feature = "tokio")]
pub mod asynch;
pub mod blocking;
mod clock;
mod connect;
mod error;
#[cfg(feature = "gateway")]
pub mod gateway;
mod line;
mod main_error;
mod moves;
mod path;
mod recovery;
mod reply;
#[cfg(feature = "server")]
pub mod server;
mod session;
mod settings;
pub mod slave;
mod task;

pub use address::{Address, AddressError, NetworkAddress, Protocol};
pub use clock::now;
pub use connect::{ConnectError, Options};
pub use error::Error;
pub use line::{Parity, SerialLine, StopBits};
pub use main_error::MainError;
pub use moves::{Destination, DestinationError, Interpolation, Move, Pass, Plane};
pub use path::{ObjectPath, ObjectPathError};
pub use recovery::Recovery;
pub use reply::OwnedReply;
pub use session::TimedReading;
pub use settings::{Backoff, Model, ServiceOptions, Settings};
pub use task::{TaskStart, TaskStatus, TaskStop};

/// A failed call.
pub type CallError = bcap_core::io::CallError<std::io::Error>;

/// A failed procedure.
pub type RunError<P = bcap_core::procedure::StepError> = bcap_core::io::RunError<P, std::io::Error>;

/// A failed RAC request.
pub type RacError = bcap_core::io::RacError<std::io::Error>;

/// The examples of the crate's page.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
