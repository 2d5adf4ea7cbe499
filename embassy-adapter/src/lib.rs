//! b-CAP and RAC on microcontrollers, without an operating system and without allocation.
//!
//! | module     | feature       | content                                                                          |
//! |------------|---------------|----------------------------------------------------------------------------------|
//! | `net`      | `embassy-net` | clients over the TCP and UDP of embassy-net                                      |
//! | `serial`   | `serial`      | clients over a serial line, with the CRC of serial frames                        |
//! | `server`   | `server`      | servers of both protocols over any transport; with `embassy-net`, over TCP and UDP |
//! | `gateway`  | `gateway`     | gateway from RAC clients to a b-CAP robot over any transport; with `embassy-net`, over TCP and UDP |
//! | `http`     | `http`        | pages over HTTP, such as the health of a board and a form for its settings        |
//! | `bare`     | `smoltcp`     | clients and servers for smoltcp without embassy, by polling                      |
//!
//! [`bcap_core`] implements the protocols. This crate moves their bytes and supplies the time. Guarantees:
//!
//! * **The caller owns the memory.** Socket buffers, sessions and tables of peers are borrowed, so a board can place
//!   them in static memory, and futures stay small.
//! * **Every wait ends.** A connection fails with an error when its peer disappears or its cable is pulled. A call ends at
//!   its timeouts, a server's session at its `server::Limits`.
//! * **Futures are cancel-safe.** They may be dropped at any point; each function documents the state after that.
#![no_std]
#![cfg_attr(docsrs, feature(doc_cfg))]

#[cfg(test)]
extern crate std;

pub use bcap_core as core;

#[cfg(feature = "smoltcp")]
pub mod bare;
#[cfg(any(feature = "embassy-net", feature = "serial", feature = "server"))]
pub mod clock;
#[cfg(any(feature = "embassy-net", feature = "gateway"))]
mod error;
#[cfg(feature = "gateway")]
pub mod gateway;
#[cfg(feature = "http")]
pub mod http;
#[cfg(feature = "embassy-net")]
pub mod net;
#[cfg(feature = "serial")]
pub mod serial;
#[cfg(feature = "server")]
pub mod server;

// with its logger the tests link with `--all-features`
#[cfg(all(test, feature = "defmt"))]
use bcap_test_support as _;

/// The examples of the crate's page.
#[cfg(all(doctest, feature = "embassy-net"))]
#[doc = include_str!("../README.md")]
pub struct Readme;
