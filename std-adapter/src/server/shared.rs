//! State that all tasks of a server share: the handler, the peer numbers, and change notifications.
//!
//! A call that waits is resumed when another request has changed something. [`ServerState::notify_change`] signals such a change,
//! and a task receives it through its [`Changes`].

use std::any::Any;
use std::borrow::Cow;
use std::cmp::Ordering::{Equal, Greater, Less};
use std::net::{IpAddr, SocketAddr};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use bcap_core::bcap::server as bcap;
use bcap_core::endpoint::{Serve, ServerEndpoint};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::peers::datagrams::SharedState;
use bcap_core::rac::{Request as RacRequest, server as rac};
use bcap_core::time::Instant;
use tokio::sync::Notify;

use super::limits::is_same_host;
use crate::clock::{now, until};

/// A session of either protocol whose handler is shared.
pub(super) trait ServeLocked<H>: for<'h> Serve<Locking<'h, H>> + Send {}

impl<H, S: for<'h> Serve<Locking<'h, H>> + Send> ServeLocked<H> for S {}

/// The handler, which many tasks call one at a time, and the state around it.
#[derive(Debug)]
pub(super) struct ServerState<H> {
    handler: Arc<Mutex<H>>,
    next_peer: AtomicU32,
    /// The number of requests whose handler waits.
    waiting: AtomicUsize,
    /// The number of tasks with such requests that the next change must wake.
    listening: AtomicUsize,
    /// The number of requests carried out while others waited.
    changes: AtomicUsize,
    changed: Notify,
    tap: OnceLock<Tap<H>>,
    on_connect: OnceLock<OnConnect<H>>,
}

/// A function that inspects the bytes of a frame or line before they are sent to a peer, and may change them. If it leaves
/// no bytes, nothing is sent; if it returns `Break`, the connection is closed.
pub type Tap<H> = fn(&mut H, PeerId, &mut Vec<u8>) -> ControlFlow<()>;

/// A function that receives the address of a new client, before its first call.
pub type OnConnect<H> = fn(&mut H, PeerId, IpAddr);

impl<H> ServerState<H> {
    pub(super) fn new(handler: Arc<Mutex<H>>) -> Self {
        Self {
            handler,
            next_peer: AtomicU32::new(1),
            waiting: AtomicUsize::new(0),
            listening: AtomicUsize::new(0),
            changes: AtomicUsize::new(0),
            changed: Notify::new(),
            tap: OnceLock::new(),
            on_connect: OnceLock::new(),
        }
    }

    /// Returns a number that no peer has had before.
    pub(super) fn next_peer(&self) -> PeerId {
        PeerId(self.next_peer.fetch_add(1, Ordering::Relaxed))
    }

    pub(super) fn set_tap(&self, tap: Tap<H>) {
        // the first tap stays
        let _ = self.tap.set(tap);
    }

    pub(super) fn set_on_connect(&self, on_connect: OnConnect<H>) {
        // the first function stays
        let _ = self.on_connect.set(on_connect);
    }

    /// Passes the address of a new client to the handler.
    pub(super) fn connected(&self, peer: PeerId, address: IpAddr) {
        if let Some(on_connect) = self.on_connect.get() {
            self.handler().with_handler(peer, |handler| on_connect(handler, peer, address));
        }
    }

    /// Passes bytes through the tap before they are sent, and returns them, or its own bytes; `None` if the connection must be
    /// closed.
    pub(super) fn tapped<'b>(&self, peer: PeerId, bytes: &'b [u8]) -> Option<Cow<'b, [u8]>> {
        let Some(tap) = self.tap.get() else { return Some(bytes.into()) };
        let mut bytes = bytes.to_vec();
        match self.handler().with_handler(peer, |handler| tap(handler, peer, &mut bytes))? {
            ControlFlow::Continue(()) => Some(bytes.into()),
            ControlFlow::Break(()) => None,
        }
    }

    /// Returns the handler for a session. The lock is taken for each call only, so decoding a large request holds no lock.
    pub(super) fn handler(&self) -> Locking<'_, H> {
        Locking(&self.handler)
    }

    /// Notifies waiting tasks that something may have changed.
    ///
    /// Every call of every peer ends here. Most waiting tasks are in their [`PAUSE`]: they are not woken, and see the change
    /// when the pause ends.
    pub(super) fn notify_change(&self) {
        if self.waiting.load(Ordering::Acquire) > 0 {
            // This increments `changes`, then reads `listening`; `change_after` increments `listening`, then reads `changes`.
            // With SeqCst at least one of the two sees the other's increment, so no change is missed.
            self.changes.fetch_add(1, Ordering::SeqCst);
            if self.listening.load(Ordering::SeqCst) > 0 {
                self.changed.notify_waiters();
            }
        }
    }

    /// Waits until the number of changes differs from `seen`; returns the new number.
    async fn change_after(&self, seen: usize) -> usize {
        struct ListenGuard<'s>(&'s AtomicUsize);
        impl Drop for ListenGuard<'_> {
            fn drop(&mut self) {
                self.0.fetch_sub(1, Ordering::SeqCst);
            }
        }
        loop {
            // `notify_waiters` wakes this future from now on, even before it is polled
            let changed = self.changed.notified();
            self.listening.fetch_add(1, Ordering::SeqCst);
            let _listening = ListenGuard(&self.listening);
            let changes = self.changes.load(Ordering::SeqCst);
            if changes != seen {
                return changes;
            }
            changed.await;
        }
    }

    /// Subscribes to changes from now on.
    pub(super) fn changes(self: &Arc<Self>) -> Changes<H> {
        Changes { shared: Arc::clone(self), seen: 0, waiting: 0, not_before: now() }
    }
}

