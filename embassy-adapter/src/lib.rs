//! b-CAP and RAC on microcontrollers, without an operating system and without allocation.
//!
//! | module     | feature       | what it is                                                                       |
//! |------------|---------------|----------------------------------------------------------------------------------|
//! | `net`      | `embassy-net` | clients over the TCP and UDP of embassy-net                                      |
//! | `serial`   | `serial`      | clients over a serial line, with the CRC that those have                         |
//! | `server`   | `server`      | servers of both protocols over any transport; with `embassy-net`, over TCP and UDP |
//! | `gateway`  | `gateway`     | RAC on one side, b-CAP on the other: the core's gateway over embassy-net         |
//! | `bare`     | `smoltcp`     | clients and servers for smoltcp alone, polled                                    |
//!
//! The protocols are in [`bcap_core`]; this crate moves their bytes and tells them the time. What it guarantees:
//!
//! * **Memory belongs to the caller**: socket buffers, sessions and tables of peers are borrowed, so a board places them
//!   where it likes, and futures stay small.
//! * **Every wait ends.** A connection whose peer vanished, or whose cable was pulled, fails with an error that says so;
//!   a call has its time limits, a server's session those of its limits.
//! * **Futures may be dropped** at any point; the docs say what has happened then.
#![no_std]

#[cfg(test)]
extern crate std;

pub use bcap_core as core;

#[cfg(feature = "smoltcp")]
pub mod bare;
#[cfg(any(feature = "embassy-net", feature = "serial", feature = "server"))]
pub mod clock;
#[cfg(feature = "gateway")]
pub mod gateway;
#[cfg(feature = "embassy-net")]
pub mod net;
#[cfg(feature = "serial")]
pub mod serial;
#[cfg(feature = "server")]
pub mod server;
