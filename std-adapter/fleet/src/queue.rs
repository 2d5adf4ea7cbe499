//! Readings and changes of state between the scans and the publisher. A full queue drops its oldest reading; it never makes
//! a scan wait.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::metrics::Metrics;
use crate::reading::Reading;

/// The maximum number of items of a queue.
const LIMIT: usize = 20_000;

/// A report of the scans to the publisher.
#[derive(Clone, Debug)]
pub(crate) enum Item {
    Reading(Reading),
    State(State),
}

/// Whether there is a session with a controller.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) cell: usize,
    /// Why there is no session; `None` if there is one.
    pub(crate) down: Option<String>,
    pub(crate) time: u64,
}

/// A bounded queue with many senders and one receiver.
#[derive(Debug)]
pub(crate) struct Queue {
    items: Mutex<VecDeque<Item>>,
    /// The number of readings that were dropped.
    losses: AtomicU64,
    added: Notify,
    metrics: Arc<Metrics>,
}

impl Queue {
    pub(crate) fn new(metrics: Arc<Metrics>) -> Self {
        Self { items: Mutex::default(), losses: AtomicU64::new(0), added: Notify::new(), metrics }
    }

    pub(crate) fn push(&self, item: Item) {
        let mut items = self.lock();
        if items.len() >= LIMIT {
            // states are few, and are needed to distinguish good values from old ones
            let oldest = items.iter().position(|item| matches!(item, Item::Reading(_)));
            if oldest.and_then(|oldest| items.remove(oldest)).is_some() {
                self.losses.fetch_add(1, Ordering::Relaxed);
                self.metrics.lose(1);
            }
        }
        items.push_back(item);
        drop(items);
        self.added.notify_one();
    }

    pub(crate) fn pop(&self) -> Option<Item> {
        self.lock().pop_front()
    }

    /// Takes the next item if it is a reading that meets a condition.
    pub(crate) fn pop_reading(&self, condition: impl FnOnce(&Reading) -> bool) -> Option<Reading> {
        let mut items = self.lock();
        let is_next = matches!(items.front(), Some(Item::Reading(reading)) if condition(reading));
        let Item::Reading(reading) = is_next.then(|| items.pop_front()).flatten()? else { return None };
        Some(reading)
    }

    /// Returns the number of readings that were dropped.
    pub(crate) fn losses(&self) -> u64 {
        self.losses.load(Ordering::Relaxed)
    }

    pub(crate) fn len(&self) -> usize {
        self.lock().len()
    }

    /// Waits until an item was added. Cancel-safe.
    pub(crate) async fn added(&self) {
        self.added.notified().await;
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Item>> {
        self.items.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reading::Quality;

    #[test]
    fn a_full_queue_drops_its_oldest_reading_and_counts_it() {
        let metrics = Arc::new(Metrics::new(1));
        let queue = Queue::new(Arc::clone(&metrics));
        queue.push(Item::State(State { cell: 0, down: None, time: 0 }));
        let reading =
            |id| Reading { cell: 0, point: 0, time: 0, id, value: None, quality: Quality::Good, historical: false };
        for id in 0..LIMIT as u64 {
            queue.push(Item::Reading(reading(id)));
        }
        assert_eq!((queue.len(), metrics.dropped.load(Ordering::Relaxed)), (LIMIT, 1));
        assert!(queue.pop_reading(|_| true).is_none(), "a state is next");
        assert!(matches!(queue.pop(), Some(Item::State(_))));
        assert!(queue.pop_reading(|reading| reading.id == 2).is_none());
        assert!(matches!(queue.pop(), Some(Item::Reading(Reading { id: 1, .. }))));
    }
}
