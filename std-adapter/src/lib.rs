//! b-CAP and RAC over the sockets and serial ports of an operating system.
//!
//! | module       | feature  | what it is                                                              |
//! |--------------|----------|-------------------------------------------------------------------------|
//! | [`blocking`] |          | blocking clients: b-CAP over TCP, UDP and serial lines, RAC over TCP    |
//! | `asynch`     | `tokio`  | the same clients for tokio                                              |
//! | [`slave`]    |          | real-time settings of Linux for streams of Slave Mode                   |
//! | `server`     | `server` | a server for any handler: b-CAP over TCP and UDP, RAC over TCP          |
//! | `gateway`    | `gateway` | RAC for PLCs on one side, b-CAP to a robot on the other                |
//!
//! Serial lines need the feature `serial`.
//!
//! The protocol is in [`bcap_core`], which does no I/O. This crate connects it to sockets and a clock. A call takes two
//! system calls: one send and one receive.
//!
//! # Examples
//!
//! ```no_run
//! use bcap_core::bcap::call;
//! use bcap_std::blocking;
//!
//! let mut robot = blocking::connect_tcp("192.168.0.1:5007", &Default::default())?;
//! robot.call(call::service_start("WDT=400"))?;
//! let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", ""))?;
//! let variable = robot.call(call::controller_get_variable(controller, "I1", ""))?;
//! println!("I1 = {:?}", robot.call(call::variable_get_value(variable))?);
//! robot.call(call::variable_release(variable))?;
//! robot.call(call::controller_disconnect(controller))?;
//! robot.call(call::service_stop())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub use bcap_core as core;
pub use bcap_core::position::{Joints, Position, Transform};
pub use bcap_core::procedure::Motion;

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
mod moves;
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
pub use moves::{Destination, Interpolation, Move, Pass, Plane};
pub use settings::{Backoff, Model, ServiceOptions, Settings};
pub use task::{TaskStart, TaskStatus, TaskStop};

/// A failed call.
pub type CallError = bcap_core::io::CallError<std::io::Error>;

/// A failed procedure.
pub type RunError<P = bcap_core::procedure::StepError> = bcap_core::io::RunError<P, std::io::Error>;

/// A failed RAC request.
pub type RacError = bcap_core::io::RacError<std::io::Error>;
