//! Admission: which client gets a slot when slots are short.

use core::time::Duration;

use crate::time::Instant;

/// The slots of a server or gateway, and the policy that assigns them to clients.
///
/// A new client of a host that has used its share can only replace a client of the same host. When all slots are taken, it can
/// replace a client of any host. The first of these that exists is replaced:
///
/// 1. a client whose session is over;
/// 2. the client of the same host that has been idle longest, because it is most likely the predecessor of the new client;
/// 3. the client that has been idle longest.
///
/// An idle client is replaced only if it has been idle for `evict_after`. A busy client is never replaced.
///
/// # Examples
///
/// ```
/// # use core::time::Duration;
/// use bcap_core::peers::{Admission, Holder, SlotState, Slots};
/// use bcap_core::time::Instant;
///
/// let slots = Slots { total: 2, per_host: 2, evict_after: Some(Duration::from_secs(10)) };
/// let taken = [("a", SlotState::Busy), ("b", SlotState::Idle(Instant::ZERO))];
/// let taken = taken.map(|(key, state)| Holder { key, is_same_host: false, state });
/// assert_eq!(slots.admit(taken, Instant::from_millis(9_999)), Admission::Refused);
/// assert_eq!(slots.admit(taken, Instant::from_millis(10_000)), Admission::Instead("b"));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slots {
    /// The number of slots.
    pub total: usize,
    /// The maximum number of slots of one host.
    pub per_host: usize,
    /// The time without traffic after which the holder of a slot may be evicted; `None` means never.
    pub evict_after: Option<Duration>,
}

/// The holder of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Holder<K> {
    /// The caller's key for this holder.
    pub key: K,
    /// Whether it is a client of the same host as the new one.
    pub is_same_host: bool,
    /// Its state.
    pub state: SlotState,
}

/// The state of the holder of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotState {
    /// Its session has ended.
    Over,
    /// It has been idle since this time.
    Idle(Instant),
    /// It has a running call or receives a reply.
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

/// The order in which holders are replaced: the lowest first.
type Rank = (bool, bool, Instant);

impl Slots {
    /// Decides whether to accept a new client; `taken` lists the holders of slots.
    pub fn admit<K>(&self, taken: impl IntoIterator<Item = Holder<K>>, now: Instant) -> Admission<K> {
        let (mut count, mut own_count) = (0_usize, 0_usize);
        let (mut any, mut own) = (None, None);
        for holder in taken {
            count = count.saturating_add(1);
            own_count = own_count.saturating_add(holder.is_same_host.into());
            let first = if holder.is_same_host { &mut own } else { &mut any };
            if let Some(rank) = self.rank(&holder, now)
                && first.as_ref().is_none_or(|(lowest, _)| rank < *lowest)
            {
                *first = Some((rank, holder.key));
            }
        }
        let has_share = own_count >= self.per_host;
        if !has_share && count < self.total {
            return Admission::Free;
        }
        let first = match (own, any) {
            (Some(own), Some(any)) if !has_share && any.0 < own.0 => Some(any),
            (None, any) if !has_share => any,
            (own, _) => own,
        };
        first.map_or(Admission::Refused, |(_, key)| Admission::Instead(key))
    }

    /// Returns the rank of a holder; `None` if it keeps its slot.
    fn rank<K>(&self, holder: &Holder<K>, now: Instant) -> Option<Rank> {
        match holder.state {
            SlotState::Over => Some((false, false, Instant::ZERO)),
            SlotState::Idle(since) if now.saturating_since(since) >= self.evict_after? => {
                Some((true, !holder.is_same_host, since))
            }
            SlotState::Idle(_) | SlotState::Busy => None,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;

    const SLOTS: Slots = Slots { total: 4, per_host: 3, evict_after: Some(Duration::from_secs(10)) };

    fn idle(secs: u64) -> SlotState {
        SlotState::Idle(Instant::from_millis(secs.saturating_mul(1000)))
    }

    /// Admits or refuses a client of host 9 at second 100.
    fn admit_by(slots: Slots, taken: &[(u8, SlotState)]) -> Admission<usize> {
        let holders = taken.iter().enumerate();
        let holders = holders.map(|(key, (host, state))| Holder { key, is_same_host: *host == 9, state: *state });
        slots.admit(holders, Instant::from_millis(100_000))
    }

    fn admit(taken: &[(u8, SlotState)]) -> Admission<usize> {
        admit_by(SLOTS, taken)
    }

    #[test]
    fn a_free_slot_is_used_before_any_client_is_evicted() {
        assert_eq!(admit(&[]), Admission::Free);
        assert_eq!(admit(&[(1, idle(0)), (9, idle(0)), (9, SlotState::Over)]), Admission::Free);
    }

    #[test]
    fn the_longest_idle_client_is_evicted_but_one_of_the_same_host_first() {
        assert_eq!(admit(&[(1, idle(50)), (1, idle(20)), (2, idle(40)), (2, idle(30))]), Admission::Instead(1));
        assert_eq!(admit(&[(1, idle(50)), (1, idle(20)), (9, idle(40)), (9, idle(30))]), Admission::Instead(3));
        assert_eq!(admit(&[(1, idle(20)), (1, SlotState::Over), (2, idle(40)), (9, idle(0))]), Admission::Instead(1));
        assert_eq!(admit(&[(1, SlotState::Busy), (1, idle(91)), (2, idle(90)), (9, idle(95))]), Admission::Instead(2));
    }

    #[test]
    fn a_client_that_was_active_recently_is_not_evicted() {
        assert_eq!(admit(&[(1, SlotState::Busy), (1, idle(91)), (2, idle(92)), (9, idle(100))]), Admission::Refused);
        assert_eq!(admit(&[(1, SlotState::Busy); 4]), Admission::Refused);
        let never = Slots { evict_after: None, ..SLOTS };
        assert_eq!(admit_by(never, &[(1, idle(0)); 4]), Admission::Refused);
        assert_eq!(admit_by(never, &[(1, SlotState::Over); 4]), Admission::Instead(0));
    }

    #[test]
    fn a_host_that_has_used_its_share_evicts_its_own_clients_only() {
        let own = [(9, idle(30)), (9, idle(20)), (9, idle(40))];
        assert_eq!(admit(&own), Admission::Instead(1));
        assert_eq!(admit(&[&own[..], &[(1, SlotState::Over)]].concat()), Admission::Instead(1));
        assert_eq!(admit(&[(9, idle(95)), (9, SlotState::Busy), (9, idle(95)), (1, idle(0))]), Admission::Refused);
    }
}
