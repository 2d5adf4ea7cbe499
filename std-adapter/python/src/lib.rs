//! The native part of the Python package `bcap`: the objects of `bcap_std` as calls that Python runs or awaits.
//!
//! ```text
//!  bcap          methods that block ──► Call.wait  ──► a future of `bcap_std::asynch` ─► its task, on the calling thread
//!  bcap.aio      coroutines ──────────► Call.start ──► a future of `bcap_std::asynch` ─► its task, on a thread of tokio
//!                event loop ◄────────── Inbox ◄─────── its result
//!  bcap.compat   BCAPClient ──────────► Client.call ─► `bcap_std::blocking`, on the calling thread
//! ```
//!
//! No logic of the protocol or of a motion is here. A [`Call`](call::Call) releases the GIL while it waits, and a signal drops its
//! future: that is how a motion is halted. Sockets and threads do not survive a fork, so the objects of the parent are refused there.

mod arm;
mod call;
mod client;
mod controller;
mod error;
mod runtime;
mod sim;
mod slave;
mod value;

use pyo3::prelude::*;

/// The native part of `bcap`.
#[pymodule]
mod _bcap {
    #[pymodule_export]
    use crate::arm::Arm;
    #[pymodule_export]
    use crate::call::{Call, Inbox, Started};
    #[pymodule_export]
    use crate::client::Client;
    #[pymodule_export]
    use crate::controller::{Controller, Stopper, Watch, connect};
    #[pymodule_export]
    use crate::runtime::end;
    #[pymodule_export]
    use crate::sim::Sim;
    #[pymodule_export]
    use crate::slave::Stream;
}
