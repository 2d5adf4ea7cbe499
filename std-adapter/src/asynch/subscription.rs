//! Subscriptions: variables that a task reads at an interval, and reports when they change.
//!
//! ```text
//!  Scanner: a variable ─► its Subscribers ─► the queue of each Subscription ─► next
//! ```

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;
use futures_core::Stream;

use super::socket::Socket;
use crate::error::Error;
use crate::session::Session;

/// A value that was read for a subscription, or the reason why it could not be read.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Reading {
    /// The variable, by the name that was subscribed.
    pub name: Arc<str>,
    /// When the reply arrived, or the reading failed.
    pub at: std::time::Instant,
    /// The value.
    pub value: Result<OwnedVariant, Arc<Error>>,
}

impl Reading {
    /// Returns whether this reading differs from the previous one.
    fn differs(&self, before: &Self) -> bool {
        match (&self.value, &before.value) {
            (Ok(value), Ok(before)) => value != before,
            (Err(error), Err(before)) => error.to_string() != before.to_string(),
            _ => true,
        }
    }
}

/// The changes of variables, from [`Controller::subscribe`](super::Controller::subscribe).
///
/// The first item of each variable is its first value. Then there is an item when a reading differs from the previous one:
/// another value, an error, or a value after an error. A reading that is replaced before it is taken is skipped, so a slow
/// receiver sees the latest values and costs no memory. The stream ends when the task does. Dropping it ends the subscription.
///
/// # Examples
///
/// ```no_run
/// # async fn example(cell: bcap_std::asynch::Controller) {
/// let mut changes = cell.subscribe(&["I1", "IO128"], std::time::Duration::from_millis(50));
/// while let Some(reading) = changes.next().await {
///     println!("{}: {:?}", reading.name, reading.value);
/// }
/// # }
/// ```
#[must_use = "a stream does nothing unless it is polled"]
pub struct Subscription {
    queue: Arc<Mutex<Queue>>,
}

/// The last reading of each variable of a subscription, and the order of the readings that were not taken.
#[derive(Default)]
struct Queue {
    last: Vec<Option<Reading>>,
    /// Indices of `last`, each at most once.
    changed: VecDeque<usize>,
    is_closed: bool,
    waker: Option<Waker>,
}

/// Locks a queue; no code that holds the lock can panic.
fn lock(queue: &Mutex<Queue>) -> MutexGuard<'_, Queue> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Subscription {
    /// Returns a subscription, and a subscriber for each variable.
    pub(super) fn new(names: &[&str]) -> (Self, Vec<Subscriber>) {
        let queue = Queue { last: vec![None; names.len()], is_closed: names.is_empty(), ..Queue::default() };
        let queue = Arc::new(Mutex::new(queue));
        let closer = Arc::new(Closer(Arc::downgrade(&queue)));
        let subscriber =
            |(index, name): (usize, &&str)| Subscriber { name: (*name).into(), index, closer: closer.clone() };
        let subscribers = names.iter().enumerate().map(subscriber).collect();
        (Self { queue }, subscribers)
    }

    /// Returns the next change; `None` when the task has ended.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future loses no change.
    pub async fn next(&mut self) -> Option<Reading> {
        std::future::poll_fn(|context| self.poll(context)).await
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<Option<Reading>> {
        let mut queue = lock(&self.queue);
        if let Some(index) = queue.changed.pop_front() {
            return Poll::Ready(queue.last.get(index).cloned().flatten());
        }
        if queue.is_closed {
            return Poll::Ready(None);
        }
        queue.waker = Some(context.waker().clone());
        Poll::Pending
    }
}

impl Stream for Subscription {
    type Item = Reading;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Reading>> {
        self.poll(context)
    }
}

/// A variable of a subscription, at the side of the task.
pub(super) struct Subscriber {
    name: Arc<str>,
    index: usize,
    closer: Arc<Closer>,
}

/// Ends a subscription when its last subscriber is dropped.
struct Closer(Weak<Mutex<Queue>>);

