//! Histograms of times with three significant digits, for reports.
//!
//! The histograms of a stream have few buckets, so p50, p99 and the maximum of a narrow distribution are equal there. A host has
//! the memory for 1,024 buckets for each power of two.

/// The maximum time that has a bucket, in microseconds.
const LONGEST: u32 = 10_000_000;

/// The buckets: 1,024 for each power of two up to [`LONGEST`].
type Histogram = bcap_core::histogram::Histogram<1024, { 15 * 1024 }>;

/// Times in microseconds, up to 10 s; longer ones count as 10 s, except in [`max`](Self::max).
#[derive(Clone, Debug, Default)]
pub struct Times {
    histogram: Box<Histogram>,
    max: u64,
}

impl Times {
    /// No times.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a time.
    pub fn record(&mut self, micros: u64) {
        self.histogram.record(u32::try_from(micros).unwrap_or(u32::MAX).min(LONGEST));
        self.max = self.max.max(micros);
    }

    /// Follows the core's histogram `counted`: records its last time once for each count since the last call.
    pub fn follow<const SUB: usize, const N: usize>(&mut self, counted: &bcap_core::histogram::Histogram<SUB, N>) {
        let new = counted.count().saturating_sub(self.histogram.count());
        (0..new).for_each(|_| self.record(counted.last().into()));
    }

    /// Returns a quantile in per mille: the time that this share of all times does not exceed. 500 is the median.
    #[must_use]
    pub fn quantile(&self, permille: u32) -> u64 {
        self.histogram.quantile(permille).into()
    }

    /// Returns the longest time.
    #[must_use]
    pub const fn max(&self) -> u64 {
        self.max
    }

    /// Returns the number of times in `from..=to`, where `from` and `to + 1` are powers of two.
    #[must_use]
    pub fn count_between(&self, from: u64, to: u64) -> u64 {
        let within = self.histogram.iter().filter(|(upper, _)| (from..=to).contains(&u64::from(*upper)));
        within.map(|(_, count)| u64::from(count)).sum()
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
        assert_eq!([times.quantile(500), times.quantile(990), times.max()], [142, 144, 146]);
    }

    #[test]
    fn a_time_above_the_bounds_is_exact_in_the_maximum() {
        let mut times = Times::new();
        assert_eq!((times.quantile(500), times.max()), (0, 0));
        times.record(0);
        times.record(20_000_000);
        assert_eq!((times.quantile(500), times.max()), (0, 20_000_000));
        assert_eq!(times.quantile(1000), 10_000_000);
    }
}
