//! What all tasks of a server share: the handler, the numbers of peers, and the news that something has changed.

use core::cell::RefCell;
use core::fmt;
use core::future::poll_fn;
use core::task::Poll;

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::waitqueue::MultiWakerRegistration;

use super::Serve;
use super::limits::{Due, Limits, TooLong};
use crate::clock::now;

/// A handler that many tasks call, one at a time; `WAITERS` of them (at least 1) can wait for each other's changes.
///
/// The mutex is embassy's: `NoopRawMutex` for one executor, `CriticalSectionRawMutex` for more.
pub struct Shared<M: RawMutex, H, const WAITERS: usize> {
    inner: Mutex<M, RefCell<Inner<H, WAITERS>>>,
}

struct Inner<H, const WAITERS: usize> {
    handler: H,
    next_peer: u32,
    /// Counts what may matter to a handler that waits.
    changes: u32,
    wakers: MultiWakerRegistration<WAITERS>,
}

impl<M: RawMutex, H, const WAITERS: usize> Shared<M, H, WAITERS> {
    /// Takes a handler.
    #[must_use]
    pub const fn new(handler: H) -> Self {
        const { assert!(WAITERS > 0) };
        let inner = Inner { handler, next_peer: 1, changes: 0, wakers: MultiWakerRegistration::new() };
        Self { inner: Mutex::new(RefCell::new(inner)) }
    }

    /// Lends the handler, and has those asked again that wait for something to change.
    ///
    /// `None` when it is lent already: a handler cannot borrow itself while it is called.
    pub fn update<T>(&self, work: impl FnOnce(&mut H) -> T) -> Option<T> {
        self.with(|inner| {
            let result = work(&mut inner.handler);
            inner.changed();
            result
        })
    }

    /// Lends the handler to be looked at.
    pub fn view<T>(&self, work: impl FnOnce(&H) -> T) -> Option<T> {
        self.with(|inner| work(&inner.handler))
    }

    /// Returns the number of changes so far.
    pub(super) fn changes(&self) -> u32 {
        self.with(|inner| inner.changes).unwrap_or_default()
    }

    /// Waits until the number of changes is not `seen` any more.
    pub(super) async fn changed(&self, seen: u32) {
        poll_fn(|cx| {
            let ready = self.with(|inner| {
                let ready = inner.changes != seen;
                if !ready {
                    inner.wakers.register(cx.waker());
                }
                ready
            });
            if ready.unwrap_or_default() { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }

    /// Lets a session go on as far as it can; `false` when it had nothing to do.
    pub(super) fn run<S: Serve<H>>(&self, session: &mut S, peer: PeerId, now: Instant) -> bool {
        let mut stepped = false;
        // one step for each lock, so that a chatty peer does not keep interrupts out for long
        while self.step(session, peer, now) {
            stepped = true;
        }
        stepped
    }

    /// Lets a session go one step on; `false` when it has nothing to do.
    pub(super) fn step<S: Serve<H>>(&self, session: &mut S, peer: PeerId, now: Instant) -> bool {
        self.with(|inner| inner.step(session, peer, now)).unwrap_or_default()
    }

    pub(super) fn close<S: Serve<H>>(&self, session: &mut S, peer: PeerId, now: Instant) {
        self.update(|handler| session.close(handler, peer, now));
    }

    /// Returns a number that no peer has had before.
    pub(super) fn next_peer(&self) -> PeerId {
        let next = self.with(|inner| {
            let peer = inner.next_peer;
            inner.next_peer = peer.wrapping_add(1);
            peer
        });
        PeerId(next.unwrap_or_default())
    }

    fn with<T>(&self, work: impl FnOnce(&mut Inner<H, WAITERS>) -> T) -> Option<T> {
        self.inner.lock(|inner| inner.try_borrow_mut().ok().map(|mut inner| work(&mut inner)))
    }
}

impl<H, const WAITERS: usize> Inner<H, WAITERS> {
    fn step<S: Serve<H>>(&mut self, session: &mut S, peer: PeerId, now: Instant) -> bool {
        let stepped = session.run(&mut self.handler, peer, now).is_some();
        if stepped {
            self.changed();
        }
        stepped
    }

    fn changed(&mut self) {
        self.changes = self.changes.wrapping_add(1);
        self.wakers.wake();
    }
}

impl<M: RawMutex, H: fmt::Debug, const WAITERS: usize> fmt::Debug for Shared<M, H, WAITERS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.lock(|inner| match inner.try_borrow() {
            Ok(inner) => f.debug_tuple("Shared").field(&inner.handler).finish(),
            Err(_) => f.write_str("Shared(<in use>)"),
        })
    }
}

/// A session while it lasts; the handler learns its end however it ends.
pub(super) struct Visit<'a, S: Serve<H>, M: RawMutex, H, const N: usize> {
    pub(super) session: &'a mut S,
    shared: &'a Shared<M, H, N>,
    peer: PeerId,
    /// When bytes came last, and when the first byte of an unfinished request came.
    heard: Instant,
    partial_since: Option<Instant>,
}

impl<'a, S: Serve<H>, M: RawMutex, H, const N: usize> Visit<'a, S, M, H, N> {
    pub(super) fn new(session: &'a mut S, shared: &'a Shared<M, H, N>, now: Instant) -> Self {
        Self { session, shared, peer: shared.next_peer(), heard: now, partial_since: None }
    }

    pub(super) fn run(&mut self, now: Instant) {
        if self.shared.run(self.session, self.peer, now) {
            // a request was whole, so what there is of another has only just come
            self.partial_since = None;
        }
    }

    pub(super) fn received(&mut self, count: usize, now: Instant) {
        self.heard = now;
        self.session.received(count);
    }

    /// Says when the session must be looked at again.
    pub(super) fn due(&mut self, limits: &Limits, now: Instant) -> Due {
        self.partial_since = self.session.is_receiving().then(|| self.partial_since.unwrap_or(now));
        let request = self.partial_since.map(|since| since.saturating_add(limits.receive));
        if request.is_some_and(|until| now >= until) {
            return Due::Ended(TooLong::Request);
        }
        let silence = match limits.idle {
            Some(idle) if !self.session.is_running() => self.heard.saturating_add(idle),
            _ => Instant::FAR_FUTURE,
        };
        if now >= silence {
            return Due::Ended(TooLong::Silence);
        }
        let session = self.session.poll_timeout();
        Due::At(silence.min(request.unwrap_or(silence)).min(session.unwrap_or(silence)))
    }
}

impl<S: Serve<H>, M: RawMutex, H, const N: usize> Drop for Visit<'_, S, M, H, N> {
    fn drop(&mut self) {
        self.shared.close(self.session, self.peer, now());
    }
}