impl Drop for Closer {
    fn drop(&mut self) {
        if let Some(queue) = self.0.upgrade() {
            let waker = {
                let mut queue = lock(&queue);
                queue.is_closed = true;
                queue.waker.take()
            };
            waker.into_iter().for_each(Waker::wake);
        }
    }
}

impl Subscriber {
    /// Returns whether the subscription still exists.
    fn is_wanted(&self) -> bool {
        self.closer.0.strong_count() > 0
    }

    fn report(&self, value: &Result<OwnedVariant, Arc<Error>>, at: std::time::Instant) {
        let Some(queue) = self.closer.0.upgrade() else { return };
        let reading = Reading { name: self.name.clone(), at, value: value.clone() };
        let waker = {
            let mut queue = lock(&queue);
            let Queue { last, changed, waker, .. } = &mut *queue;
            let Some(last) = last.get_mut(self.index) else { return };
            if last.as_ref().is_some_and(|last| !reading.differs(last)) {
                return;
            }
            *last = Some(reading);
            if !changed.contains(&self.index) {
                changed.push_back(self.index);
            }
            waker.take()
        };
        waker.into_iter().for_each(Waker::wake);
    }
}

/// All subscriptions of a controller: each variable is read once for all of its subscribers, at the shortest of their
/// intervals.
#[derive(Default)]
pub(super) struct Scanner {
    variables: Vec<Scanned>,
}

struct Scanned {
    name: Arc<str>,
    /// When it is read next.
    next: Instant,
    subscribers: Vec<(Duration, Subscriber)>,
}

impl Scanner {
    /// Adds the variables of a subscription, which are read immediately.
    pub(super) fn add(&mut self, subscribers: Vec<Subscriber>, interval: Duration) {
        for subscriber in subscribers {
            let name = subscriber.name.clone();
            let subscriber = (interval.max(SHORTEST), subscriber);
            match self.variables.iter_mut().find(|scanned| scanned.name == name) {
                Some(scanned) => {
                    scanned.subscribers.push(subscriber);
                    scanned.next = Instant::ZERO;
                }
                None => self.variables.push(Scanned { name, next: Instant::ZERO, subscribers: vec![subscriber] }),
            }
        }
    }

    /// Returns when the next variable is read.
    pub(super) fn next(&self) -> Option<Instant> {
        self.variables.iter().map(|scanned| scanned.next).min()
    }

    /// Schedules all variables for immediate reading, for a new session with another clock.
    pub(super) fn restart(&mut self) {
        self.variables.iter_mut().for_each(|scanned| scanned.next = Instant::ZERO);
    }

    /// Reads the variable with the earliest time; returns whether it was read.
    pub(super) async fn read(&mut self, session: &mut Session<Socket>) -> bool {
        self.variables.retain_mut(Scanned::is_wanted);
        let Some(scanned) = self.variables.iter_mut().min_by_key(|scanned| scanned.next) else { return false };
        let reading = session.read::<OwnedVariant>(Object::Controller, &scanned.name).await;
        // from now on, not from the planned time, so that a slow controller gets no burst of reads
        scanned.next = session.now().saturating_add(scanned.interval());
        let read = reading.is_ok();
        scanned.report(&reading.map_err(Arc::new));
        read
    }

    /// Reports to all subscribers that there is no connection.
    pub(super) fn fail(&mut self, error: &Arc<Error>) {
        self.variables.retain_mut(Scanned::is_wanted);
        self.variables.iter().for_each(|scanned| scanned.report(&Err(Arc::clone(error))));
    }
}

/// The shortest interval of a subscription.
const SHORTEST: Duration = Duration::from_millis(1);

impl Scanned {
    /// Drops subscribers that have ended, and returns whether there are others.
    fn is_wanted(&mut self) -> bool {
        self.subscribers.retain(|(_, subscriber)| subscriber.is_wanted());
        !self.subscribers.is_empty()
    }

    fn interval(&self) -> Duration {
        self.subscribers.iter().map(|(interval, _)| *interval).min().unwrap_or(SHORTEST)
    }

    fn report(&self, value: &Result<OwnedVariant, Arc<Error>>) {
        let at = std::time::Instant::now();
        self.subscribers.iter().for_each(|(_, subscriber)| subscriber.report(value, at));
    }
}
