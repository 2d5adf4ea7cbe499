//! The core's gateway over any transport: it connects PLCs that speak RAC to a robot that speaks b-CAP.
//!
//! ```text
//!  PLC ─► Listener ─► serve ─┐
//!  PLC ─► Listener ─► serve ─┼─► SharedGateway ◄─► run_robot ─► robot, over TCP, UDP or RS-232
//!  serial line ─────► serve ─┘         │
//!                                      └─► Log: answered and refused lines, connections and disconnections
//! ```
//!
//! Each PLC that is served concurrently needs a task, socket buffers and a client slot of the gateway. The robot needs
//! one task, which also polls the gateway at its deadlines. After moving bytes, a task polls the gateway and wakes the
//! tasks that its events concern. [`bcap_gateway`] defines the answers and their timing.
//!
//! A board without Ethernet needs neither embassy-net nor its feature: PLCs and robot are on serial lines, and any other
//! [`Transport`](bcap_core::io::asynch::Transport) also works. [`Listener`], [`TcpRobot`] and `ModbusListener` need
//! `embassy-net`.
//!
//! # Examples
//!
//! ```
//! # #[cfg(feature = "embassy-net")] mod example {
//! use bcap_gateway::{Config, Gateway, Memory};
//! use bcap_core::rac;
//! use bcap_embassy::gateway::{Limits, Listener, Report, SharedGateway, TcpRobot, run_robot};
//! use bcap_embassy::net::Options;
//! use embassy_futures::join::join;
//! use embassy_net::{IpEndpoint, Stack};
//! use embassy_sync::blocking_mutex::raw::NoopRawMutex;
//!
//! fn log(report: &Report<'_>) {
//!     if let Report::Answered { client, line, .. } = report {
//!         // ... write it to a log ...
//!     }
//! }
//!
//! // on a board the memory is static, and the robot and the PLC have a task each
//! async fn gateway(stack: Stack<'_>, robot: IpEndpoint) {
//!     let mut memory = Memory::<1, 16>::new();
//!     let shared: SharedGateway<'_, NoopRawMutex, 1> = SharedGateway::new(Gateway::new(Config::RC8, &mut memory), log);
//!
//!     let ([mut rx, mut tx], mut frame) = ([[0; 512]; 2], [0; 512]);
//!     let mut robot = TcpRobot::new(stack, &mut rx, &mut tx, Options::default(), robot);
//!     let ([mut rx, mut tx], limits) = ([[0; 512]; 2], Limits::default());
//!     let mut plc = Listener::new(stack, rac::PORT, &mut rx, &mut tx);
//!     join(run_robot(&mut robot, &mut frame, &shared), plc.run(&shared, &limits)).await;
//! }
//! # }
//! ```

mod clients;
#[cfg(feature = "embassy-net")]
mod listener;
#[cfg(all(feature = "embassy-net", feature = "modbus"))]
mod modbus_listener;
mod platform;
mod report;
#[cfg(feature = "serial")]
mod serial;
#[cfg(feature = "embassy-net")]
mod tcp;

pub use self::clients::serve;
#[cfg(feature = "embassy-net")]
pub use self::listener::Listener;
#[cfg(all(feature = "embassy-net", feature = "modbus"))]
pub use self::modbus_listener::ModbusListener;
pub use self::platform::{Embassy, SharedGateway};
pub use self::report::{Log, Report};
#[cfg(feature = "serial")]
pub use self::serial::SerialRobot;
#[cfg(feature = "embassy-net")]
pub use self::tcp::TcpRobot;
pub use crate::error::NetError;
pub use bcap_gateway::driver::{Denial, Ended, Front, Limits, RobotLink, run_robot};
