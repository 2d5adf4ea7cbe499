//! Support code that tests of several crates share, and that depends on none of them.
//!
//! | module              | contents                                                       | feature  |
//! |---------------------|----------------------------------------------------------------|----------|
//! | [`async_functions`] | the async functions of a crate, read from its sources          |          |
//! | [`pymodbus`]        | a client of Modbus of another make                             |          |
//! | [`python`]          | packages of PyPI that tests run                                |          |
//! | [`tools`]           | tools that tests need, and may be missing                      |          |
//! | `dhcp`              | answers of DHCP servers                                        | `frames` |
//! | `frames`            | frames for a board                                             | `frames` |
//! | `logger`            | a logger of defmt, without which its programs do not link      | `defmt`  |
//! | `stacks`            | two stacks of embassy-net that a cable in memory connects      | `stacks` |

pub mod async_functions;
#[cfg(feature = "frames")]
pub mod dhcp;
#[cfg(feature = "frames")]
pub mod frames;
#[cfg(feature = "defmt")]
mod logger;
pub mod pymodbus;
pub mod python;
#[cfg(feature = "stacks")]
pub mod stacks;
pub mod tools;
