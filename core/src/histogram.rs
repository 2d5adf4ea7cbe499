//! Histograms of times with a fixed number of buckets.
//!
//! ```text
//!  bucket       0   1   ...  SUB-1 │ SUB ... 2 SUB-1 │ 2 SUB ... 3 SUB-1  │ ...
//!  times, us    0   1   ...  SUB-1 │ SUB ... 2 SUB-1 │ 2 SUB ... 4 SUB-1  │ ...
//!                    one each      │    one each     │     two each       │ twice as many each time
//! ```
//!
//! A quantile is the upper bound of its bucket, so it is at most `1 / SUB` above the true one. A narrow distribution fills
//! only a few buckets; a host with enough memory can read [`last`](Histogram::last) after each time and keep all digits.

use crate::num::{to_u32, to_usize};

/// A histogram of times with `SUB` buckets for each power of two, and `N` buckets in total; `SUB` is a power of two.
///
/// The last bucket also counts times above it; the maximum is exact. The count saturates. When a bucket is full, all buckets
/// are halved, so quantiles follow later times.
///
/// # Examples
///
/// ```
/// use bcap_core::histogram::Histogram;
///
/// let mut times = Histogram::<8, 152>::new();
/// (1..=1000).for_each(|us| times.record(us));
/// assert_eq!((times.count(), times.max()), (1000, 1000));
/// assert!((500..=575).contains(&times.quantile(500)));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Histogram<const SUB: usize, const N: usize> {
    buckets: [u32; N],
    count: u32,
    max: u32,
    last: u32,
}

impl<const SUB: usize, const N: usize> Histogram<SUB, N> {
    const LOG: u32 = {
        assert!(SUB.is_power_of_two() && N > SUB, "SUB is a power of two, and N above it");
        SUB.trailing_zeros()
    };

    /// Creates an empty histogram.
    #[must_use]
    pub const fn new() -> Self {
        Self { buckets: [0; N], count: 0, max: 0, last: 0 }
    }

    /// Counts a time, in microseconds.
    pub fn record(&mut self, micros: u32) {
        let index = Self::bucket(micros).min(N.saturating_sub(1));
        if self.buckets.get(index) == Some(&u32::MAX) {
            self.buckets.iter_mut().for_each(|bucket| *bucket = bucket.wrapping_shr(1));
        }
        if let Some(bucket) = self.buckets.get_mut(index) {
            *bucket = bucket.saturating_add(1);
        }
        self.count = self.count.saturating_add(1);
        self.max = self.max.max(micros);
        self.last = micros;
    }

    /// Returns the number of recorded times.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Returns the maximum in microseconds; 0 for an empty histogram.
    #[must_use]
    pub const fn max(&self) -> u32 {
        self.max
    }

    /// Returns the last recorded time in microseconds; 0 for an empty histogram.
    #[must_use]
    pub const fn last(&self) -> u32 {
        self.last
    }

    /// Returns a quantile in microseconds, in per mille: 500 is the median, 999 the 99.9th percentile.
    #[must_use]
    pub fn quantile(&self, permille: u32) -> u32 {
        // not `count`, which does not decrease when the buckets are halved
        let counted: u64 = self.buckets.iter().copied().map(u64::from).fold(0, u64::wrapping_add);
        let needed = counted.wrapping_mul(u64::from(permille.min(1000))).div_ceil(1000);
        let mut seen = 0_u64;
        for (upper, count) in self.iter() {
            seen = seen.wrapping_add(u64::from(count));
            if seen >= needed {
                return upper.min(self.max);
            }
        }
        self.max
    }

    /// Iterates over the buckets that are not empty: the upper bound of the bucket in microseconds, and its count.
    pub fn iter(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let used = self.buckets.iter().enumerate().filter(|(_, count)| **count > 0);
        used.map(|(index, count)| {
            let upper = Self::upper(index);
            (if index.wrapping_add(1) == N { upper.max(self.max) } else { upper }, *count)
        })
    }

    /// Returns the bucket of a time: the position of its first bit, and the `LOG` bits after that.
    fn bucket(micros: u32) -> usize {
        let micros = to_usize(micros);
        match micros.checked_ilog2().and_then(|log| log.checked_sub(Self::LOG)) {
            Some(shift) => {
                let sub = micros.wrapping_shr(shift) & SUB.wrapping_sub(1);
                to_usize(shift.wrapping_add(1)).wrapping_shl(Self::LOG).wrapping_add(sub)
            }
            None => micros,
        }
    }

    /// Returns the upper bound of a bucket.
    fn upper(index: usize) -> u32 {
        let power = to_u32(index.wrapping_shr(Self::LOG));
        let sub = to_u32(index & SUB.wrapping_sub(1));
        match power.checked_sub(1) {
            Some(shift) => sub.wrapping_add(to_u32(SUB)).wrapping_add(1).wrapping_shl(shift).wrapping_sub(1),
            None => sub,
        }
    }
}

impl<const SUB: usize, const N: usize> Default for Histogram<SUB, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(feature = "defmt")]
impl<const SUB: usize, const N: usize> defmt::Format for Histogram<SUB, N> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{} times, median {} us, max {} us", self.count, self.quantile(500), self.max);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]

    use super::*;

    fn bounds<const SUB: usize, const N: usize>() {
        let mut last = 0;
        for micros in (0..5000).chain([1 << 20, u32::MAX]) {
            let bucket = Histogram::<SUB, N>::bucket(micros);
            let upper = Histogram::<SUB, N>::upper(bucket);
            assert!(bucket >= last && upper >= micros, "{micros} us are in {bucket}, up to {upper}");
            assert!(
                u64::from(upper - micros) * u64::try_from(SUB).unwrap() <= u64::from(micros),
                "{micros} us are up to {upper}"
            );
            assert!(bucket == 0 || Histogram::<SUB, N>::upper(bucket - 1) < micros);
            last = bucket;
        }
    }

    #[test]
    fn every_time_is_in_the_bucket_with_the_next_upper_bound() {
        bounds::<1, 22>();
        bounds::<2, 44>();
        bounds::<8, 152>();
    }

    #[test]
    fn quantiles_follow_later_times_after_two_to_the_32() {
        let mut times = Histogram::<1, 22>::new();
        let old = Histogram::<1, 22>::bucket(64);
        times.buckets[old] = u32::MAX;
        times.count = u32::MAX;
        times.record(64);
        assert_eq!((times.buckets[old], times.count()), (1 << 31, u32::MAX));
        // as many again, and some more, at 900 us
        let new = Histogram::<1, 22>::bucket(900);
        times.buckets[new] = u32::MAX - 1;
        times.record(900);
        times.record(900);
        times.max = 2000;
        assert_eq!(times.buckets[new], 1 << 31);
        assert_eq!(times.quantile(500), 1023);
    }

    #[test]
    fn the_last_bucket_counts_times_above_it_and_the_maximum_is_exact() {
        let mut times = Histogram::<1, 4>::new();
        times.record(3);
        times.record(3_000_000);
        times.record(u32::MAX);
        assert_eq!((times.count(), times.max(), times.last()), (3, u32::MAX, u32::MAX));
        assert_eq!(times.iter().collect::<heapless::Vec<_, 4>>(), [(3, 1), (u32::MAX, 2)]);
    }
}
