//! The state of a running fleet, for a screen.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::scan::Shared;

/// Reads the status of a running fleet, from [`Fleet::monitor`](crate::Fleet::monitor).
#[derive(Clone)]
pub struct Monitor {
    pub(crate) shared: Arc<Shared>,
}

/// The status of a fleet. Counts begin with the process.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Status {
    /// The host of the broker.
    pub broker: String,
    /// Whether there is a connection to the broker.
    pub broker_up: bool,
    /// The connections to the broker.
    pub broker_connections: u64,
    /// The readings that the broker has.
    pub published: u64,
    /// The readings that were lost.
    pub dropped: u64,
    /// The readings that wait in memory.
    pub queued: u64,
    /// The readings on disk.
    pub stored: u64,
    /// The bytes of the readings on disk.
    pub stored_bytes: u64,
    /// The commands from the broker.
    pub commands: u64,
    /// The commands that were refused.
    pub refused: u64,
    /// The controllers, in the order of the configuration.
    pub controllers: Vec<ControllerStatus>,
}

/// The status of a controller.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ControllerStatus {
    /// Its name.
    pub name: String,
    /// Whether there is a session.
    pub up: bool,
    /// The time of the last scan: the reads of all variables whose deadline had passed.
    pub scan: Duration,
    /// The values that were read.
    pub readings: u64,
    /// The values that could not be read.
    pub errors: u64,
    /// The values that were not read, because that may have ended a stream of Slave Mode.
    pub skipped: u64,
    /// The readings that were left out because the controller is too slow.
    pub overruns: u64,
}

impl Monitor {
    /// Reads the status.
    #[must_use]
    pub fn status(&self) -> Status {
        let Shared { config, metrics, queue, .. } = &*self.shared;
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let controllers = config.controllers.iter().zip(&metrics.cells).map(|(cell, metrics)| ControllerStatus {
            name: cell.name.clone(),
            up: metrics.up.load(Ordering::Relaxed),
            scan: Duration::from_micros(get(&metrics.scan_us)),
            readings: get(&metrics.readings),
            errors: get(&metrics.errors),
            skipped: get(&metrics.skipped),
            overruns: get(&metrics.overruns),
        });
        Status {
            broker: config.broker.host.clone(),
            broker_up: metrics.broker_up.load(Ordering::Relaxed),
            broker_connections: get(&metrics.broker_connections),
            published: get(&metrics.published),
            dropped: get(&metrics.dropped),
            queued: queue.len() as u64,
            stored: get(&metrics.stored),
            stored_bytes: get(&metrics.stored_bytes),
            commands: get(&metrics.commands),
            refused: get(&metrics.refused),
            controllers: controllers.collect(),
        }
    }
}

impl std::fmt::Debug for Monitor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Monitor").field(&self.status()).finish()
    }
}
