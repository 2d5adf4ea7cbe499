//! Subscriptions: variables that a task reads at an interval, and reports when they change.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;
use futures_core::Stream;
use tokio::sync::watch;

use super::socket::Socket;
use super::state::Latest;
use crate::error::Error;
use crate::session::Session;

/// A value that was read for a subscription, or why it was not.
pub type Reading = Result<OwnedVariant, Arc<Error>>;

/// The changes of a variable, from [`Controller::subscribe`](super::Controller::subscribe).
///
/// The first item is the first value. Then there is an item when a reading differs from the one before: another value,
/// an error, or a value after an error. A reading that is replaced before it is taken is skipped, so a slow receiver sees
/// the latest value. The stream ends when the task does. Dropping it ends the subscription.
#[must_use = "a stream does nothing unless it is polled"]
pub struct Subscription(Latest<Option<Reading>>);

impl Subscription {
    /// Returns a subscription and where its readings go.
    pub(super) fn new() -> (Self, watch::Sender<Option<Reading>>) {
        let (sender, receiver) = watch::channel(None);
        (Self(Latest::new(receiver)), sender)
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
        // the value is `None` only before the first reading
        self.0.poll(context).map(Option::flatten)
    }
}

impl Stream for Subscription {
    type Item = Reading;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Reading>> {
        self.poll(context)
    }
}

/// All subscriptions of a controller: each variable is read once for all of its subscribers, at the shortest of their
/// intervals.
#[derive(Default)]
pub(super) struct Scan {
    variables: Vec<Scanned>,
}

struct Scanned {
    name: String,
    due: Instant,
    subscribers: Vec<(Duration, watch::Sender<Option<Reading>>)>,
}

impl Scan {
    /// Adds a subscription, which is due at once.
    pub(super) fn add(&mut self, name: String, interval: Duration, sender: watch::Sender<Option<Reading>>) {
        let subscriber = (interval.max(SHORTEST), sender);
        match self.variables.iter_mut().find(|scanned| scanned.name == name) {
            Some(scanned) => {
                scanned.subscribers.push(subscriber);
                scanned.due = Instant::ZERO;
            }
            None => self.variables.push(Scanned { name, due: Instant::ZERO, subscribers: vec![subscriber] }),
        }
    }

    /// Returns when the next variable is due.
    pub(super) fn due(&self) -> Option<Instant> {
        self.variables.iter().map(|scanned| scanned.due).min()
    }

    /// Makes all variables due, for a new session with its own clock.
    pub(super) fn restart(&mut self) {
        self.variables.iter_mut().for_each(|scanned| scanned.due = Instant::ZERO);
    }

    /// Reads the variable that has been due for the longest time; returns whether it was read.
    pub(super) async fn read(&mut self, session: &mut Session<Socket>) -> bool {
        self.variables.retain_mut(Scanned::is_wanted);
        let Some(scanned) = self.variables.iter_mut().min_by_key(|scanned| scanned.due) else { return false };
        let reading = session.read::<OwnedVariant>(Object::Controller, &scanned.name).await;
        // from now on, not from when it was due: a controller that is too slow is not asked in a burst
        scanned.due = session.now().saturating_add(scanned.interval());
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
        self.subscribers.retain(|(_, sender)| !sender.is_closed());
        !self.subscribers.is_empty()
    }

    fn interval(&self) -> Duration {
        self.subscribers.iter().map(|(interval, _)| *interval).min().unwrap_or(SHORTEST)
    }

    fn report(&self, reading: &Reading) {
        for (_, sender) in &self.subscribers {
            sender.send_if_modified(|last| {
                let changed = match (&*last, reading) {
                    (Some(Ok(last)), Ok(value)) => last != value,
                    (Some(Err(last)), Err(error)) => last.to_string() != error.to_string(),
                    _ => true,
                };
                if changed {
                    *last = Some(reading.clone());
                }
                changed
            });
        }
    }
}
