//! The time of this process: a monotonic clock that starts with its first use.

use std::sync::OnceLock;
use std::time::Duration;

use bcap_core::time::Instant;

fn origin() -> std::time::Instant {
    static ORIGIN: OnceLock<std::time::Instant> = OnceLock::new();
    *ORIGIN.get_or_init(std::time::Instant::now)
}

/// Returns the time that all clients and servers of this crate go by.
#[must_use]
pub fn now() -> Instant {
    Instant::ZERO.saturating_add(origin().elapsed())
}

/// Returns how long it is until `at`; zero when it is over.
pub(crate) fn until(at: Instant) -> Duration {
    at.saturating_since(now())
}
