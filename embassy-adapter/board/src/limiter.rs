//! Limits the log: at most one line a second for each client and reason.

use core::net::Ipv4Addr;

use bcap_core::time::Instant;

/// Minimum time between two lines of the same client and reason, in microseconds.
const INTERVAL: u64 = 1_000_000;

/// Admits at most one line a second for each client and reason, and counts the others.
///
/// It stores `N` pairs of a client and a reason. When all of them wrote a line within the last second, lines of further pairs
/// are left out, so a log has at most `N` lines a second.
///
/// # Examples
///
/// ```
/// use bcap_board::limiter::Limiter;
/// use bcap_core::time::Instant;
///
/// let mut limiter = Limiter::<8>::new();
/// let at = Instant::from_micros;
/// let client = Some([10, 0, 0, 7].into());
/// assert_eq!(limiter.admit(client, "refused", at(0)), Some(0));
/// assert_eq!(limiter.admit(client, "refused", at(10)), None);
/// assert_eq!(limiter.admit(client, "connected", at(10)), Some(0), "another reason");
/// assert_eq!(limiter.admit(client, "refused", at(1_000_000)), Some(1), "one line was left out");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Limiter<const N: usize> {
    entries: [Entry; N],
    /// Lines of pairs without an entry.
    others: u32,
}

/// A client and a reason; without a reason the entry is free.
#[derive(Clone, Copy, Debug)]
struct Entry {
    client: Option<Ipv4Addr>,
    reason: Option<&'static str>,
    logged: Instant,
    left_out: u32,
}

impl Entry {
    /// All zero, so that a static limiter needs no memory in the flash.
    const FREE: Self = Self { client: None, reason: None, logged: Instant::ZERO, left_out: 0 };

    fn may_log(&self, now: Instant) -> bool {
        now >= Instant::from_micros(self.logged.as_micros().saturating_add(INTERVAL))
    }
}

impl<const N: usize> Limiter<N> {
    /// Creates a limiter that has admitted no line yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { entries: [Entry::FREE; N], others: 0 }
    }

    /// Returns the number of lines left out since the last line of this client and reason; `None` to leave out this line.
    ///
    /// The client is `None` on a serial line.
    pub fn admit(&mut self, client: Option<Ipv4Addr>, reason: &'static str, now: Instant) -> Option<u32> {
        let reason = Some(reason);
        let known = self.entries.iter_mut().find(|entry| entry.client == client && entry.reason == reason);
        if let Some(entry) = known {
            if !entry.may_log(now) {
                entry.left_out = entry.left_out.saturating_add(1);
                return None;
            }
            entry.logged = now;
            return Some(core::mem::take(&mut entry.left_out));
        }
        // an entry with lines left out is kept until `drain` reports them
        let is_free = |entry: &&mut Entry| entry.reason.is_none() || entry.left_out == 0 && entry.may_log(now);
        let place = self.entries.iter_mut().find(is_free);
        match place {
            Some(place) => {
                *place = Entry { client, reason, logged: now, left_out: 0 };
                Some(0)
            }
            None => {
                self.others = self.others.saturating_add(1);
                None
            }
        }
    }

    /// Reports each client and reason with lines left out, and resets their counts. Call it periodically.
    pub fn drain(&mut self, mut report: impl FnMut(Option<Ipv4Addr>, &'static str, u32)) {
        for entry in self.entries.iter_mut().filter(|entry| entry.left_out > 0) {
            report(entry.client, entry.reason.unwrap_or_default(), core::mem::take(&mut entry.left_out));
        }
        if self.others > 0 {
            report(None, "other lines", core::mem::take(&mut self.others));
        }
    }
}

impl<const N: usize> Default for Limiter<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn client(last: u8) -> Option<Ipv4Addr> {
        Some(Ipv4Addr::new(10, 0, 0, last))
    }

    #[test]
    fn a_flood_is_one_line_a_second_with_a_count() {
        let mut limiter = Limiter::<2>::new();
        let admitted: Vec<_> =
            (0..5000_u64).filter_map(|n| limiter.admit(client(1), "a", Instant::from_micros(n * 1000))).collect();
        assert_eq!(admitted, [0, 999, 999, 999, 999]);
    }

    #[test]
    fn many_clients_write_no_more_lines_than_there_are_entries() {
        let mut limiter = Limiter::<4>::new();
        let (mut lines, mut left_out) = (0, 0);
        for n in 0..3000_u64 {
            let who = client(u8::try_from(n % 200).unwrap());
            if let Some(count) = limiter.admit(who, "a", Instant::from_micros(n * 1000)) {
                lines += 1;
                left_out += count;
            }
        }
        assert!(lines <= 4 * 3, "{lines} lines in 3 s");
        // all lines are accounted for
        limiter.drain(|_, _, count| left_out += count);
        assert_eq!(lines + left_out, 3000);
        limiter.drain(|_, _, _| panic!("reported twice"));
        // and a quiet log takes new clients again
        assert_eq!(limiter.admit(client(250), "b", Instant::from_micros(10_000_000)), Some(0));
    }
}
