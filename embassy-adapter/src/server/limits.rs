//! The time that a peer may take, and what follows from it.

use core::time::Duration;

use bcap_core::time::Instant;

/// What a peer may cost in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Limits {
    /// How long a request may take to arrive once its first byte has.
    pub receive: Duration,
    /// How long a peer may take to accept a reply.
    pub send: Duration,
    /// How long a peer may be silent before its slot is free for others; `None` is without a limit.
    pub idle: Option<Duration>,
    /// The silence after which a UDP peer may be forgotten when another needs its slot.
    pub udp_idle: Duration,
}

impl Default for Limits {
    /// 30 s for a request, 10 s for a reply, no limit to silence on a connection, 10 s on UDP.
    fn default() -> Self {
        Self {
            receive: Duration::from_secs(30),
            send: Duration::from_secs(10),
            idle: None,
            udp_idle: Duration::from_secs(10),
        }
    }
}

/// When a session must be polled again, or why it must end.
pub(super) enum Due {
    At(Instant),
    Ended(TooLong),
}

/// What took longer than its limit.
pub(super) enum TooLong {
    Request,
    Silence,
}
