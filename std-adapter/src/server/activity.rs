//! The activity of a connection, which determines whether it keeps its slot, and the signals that end it.
//!
//! A task registers its waker once and then reads a flag before it waits. A future for each signal would be polled for each
//! request, which is a tenth of the instructions of a small one.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

use bcap_core::peers::SlotState;
use bcap_core::time::Instant;

/// The activity of a connection's task, and the signals that end it.
#[derive(Debug)]
pub(super) struct Activity {
    /// The time in microseconds since which it is idle; [`BUSY`] while it is not.
    idle_since: AtomicU64,
    evicted: Signal,
    stopped: Signal,
    /// The waker of the task, once it has waited.
    task: Mutex<Option<Waker>>,
}

/// A flag that is set once.
#[derive(Debug, Default)]
struct Signal(AtomicBool);

/// The waker that an [`Activity`] has.
#[derive(Debug, Default)]
pub(super) struct Registered(Option<Waker>);

const BUSY: u64 = u64::MAX;

impl Activity {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            idle_since: AtomicU64::new(now.as_micros()),
            evicted: Signal::default(),
            stopped: Signal::default(),
            task: Mutex::default(),
        }
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

    /// Requests the connection's task to end as soon as it is idle.
    pub(super) fn evict(&self) {
        self.send(&self.evicted);
    }

    /// Requests the connection's task to end: the server stops.
    pub(super) fn stop(&self) {
        self.send(&self.stopped);
    }

    fn send(&self, signal: &Signal) {
        // The flag is set before the waker is read, and a task registers its waker before it reads the flag. So the task sees
        // the flag, or is woken.
        signal.0.store(true, Ordering::SeqCst);
        if let Some(task) = &*self.task.lock().unwrap_or_else(PoisonError::into_inner) {
            task.wake_by_ref();
        }
    }

    /// Returns whether the connection must end as soon as it is idle.
    pub(super) fn is_evicted(&self) -> bool {
        self.evicted.0.load(Ordering::SeqCst)
    }

    /// Returns whether the server stops.
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.0.load(Ordering::SeqCst)
    }

    /// Wakes this task at each further signal. It does nothing if `registered` is the same task already.
    fn register(&self, registered: &mut Registered, context: &Context<'_>) {
        if registered.0.as_ref().is_none_or(|waker| !waker.will_wake(context.waker())) {
            registered.0 = Some(context.waker().clone());
            *self.task.lock().unwrap_or_else(PoisonError::into_inner) = Some(context.waker().clone());
        }
    }

    /// Waits until the server stops, or until the connection is evicted if that `may_evict`; returns whether it is evicted.
    ///
    /// # Cancel safety
    ///
    /// Cancel safe.
    pub(super) async fn ended(&self, registered: &mut Registered, may_evict: bool) -> bool {
        std::future::poll_fn(|context| {
            self.register(registered, context);
            let evicted = may_evict && self.is_evicted();
            if evicted || self.is_stopped() { Poll::Ready(evicted) } else { Poll::Pending }
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[tokio::test]
    async fn a_signal_ends_a_wait_that_began_before_it_and_one_after_it() {
        let activity = Arc::new(Activity::new(Instant::ZERO));
        let waiting = Arc::clone(&activity);
        let task = tokio::spawn(async move { waiting.ended(&mut Registered::default(), false).await });
        tokio::task::yield_now().await;
        assert!(!task.is_finished(), "nothing was sent");
        activity.evict();
        tokio::task::yield_now().await;
        assert!(!task.is_finished() && activity.is_evicted(), "a busy connection is not evicted");
        activity.stop();
        assert!(!task.await.expect("the task was woken"), "the server stops");
        // the task has ended, so this one may wait
        assert!(activity.ended(&mut Registered::default(), true).await, "an idle connection is evicted");
        assert!(!activity.ended(&mut Registered::default(), false).await);
    }

    #[tokio::test]
    async fn a_task_with_another_waker_is_woken_too() {
        let activity = Arc::new(Activity::new(Instant::ZERO));
        let mut registered = Registered::default();
        activity.register(&mut registered, &Context::from_waker(Waker::noop()));
        let waiting = Arc::clone(&activity);
        let task = tokio::spawn(async move { waiting.ended(&mut registered, true).await });
        tokio::task::yield_now().await;
        activity.stop();
        assert!(!task.await.expect("the task was woken"));
    }
}
