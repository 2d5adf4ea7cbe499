//! Admission: which connection or UDP peer gets a slot when slots are short.

use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::time::Instant;
use tokio::sync::Notify;

/// The slots of a server, and the policy that assigns them to clients.
///
/// A new client of an address that has used its share can only replace a client of the same address. When all slots are
/// taken, it can replace a client of any address. The client that has been idle longest is evicted first, and only if it has
/// been idle for `evict_after`.
///
/// # Examples
///
/// ```
/// # use std::time::Duration;
/// use bcap_core::time::Instant;
/// use bcap_std::server::{Admission, SlotState, Slots};
///
/// let slots = Slots { total: 2, per_address: 2, evict_after: Duration::from_secs(10) };
/// let (one, two) = ([10, 0, 0, 1].into(), [10, 0, 0, 2].into());
/// let taken = [("a", one, SlotState::Busy), ("b", one, SlotState::Idle(Instant::ZERO))];
/// assert_eq!(slots.admit(taken, two, Instant::from_millis(9_999)), Admission::Refused);
/// assert_eq!(slots.admit(taken, two, Instant::from_millis(10_000)), Admission::Instead("b"));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slots {
    /// The number of slots.
    pub total: usize,
    /// The maximum number of slots of one IP address.
    pub per_address: usize,
    /// The time without traffic after which the holder of a slot may be evicted.
    pub evict_after: Duration,
}

/// The state of the holder of a slot, in the order of eviction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SlotState {
    /// Its session has ended.
    Over,
    /// It has been idle since this time.
    Idle(Instant),
    /// It has a running call or receives a reply: it is never evicted.
    Busy,
}

/// Whether a client gets a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission<K> {
    /// The client gets a free slot.
    Free,
    /// The client gets the slot of this holder, which must be closed.
    Instead(K),
    /// The client gets no slot.
    Refused,
}

impl Slots {
    /// Decides on a client that connects from `address`; `taken` lists the holders of slots.
    pub fn admit<K>(
        &self,
        taken: impl IntoIterator<Item = (K, IpAddr, SlotState)>,
        address: IpAddr,
        now: Instant,
    ) -> Admission<K> {
        let address = address.to_canonical();
        let taken: Vec<_> = taken.into_iter().collect();
        let is_own = |holder: &(K, IpAddr, SlotState)| holder.1.to_canonical() == address;
        let has_share = taken.iter().filter(|holder| is_own(holder)).count() >= self.per_address;
        if !has_share && taken.len() < self.total {
            return Admission::Free;
        }
        let candidates = taken.into_iter().filter(|holder| !has_share || is_own(holder));
        match candidates.min_by_key(|(_, _, state)| *state) {
            Some((key, _, SlotState::Over)) => Admission::Instead(key),
            Some((key, _, SlotState::Idle(since))) if now.saturating_since(since) >= self.evict_after => {
                Admission::Instead(key)
            }
            _ => Admission::Refused,
        }
    }
}

/// The activity of a connection's task, and the signal that evicts it.
#[derive(Debug)]
pub(super) struct Activity {
    /// The time in microseconds since which it is idle; [`BUSY`] while it is not.
    idle_since: AtomicU64,
    evicted: Notify,
}

const BUSY: u64 = u64::MAX;

impl Activity {
    pub(super) fn new(now: Instant) -> Self {
        Self { idle_since: AtomicU64::new(now.as_micros()), evicted: Notify::new() }
    }

    /// Records since when the connection is idle; `None` while it is busy.
    pub(super) fn set(&self, idle_since: Option<Instant>) {
        self.idle_since.store(idle_since.map_or(BUSY, Instant::as_micros), Ordering::Release);
    }

    pub(super) fn state(&self) -> SlotState {
        match self.idle_since.load(Ordering::Acquire) {
            BUSY => SlotState::Busy,
            micros => SlotState::Idle(Instant::from_micros(micros)),
        }
    }

    /// Requests the connection's task to end.
    pub(super) fn evict(&self) {
        self.evicted.notify_one();
    }

    /// Waits until the connection is evicted.
    ///
    /// # Cancel safety
    ///
    /// Cancel safe.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOTS: Slots = Slots { total: 4, per_address: 3, evict_after: Duration::from_secs(10) };

    fn ip(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    fn idle(secs: u64) -> SlotState {
        SlotState::Idle(Instant::from_millis(1000 * secs))
    }

    /// Decides at second 100 about a client of address 9.
    fn admit(taken: &[(u8, SlotState)]) -> Admission<usize> {
        let holders = taken.iter().enumerate().map(|(key, (address, state))| (key, ip(*address), *state));
        SLOTS.admit(holders, ip(9), Instant::from_millis(100_000))
    }

    #[test]
    fn a_free_slot_is_used_before_any_connection_is_evicted() {
        assert_eq!(admit(&[]), Admission::Free);
        assert_eq!(admit(&[(1, idle(0)), (9, idle(0)), (9, SlotState::Over)]), Admission::Free);
    }

    #[test]
    fn the_longest_idle_connection_is_evicted_first() {
        assert_eq!(admit(&[(1, idle(50)), (1, idle(20)), (2, idle(40)), (9, idle(30))]), Admission::Instead(1));
        assert_eq!(admit(&[(1, idle(20)), (1, SlotState::Over), (2, idle(40)), (9, idle(0))]), Admission::Instead(1));
        assert_eq!(admit(&[(1, SlotState::Busy), (1, idle(91)), (2, idle(90)), (9, idle(95))]), Admission::Instead(2));
    }

    #[test]
    fn a_connection_that_was_active_recently_is_not_evicted() {
        assert_eq!(admit(&[(1, SlotState::Busy), (1, idle(91)), (2, idle(92)), (9, idle(100))]), Admission::Refused);
        assert_eq!(admit(&[(1, SlotState::Busy); 4]), Admission::Refused);
    }

    #[test]
    fn an_address_that_has_used_its_share_evicts_its_own_connections_only() {
        let own = [(9, idle(30)), (9, idle(20)), (9, idle(40))];
        assert_eq!(admit(&own), Admission::Instead(1));
        assert_eq!(admit(&[&own[..], &[(1, idle(0))]].concat()), Admission::Instead(1));
        assert_eq!(admit(&[(9, idle(95)), (9, SlotState::Busy), (9, idle(95)), (1, idle(0))]), Admission::Refused);
    }

    #[test]
    fn an_ipv4_mapped_ipv6_address_is_the_same_address() {
        let mapped = |n: u8| IpAddr::V6(std::net::Ipv4Addr::new(10, 0, 0, n).to_ipv6_mapped());
        let taken = [(0, mapped(9), SlotState::Busy), (1, ip(9), SlotState::Busy), (2, mapped(9), SlotState::Busy)];
        assert_eq!(SLOTS.admit(taken, ip(9), Instant::ZERO), Admission::Refused);
        assert_eq!(SLOTS.admit(taken, mapped(9), Instant::ZERO), Admission::Refused);
        assert_eq!(SLOTS.admit(taken, mapped(1), Instant::ZERO), Admission::Free);
    }
}
