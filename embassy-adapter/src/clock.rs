//! embassy's time as the core's [`Clock`].

use bcap_core::time::{Clock, Instant};

/// embassy's clock and timer.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EmbassyClock;

impl Clock for EmbassyClock {
    fn now(&self) -> Instant {
        now()
    }
}

#[cfg(feature = "serial")]
impl bcap_core::io::asynch::Timer for EmbassyClock {
    async fn sleep_until(&mut self, at: Instant) {
        embassy_time::Timer::at(ticks(at)).await;
    }
}

/// Returns the current time.
#[must_use]
pub fn now() -> Instant {
    Instant::from_micros(embassy_time::Instant::now().as_micros())
}

/// Converts an instant to embassy's type, rounding up so that a timer never fires before the instant.
#[must_use]
pub(crate) fn ticks(at: Instant) -> embassy_time::Instant {
    match embassy_time::Instant::try_from_micros(at.as_micros()) {
        Some(tick) if tick.as_micros() >= at.as_micros() => tick,
        Some(tick) => tick.saturating_add(embassy_time::Duration::from_ticks(1)),
        None => embassy_time::Instant::MAX,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_rounds_up() {
        for micros in [0, 1, 999, 1_000_001] {
            assert!(ticks(Instant::from_micros(micros)).as_micros() >= micros);
        }
        assert!(ticks(Instant::FAR_FUTURE) > embassy_time::Instant::from_secs(1 << 40));
        assert_eq!(ticks(Instant::from_micros(250)), embassy_time::Instant::from_micros(250));
    }
}
