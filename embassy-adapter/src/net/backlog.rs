//! The clients of a port that have not finished a handshake or a request.

use core::cell::RefCell;
use core::cmp::Reverse;
use core::future::poll_fn;
use core::task::{Context, Poll, Waker};

use embassy_net::IpAddress;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

/// The maximum number of listeners of a port that are counted.
const LISTENERS: usize = 8;
/// The number of addresses that are stored.
const KNOWN: usize = 4;

/// The listeners of one port, so that clients that never finish do not occupy all of them
/// ([`Options::backlog`](super::Options::backlog)).
///
/// A client is unfinished during its handshake; a client of a page is unfinished until it has the page. When the last free
/// listener gets a client, the oldest other unfinished client is evicted. The handshake of an address that has finished a
/// handshake before is evicted only if there is no other. So under a flood of handshakes from invented addresses, a known
/// client has time for its own handshake. Each listener needs its own socket; a backlog counts the first eight of them.
pub struct Backlog(Mutex<CriticalSectionRawMutex, RefCell<State>>);

struct State {
    slots: [Slot; LISTENERS],
    /// The number of the next client. It wraps.
    next: u16,
    /// The addresses that have finished a handshake, the most recent first.
    known: [Option<IpAddress>; KNOWN],
}

enum Slot {
    Unused,
    /// A listener without a client.
    Free,
    Unfinished {
        number: u16,
        /// Whether it is a handshake of a known address.
        is_known: bool,
        waker: Option<Waker>,
    },
    /// An unfinished client that is evicted.
    Evicted,
}

impl Backlog {
    /// Creates the backlog of a port.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(State {
            slots: [const { Slot::Unused }; LISTENERS],
            next: 0,
            known: [None; KNOWN],
        })))
    }

    /// Adds a listener without a client; `None` if too many are counted.
    pub(crate) fn join(&'static self) -> Option<Place> {
        self.with(|state| {
            let index = state.slots.iter().position(|slot| matches!(slot, Slot::Unused))?;
            *state.slots.get_mut(index)? = Slot::Free;
            Some(Place { backlog: self, index })
        })?
    }

    fn with<R>(&self, work: impl FnOnce(&mut State) -> R) -> Option<R> {
        self.0.lock(|state| state.try_borrow_mut().ok().map(|mut state| work(&mut state)))
    }
}

impl Default for Backlog {
    fn default() -> Self {
        Self::new()
    }
}

impl core::fmt::Debug for Backlog {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Backlog").finish_non_exhaustive()
    }
}

/// Backlogs are equal only to themselves.
impl PartialEq for Backlog {
    fn eq(&self, other: &Self) -> bool {
        core::ptr::eq(self, other)
    }
}

impl Eq for Backlog {}

#[cfg(feature = "defmt")]
impl defmt::Format for Backlog {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "Backlog");
    }
}

impl State {
    /// Evicts an unfinished client, unless another listener is free or has already evicted its client. `newest` is the listener
    /// whose client began last.
    fn make_room(&mut self, newest: usize) {
        if self.slots.iter().any(|slot| matches!(slot, Slot::Free | Slot::Evicted)) {
            return;
        }
        let next = self.next;
        let unfinished = self.slots.iter_mut().enumerate().filter_map(|(index, slot)| match slot {
            Slot::Unfinished { number, is_known, .. } => {
                let age = next.wrapping_sub(*number);
                Some(((*is_known, index == newest, Reverse(age)), slot))
            }
            _ => None,
        });
        let (mut count, mut first) = (0_usize, None);
        for (order, slot) in unfinished {
            count = count.saturating_add(1);
            if first.as_ref().is_none_or(|(least, _)| order < *least) {
                first = Some((order, slot));
            }
        }
        if let (2.., Some((_, slot))) = (count, first)
            && let Slot::Unfinished { waker: Some(waker), .. } = core::mem::replace(slot, Slot::Evicted)
        {
            waker.wake();
        }
    }

    fn is_known(&self, address: Option<IpAddress>) -> bool {
        address.is_some() && self.known.contains(&address)
    }

    /// Stores an address as the most recent.
    fn remember(&mut self, address: Option<IpAddress>) {
        let place = self.known.iter().position(|known| *known == address).unwrap_or(KNOWN.saturating_sub(1));
        if let (Some(known), true) = (self.known.get_mut(..=place), address.is_some()) {
            known.rotate_right(1);
            known.iter_mut().take(1).for_each(|first| *first = address);
        }
    }
}

/// A listener in a [`Backlog`], until this value is dropped.
#[derive(Debug)]
pub(crate) struct Place {
    backlog: &'static Backlog,
    index: usize,
}

