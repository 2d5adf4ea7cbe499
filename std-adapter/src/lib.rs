//! b-CAP and RAC over the sockets of an operating system.
//!
//! | module       | feature  | what it is                                                              |
//! |--------------|----------|-------------------------------------------------------------------------|
//! | [`blocking`] |          | clients that block: b-CAP over TCP and UDP, RAC over TCP                |
//! | `asynch`     | `tokio`  | the same clients for tokio                                              |
//! | [`slave`]    |          | what Linux can do for a stream of Slave Mode                             |
//! | `server`     | `server` | a server for any handler: b-CAP over TCP and UDP, RAC over TCP          |
//! | `gateway`    | `gateway` | RAC for PLCs on one side, b-CAP to a robot on the other                |
//!
//! The protocol itself is in [`bcap_core`]: this crate moves its bytes and tells it the time. A call takes two system
//! calls, one that sends and one that receives.
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

#[cfg(feature = "tokio")]
pub mod asynch;
pub mod blocking;
mod clock;
mod connect;
#[cfg(feature = "gateway")]
pub mod gateway;
#[cfg(feature = "server")]
pub mod server;
pub mod slave;

pub use clock::now;
pub use connect::{ConnectError, Options};

/// A failed call of a client of this crate.
pub type CallError = bcap_core::io::CallError<std::io::Error>;

/// A failed procedure over a client of this crate.
pub type RunError<P = bcap_core::procedure::StepError> = bcap_core::io::RunError<P, std::io::Error>;

/// A failed request of a client of RAC of this crate.
pub type RacError = bcap_core::io::RacError<std::io::Error>;
