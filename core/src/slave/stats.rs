//! Figures on how well a stream ran, in fixed counters.

use core::time::Duration;

/// Values below this are counted exactly; above, each power of two has this many buckets.
const SUB: usize = 8;
/// Powers of two above the exact values: up to 8 * 2^18 us, two seconds.
const POWERS: usize = 18;
const BUCKETS: usize = SUB * (POWERS + 1);

/// A histogram of times in microseconds; a quantile is right within an eighth, the greatest value exactly.
///
/// # Examples
///
/// ```
/// use bcap_core::slave::Histogram;
///
/// let mut rtt = Histogram::new();
/// (1..=1000).for_each(|us| rtt.record(us));
/// assert_eq!((rtt.count(), rtt.max()), (1000, 1000));
/// assert!((500..=575).contains(&rtt.quantile(500)));
/// ```
#[derive(Clone, Debug)]
pub struct Histogram {
    buckets: [u32; BUCKETS],
    count: u32,
    max: u32,
}

impl Histogram {
    /// Makes an empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self { buckets: [0; BUCKETS], count: 0, max: 0 }
    }

    /// Counts a time; what is over two seconds goes into the last bucket.
    pub fn record(&mut self, micros: u32) {
        if let Some(bucket) = self.buckets.get_mut(bucket(micros).min(BUCKETS - 1)) {
            *bucket = bucket.saturating_add(1);
        }
        self.count = self.count.saturating_add(1);
        self.max = self.max.max(micros);
    }

    /// Returns how many times were counted.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Returns the greatest time, 0 when there is none.
    #[must_use]
    pub const fn max(&self) -> u32 {
        self.max
    }

    /// Returns the time that `permille` of a thousand do not exceed: 500 is the median, 999 the 99.9th percentile.
    #[must_use]
    pub fn quantile(&self, permille: u32) -> u32 {
        let needed = u64::from(self.count).wrapping_mul(u64::from(permille.min(1000))).div_ceil(1000);
        let mut seen = 0_u64;
        for (upper, count) in self.iter() {
            seen = seen.wrapping_add(u64::from(count));
            if seen >= needed {
                return upper.min(self.max);
            }
        }
        self.max
    }

    /// Iterates over the buckets that are not empty: the greatest time of the bucket, and how many are in it.
    pub fn iter(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.buckets.iter().enumerate().filter(|(_, count)| **count > 0).map(|(index, count)| (upper(index), *count))
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Histogram {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{} times, median {} us, max {} us", self.count, self.quantile(500), self.max);
    }
}

/// Returns the bucket of a time: the position of its first bit, and the three bits behind that.
fn bucket(micros: u32) -> usize {
    let micros = crate::num::to_usize(micros);
    match micros.checked_ilog2() {
        Some(log @ 3..) => {
            let shift = log.wrapping_sub(3);
            let sub = micros.wrapping_shr(shift) & (SUB - 1);
            crate::num::to_usize(shift.wrapping_add(1)).wrapping_mul(SUB).wrapping_add(sub)
        }
        _ => micros,
    }
}

/// Returns the greatest time of a bucket.
fn upper(index: usize) -> u32 {
    let (power, sub) = (crate::num::to_u32(index / SUB), crate::num::to_u32(index % SUB));
    match power.checked_sub(1) {
        Some(shift) => sub.wrapping_add(9).wrapping_shl(shift).wrapping_sub(1),
        None => sub,
    }
}

/// What a stream has counted since it began.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stats {
    /// Poses that the controller has taken.
    pub cycles: u32,
    /// Poses that were sent later after their time than [`Config::late_after`](super::Config::late_after).
    pub late: u32,
    /// Answers E_BUF_FULL; the pose was sent again.
    pub refused: u32,
    /// Errors 0x84201482: the buffer was empty while the robot moved.
    pub underflows: u32,
    /// The least that was left in the controller's buffer when a pose was sent, by this side's reckoning; `None` before
    /// it was full once, and in mode 1.
    pub least_margin: Option<Duration>,
    /// From sending a pose to its answer.
    pub rtt: Histogram,
    /// How far from its time a pose was sent; in mode 2, by how much the cycle missed its length.
    pub jitter: Histogram,
}

/// Returns a time in microseconds, at most an hour and a bit.
pub(super) fn micros(duration: Duration) -> u32 {
    // not `as_micros`, which a 32-bit target computes in 128 bits
    let micros = duration.as_secs().saturating_mul(1_000_000).saturating_add(u64::from(duration.subsec_micros()));
    u32::try_from(micros).unwrap_or(u32::MAX)
}
