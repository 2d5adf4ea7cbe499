//! The tests of this package, as one program. `cargo test -p bcap-board NAME::` runs one module.

mod configure;
mod console;
mod slots;
#[cfg(feature = "update")]
mod update;
