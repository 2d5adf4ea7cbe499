//! The tests of this package, as one program. `cargo test -p bcap-std NAME::` runs one module.

#[cfg(feature = "gateway")]
mod gateway;
#[cfg(feature = "server")]
mod loopback;
#[cfg(feature = "server")]
mod panics;
#[cfg(feature = "server")]
mod rac;
#[cfg(feature = "server")]
mod served;
#[cfg(feature = "server")]
mod turns;