impl<H, S: ServeLocked<H>> SharedState<S> for ServerState<H> {
    type Address = SocketAddr;

    fn is_same_host(one: SocketAddr, other: SocketAddr) -> bool {
        is_same_host(one.ip(), other.ip())
    }

    fn connect(&self, address: SocketAddr) -> PeerId {
        let peer = self.next_peer();
        self.connected(peer, address.ip());
        peer
    }

    /// Performs one step of a session, and notifies waiting tasks.
    fn step(&self, session: &mut S, peer: PeerId, now: Instant) -> bool {
        let Some(event) = session.run(&mut self.handler(), peer, now) else { return false };
        tracing::trace!(peer = peer.0, ?event);
        self.notify_change();
        true
    }

    /// Ends a session: releases the objects of its peer.
    fn close(&self, session: &mut S, peer: PeerId, now: Instant) {
        session.close(&mut self.handler(), peer, now);
        self.notify_change();
    }
}

/// The handler, locked during each call. A panic in a call fails that call with E_UNEXPECTED and has no other effect.
#[derive(Debug)]
pub(super) struct Locking<'s, H>(&'s Mutex<H>);

impl<H> Locking<'_, H> {
    /// Locks the handler and calls `call`; `None` if it panicked.
    fn with_handler<T>(&mut self, peer: PeerId, call: impl FnOnce(&mut H) -> T) -> Option<T> {
        // a handler that panicked before still serves its other peers
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
        self.with_handler(peer, |handler| call(handler, reply)).unwrap_or_else(|| {
            reply.clear();
            HResult::E_UNEXPECTED.into()
        })
    }
}

/// Drops a panic's payload. The payload's destructor is code of the handler and may panic too; that second payload is leaked,
/// which bounds the recursion.
fn discard(payload: Box<dyn Any + Send>) {
    if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(second);
    }
}

