//! Wakes tasks, for any executor.

use core::future::poll_fn;
use core::pin::Pin;
use core::task::{Context, Poll, Waker};

/// Wakes one task; a notification without a waiting task stays pending.
#[derive(Debug, Default)]
pub(super) struct Notify {
    pending: bool,
    waker: Option<Waker>,
}

impl Notify {
    pub(super) fn notify(&mut self) {
        self.pending = true;
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }

    pub(super) fn poll(&mut self, cx: &Context<'_>) -> Poll<()> {
        if core::mem::take(&mut self.pending) {
            return Poll::Ready(());
        }
        match &mut self.waker {
            Some(waker) => waker.clone_from(cx.waker()),
            None => self.waker = Some(cx.waker().clone()),
        }
        Poll::Pending
    }
}

/// Waits for `work` or `end`; `None` when `end` is ready first. Both are pinned by the caller, because an async function keeps
/// a second copy of a future that it pins.
pub(super) async fn first<T>(
    mut work: Pin<&mut impl Future<Output = T>>,
    mut end: Pin<&mut impl Future<Output = ()>>,
) -> Option<T> {
    poll_fn(|cx| match work.as_mut().poll(cx) {
        Poll::Ready(done) => Poll::Ready(Some(done)),
        Poll::Pending => end.as_mut().poll(cx).map(|()| None),
    })
    .await
}

/// Waits for `end` or `work`, and polls `end` first: it costs less, and then often `work` need not be polled.
pub(super) async fn unless<T>(
    mut end: Pin<&mut impl Future<Output = ()>>,
    mut work: Pin<&mut impl Future<Output = T>>,
) -> Option<T> {
    poll_fn(|cx| match end.as_mut().poll(cx) {
        Poll::Ready(()) => Poll::Ready(None),
        Poll::Pending => work.as_mut().poll(cx).map(Some),
    })
    .await
}

/// Lets the other tasks run.
pub(super) async fn yield_now() {
    let mut yielded = false;
    poll_fn(|cx| {
        if core::mem::replace(&mut yielded, true) {
            return Poll::Ready(());
        }
        cx.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}
