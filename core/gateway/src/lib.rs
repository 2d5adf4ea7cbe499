//! The gateway: PLCs that speak RAC on one side, a robot that speaks b-CAP on the other.
//!
//! ```text
//!  PLC ─ receive_buffer, received ─►┌─────────┐─ robot_transmit ───────────────────► robot
//!  PLC ◄─ transmit, transmitted ────│ Gateway │◄─ robot_receive_buffer, robot_received ─
//!  ...                              └─────────┘
//!                            poll_event, at poll_timeout, and after
//!                            bytes moved or a connection opened or closed
//! ```
//!
//! A GET becomes Variable_GetValue, a PUT Variable_PutValue, with a handle from Controller_GetVariable. A [`Gateway`]
//! contains no socket and no clock. The caller moves the bytes, opens and closes the connection to the robot as
//! [`robot_wanted`](Gateway::robot_wanted) says, and reads events. All memory is in a [`Memory`]; the gateway itself is not
//! generic, so an image contains one copy of it.
//!
//! * **Replies**: every line gets exactly one reply, its own, in the order of a client's lines. A request that times out
//!   gets the reply E_TIMEOUT; a later reply of the robot is dropped.
//! * **Order**: one call to the robot is in flight at a time. Requests of all clients are served in the order of arrival.
//! * **Without a session** with the robot, every request immediately gets the reply E_NOT_CONNECTED. The request in flight when
//!   the session ends gets E_NOT_CONNECTED, or E_TIMEOUT if the robot stopped responding or a PUT was sent, which the robot may
//!   have executed. The gateway never sends a PUT twice, except after E_HANDLE, which means that it was not executed.
//! * **Handles** are valid on the connection that opened them, and kept in an LRU cache. When the cache is full, the least
//!   recently used handle is released. After E_HANDLE the gateway gets a new handle, once per request. E_HANDLE or
//!   E_NOT_CONNECTED in reply to a call of the controller ends the session: it no longer exists on the robot.
//! * **Results** of the robot are passed on unchanged. **Values** are converted to the type of the variable if that is
//!   lossless, and passed on unchanged otherwise: a line contains the type. A value that has no text, or does not fit the
//!   256 bytes of a line, becomes the reply E_INVALIDSNDPACKET.
//! * **Slave Mode**: a PUT may end a stream of another client. So the gateway sends `slvGetMode` before each PUT, and refuses
//!   the PUT with E_SLVMODE_ON if a stream runs or may run. A stream that begins just after this query can still be ended.
//! * **Rules** ([`Rules`]) are checked first; by default nothing can be written.
//!
//! # Examples
//!
//! ```
//! use bcap_gateway::{Config, Event, Gateway, Memory, Refusal};
//! use bcap_core::time::Instant;
//!
//! // four PLCs, 32 handles; on a board this is a static
//! let mut memory = Memory::<4, 32>::new();
//! let mut gateway = Gateway::new(Config::RC8, &mut memory);
//! let now = Instant::ZERO;
//! assert!(gateway.robot_wanted(), "open a connection to the robot");
//!
//! let plc = gateway.open().ok_or("all slots are taken")?;
//! let line = b"PUT:RC8:10:I:3,5\r";
//! gateway.receive_buffer(plc)[..line.len()].copy_from_slice(line);
//! gateway.received(plc, line.len());
//! let event = gateway.poll_event(now);
//! assert_eq!(event, Some(Event::Refused { peer: plc, refusal: Refusal::ReadOnly }));
//! assert_eq!(gateway.line(plc), b"PUT:RC8:10:I:3,5");
//! assert_eq!(gateway.transmit(plc), b"-2147024891\r"); // E_ACCESSDENIED
//! # Ok::<(), &str>(())
//! ```

#![no_std]
#![cfg_attr(docsrs, feature(doc_cfg))]

mod config;
mod convert;
mod counters;
pub mod driver;
mod event;
mod gateway;
mod handles;
mod link;
pub mod modbus;
mod network;
mod rule_text;
mod rules;
mod slot;
mod stream;

pub use self::config::Config;
pub use self::counters::{Counters, Tally};
pub use self::event::{Asked, Event};
pub use self::gateway::{Gateway, Memory};
pub use self::link::RobotError;
pub use self::network::Network;
pub use self::rule_text::{AllowBuf, RuleError, RuleErrorKind};
pub use self::rules::{Allow, Bounds, Rate, Refusal, Rules};

/// The examples of the crate's page.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
