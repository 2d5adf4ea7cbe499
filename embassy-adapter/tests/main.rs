//! The tests of this package, as one program. `cargo test -p bcap-embassy NAME::` runs one module.

#![allow(
    clippy::expect_used,
    clippy::indexing_slicing,
    clippy::large_futures,
    clippy::panic,
    clippy::unwrap_used,
    reason = "a test fails by panicking"
)]

#[cfg(all(feature = "http", feature = "modbus", feature = "serial"))]
mod cancellation;
mod common;
#[cfg(feature = "gateway")]
mod gateway;
#[cfg(feature = "http")]
mod http;
#[cfg(feature = "modbus")]
mod modbus;
#[cfg(all(feature = "embassy-net", feature = "server"))]
mod net;
#[cfg(all(feature = "gateway", feature = "serial"))]
mod serial;
