//! Histograms of times with three significant digits, for reports.
//!
//! The core's histogram has few buckets, so p50, p99 and the maximum of a narrow distribution are equal there. A host has
//! the memory for an HDR histogram, which allocates once and never while it records.

use hdrhistogram::Histogram;

/// Times in microseconds, from 1 us to 10 s; longer ones count as 10 s, except in [`max`](Self::max).
#[derive(Clone, Debug)]
pub struct Times {
    histogram: Histogram<u32>,
    max: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self::new()
    }
}

impl Times {
    /// No times.
    #[must_use]
    pub fn new() -> Self {
        const LONGEST: u64 = 10_000_000;
        const DIGITS: u8 = 3;
        let histogram = Histogram::new_with_bounds(1, LONGEST, DIGITS).expect("the bounds are valid");
        Self { histogram, max: 0 }
    }

    /// Adds a time.
    pub fn record(&mut self, micros: u64) {
        self.record_n(micros, 1);
    }

    fn record_n(&mut self, micros: u64, count: u32) {
        self.histogram.saturating_record_n(micros, count);
        self.max = self.max.max(micros);
    }

    /// Follows the core's histogram `counted`: records its last time once for each count since the last call.
    pub fn follow<const SUB: usize, const N: usize>(&mut self, counted: &bcap_core::histogram::Histogram<SUB, N>) {
        let new = u64::from(counted.count()).saturating_sub(self.histogram.len());
        if let Ok(new @ 1..) = u32::try_from(new) {
            self.record_n(counted.last().into(), new);
        }
    }

    /// Returns a quantile: the time that this share of all times does not exceed. 0.5 is the median.
    #[must_use]
    pub fn quantile(&self, share: f64) -> u64 {
        self.histogram.value_at_quantile(share).min(self.max)
    }

    /// Returns the longest time.
    #[must_use]
    pub const fn max(&self) -> u64 {
        self.max
    }

    /// Returns how many times are in `from..=to`.
    #[must_use]
    pub fn count_between(&self, from: u64, to: u64) -> u64 {
        self.histogram.count_between(from, to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_narrow_distribution_differ() {
        let mut times = Times::new();
        let mut counted = bcap_core::slave::Histogram::new();
        for micros in (0..1000).map(|n| 140 + n / 200 + 2 * (n / 990)) {
            counted.record(micros);
            times.follow(&counted);
        }
        assert_eq!([counted.quantile(500), counted.quantile(990), counted.max()], [143, 146, 146]);
        assert_eq!([times.quantile(0.5), times.quantile(0.99), times.max()], [142, 144, 146]);
    }

    #[test]
    fn a_time_above_the_bounds_is_exact_in_the_maximum() {
        let mut times = Times::new();
        assert_eq!((times.quantile(0.5), times.max()), (0, 0));
        times.record(0);
        times.record(20_000_000);
        assert_eq!((times.quantile(0.5), times.max()), (0, 20_000_000));
        assert_eq!(times.quantile(1.0), 10_002_431);
    }
}
