//! Board support that the images share: the Ethernet controller, clock, serial port and executor of a board in QEMU.
//! Code that does not depend on this board is in `bcap_board`.
//!
//! | module       | content                                                                           |
//! |--------------|-----------------------------------------------------------------------------------|
//! | [`board`]    | the addresses of the chosen board's peripherals                                   |
//! | [`lan9118`]  | the driver of the Ethernet controller for embassy-net and smoltcp                 |
//! | [`clock`]    | a hardware counter as a clock, and embassy's time driver on it                    |
//! | [`executor`] | an executor that sleeps with WFI                                                  |
//! | [`uart`]     | the serial port and its transmit buffer                                           |
//! | `lines`      | more serial ports: to a robot and a PLC with the feature `lines`, else the console |
//! | `console`    | changes the settings and the image, with the feature `console`                    |
//! | `flash`      | a model of a flash, with the feature `console`                                    |
//! | `update`     | the partitions and the boot loader, with the feature `update`                     |
//! | [`config`]   | the settings of the image or of the console                                       |
//! | [`net`]      | embassy-net on the board                                                          |
//! | `echo`       | an echo server, with the feature `echo`                                           |
//! | [`node`]     | the board as a controller: uptime, counters and some memory                       |
//! | `pac`        | the facts about the processor that RTIC needs, with the feature `rtic`            |
//! | [`watchdog`] | the registers of the watchdog                                                     |
//! | [`fault`]    | reports and resets after a panic or a fault                                       |
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
pub mod lan9118;
#[cfg(any(feature = "console", feature = "lines"))]
pub mod lines;
mod mmio;
pub mod net;
pub mod node;
#[cfg(feature = "rtic")]
pub mod pac;
#[cfg(feature = "faults")]
pub mod provoke;
pub mod uart;
#[cfg(feature = "update")]
pub mod update;
pub mod watchdog;
