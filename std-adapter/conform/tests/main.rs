//! The tests of this package, as one program. `cargo test -p bcap-conform NAME::` runs those of one module.

mod clients;
mod common;
mod devices;
mod faults;
