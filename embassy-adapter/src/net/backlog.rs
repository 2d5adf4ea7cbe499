//! The clients of a port that have not finished a handshake or a request.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::{Context, Poll, Waker};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

/// The most listeners of a port that are counted.
const LISTENERS: usize = 8;

/// The listeners of one port, so that clients that never finish do not occupy all of them
/// ([`Options::backlog`](super::Options::backlog)).
///
/// A client is unfinished during its handshake, and on a page also until it has its page. When the last free listener gets a client,
/// the oldest other unfinished one is given up. Each listener needs its own socket; a backlog counts the first eight of them.
pub struct Backlog(Mutex<CriticalSectionRawMutex, RefCell<State>>);

struct State {
    slots: [Slot; LISTENERS],
    /// The number of the next client; the older of two clients has the lower one.
    next: u32,
}

enum Slot {
    Unused,
    /// A listener without a client.
    Free,
    Unfinished {
        number: u32,
        waker: Option<Waker>,
    },
    /// An unfinished client that is given up.
    Evicted,
}

impl Backlog {
    /// Creates the backlog of a port.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(State { slots: [const { Slot::Unused }; LISTENERS], next: 0 })))
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
    /// Gives up the oldest unfinished client except for that of a listener, unless another listener is free.
    fn make_room(&mut self, except: usize) {
        if self.slots.iter().any(|slot| matches!(slot, Slot::Free | Slot::Evicted)) {
            return;
        }
        let number_of = |slot: &Slot| match slot {
            Slot::Unfinished { number, .. } => Some(*number),
            _ => None,
        };
        let others = self.slots.iter_mut().enumerate().filter(|(index, _)| *index != except);
        let oldest = others.filter_map(|(_, slot)| Some((number_of(slot)?, slot))).min_by_key(|(number, _)| *number);
        if let Some((_, slot)) = oldest
            && let Slot::Unfinished { waker: Some(waker), .. } = core::mem::replace(slot, Slot::Evicted)
        {
            waker.wake();
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
    pub(crate) fn begin(&self) {
        let _ = self.backlog.with(|state| {
            let number = state.next;
            if let Some(slot @ Slot::Free) = state.slots.get_mut(self.index) {
                *slot = Slot::Unfinished { number, waker: None };
                state.next = number.wrapping_add(1);
                state.make_room(self.index);
            }
        });
    }

    /// Is ready when the client is given up.
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

/// Waits until the client in a place is given up; for ever without a place.
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
        second.begin();
        first.begin();
        assert!(!is_evicted(&first) && !is_evicted(&second), "a listener is free");
        third.begin();
        assert!(is_evicted(&second) && !is_evicted(&first) && !is_evicted(&third));
        // its listener is free again
        drop(second);
        let second = BACKLOG.join().unwrap();
        assert!(!is_evicted(&first));
        second.begin();
        assert!(is_evicted(&first) && !is_evicted(&third) && !is_evicted(&second));
        drop(first);
        // a client that has finished is not counted
        drop(third);
        let first = BACKLOG.join().unwrap();
        first.begin();
        assert!(is_evicted(&second) && !is_evicted(&first));
    }

    #[test]
    fn the_only_client_is_not_given_up() {
        static BACKLOG: Backlog = Backlog::new();
        let place = BACKLOG.join().unwrap();
        place.begin();
        assert!(!is_evicted(&place));
        let others: std::vec::Vec<_> = (1..LISTENERS).map(|_| BACKLOG.join().unwrap()).collect();
        assert!(BACKLOG.join().is_none(), "{}", others.len());
    }
}
