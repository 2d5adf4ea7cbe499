//! The state that all tasks of a proxy share.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::faults::{FaultPlan, Faults};
use crate::record::{Recorder, Recording};

/// The maximum number of clients over UDP, and of connections of each TCP port: each needs a socket to the robot and memory.
pub(super) const CLIENTS: usize = 256;

/// The time during which a client that waits for a reply keeps its slot: its disconnection would stop a motion.
pub(super) const CALL: Duration = Duration::from_secs(600);

/// The state that all tasks share.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) recorder: Recorder,
    pub(super) connect_timeout: Duration,
    plan: Arc<FaultPlan>,
    seed: u64,
    /// The number of connections until now.
    count: Arc<AtomicU64>,
    /// Whether the server of a recorded connection is the address that the client used, instead of the robot's.
    pub(super) shows_listener: bool,
}

impl Shared {
    /// The state of a proxy.
    pub(super) fn new(
        recording: &Recording,
        connect_timeout: Duration,
        faults: FaultPlan,
        seed: u64,
        shows_listener: bool,
    ) -> Self {
        Self {
            recorder: recording.recorder().clone(),
            connect_timeout,
            plan: Arc::new(faults),
            seed,
            count: Arc::default(),
            shows_listener,
        }
    }

    /// Returns the faults of a new connection; `None` if every frame passes unchanged.
    pub(super) fn faults(&self, is_rac: bool) -> Option<Faults> {
        let number = self.count.fetch_add(1, Ordering::Relaxed);
        (!self.plan.is_empty()).then(|| Faults::new((*self.plan).clone(), self.seed.wrapping_add(number), is_rac))
    }
}
