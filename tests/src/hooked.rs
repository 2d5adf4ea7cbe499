//! A handler whose answers to some calls are replaced, delayed or recorded.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;

/// Returns the outcome of a call, or `None` to leave it to the handler. The flag is set for a new call, and not for one that
/// waits.
type Hook = Box<dyn FnMut(&Request<'_>, bool) -> Option<Outcome> + Send>;

/// A handler behind a hook.
pub struct Hooked<H> {
    /// The handler.
    pub inner: H,
    hook: Hook,
    /// Clients whose call waits because of the hook: the handler has not seen it.
    waiting: BTreeSet<PeerId>,
}

impl<H> fmt::Debug for Hooked<H> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hooked").field("waiting", &self.waiting).finish_non_exhaustive()
    }
}

impl<H> Hooked<H> {
    /// Wraps a handler that answers all calls.
    pub fn new(inner: H) -> Self {
        Self { inner, hook: Box::new(|_, _| None), waiting: BTreeSet::new() }
    }

    /// Calls `hook` before the inner handler from now on.
    pub fn set(&mut self, mut hook: impl FnMut(&Request<'_>) -> Option<HResult> + Send + 'static) {
        self.hook = Box::new(move |request, is_new| if is_new { hook(request).map(Into::into) } else { None });
    }

    /// Answers `left` more calls of a function, and none after them. The receiver gets a message when the next call has
    /// arrived.
    pub fn stall(&mut self, function: FunctionId, mut left: u32) -> Receiver<()> {
        let (stalled, receiver) = sync_channel(1);
        self.hook = Box::new(move |request, is_new| {
            if request.function != function {
                return None;
            }
            if left > 0 {
                left -= u32::from(is_new);
                return None;
            }
            if is_new {
                let _ = stalled.try_send(());
            }
            Some(Outcome::Wait(Instant::FAR_FUTURE))
        });
        receiver
    }

    /// Delays the calls that `is_held` selects until `release` gets a message. The receiver gets one when the first call has
    /// arrived.
    pub fn hold(
        &mut self,
        is_held: impl Fn(&Request<'_>) -> bool + Send + 'static,
        release: Receiver<()>,
    ) -> Receiver<()> {
        let (held, receiver) = sync_channel(1);
        let mut is_released = false;
        self.hook = Box::new(move |request, is_new| {
            if is_released || !is_held(request) {
                return None;
            }
            if is_new {
                let _ = held.try_send(());
            }
            is_released = release.try_recv() != Err(TryRecvError::Empty);
            (!is_released).then(|| Outcome::Wait(bcap_std::now() + Duration::from_millis(1)))
        });
        receiver
    }
}

impl<H: Handler> Handler for Hooked<H> {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        match (self.hook)(request, true) {
            None => self.inner.call(peer, request, reply, now),
            Some(outcome) => {
                if matches!(outcome, Outcome::Wait(_)) {
                    self.waiting.insert(peer);
                }
                outcome
            }
        }
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        if !self.waiting.contains(&peer) {
            return self.inner.resume(peer, request, reply, now);
        }
        match (self.hook)(request, false) {
            Some(outcome @ Outcome::Wait(_)) => outcome,
            outcome => {
                self.waiting.remove(&peer);
                outcome.unwrap_or_else(|| self.inner.call(peer, request, reply, now))
            }
        }
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        if !self.waiting.remove(&peer) {
            self.inner.abandoned(peer, now);
        }
    }

    fn refused(&mut self, peer: PeerId, request: &Request<'_>, code: HResult, now: Instant) {
        self.inner.refused(peer, request, code, now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.waiting.remove(&peer);
        self.inner.left(peer, now);
    }
}

impl<H: rac::server::Handler> rac::server::Handler for Hooked<H> {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.inner.call(peer, request, reply, now)
    }
}
