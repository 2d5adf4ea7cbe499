//! The state that all tasks of a server share: the handler, the next peer number and the notification of changes.

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
use crate::clock::now;

/// A handler that several tasks call, one at a time; up to `WAITERS` tasks (at least 1) can wait for changes.
///
/// `M` is embassy's mutex: `NoopRawMutex` for one executor, `CriticalSectionRawMutex` for several.
pub struct SharedHandler<M: RawMutex, H, const WAITERS: usize> {
    inner: Mutex<M, RefCell<Inner<H, WAITERS>>>,
}

struct Inner<H, const WAITERS: usize> {
    handler: H,
    next_peer: u32,
    /// Counts the changes that may complete a waiting request.
    changes: u32,
    wakers: MultiWakerRegistration<WAITERS>,
}

impl<M: RawMutex, H, const WAITERS: usize> SharedHandler<M, H, WAITERS> {
    /// Wraps a handler.
    #[must_use]
    pub const fn new(handler: H) -> Self {
        const { assert!(WAITERS > 0) };
        let inner = Inner { handler, next_peer: 1, changes: 0, wakers: MultiWakerRegistration::new() };
        Self { inner: Mutex::new(RefCell::new(inner)) }
    }

    /// Calls `work` with the handler, and polls waiting requests again afterwards.
    ///
    /// Returns `None` when the handler is already borrowed: a handler cannot call this while it is called itself.
    pub fn update<T>(&self, work: impl FnOnce(&mut H) -> T) -> Option<T> {
        self.with(|inner| {
            let result = work(&mut inner.handler);
            inner.changed();
            result
        })
    }

    /// Calls `work` with the handler, without polling waiting requests; `None` as for [`update`](Self::update).
    pub fn view<T>(&self, work: impl FnOnce(&H) -> T) -> Option<T> {
        self.with(|inner| work(&inner.handler))
    }

    /// Returns the number of changes so far.
    pub(super) fn changes(&self) -> u32 {
        self.with(|inner| inner.changes).unwrap_or_default()
    }

    /// Waits until the number of changes differs from `seen`.
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

    /// Performs one step of a session; returns whether it made progress.
    pub(super) fn step<S: Serve<H>>(&self, session: &mut S, peer: PeerId, now: Instant) -> bool {
        self.with(|inner| inner.step(session, peer, now)).unwrap_or_default()
    }

    pub(super) fn close<S: Serve<H>>(&self, session: &mut S, peer: PeerId, now: Instant) {
        self.update(|handler| session.close(handler, peer, now));
    }

    /// Returns the next unused peer number.
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
        let progressed = session.run(&mut self.handler, peer, now).is_some();
        if progressed {
            self.changed();
        }
        progressed
    }

    fn changed(&mut self) {
        self.changes = self.changes.wrapping_add(1);
        self.wakers.wake();
    }
}

impl<M: RawMutex, H: fmt::Debug, const WAITERS: usize> fmt::Debug for SharedHandler<M, H, WAITERS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.lock(|inner| match inner.try_borrow() {
            Ok(inner) => f.debug_tuple("SharedHandler").field(&inner.handler).finish(),
            Err(_) => f.write_str("SharedHandler(<in use>)"),
        })
    }
}

/// A session in progress; dropping it closes the session and notifies the handler.
pub(super) struct ActiveSession<'a, S: Serve<H>, M: RawMutex, H, const N: usize> {
    pub(super) session: &'a mut S,
    shared: &'a SharedHandler<M, H, N>,
    peer: PeerId,
}

impl<'a, S: Serve<H>, M: RawMutex, H, const N: usize> ActiveSession<'a, S, M, H, N> {
    pub(super) fn new(session: &'a mut S, shared: &'a SharedHandler<M, H, N>) -> Self {
        Self { session, shared, peer: shared.next_peer() }
    }

    /// Runs the session until it makes no progress; returns whether it made any.
    pub(super) fn run(&mut self, now: Instant) -> bool {
        let mut progressed = false;
        // one step for each lock, so that a busy peer does not block interrupts for long
        while self.shared.step(self.session, self.peer, now) {
            progressed = true;
        }
        progressed
    }
}

impl<S: Serve<H>, M: RawMutex, H, const N: usize> Drop for ActiveSession<'_, S, M, H, N> {
    fn drop(&mut self) {
        self.shared.close(self.session, self.peer, now());
    }
}