impl<H: bcap::Handler> bcap::Handler for Locking<'_, H> {
    fn call(&mut self, peer: PeerId, request: &bcap::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.answer(peer, reply, |handler, reply| handler.call(peer, request, reply, now))
    }

    fn resume(
        &mut self,
        peer: PeerId,
        request: &bcap::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        self.answer(peer, reply, |handler, reply| handler.resume(peer, request, reply, now))
    }

    fn release(&mut self, peer: PeerId, request: &bcap::Request<'_>, now: Instant) {
        self.with_handler(peer, |handler| handler.release(peer, request, now));
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.with_handler(peer, |handler| handler.abandoned(peer, now));
    }

    fn refused(&mut self, peer: PeerId, request: &bcap::Request<'_>, code: HResult, now: Instant) {
        self.with_handler(peer, |handler| handler.refused(peer, request, code, now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.with_handler(peer, |handler| handler.left(peer, now));
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
        self.with_handler(peer, |handler| handler.abandoned(peer, now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.with_handler(peer, |handler| handler.left(peer, now));
    }
}

/// A task's subscription to changes.
#[derive(Debug)]
pub(super) struct Changes<H> {
    shared: Arc<ServerState<H>>,
    /// The number of changes when the handler was called last.
    seen: usize,
    /// The number of requests of this task whose handler waits.
    waiting: usize,
    /// The earliest time for the next change; see [`PAUSE`].
    not_before: Instant,
}

/// The pause of a waiting task between two changes, for each waiting request of the server. It lasts at least
/// [`MIN_PAUSE`].
///
/// Every change resumes all waiting requests. Without a pause, each short call would resume two hundred long ones and be
/// slowed by them. With it, waiting requests are resumed at most 20,000 times a second in total.
const PAUSE: Duration = Duration::from_micros(50);
const MIN_PAUSE: Duration = Duration::from_millis(1);

impl<H> Changes<H> {
    /// Sets how many requests of this task wait for changes. A task must call this before it calls its handler, or it can
    /// miss a change.
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

    /// Runs a session until `step` has nothing to do.
    pub(super) fn run<M: ServerEndpoint>(&mut self, session: &mut M, mut step: impl FnMut(&mut M) -> bool) {
        // register before the handler runs, so that no change of another peer is missed
        self.wait(session.is_running().into());
        while step(session) {}
        if session.is_running() && self.waiting == 0 {
            // the handler has just begun to wait: call it once more now that this task is registered for changes
            self.wait(1);
            step(session);
        }
    }

    /// Waits for the next change; never returns while no request of this task waits.
    ///
    /// # Cancel safety
    ///
    /// Cancel safe: a change that was not returned is returned by the next call.
    pub(super) async fn next(&mut self) {
        if self.waiting == 0 {
            std::future::pending().await
        }
        // while the task sleeps, `listening` does not count it and notifications cost nothing
        let pause = until(self.not_before);
        if !pause.is_zero() {
            tokio::time::sleep(pause).await;
        }
        self.seen = self.shared.change_after(self.seen).await;
        let waiting = u32::try_from(self.shared.waiting.load(Ordering::Acquire)).unwrap_or(u32::MAX);
        self.not_before = now().saturating_add(PAUSE.saturating_mul(waiting).max(MIN_PAUSE));
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
    use bcap_core::bcap::{Args, FunctionId};

    /// A handler that counts the releases by the server and the calls of its peers separately.
    #[derive(Default)]
    struct Counter {
        calls: usize,
        releases: usize,
    }

    impl bcap::Handler for Counter {
        fn call(&mut self, _: PeerId, _: &bcap::Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
            self.calls += 1;
            HResult::S_OK.into()
        }

        fn release(&mut self, _: PeerId, _: &bcap::Request<'_>, _: Instant) {
            self.releases += 1;
        }
    }

    #[test]
    fn a_release_is_not_a_call_of_the_handler() {
        let handler = Mutex::new(Counter::default());
        let request = bcap::Request::new(FunctionId::SERVICE_STOP, Args::NONE);
        bcap::Handler::release(&mut Locking(&handler), PeerId(1), &request, Instant::ZERO);
        let counter = handler.lock().unwrap();
        assert_eq!((counter.calls, counter.releases), (0, 1));
    }

    fn shared() -> Arc<ServerState<()>> {
        Arc::new(ServerState::new(Arc::default()))
    }

    /// Returns whether a change is received within 100 ms.
    async fn is_notified(changes: &mut Changes<()>) -> bool {
        tokio::time::timeout(Duration::from_millis(100), changes.next()).await.is_ok()
    }

    #[tokio::test]
    async fn a_waiting_task_receives_each_change_once() {
        let shared = shared();
        let mut changes = shared.changes();
        shared.notify_change();
        assert!(!is_notified(&mut changes).await, "no request waits");
        changes.wait(1);
        assert!(!is_notified(&mut changes).await, "the change was before the wait");
        assert_eq!(shared.listening.load(Ordering::SeqCst), 0, "a cancelled task does not listen");
        shared.notify_change();
        shared.notify_change();
        assert!(is_notified(&mut changes).await, "changed before the task listened");
        shared.notify_change();
        assert!(is_notified(&mut changes).await, "changed during the pause");
        assert!(!is_notified(&mut changes).await, "no further change");
        let (notified, ()) = tokio::join!(is_notified(&mut changes), async { shared.notify_change() });
        assert!(notified, "changed while the task listened");
        changes.wait(3);
        assert_eq!(shared.waiting.load(Ordering::Acquire), 3);
        drop(changes);
        assert_eq!(shared.waiting.load(Ordering::Acquire), 0);
    }

    #[test]
    fn no_change_is_missed_between_the_check_and_the_wait() {
        const ROUNDS: usize = 20_000;
        let shared = shared();
        shared.waiting.store(1, Ordering::Release);
        let changing = Arc::clone(&shared);
        let received = Arc::new(AtomicUsize::new(0));
        let acknowledged = Arc::clone(&received);
        let changer = std::thread::spawn(move || {
            for round in 0..ROUNDS {
                while acknowledged.load(Ordering::Acquire) < round {
                    std::thread::yield_now();
                }
                changing.notify_change();
            }
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            for round in 0..ROUNDS {
                let change = shared.change_after(round);
                let changes = tokio::time::timeout(Duration::from_secs(10), change).await.expect("a change");
                assert_eq!(changes, round + 1);
                received.store(changes, Ordering::Release);
            }
        });
        changer.join().unwrap();
    }
}
