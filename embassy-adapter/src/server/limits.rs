//! The time limits of a peer's session.

use core::time::Duration;

use bcap_core::peers::TimeLimits;

/// The time limits of a peer's session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Limits {
    /// How long a request may take from its first byte to its last.
    pub receive: Duration,
    /// How long a peer may take to accept a reply.
    pub send: Duration,
    /// How long a connection may be idle before it is closed; `None` means forever.
    pub idle: Option<Duration>,
    /// How long a UDP peer with a service must be idle before another peer may take its slot. Without one, before Service_Start
    /// and after Service_Stop, its slot may be taken immediately.
    pub udp_idle: Duration,
}

impl Default for Limits {
    /// 30 s for a request, 10 s for a reply, no idle limit on a connection, 10 s before another client may take the
    /// slot of a UDP peer.
    fn default() -> Self {
        Self {
            receive: Duration::from_secs(30),
            send: Duration::from_secs(10),
            idle: None,
            udp_idle: Duration::from_secs(10),
        }
    }
}

impl Limits {
    /// Returns the time limits of a connection.
    pub(super) const fn times(&self) -> TimeLimits {
        TimeLimits { receive: self.receive, idle: self.idle }
    }
}
