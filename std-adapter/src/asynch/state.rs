//! The reports of a controller's task: its state and its counters.

use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use futures_core::Stream;
use tokio::sync::watch;

use super::socket::BoxFuture;
use crate::recovery::Recovery;

/// The state of a controller's connection.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum State {
    /// A session is being opened.
    Connecting,
    /// Calls can be made.
    Connected,
    /// There is no session; calls fail until there is one.
    Disconnected {
        /// Why.
        reason: String,
        /// The time until the next attempt.
        retry_in: Duration,
    },
    /// The task has ended: it was closed, or the connection over a stream of the caller was lost.
    Closed,
}

/// The counters of a controller's task, since it was started. They never decrease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Statistics {
    /// Operations that were carried out.
    pub operations: u64,
    /// Operations that failed, even without a connection.
    pub failures: u64,
    /// Values that were read for subscriptions.
    pub scanned: u64,
    /// Sessions that were opened.
    pub connections: u64,
    /// Sessions that were lost.
    pub losses: u64,
}

/// The [`Statistics`] that a task updates.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) operations: Counter,
    pub(super) failures: Counter,
    pub(super) scanned: Counter,
    pub(super) connections: Counter,
    pub(super) losses: Counter,
}

/// A number of events.
#[derive(Debug, Default)]
pub(super) struct Counter(AtomicU64);

impl Counter {
    pub(super) fn add(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Counters {
    pub(super) fn read(&self) -> Statistics {
        let Self { operations, failures, scanned, connections, losses } = self;
        Statistics {
            operations: operations.get(),
            failures: failures.get(),
            scanned: scanned.get(),
            connections: connections.get(),
            losses: losses.get(),
        }
    }
}

/// The latest values of something that changes: a stream that skips the values between two polls.
pub(super) struct Latest<T> {
    /// Ready when the value has changed or the task has ended; it returns the receiver.
    changed: BoxFuture<'static, (bool, watch::Receiver<T>)>,
}

impl<T: Clone + Send + Sync + 'static> Latest<T> {
    /// Begins with the next change, or with the current value when it is marked as changed.
    pub(super) fn new(mut receiver: watch::Receiver<T>) -> Self {
        Self {
            changed: Box::pin(async move {
                let open = receiver.changed().await.is_ok();
                (open, receiver)
            }),
        }
    }

    pub(super) fn poll(&mut self, context: &mut Context<'_>) -> Poll<Option<T>> {
        let Poll::Ready((open, mut receiver)) = self.changed.as_mut().poll(context) else { return Poll::Pending };
        let value = receiver.borrow_and_update().clone();
        *self = Self::new(receiver);
        Poll::Ready(open.then_some(value))
    }
}

/// The states of a controller, from [`Controller::states`](super::Controller::states): the current state first, then each new
/// state. States between two polls are skipped. It ends with the task.
#[must_use = "a stream does nothing unless it is polled"]
pub struct States(Latest<State>);

impl States {
    pub(super) fn new(mut states: watch::Receiver<State>) -> Self {
        states.mark_changed();
        Self(Latest::new(states))
    }

    /// Returns the next state; `None` when the task has ended.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future loses no state.
    pub async fn next(&mut self) -> Option<State> {
        std::future::poll_fn(|context| self.0.poll(context)).await
    }
}

/// The recoveries of the robot after lost connections, from [`Controller::recoveries`](super::Controller::recoveries). If
/// several happen between two polls, only the last is returned. The stream ends with the task.
#[must_use = "a stream does nothing unless it is polled"]
pub struct Recoveries(Latest<Option<Recovery>>);

impl Recoveries {
    pub(super) fn new(mut recoveries: watch::Receiver<Option<Recovery>>) -> Self {
        recoveries.mark_unchanged();
        Self(Latest::new(recoveries))
    }

    /// Returns the next recovery; `None` when the task has ended.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future loses no recovery.
    pub async fn next(&mut self) -> Option<Recovery> {
        std::future::poll_fn(|context| self.0.poll(context)).await.flatten()
    }
}

impl Stream for Recoveries {
    type Item = Recovery;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Recovery>> {
        self.0.poll(context).map(Option::flatten)
    }
}

impl Stream for States {
    type Item = State;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<State>> {
        self.0.poll(context)
    }
}
