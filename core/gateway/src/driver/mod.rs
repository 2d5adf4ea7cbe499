//! The driver of a gateway, for any executor, network and lock.
//!
//! ```text
//!  PLC ─► serve ─┐
//!  PLC ─► serve ─┼─► SharedGateway ◄─► run_robot ─► robot
//!  PLC ─► serve ─┘         │
//!                          └─► log: answered and refused lines, connections and disconnections
//! ```
//!
//! Each PLC needs a task that runs [`serve`], the robot one that runs [`run_robot`], which also polls the gateway at its
//! deadlines. After moving bytes, a task polls the gateway and wakes the tasks that its events concern. The bytes move over
//! [`Transport`](bcap_core::io::asynch::Transport)s. A [`Platform`] provides the lock, the clock and the types of addresses.
//! `bcap-std` and `bcap-embassy` each contain a platform and the sockets.

mod client;
mod clients;
mod front;
mod limits;
mod notify;
mod platform;
mod report;
mod robot;
mod shared;

pub use self::client::Client;
pub use self::clients::{refuse, serve};
pub use self::front::Front;
pub use self::limits::Limits;
pub use self::platform::{Lock, Platform};
pub use self::report::{Denial, Ended, Report};
pub use self::robot::{RobotLink, run_robot};
pub use self::shared::{Shared, SharedGateway};

#[cfg(test)]
mod tests;
