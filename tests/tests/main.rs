//! The tests of this package, as one program. `cargo test -p bcap-tests NAME::` runs one module.

mod async_controller;
#[cfg(unix)]
mod boards;
mod book;
mod cancellation;
mod citations;
mod controller;
mod corpora;
mod drivers;
mod early_replies;
mod endings;
mod examples;
mod faults;
#[cfg(target_os = "linux")]
mod gateway_access;
mod invariants;
mod layers;
mod loops;
mod network;
mod no_alloc;
mod outages;
mod procedures;
mod programs;
mod rac;
mod rare_orders;
mod reconnection;
mod recovery;
mod roundtrip;
#[cfg(unix)]
mod serial_cable;
#[cfg(unix)]
mod serial_lines;
mod server_robustness;
mod sizes;
mod slave;
mod text;
mod tools;
mod udp_session;
mod vectors;
