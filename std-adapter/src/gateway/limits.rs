//! Resource limits for PLC connections.

use std::time::Duration;

use bcap_gateway::driver;

/// Resource limits for PLC connections; the number of slots is its [`capacity`](bcap_gateway::Gateway::capacity).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Connections of one IP address at the same time.
    pub connections_per_address: usize,
    /// The silence after which a connection without a running request may be closed when another connection needs its
    /// slot. The connection that has been idle longest is closed first.
    pub evict_after: Duration,
    /// How long a line may take to arrive once its first byte has.
    pub receive: Duration,
    /// How long a PLC may accept no bytes of an answer.
    pub send: Duration,
    /// The silence after which a connection without a running request is closed; `None` is without a limit.
    pub idle: Option<Duration>,
    /// The silence after which the operating system probes the PLC; `None` never does.
    pub keep_alive: Option<Duration>,
}

setters! { Limits {
    connections_per_address: usize;
    evict_after: Duration;
    receive: Duration;
    send: Duration;
    idle: Option<Duration>;
    keep_alive: Option<Duration>;
} }

impl Limits {
    pub(super) const fn of_driver(&self) -> driver::Limits {
        let Self { connections_per_address, evict_after, receive, send, idle, .. } = *self;
        driver::Limits { connections_per_address, evict_after: Some(evict_after), receive, send, idle }
    }
}

impl Default for Limits {
    /// 16 connections of an address, 10 s until an idle one may lose its slot, 30 s for a line, 10 s for an answer, no
    /// limit to silence, probes after 60 s.
    fn default() -> Self {
        Self {
            connections_per_address: 16,
            evict_after: Duration::from_secs(10),
            receive: Duration::from_secs(30),
            send: Duration::from_secs(10),
            idle: None,
            keep_alive: Some(Duration::from_secs(60)),
        }
    }
}
