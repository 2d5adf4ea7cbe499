//! The counters of a gateway, for a status line.

use core::time::Duration;

use bcap_core::histogram::Histogram;
use bcap_core::time::micros_u32;

/// Counts since the gateway was made; they saturate at 2^32 - 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Counters {
    /// Requests that the robot executed.
    pub served: Tally,
    /// Requests that the robot refused or did not reply to, or that arrived while it was disconnected.
    pub failed: Tally,
    /// Lines that the gateway refused. They get their reply immediately, so their times are not counted.
    pub refused: u32,
    /// Sessions with the robot.
    pub connected: u32,
}

/// Requests of one outcome, and their times from the end of the line to the reply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tally {
    total_micros: u64,
    /// Up to two seconds.
    times: Histogram<1, 22>,
}

impl Tally {
    pub(super) fn add(&mut self, time: Duration) {
        let micros = micros_u32(time);
        self.total_micros = self.total_micros.saturating_add(micros.into());
        self.times.record(micros);
    }

    /// Returns the number of requests.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.times.count()
    }

    /// Returns the mean time; zero without requests.
    #[must_use]
    pub fn mean(&self) -> Duration {
        Duration::from_micros(self.total_micros.checked_div(self.count().into()).unwrap_or(0))
    }

    /// Returns the longest time, at most 71 minutes; zero without requests.
    #[must_use]
    pub fn max(&self) -> Duration {
        Duration::from_micros(self.times.max().into())
    }

    /// Returns a percentile of the times; it is at most twice the exact one.
    #[must_use]
    pub fn percentile(&self, percent: u8) -> Duration {
        Duration::from_micros(self.times.quantile(u32::from(percent).saturating_mul(10)).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_a_mean_a_maximum_and_percentiles() {
        let mut tally = Tally::default();
        assert_eq!((tally.mean(), tally.max(), tally.percentile(50)), Default::default());
        for micros in (1..=98).map(|_| 100).chain([5_000, 3_000_000]) {
            tally.add(Duration::from_micros(micros));
        }
        assert_eq!(tally.count(), 100);
        assert_eq!(tally.mean(), Duration::from_micros((98 * 100 + 5_000 + 3_000_000) / 100));
        assert_eq!(tally.max(), Duration::from_secs(3));
        assert_eq!(tally.percentile(50), Duration::from_micros(127));
        assert_eq!(tally.percentile(98), Duration::from_micros(127));
        assert_eq!(tally.percentile(99), Duration::from_micros(8191));
        assert_eq!(tally.percentile(100), Duration::from_secs(3), "a time above the last bound is the maximum");
    }

    #[test]
    fn a_time_above_71_minutes_is_clamped() {
        let mut tally = Tally::default();
        tally.add(Duration::from_secs(5000));
        assert_eq!(tally.max(), Duration::from_micros(u32::MAX.into()));
    }
}
