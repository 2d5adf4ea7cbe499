//! What the images share: a board that QEMU emulates, with its Ethernet controller, clock, serial port and executor.
//!
//! | module       | what it is                                                                        |
//! |--------------|-----------------------------------------------------------------------------------|
//! | [`board`]    | where the peripherals of the chosen board are                                     |
//! | [`lan9118`]  | the Ethernet controller, and its seams to embassy-net and smoltcp                 |
//! | [`clock`]    | SysTick, and embassy's time driver on it                                          |
//! | [`executor`] | an executor that sleeps with WFI                                                  |
//! | [`uart`]     | the serial port, and defmt's frames over it                                       |
//! | [`config`]   | the block of flash that a host tool patches: addresses, names and rules           |
//! | [`net`]      | embassy-net on the board: its tasks, and an address                               |
//! | [`stack`]    | how much of the stack has ever been in use                                        |
//! | [`echo`]     | a port that sends back what comes                                                 |
//! | [`node`]     | the board as a controller: uptime, counters and some memory                       |
//! | [`watchdog`] | a reset when the tasks make no progress                                           |
//! | [`fault`]    | what happens after a panic or a fault                                             |
//!
//! The handlers of exceptions (`exceptions`) are above all of them. Unsafe code is only where the hardware leaves no choice:
//! access to registers (`mmio`), the symbols that the linker looks for, and the handlers of exceptions.
#![no_std]

pub mod board;
pub mod clock;
pub mod config;
pub mod echo;
mod exceptions;
pub mod executor;
pub mod fault;
pub mod lan9118;
mod mmio;
pub mod net;
pub mod node;
pub mod stack;
pub mod uart;
pub mod watchdog;
