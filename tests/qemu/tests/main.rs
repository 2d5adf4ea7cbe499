//! The tests of this package, as one program. `cargo test -p bcap-qemu NAME::` runs those of one module.

#[cfg(unix)]
#[path = "../../../embassy-adapter/board/src/lease/answer.rs"]
mod answer;
#[cfg(unix)]
mod console;
#[cfg(unix)]
mod dhcp;
#[cfg(unix)]
mod faults;
#[cfg(unix)]
mod flood;
#[cfg(unix)]
#[path = "../../../embassy-adapter/board/src/lease/frames.rs"]
mod frames;
#[cfg(unix)]
mod gateway;
#[cfg(unix)]
mod health;
#[cfg(unix)]
mod hostile;
mod line;
#[cfg(unix)]
mod modbus;
// without a dependency on the crate of these files, which would double the build
#[path = "../../src/pymodbus.rs"]
pub mod pymodbus;
#[path = "../../src/python.rs"]
pub mod python;
#[cfg(unix)]
mod serial;
#[cfg(unix)]
mod soak;
#[cfg(unix)]
mod update;
#[cfg(unix)]
mod wire;
