//! What all tasks of a server share: the handler, the numbers of peers, and the news that something has changed.

use std::any::Any;
use std::cmp::Ordering::{Equal, Greater, Less};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use bcap_core::bcap::server as bcap;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request as RacRequest, server as rac};
use bcap_core::time::Instant;
use tokio::sync::Notify;

use crate::clock::{now, until};

/// A handler that many tasks call, one at a time.
#[derive(Debug)]
pub(super) struct Shared<H> {
    handler: Arc<Mutex<H>>,
    next_peer: AtomicU32,
    /// Requests whose handler waits.
    waiting: AtomicUsize,
    /// Tasks with such requests that are to be woken by the next change.
    listening: AtomicUsize,
    /// How often a request has been carried out while others waited.
    changes: AtomicUsize,
    changed: Notify,
    tap: OnceLock<Tap<H>>,
}

/// Looks at the bytes of a frame or line before they are sent to a peer, and may change them; without bytes nothing is
/// sent, and with `Break` the connection is closed.
pub type Tap<H> = fn(&mut H, PeerId, &mut Vec<u8>) -> ControlFlow<()>;

impl<H> Shared<H> {
    pub(super) fn new(handler: Arc<Mutex<H>>) -> Self {
        Self {
            handler,
            next_peer: AtomicU32::new(1),
            waiting: AtomicUsize::new(0),
            listening: AtomicUsize::new(0),
            changes: AtomicUsize::new(0),
            changed: Notify::new(),
            tap: OnceLock::new(),
        }
    }

    /// Returns a number that no peer has had before.
    pub(super) fn next_peer(&self) -> PeerId {
        PeerId(self.next_peer.fetch_add(1, Ordering::Relaxed))
    }

    pub(super) fn set_tap(&self, tap: Tap<H>) {
        // whoever was first stays
        let _ = self.tap.set(tap);
    }

    /// Returns what the tap makes of bytes that are to be sent; `None` when the connection is to be closed.
    pub(super) fn tapped(&self, peer: PeerId, bytes: &[u8]) -> Option<Tapped> {
        let Some(tap) = self.tap.get() else { return Some(Tapped::Untouched) };
        let mut bytes = bytes.to_vec();
        match self.handler().ask(peer, |handler| tap(handler, peer, &mut bytes))? {
            ControlFlow::Continue(()) => Some(Tapped::Instead(bytes)),
            ControlFlow::Break(()) => None,
        }
    }

    /// Returns the handler for a session. It is locked for each call, so that decoding a large request holds no lock.
    pub(super) fn handler(&self) -> Locking<'_, H> {
        Locking(&self.handler)
    }

    /// Tells those who wait that something may have changed. Every call of every peer comes by here, and most of those who
    /// wait pause most of the time: they are not woken, and see the change when their pause is over.
    pub(super) fn has_changed(&self) {
        if self.waiting.load(Ordering::Acquire) > 0 {
            // counted, then looked who listens; a listener is noted, then looks at the count: one sees the other
            self.changes.fetch_add(1, Ordering::SeqCst);
            if self.listening.load(Ordering::SeqCst) > 0 {
                self.changed.notify_waiters();
            }
        }
    }

    /// Waits until there are not as many changes any more; returns how many there are.
    async fn change_after(&self, seen: usize) -> usize {
        struct Listening<'s>(&'s AtomicUsize);
        impl Drop for Listening<'_> {
            fn drop(&mut self) {
                self.0.fetch_sub(1, Ordering::SeqCst);
            }
        }
        loop {
            // it hears from now on, whenever it is awaited
            let changed = self.changed.notified();
            self.listening.fetch_add(1, Ordering::SeqCst);
            let _listening = Listening(&self.listening);
            let changes = self.changes.load(Ordering::SeqCst);
            if changes != seen {
                return changes;
            }
            changed.await;
        }
    }

    /// Listens for changes from now on.
    pub(super) fn changes(self: &Arc<Self>) -> Changes<H> {
        Changes { shared: Arc::clone(self), seen: 0, waiting: 0, not_before: now() }
    }
}

/// The handler, locked for the time of each call. A panic in a call ends that call with E_UNEXPECTED, and nothing else.
#[derive(Debug)]
pub(super) struct Locking<'s, H>(&'s Mutex<H>);

impl<H> Locking<'_, H> {
    /// Calls the handler; `None` when it panicked.
    fn ask<T>(&mut self, peer: PeerId, call: impl FnOnce(&mut H) -> T) -> Option<T> {
        // a handler that panicked before is used on, for its other peers
        let mut handler = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match catch_unwind(AssertUnwindSafe(|| call(&mut handler))) {
            Ok(answer) => Some(answer),
            Err(payload) => {
                tracing::error!(peer = peer.0, "the handler has panicked");
                discard(payload);
                None
            }
        }
    }

    fn answer(
        &mut self,
        peer: PeerId,
        reply: &mut ReplyValue<'_>,
        call: impl FnOnce(&mut H, &mut ReplyValue<'_>) -> Outcome,
    ) -> Outcome {
        self.ask(peer, |handler| call(handler, reply)).unwrap_or_else(|| {
            reply.clear();
            HResult::E_UNEXPECTED.into()
        })
    }
}

/// Drops a panic's payload. That runs code of the handler once more, which may panic as well; the second payload is leaked,
/// so that this ends.
fn discard(payload: Box<dyn Any + Send>) {
    if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(second);
    }
}

