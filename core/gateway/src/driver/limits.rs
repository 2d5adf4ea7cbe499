//! Resource limits for PLC connections.

use core::time::Duration;

/// Resource limits for PLC connections; the number of slots is the [`capacity`](crate::Gateway::capacity) of the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Limits {
    /// Connections of one host at the same time.
    pub connections_per_address: usize,
    /// How long a client must be idle before another client may get its slot; `None` means forever.
    pub evict_after: Option<Duration>,
    /// How long a request may take from its first byte to its last.
    pub receive: Duration,
    /// How long a client may accept no bytes of an answer.
    pub send: Duration,
    /// How long a client may be idle before its connection is closed; `None` means forever.
    pub idle: Option<Duration>,
}

impl Default for Limits {
    /// 16 connections of a host, 10 s until another client may take a slot, 30 s for a request, 10 s for an answer, no
    /// limit to idle connections.
    fn default() -> Self {
        Self {
            connections_per_address: 16,
            evict_after: Some(Duration::from_secs(10)),
            receive: Duration::from_secs(30),
            send: Duration::from_secs(10),
            idle: None,
        }
    }
}
