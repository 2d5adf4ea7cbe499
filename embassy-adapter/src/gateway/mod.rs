//! The gateway of the core over embassy-net: PLCs that speak RAC on one side, a robot that speaks b-CAP on the other.
//!
//! ```text
//!  PLC ─► Listener ─► serve ─┐
//!  PLC ─► Listener ─► serve ─┼─► Shared: the gateway ◄─► run_robot ─► the robot, over TCP or UDP
//!  a serial line ───► serve ─┘            │
//!                                         └─► Log: what was refused, and why; the robot comes and goes
//! ```
//!
//! Each PLC that is to be served at the same time needs a task, a socket's memory and a seat in the gateway; the robot
//! needs one task, which also keeps the gateway's time. Whoever has moved bytes lets the gateway take its steps, and wakes
//! those whom they concern. What is answered, and when, is [`bcap_core::gateway`]'s affair.
//!
//! # Examples
//!
//! ```
//! use bcap_core::gateway::{Config, Gateway, Memory};
//! use bcap_core::rac;
//! use bcap_embassy::gateway::{Listener, Report, Shared, TcpRobot, run_robot};
//! use bcap_embassy::net::Options;
//! use bcap_embassy::server::Limits;
//! use embassy_futures::join::join;
//! use embassy_net::{IpEndpoint, Stack};
//! use embassy_sync::blocking_mutex::raw::NoopRawMutex;
//!
//! fn log(report: &Report<'_>) {
//!     if let Report::Answered { client, line, .. } = report {
//!         // ... say it somewhere ...
//!     }
//! }
//!
//! // on a board the memory is static, and each of the two has a task of its own
//! async fn gateway(stack: Stack<'_>, robot: IpEndpoint) {
//!     let mut memory = Memory::<1, 16>::new();
//!     let shared: Shared<'_, NoopRawMutex, 1> = Shared::new(Gateway::new(Config::RC8, &mut memory), log);
//!
//!     let ([mut rx, mut tx], mut frame) = ([[0; 512]; 2], [0; 512]);
//!     let mut robot = TcpRobot::new(stack, &mut rx, &mut tx, Options::default(), robot);
//!     let ([mut rx, mut tx], limits) = ([[0; 512]; 2], Limits::default());
//!     let mut plc = Listener::new(stack, rac::PORT, &mut rx, &mut tx);
//!     join(run_robot(&mut robot, &mut frame, &shared), plc.run(&shared, &limits)).await;
//! }
//! ```

mod clients;
mod robot;
mod shared;

use bcap_core::gateway::Event;
use embassy_net::IpEndpoint;

pub use self::clients::{Listener, serve};
pub use self::robot::{Link, TcpRobot, run_robot};
pub use self::shared::Shared;
use crate::net::NetError;
use crate::server::Ended;

/// Says what has happened; it is called while the gateway takes a step, so it must not call the gateway.
pub type Log = fn(&Report<'_>);

/// What has happened, for a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Report<'a> {
    /// A client has been given a seat.
    Connected {
        /// Its address; `None` when it did not come over the network.
        client: Option<IpEndpoint>,
    },
    /// A client has gone.
    Disconnected {
        /// Its address.
        client: Option<IpEndpoint>,
        /// Why its session ended; `None` when its task was dropped.
        ended: Option<Ended<()>>,
    },
    /// A line was answered: served, failed or refused.
    Answered {
        /// The client's address.
        client: Option<IpEndpoint>,
        /// The line, without its CR; of an over-long one the first 256 bytes.
        line: &'a [u8],
        /// How it was answered.
        event: Event,
    },
    /// The robot has come, or gone.
    Robot {
        /// Which of the two.
        event: Event,
        /// What the network said, when it is the reason.
        cause: Option<NetError>,
    },
}
