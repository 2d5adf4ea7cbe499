//! The tests of this package, as one program. `cargo test -p bcap-sim NAME::` runs one module.

mod common;
mod conditions;
mod controller;
mod decisions;
mod determinism;
mod engine;
mod explain;
mod figures;
mod files;
mod functions;
mod guide;
mod logs;
mod objects;
mod preparation;
mod programs;
mod provider;
mod rac;
mod robot;
mod scenario;
mod slave;
mod strict;
mod variables;
