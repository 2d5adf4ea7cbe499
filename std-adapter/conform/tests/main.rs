//! The tests of this package, as one program. `cargo test -p bcap-conform NAME::` runs one module.

mod clients;
mod common;
mod devices;
mod faults;
