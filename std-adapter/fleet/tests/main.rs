//! The tests of this package, as one program. `cargo test -p bcap-fleet NAME::` runs one module.

mod chaos;
mod common;
mod host;
mod json;
#[cfg(all(unix, feature = "program"))]
mod program;
mod rules;
mod sparkplug;
mod standby;
#[cfg(feature = "tls")]
mod tls;