impl<H: bcap::Handler> bcap::Handler for Locking<'_, H> {
    fn call(&mut self, peer: PeerId, request: &bcap::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.answer(peer, reply, |handler, reply| handler.call(peer, request, reply, now))
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.ask(peer, |handler| handler.abandoned(peer, now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.ask(peer, |handler| handler.left(peer, now));
    }
}

impl<H: rac::Handler> rac::Handler for Locking<'_, H> {
    fn call(&mut self, peer: PeerId, request: &RacRequest<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.answer(peer, reply, |handler, reply| handler.call(peer, request, reply, now))
    }

    fn resume(&mut self, peer: PeerId, request: &RacRequest<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.answer(peer, reply, |handler, reply| handler.resume(peer, request, reply, now))
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.ask(peer, |handler| handler.abandoned(peer, now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.ask(peer, |handler| handler.left(peer, now));
    }
}

/// What is to be sent.
#[derive(Debug)]
pub(super) enum Tapped {
    /// The bytes as they are.
    Untouched,
    /// These in their place.
    Instead(Vec<u8>),
}

/// A task's ear for changes.
#[derive(Debug)]
pub(super) struct Changes<H> {
    shared: Arc<Shared<H>>,
    /// How many changes there were when the handler was asked last.
    seen: usize,
    /// Requests of this task whose handler waits.
    waiting: usize,
    /// When the next change may be returned; see [`PAUSE`].
    not_before: Instant,
}

/// How long a task that waits hears of no change after the last one: so long for each request that waits, whosever it is,
/// and not less than [`LEAST_PAUSE`].
///
/// Every change asks again for all requests that wait. Without a pause two hundred long calls would be asked again for each call of
/// somebody else, who would pay for it; with it, all of them together are asked 20,000 times a second at most.
const PAUSE: Duration = Duration::from_micros(50);
const LEAST_PAUSE: Duration = Duration::from_millis(1);

impl<H> Changes<H> {
    /// Says how many requests of this task wait for changes; it must say so before it asks its handler, not to miss one.
    pub(super) fn wait(&mut self, requests: usize) {
        let before = std::mem::replace(&mut self.waiting, requests);
        match requests.cmp(&before) {
            Less => drop(self.shared.waiting.fetch_sub(before - requests, Ordering::AcqRel)),
            Equal => {}
            Greater => drop(self.shared.waiting.fetch_add(requests - before, Ordering::AcqRel)),
        }
        if before == 0 && requests > 0 {
            self.seen = self.shared.changes.load(Ordering::SeqCst);
        }
    }

    /// Returns how many requests of this task wait for changes.
    pub(super) const fn waiting(&self) -> usize {
        self.waiting
    }

    /// Waits for the next change; for ever while this task does not wait for any.
    ///
    /// # Cancel safety
    ///
    /// A change that was not returned is returned next time.
    pub(super) async fn next(&mut self) {
        if self.waiting == 0 {
            std::future::pending().await
        }
        // while it sleeps nobody has to wake it
        let pause = until(self.not_before);
        if !pause.is_zero() {
            tokio::time::sleep(pause).await;
        }
        self.seen = self.shared.change_after(self.seen).await;
        let waiting = u32::try_from(self.shared.waiting.load(Ordering::Acquire)).unwrap_or(u32::MAX);
        self.not_before = now().saturating_add(PAUSE.saturating_mul(waiting).max(LEAST_PAUSE));
    }
}

impl<H> Drop for Changes<H> {
    fn drop(&mut self) {
        self.wait(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shared() -> Arc<Shared<()>> {
        Arc::new(Shared::new(Arc::default()))
    }

    /// Returns whether a change is heard of soon.
    async fn is_heard(changes: &mut Changes<()>) -> bool {
        tokio::time::timeout(Duration::from_millis(100), changes.next()).await.is_ok()
    }

    #[tokio::test]
    async fn a_change_is_heard_once_by_those_who_wait_for_it() {
        let shared = shared();
        let mut changes = shared.changes();
        shared.has_changed();
        assert!(!is_heard(&mut changes).await, "it does not wait");
        changes.wait(1);
        assert!(!is_heard(&mut changes).await, "that was before");
        assert_eq!(shared.listening.load(Ordering::SeqCst), 0, "who has been cancelled does not listen");
        shared.has_changed();
        shared.has_changed();
        assert!(is_heard(&mut changes).await, "while nobody listened");
        shared.has_changed();
        assert!(is_heard(&mut changes).await, "while it paused");
        assert!(!is_heard(&mut changes).await, "nothing is new");
        let (heard, ()) = tokio::join!(is_heard(&mut changes), async { shared.has_changed() });
        assert!(heard, "while it listened");
        changes.wait(3);
        assert_eq!(shared.waiting.load(Ordering::Acquire), 3);
        drop(changes);
        assert_eq!(shared.waiting.load(Ordering::Acquire), 0);
    }

    #[test]
    fn no_change_is_missed_between_looking_and_listening() {
        const ROUNDS: usize = 20_000;
        let shared = shared();
        shared.waiting.store(1, Ordering::Release);
        let changing = Arc::clone(&shared);
        let heard = Arc::new(AtomicUsize::new(0));
        let has_heard = Arc::clone(&heard);
        let changer = std::thread::spawn(move || {
            for round in 0..ROUNDS {
                while has_heard.load(Ordering::Acquire) < round {
                    std::thread::yield_now();
                }
                changing.has_changed();
            }
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            for round in 0..ROUNDS {
                let change = shared.change_after(round);
                let changes = tokio::time::timeout(Duration::from_secs(10), change).await.expect("a change");
                assert_eq!(changes, round + 1);
                heard.store(changes, Ordering::Release);
            }
        });
        changer.join().unwrap();
    }
}
