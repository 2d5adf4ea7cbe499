//! Time in microseconds, from a clock of the caller.
//!
//! The core has no clock. The caller of a client or server passes the current [`Instant`] and gets the next deadline.
//! Only differences matter, so any counter that never goes back works: `std::time::Instant` since the start of
//! the program, embassy's ticks, a timer of the board, the fake clock of a test. A timer of 32 bits goes back to 0 after 71
//! minutes, and a deadline before that would not pass for as long; [`Wrapping32`] makes a clock of it.

use core::cell::Cell;
use core::fmt;
use core::time::Duration;

/// A point in time, in microseconds since an origin that the caller chooses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(u64);

impl Instant {
    /// The origin.
    pub const ZERO: Self = Self(0);
    /// The latest instant, which is never reached.
    pub const FAR_FUTURE: Self = Self(u64::MAX);

    /// Creates the instant `micros` microseconds after the origin.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Creates the instant `millis` milliseconds after the origin, saturating.
    #[must_use]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1000))
    }

    /// Returns the microseconds since the origin.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the time from `earlier` to `self`, or zero if `earlier` is later.
    #[must_use]
    pub const fn saturating_since(self, earlier: Self) -> Duration {
        Duration::from_micros(self.0.saturating_sub(earlier.0))
    }

    /// Returns `self + duration`; a sum that does not fit is [`FAR_FUTURE`](Self::FAR_FUTURE).
    #[must_use]
    pub const fn saturating_add(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(micros(duration)))
    }

    /// Returns `self - duration`; before the origin it is [`ZERO`](Self::ZERO).
    #[must_use]
    pub const fn saturating_sub(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(micros(duration)))
    }
}

/// Returns a duration in microseconds, saturating.
///
/// Unlike [`Duration::as_micros`] it needs no 128-bit arithmetic, which is slow on a small processor.
#[must_use]
#[expect(clippy::as_conversions, reason = "From is not const; u32 to u64 is lossless")]
pub const fn micros(duration: Duration) -> u64 {
    duration.as_secs().saturating_mul(1_000_000).saturating_add(duration.subsec_micros() as u64)
}

/// Returns a duration in microseconds, at most 71 minutes.
#[must_use]
pub fn micros_u32(duration: Duration) -> u32 {
    u32::try_from(micros(duration)).unwrap_or(u32::MAX)
}

impl core::ops::Add<Duration> for Instant {
    type Output = Self;

    fn add(self, duration: Duration) -> Self {
        self.saturating_add(duration)
    }
}

impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} us", self.0)
    }
}

/// A monotonic clock.
///
/// Any function that returns an [`Instant`] is one.
pub trait Clock {
    /// Returns the time.
    fn now(&self) -> Instant;
}

impl<F: Fn() -> Instant> Clock for F {
    fn now(&self) -> Instant {
        self()
    }
}

/// Returns the earlier of two times, either of which may be missing.
#[inline]
#[must_use]
pub fn earliest(one: Option<Instant>, other: Option<Instant>) -> Option<Instant> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}

/// A clock from a timer that counts microseconds in 32 bits and wraps.
///
/// Read it at least once in 71 minutes, the time of a wrap; a waiting call does. If an interrupt or another processor also
/// reads the timer, each needs a separate clock.
///
/// # Examples
///
/// ```
/// use bcap_core::time::{Clock, Wrapping32};
///
/// # fn read_timer() -> u32 { 5 }
/// let clock = Wrapping32::new(read_timer);
/// assert_eq!(clock.now().as_micros(), 5);
/// ```
#[derive(Clone, Debug)]
pub struct Wrapping32<F> {
    read: F,
    /// The time when it was last read.
    last: Cell<u64>,
}

impl<F: Fn() -> u32> Wrapping32<F> {
    /// Creates a clock from a function that reads the timer.
    #[must_use]
    pub const fn new(read: F) -> Self {
        Self { read, last: Cell::new(0) }
    }
}

impl<F: Fn() -> u32> Clock for Wrapping32<F> {
    fn now(&self) -> Instant {
        let last = self.last.get();
        let [.., a, b, c, d] = last.to_be_bytes();
        let passed = (self.read)().wrapping_sub(u32::from_be_bytes([a, b, c, d]));
        let now = last.saturating_add(passed.into());
        self.last.set(now);
        Instant(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_timer_of_32_bits_never_goes_back() {
        let count = Cell::new(0_u32);
        let clock = Wrapping32::new(|| count.get());
        let mut expected = 0;
        // three wraps, with steps of up to a whole one
        for step in [5, u32::MAX - 10, 5, 1, u32::MAX, 0, 7, u32::MAX / 2] {
            count.set(count.get().wrapping_add(step));
            expected += u64::from(step);
            assert_eq!(clock.now().as_micros(), expected, "after a step of {step}");
        }
        assert!(expected > 2 << 32);
    }

    #[test]
    fn a_deadline_passes_across_a_wrap() {
        let count = Cell::new(u32::MAX - 5);
        let clock = Wrapping32::new(|| count.get());
        let deadline = clock.now() + Duration::from_micros(10);
        count.set(3);
        assert!(clock.now() < deadline);
        count.set(4);
        assert_eq!(clock.now(), deadline);
    }

    #[test]
    fn a_missing_time_is_later_than_any_other() {
        let times = [None, Some(Instant::ZERO), Some(Instant::FAR_FUTURE)];
        for (one, other) in times.iter().flat_map(|one| times.iter().map(move |other| (*one, *other))) {
            assert_eq!(earliest(one, other), [one, other].into_iter().flatten().min(), "{one:?} {other:?}");
        }
    }

    #[test]
    fn sums_saturate_and_differences_never_wrap() {
        let a = Instant::from_millis(2);
        assert_eq!((a + Duration::from_micros(5)).as_micros(), 2005);
        assert_eq!(Instant::FAR_FUTURE + Duration::MAX, Instant::FAR_FUTURE);
        assert_eq!(Instant::from_millis(u64::MAX), Instant::FAR_FUTURE);
        assert_eq!(Instant::ZERO.saturating_since(a), Duration::ZERO);
        assert_eq!(a.saturating_since(Instant::ZERO), Duration::from_millis(2));
        assert_eq!(a.saturating_sub(Duration::from_micros(5)).as_micros(), 1995);
        assert_eq!(a.saturating_sub(Duration::MAX), Instant::ZERO);
    }

    #[test]
    fn microseconds_saturate() {
        assert_eq!((micros(Duration::from_nanos(1_999)), micros_u32(Duration::from_nanos(1_999))), (1, 1));
        assert_eq!(micros(Duration::new(7, 5_000)), 7_000_005);
        assert_eq!((micros(Duration::MAX), micros_u32(Duration::from_secs(4295))), (u64::MAX, u32::MAX));
    }
}
