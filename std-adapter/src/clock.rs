//! The monotonic clock of this process. It starts at zero on first use.

use std::sync::OnceLock;
use std::time::Duration;

use bcap_core::time::Instant;

fn origin() -> std::time::Instant {
    static ORIGIN: OnceLock<std::time::Instant> = OnceLock::new();
    *ORIGIN.get_or_init(std::time::Instant::now)
}

/// Returns the present time on the clock that all clients and servers of this crate share.
#[must_use]
pub fn now() -> Instant {
    Instant::ZERO.saturating_add(origin().elapsed())
}

/// Returns the duration until `at`; zero if `at` has passed. It does not read the clock for [`Instant::ZERO`].
pub(crate) fn until(at: Instant) -> Duration {
    if at == Instant::ZERO { Duration::ZERO } else { at.saturating_since(now()) }
}
