//! Proxies between real clients and a real server that inject network faults.
//!
//! ```text
//!   client ── proxy ── server       [`TcpProxy`]: split, merged, stalled, doubled, corrupted, cut, reset, by a script
//!                                   [`UdpProxy`]: lost, doubled, delayed and so reordered, garbled, by chance
//!                                   [`Relay`]: cut, held, by the test
//! ```
//!
//! Each runs in its own thread until it is dropped. A seed determines all random decisions, but not their timing.

mod relay;
mod tcp;
mod udp;

pub use self::relay::{Cut, Relay};
pub use self::tcp::{Script, Step, StreamFault, TcpProxy};
pub use self::udp::{Counts, UdpProxy};