impl Place {
    /// Records that the listener has a client, which is unfinished.
    pub(crate) fn begin(&self, address: Option<IpAddress>) {
        let _ = self.backlog.with(|state| {
            let (number, is_known) = (state.next, state.is_known(address));
            if let Some(slot @ Slot::Free) = state.slots.get_mut(self.index) {
                *slot = Slot::Unfinished { number, is_known, waker: None };
                state.next = number.wrapping_add(1);
                state.make_room(self.index);
            }
        });
    }

    /// Records that the client has finished its handshake.
    pub(crate) fn connected(&self, address: Option<IpAddress>) {
        let _ = self.backlog.with(|state| {
            state.remember(address);
            if let Some(Slot::Unfinished { is_known, .. }) = state.slots.get_mut(self.index) {
                *is_known = false;
            }
        });
    }

    /// Is ready when the client is evicted.
    fn poll_evicted(&self, cx: &Context<'_>) -> Poll<()> {
        let slot = |state: &mut State| match state.slots.get_mut(self.index) {
            Some(Slot::Evicted) => Poll::Ready(()),
            Some(Slot::Unfinished { waker, .. }) => {
                *waker = Some(cx.waker().clone());
                Poll::Pending
            }
            _ => Poll::Pending,
        };
        self.backlog.with(slot).unwrap_or(Poll::Pending)
    }
}

/// Waits until the client in a slot is evicted; forever without a slot.
pub(crate) async fn evicted(place: Option<&Place>) {
    poll_fn(|cx| place.map_or(Poll::Pending, |place| place.poll_evicted(cx))).await;
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = self.backlog.with(|state| {
            if let Some(slot) = state.slots.get_mut(self.index) {
                *slot = Slot::Unused;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use core::task::{Context, Poll, Waker};

    use super::*;

    fn is_evicted(place: &Place) -> bool {
        place.poll_evicted(&Context::from_waker(Waker::noop())) == Poll::Ready(())
    }

    #[test]
    fn the_oldest_unfinished_client_makes_room_for_the_last_listener() {
        static BACKLOG: Backlog = Backlog::new();
        let [first, second, third] = [(); 3].map(|()| BACKLOG.join().unwrap());
        second.begin(None);
        first.begin(None);
        assert!(!is_evicted(&first) && !is_evicted(&second), "a listener is free");
        third.begin(None);
        assert!(is_evicted(&second) && !is_evicted(&first) && !is_evicted(&third));
        // its listener is free again
        drop(second);
        let second = BACKLOG.join().unwrap();
        assert!(!is_evicted(&first));
        second.begin(None);
        assert!(is_evicted(&first) && !is_evicted(&third) && !is_evicted(&second));
        drop(first);
        // a client that has finished is not counted
        drop(third);
        let first = BACKLOG.join().unwrap();
        first.begin(None);
        assert!(is_evicted(&second) && !is_evicted(&first));
    }

    #[test]
    fn handshakes_of_unknown_addresses_make_room_for_those_of_known_ones() {
        static BACKLOG: Backlog = Backlog::new();
        let address = |last| Some(IpAddress::v4(10, 0, 2, last));
        let [first, second, third] = [(); 3].map(|()| BACKLOG.join().unwrap());
        first.begin(address(1));
        first.connected(address(1));
        drop(first);
        let first = BACKLOG.join().unwrap();
        first.begin(address(1));
        second.begin(address(2));
        third.begin(address(3));
        assert!(is_evicted(&second) && !is_evicted(&first) && !is_evicted(&third), "the oldest one is known");
        drop(second);
        // it waits for its page, and does not keep others out
        first.connected(address(1));
        let second = BACKLOG.join().unwrap();
        second.begin(address(2));
        assert!(is_evicted(&first) && !is_evicted(&second) && !is_evicted(&third));
    }

    #[test]
    fn an_unknown_address_is_given_up_when_all_others_are_known() {
        static BACKLOG: Backlog = Backlog::new();
        let address = |last| Some(IpAddress::v4(10, 0, 2, last));
        for last in 0..5 {
            let place = BACKLOG.join().unwrap();
            place.begin(address(last));
            place.connected(address(last));
        }
        let [first, second, third] = [(); 3].map(|()| BACKLOG.join().unwrap());
        first.begin(address(4));
        second.begin(address(1));
        // the address that connected first was dropped
        third.begin(address(0));
        assert!(is_evicted(&third) && !is_evicted(&first) && !is_evicted(&second));
        drop(third);
        let third = BACKLOG.join().unwrap();
        third.begin(address(2));
        assert!(is_evicted(&first) && !is_evicted(&second) && !is_evicted(&third), "all are known");
    }

    #[test]
    fn the_only_client_is_not_given_up() {
        static BACKLOG: Backlog = Backlog::new();
        let place = BACKLOG.join().unwrap();
        place.begin(None);
        assert!(!is_evicted(&place));
        let others: std::vec::Vec<_> = (1..LISTENERS).map(|_| BACKLOG.join().unwrap()).collect();
        assert!(BACKLOG.join().is_none(), "{}", others.len());
    }
}
