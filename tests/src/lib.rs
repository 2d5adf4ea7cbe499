//! Support code for the tests of the b-CAP stack in addition to [`bcap_testkit`]: servers on real sockets and measurements.
//!
//! | module         | contents                                                                            |
//! |----------------|-------------------------------------------------------------------------------------|
//! | [`served`]     | a server on real sockets with a small application                                   |
//! | [`serial`]     | a server of serial framing, over TCP or a serial line                               |
//! | `pty`          | the same over a pair of pseudo-terminals, with noise                                |
//! | `cable`        | a serial cable between two pseudo-terminals, with the speed and faults of a real one |
//! | `line_server`  | the server of `bcap-std` on a serial line                                           |
//! | [`real_time`]  | tests in real time that a busy machine may starve                                    |
//! | [`simulated`]  | a virtual RC8 on real sockets                                                       |
//! | [`slowed`]     | a virtual controller with a slow clock                                              |
//! | [`stepped`]    | a virtual controller whose clock advances only when clients call or wait            |
//! | [`drivers`]    | the call sequences of public drivers, from `tests/drivers`                          |
//! | [`hooked`]     | a handler whose answers to some calls are replaced, delayed or recorded             |
//! | [`proxy`]      | a proxy between a client and a server on real sockets that injects faults            |
//! | [`background`] | asynchronous code in a thread                                                       |
//! | `mosquitto`    | a broker for MQTT that does not outlive the tests                                   |
//! | [`tools`]      | tools that tests need, and may be missing                                           |
//! | [`pymodbus`]   | a client of Modbus of another make                                                  |
//! | [`python`]     | packages of PyPI that tests run                                                     |
//! | [`process`]    | signals to a process; its memory, processor time and file descriptors               |
//! | [`allocation`] | an allocator that counts the allocations of each thread                             |
//! | `endings`      | random trials of how programs end while they move a robot                           |
//! | [`async_functions`] | the async functions of a crate, read from its sources                          |

pub mod allocation;
pub mod background;
#[cfg(unix)]
pub mod cable;
pub mod drivers;
#[cfg(unix)]
pub mod endings;
pub mod hooked;
#[cfg(unix)]
pub mod line_server;
pub mod mosquitto;
pub mod process;
pub mod proxy;
#[cfg(unix)]
pub mod pty;
pub mod real_time;
pub mod serial;
pub mod served;
pub mod simulated;
pub mod slowed;
pub mod stepped;

pub use bcap_test_support::{async_functions, pymodbus, python, tools};

/// The examples of the README are compiled.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;

/// The programs of the book are compiled; those without a socket run.
#[cfg(doctest)]
mod book {
    #[doc = include_str!("../../docs/start.md")]
    mod start {}
    #[doc = include_str!("../../docs/variables.md")]
    mod variables {}
    #[doc = include_str!("../../docs/move.md")]
    mod motion {}
    #[doc = include_str!("../../docs/serial.md")]
    mod serial {}
    #[doc = include_str!("../../docs/rac.md")]
    mod rac {}
    #[doc = include_str!("../../docs/firmware.md")]
    mod firmware {}
    #[doc = include_str!("../../docs/test-your-driver.md")]
    mod test_your_driver {}
    #[doc = include_str!("../../docs/porting.md")]
    mod porting {}
}
