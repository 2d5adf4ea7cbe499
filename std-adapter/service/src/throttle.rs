//! The rate of lines in a log: a token bucket for each source, such as the IP address of a client.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

use bcap_core::time::Instant;

/// The capacity of a bucket, in seconds of its rate.
const BURST: u32 = 10;

/// The time between the first suppressed line and the record of their number.
const REPORT: Duration = Duration::from_secs(10);

/// The number of sources with a separate bucket; other sources share one bucket.
const BUCKETS: usize = 1024;

/// The interval at which full buckets are removed.
const PURGE: Duration = Duration::from_secs(1);

/// Selects the lines to write, and counts the suppressed lines.
#[derive(Debug)]
pub struct Throttle<K> {
    /// Lines a second for each source; 0 writes all.
    rate: u32,
    /// `None` is the shared bucket of the other sources.
    buckets: HashMap<Option<K>, Bucket>,
    /// When counts are to be written; `None` without any.
    report_at: Option<Instant>,
    /// When full buckets may be removed next, because searching for them costs more than writing a line.
    purge_at: Instant,
}

/// The allowance of one source.
#[derive(Debug)]
struct Bucket {
    /// When all tokens are back.
    full_at: Instant,
    suppressed: u64,
}

/// Lines of a source that were not written.
#[derive(Debug, PartialEq, Eq)]
pub struct Suppressed<K> {
    /// `None` for sources that share a bucket.
    pub source: Option<K>,
    /// How many.
    pub lines: u64,
}

impl<K: Copy + Eq + Hash> Throttle<K> {
    /// Allows this number of lines a second for each source; 0 allows all.
    #[must_use]
    pub fn new(rate: u32) -> Self {
        Self { rate, buckets: HashMap::new(), report_at: None, purge_at: Instant::ZERO }
    }

    /// Takes a token of a source. Without a token it counts a suppressed line and returns `false`.
    pub fn admits(&mut self, source: K, now: Instant) -> bool {
        let Some(interval) = Duration::from_secs(1).checked_div(self.rate) else { return true };
        let ahead = interval.saturating_mul(self.rate.saturating_mul(BURST).saturating_sub(1));
        let key = self.key(source, now);
        let bucket = self.buckets.entry(key).or_insert(Bucket { full_at: now, suppressed: 0 });
        if bucket.full_at.saturating_since(now) > ahead {
            bucket.suppressed += 1;
            self.report_at.get_or_insert(now.saturating_add(REPORT));
            return false;
        }
        bucket.full_at = bucket.full_at.max(now).saturating_add(interval);
        true
    }

    /// Returns the key of a source's bucket, and removes full buckets when there are too many.
    fn key(&mut self, source: K, now: Instant) -> Option<K> {
        let key = Some(source);
        if self.buckets.len() < BUCKETS || self.buckets.contains_key(&key) {
            return key;
        }
        if now >= self.purge_at {
            self.buckets.retain(|_, bucket| bucket.suppressed > 0 || bucket.full_at > now);
            self.purge_at = now.saturating_add(PURGE);
        }
        key.filter(|_| self.buckets.len() < BUCKETS)
    }

    /// Returns the counts whose interval has ended.
    pub fn take_expired(&mut self, now: Instant) -> Vec<Suppressed<K>> {
        match self.report_at {
            Some(at) if at <= now => self.take(),
            _ => Vec::new(),
        }
    }

    /// Returns all counts and resets them.
    pub fn take(&mut self) -> Vec<Suppressed<K>> {
        self.report_at = None;
        let counted = self.buckets.iter_mut().filter(|(_, bucket)| bucket.suppressed > 0);
        counted
            .map(|(source, bucket)| Suppressed { source: *source, lines: std::mem::take(&mut bucket.suppressed) })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    fn ip(n: u32) -> IpAddr {
        IpAddr::V4(n.into())
    }

    #[test]
    fn a_flood_is_written_at_the_rate_and_the_rest_is_counted() {
        let mut throttle = Throttle::new(10);
        // a line every millisecond for a minute
        let (mut written, mut counted) = (0, 0);
        for millis in 0..60_000 {
            written += u64::from(throttle.admits(ip(1), at(millis)));
            let counts = throttle.take_expired(at(millis));
            assert!(counts.len() <= 1);
            counted += counts.iter().map(|suppressed| suppressed.lines).sum::<u64>();
        }
        counted += throttle.take().iter().map(|suppressed| suppressed.lines).sum::<u64>();
        assert_eq!((written, counted), (100 + 599, 60_000 - 699));
        assert_eq!(throttle.take(), []);
    }

    #[test]
    fn a_flood_of_one_client_suppresses_no_line_of_another() {
        let mut throttle = Throttle::new(1);
        for _ in 0..1000 {
            throttle.admits(ip(1), at(0));
        }
        assert!(throttle.admits(ip(2), at(0)));
        assert_eq!(throttle.take_expired(at(9_999)), []);
        assert_eq!(throttle.take_expired(at(10_000)), [Suppressed { source: Some(ip(1)), lines: 990 }]);
        assert_eq!(throttle.take_expired(at(20_000)), []);
    }

    #[test]
    fn a_rate_of_0_writes_all() {
        let mut throttle = Throttle::new(0);
        assert!((0..10_000).all(|_| throttle.admits(ip(1), at(0))));
    }

    #[test]
    fn many_addresses_share_a_bucket_when_there_are_too_many() {
        let mut throttle = Throttle::new(1);
        let written = (0..100_000).filter(|n| throttle.admits(ip(*n), at(0))).count();
        assert_eq!(written, BUCKETS + BURST as usize);
        assert_eq!(throttle.buckets.len(), BUCKETS + 1);
        assert_eq!(throttle.take(), [Suppressed { source: None, lines: 100_000 - written as u64 }]);
        // buckets that are full again are not kept
        assert!(throttle.admits(ip(200_000), at(60_000)));
        assert!(throttle.buckets.len() < 3);
    }
}
