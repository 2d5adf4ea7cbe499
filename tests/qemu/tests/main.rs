//! The tests of this package, as one program. `cargo test -p bcap-qemu NAME::` runs one module.

#[cfg(unix)]
mod console;
#[cfg(unix)]
mod dhcp;
#[cfg(unix)]
mod faults;
#[cfg(unix)]
mod find;
#[cfg(unix)]
mod flood;
#[cfg(unix)]
mod gateway;
#[cfg(unix)]
mod health;
#[cfg(unix)]
mod hostile;
mod line;
#[cfg(unix)]
mod modbus;
#[cfg(unix)]
mod serial;
#[cfg(unix)]
mod soak;
#[cfg(unix)]
mod update;
#[cfg(unix)]
mod wire;
