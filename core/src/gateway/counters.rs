//! What a gateway has done so far: numbers for a status line.

use core::time::Duration;

use crate::num::to_usize;

/// Counts since the gateway was made; they wrap at 2^32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Requests that the robot carried out.
    pub served: Tally,
    /// Requests that the robot refused, or did not answer, or that came while it was away.
    pub failed: Tally,
    /// Lines that the gateway refused by itself; they are answered in the step that sees them, in no time.
    pub refused: u32,
    /// Sessions with the robot that have begun.
    pub connected: u32,
}

/// Requests of one outcome, and how long they took from the end of the line to the answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tally {
    count: u32,
    total_micros: u64,
    max_micros: u32,
    /// How many took below 64 us, below 128 us, ..., below 1 s, and longer.
    histogram: [u32; STEPS],
}

/// 2^6 us is the first bound of the histogram, 2^20 us the last; what is longer has none.
const STEPS: usize = 16;
const FIRST: u32 = 6;
const LAST: u32 = 21;

impl Tally {
    pub(super) fn add(&mut self, time: Duration) {
        // not `as_micros`: 128 bits are a lot for a small processor
        let micros = time.as_secs().saturating_mul(1_000_000).saturating_add(time.subsec_micros().into());
        let micros = u32::try_from(micros).unwrap_or(u32::MAX);
        self.count = self.count.wrapping_add(1);
        self.total_micros = self.total_micros.wrapping_add(micros.into());
        self.max_micros = self.max_micros.max(micros);
        let bits = u32::BITS.saturating_sub(micros.leading_zeros());
        let step = to_usize(bits.saturating_sub(FIRST)).min(STEPS.saturating_sub(1));
        if let Some(count) = self.histogram.get_mut(step) {
            *count = count.wrapping_add(1);
        }
    }

    /// Returns how many there were.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Returns how long they took on average; zero when there were none.
    #[must_use]
    pub fn mean(&self) -> Duration {
        Duration::from_micros(self.total_micros.checked_div(self.count.into()).unwrap_or(0))
    }

    /// Returns how long the longest took.
    #[must_use]
    pub const fn max(&self) -> Duration {
        Duration::from_micros(widen(self.max_micros))
    }

    /// Returns a time that so many percent of them did not exceed, to a power of two: at most twice the true one.
    #[must_use]
    pub fn percentile(&self, percent: u8) -> Duration {
        let rank = u64::from(self.count).wrapping_mul(percent.min(100).into()).div_ceil(100);
        let mut seen = 0_u64;
        for (step, count) in (FIRST..LAST).zip(self.histogram) {
            seen = seen.wrapping_add(count.into());
            if seen >= rank {
                let bound = Duration::from_micros(1_u64.checked_shl(step).unwrap_or(u64::MAX));
                return bound.min(self.max());
            }
        }
        self.max()
    }
}

#[expect(clippy::as_conversions, reason = "From is not const; u32 to u64 is lossless")]
const fn widen(value: u32) -> u64 {
    value as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_summed_up() {
        let mut tally = Tally::default();
        assert_eq!((tally.mean(), tally.max(), tally.percentile(50)), Default::default());
        for micros in (1..=98).map(|_| 100).chain([5_000, 3_000_000]) {
            tally.add(Duration::from_micros(micros));
        }
        assert_eq!(tally.count(), 100);
        assert_eq!(tally.mean(), Duration::from_micros((98 * 100 + 5_000 + 3_000_000) / 100));
        assert_eq!(tally.max(), Duration::from_secs(3));
        assert_eq!(tally.percentile(50), Duration::from_micros(128));
        assert_eq!(tally.percentile(98), Duration::from_micros(128));
        assert_eq!(tally.percentile(99), Duration::from_micros(8192));
        assert_eq!(tally.percentile(100), Duration::from_secs(3), "what is longer than the last bound is the longest");
    }

    #[test]
    fn a_bound_belongs_to_the_step_above() {
        let mut tally = Tally::default();
        tally.add(Duration::from_micros(63));
        assert_eq!(tally.percentile(100), Duration::from_micros(63));
        tally.add(Duration::from_micros(64));
        assert_eq!(tally.histogram[..3], [1, 1, 0]);
        tally.add(Duration::from_secs(5000));
        assert_eq!(tally.max(), Duration::from_micros(u32::MAX.into()), "over an hour and a quarter is not told apart");
    }
}
