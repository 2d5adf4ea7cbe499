//! Board support that the images share: the Ethernet controller, clock, serial port and executor of a board in QEMU.
//!
//! | module       | what it is                                                                        |
//! |--------------|-----------------------------------------------------------------------------------|
//! | [`board`]    | the addresses of the chosen board's peripherals                                   |
//! | [`lan9118`]  | the driver of the Ethernet controller for embassy-net and smoltcp                 |
//! | [`clock`]    | a hardware counter as a clock, and embassy's time driver on it                    |
//! | [`executor`] | an executor that sleeps with WFI                                                  |
//! | [`uart`]     | the serial port and the buffer of what it sends                                   |
//! | [`log`]      | defmt's logger on the serial port                                                 |
//! | [`config`]   | the settings block in the flash, which a host tool patches                        |
//! | [`net`]      | embassy-net on the board: its task and its address                                |
//! | [`stack`]    | the program's stack and its high-water mark                                       |
//! | `echo`       | an echo server, with the feature `echo`                                           |
//! | `health`     | the page of the state and messages of syslog, with the feature `health`           |
//! | [`node`]     | the board as a controller: uptime, counters and some memory                       |
//! | [`watchdog`] | a reset when a task makes no progress                                             |
//! | [`fault`]    | reports and resets after a panic or a fault                                       |
//! | [`record`]   | the cause of the last reset, kept over the reset                                  |
//!
//! The exception handlers (`exceptions`) use all of them. Unsafe code is limited to what the hardware requires: access to
//! registers (`mmio`), the symbols that the linker looks for, and the exception handlers.
#![no_std]

pub mod board;
pub mod clock;
pub mod config;
#[cfg(feature = "console")]
pub mod console;
#[cfg(feature = "echo")]
pub mod echo;
mod exceptions;
pub mod executor;
pub mod fault;
#[cfg(feature = "console")]
pub mod flash;
#[cfg(feature = "health")]
pub mod health;
pub mod lan9118;
pub mod log;
mod mmio;
pub mod net;
pub mod node;
#[cfg(feature = "faults")]
pub mod provoke;
pub mod record;
pub mod stack;
pub mod uart;
pub mod watchdog;
