//! The backlog: readings to send as historical ones, in memory and on disk.
//!
//! Without a buffer on disk, the newest [`MEMORY`] readings are kept. With one, new readings of the backlog are appended to it,
//! and one file after another is loaded to be sent. The file is deleted when all of its readings have arrived. While the disk
//! fails, the newest [`MEMORY`] readings wait in memory, and each new reading triggers another attempt.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::task::spawn_blocking;

use crate::event::Event;
use crate::reading::{Reading, now_ms};
use crate::scan::Shared;
use crate::store::Store;

/// The maximum number of readings in memory without a buffer on disk.
const MEMORY: usize = 20_000;

/// The readings to send as historical ones.
pub(super) struct Backlog {
    shared: Arc<Shared>,
    /// `None` without a buffer on disk.
    store: Option<Store>,
    /// The readings that the store has not taken.
    unstored: VecDeque<Reading>,
    /// The readings to send next.
    next: VecDeque<Reading>,
    /// Readings that must arrive before the loaded file of the store can be deleted.
    loaded: usize,
    /// The ids of the readings of the loaded file, in order.
    loaded_ids: Vec<u64>,
}

impl Backlog {
    pub(super) const fn new(shared: Arc<Shared>, store: Option<Store>) -> Self {
        Self { shared, store, unstored: VecDeque::new(), next: VecDeque::new(), loaded: 0, loaded_ids: Vec::new() }
    }

    /// Adds readings, on disk if there is a buffer.
    pub(super) async fn keep(&mut self, readings: Vec<Reading>) {
        if readings.is_empty() {
            return;
        }
        if self.store.is_none() {
            self.next.extend(readings);
            let excess = trim(&mut self.next);
            return self.shared.metrics.lose(excess);
        }
        self.unstored.extend(readings);
        self.append().await;
        self.trim_unstored();
    }

    /// Writes readings to the store; those that it does not take wait.
    async fn append(&mut self) {
        let mut unstored = std::mem::take(&mut self.unstored);
        let appended = self.with_store(move |store| {
            let result = store.append(&mut unstored, now_ms());
            Ok((unstored, result))
        });
        let Some((unstored, result)) = appended.await else { return };
        self.unstored = unstored;
        let failed = &self.shared.metrics.buffer_failed;
        match result {
            Ok(()) if failed.swap(false, Ordering::Relaxed) => (self.shared.report)(&Event::BufferWorks {}),
            Ok(()) => {}
            Err(error) if !failed.swap(true, Ordering::Relaxed) => self.report_failure(&error),
            Err(_) => {}
        }
    }

    /// Drops the oldest readings that wait for the store and do not fit the memory.
    fn trim_unstored(&mut self) {
        let excess = trim(&mut self.unstored);
        self.shared.metrics.lose(excess);
    }

    /// Adds readings to send as soon as there are no new ones.
    pub(super) fn push(&mut self, readings: impl IntoIterator<Item = Reading>) {
        let before = self.next.len();
        self.next.extend(readings);
        // the loaded file stays until these have arrived as well
        self.loaded += self.next.len() - before;
    }

    /// Takes the next reading to send, and returns whether another reading of the same controller follows.
    pub(super) fn pop(&mut self) -> Option<(Reading, bool)> {
        let reading = self.next.pop_front()?;
        let has_more = self.next.front().is_some_and(|next| next.cell == reading.cell);
        Some((reading, has_more))
    }

    /// Loads the oldest readings of the store when all others were sent and have arrived; returns whether there are any.
    pub(super) async fn load(&mut self) -> bool {
        if !self.next.is_empty() || self.loaded > 0 {
            return false;
        }
        if self.store.as_ref().is_some_and(|store| store.stored() > 0) {
            let readings = self.with_store(|store| store.load(now_ms())).await.unwrap_or_default();
            self.loaded_ids = readings.iter().map(|reading| reading.id).collect();
            self.loaded_ids.sort_unstable();
            self.push(readings);
        } else {
            let unstored = std::mem::take(&mut self.unstored);
            self.push(unstored);
        }
        self.loaded > 0
    }

    /// Counts readings that the broker has.
    pub(super) async fn arrived(&mut self, readings: &[Reading]) {
        self.shared.metrics.published.fetch_add(readings.len() as u64, Ordering::Relaxed);
        let loaded = readings.iter().filter(|reading| reading.historical).count().min(self.loaded);
        self.loaded -= loaded;
        if loaded > 0 && self.loaded == 0 {
            self.acknowledge().await;
        }
    }

    /// Takes back the readings of a lost connection, which may not have arrived.
    pub(super) async fn restore(&mut self, mut readings: Vec<Reading>) {
        // loaded readings go back as well, so that their file can be deleted
        readings.extend(self.next.drain(..));
        readings.iter_mut().for_each(|reading| reading.historical = true);
        readings.sort_by_key(|reading| reading.id);
        let had_loaded = std::mem::take(&mut self.loaded) > 0;
        if self.store.is_none() {
            return self.keep(readings).await;
        }
        self.unstored.extend(readings);
        if !self.unstored.is_empty() {
            self.append().await;
        }
        if had_loaded && self.unstored.is_empty() {
            self.acknowledge().await;
        } else if had_loaded {
            // the loaded file has readings that could not be written again, so it stays
            self.with_store(|store| {
                store.unload();
                Ok(())
            })
            .await;
            let ids = std::mem::take(&mut self.loaded_ids);
            self.unstored.retain(|reading| ids.binary_search(&reading.id).is_err());
        }
        self.trim_unstored();
    }

    /// Ends it: readings in memory are lost.
    pub(super) fn close(self) {
        let readings = (self.next.len() + self.unstored.len()) as u64;
        if readings > 0 {
            self.shared.metrics.lose(readings);
            (self.shared.report)(&Event::Unsent { readings });
        }
    }

    /// Deletes the loaded file.
    async fn acknowledge(&mut self) {
        self.loaded_ids = Vec::new();
        self.with_store(|store| {
            store.acknowledge();
            Ok(())
        })
        .await;
    }

    /// Runs a blocking function of the store on another thread.
    async fn with_store<T: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut Store) -> io::Result<T> + Send + 'static,
    ) -> Option<T> {
        let mut store = self.store.take()?;
        let done = spawn_blocking(move || {
            let result = work(&mut store);
            let counts = (store.take_dropped(), store.stored(), store.stored_bytes());
            (store, result, counts)
        });
        let (store, result, (dropped, stored, bytes)) = done.await.ok()?;
        self.shared.metrics.lose(dropped);
        self.shared.metrics.stored.store(stored, Ordering::Relaxed);
        self.shared.metrics.stored_bytes.store(bytes, Ordering::Relaxed);
        self.store = Some(store);
        result.inspect_err(|error| self.report_failure(error)).ok()
    }

    fn report_failure(&self, error: &io::Error) {
        (self.shared.report)(&Event::BufferFailed { reason: error.to_string() });
    }
}

/// Keeps the newest readings that the memory takes; returns the number of others.
fn trim(readings: &mut VecDeque<Reading>) -> u64 {
    readings.drain(..readings.len().saturating_sub(MEMORY)).count() as u64
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Mutex;
    use std::sync::atomic::AtomicU64;

    use tokio::sync::watch;

    use super::*;
    use crate::config::{Buffer, Config};
    use crate::metrics::Metrics;
    use crate::queue::Queue;
    use crate::reading::{Quality, Value};

    /// A backlog, and the events that it reports.
    fn backlog(store: impl FnOnce(&Config) -> Option<Store>) -> (Backlog, Arc<Mutex<Vec<Event>>>) {
        let text = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"h\"\n[[controller]]\nname = \"a\"\n\
            address = \"tcp:127.0.0.1\"\n[[controller.publish]]\nnames = [\"I1\"]\n";
        let config = Config::parse(text).unwrap();
        let (store, metrics) = (store(&config), Arc::new(Metrics::new(1)));
        let events = Arc::new(Mutex::new(Vec::new()));
        let reported = Arc::clone(&events);
        let shared = Shared {
            config,
            queue: Queue::new(Arc::clone(&metrics)),
            metrics,
            report: Box::new(move |event| reported.lock().unwrap().push(event.clone())),
            reads: watch::Sender::new(true),
            next_id: AtomicU64::new(0),
        };
        (Backlog::new(Arc::new(shared), store), events)
    }

    fn open(directory: &Path, config: &Config) -> Option<Store> {
        Some(Store::open(&Buffer { directory: directory.to_owned(), mib: 4, hours: 1 }, config).unwrap())
    }

    fn readings(ids: std::ops::Range<u64>) -> Vec<Reading> {
        let (time, value) = (now_ms(), Some(Value::Integer(1)));
        let reading = |id| Reading {
            cell: 0,
            point: 0,
            time,
            id,
            value: value.clone(),
            quality: Quality::Good,
            historical: false,
        };
        ids.map(reading).collect()
    }

    fn dropped(backlog: &Backlog) -> u64 {
        backlog.shared.metrics.dropped.load(Ordering::Relaxed)
    }

    fn ids(backlog: &mut Backlog) -> Vec<(u64, bool)> {
        std::iter::from_fn(|| backlog.pop()).map(|(reading, has_more)| (reading.id, has_more)).collect()
    }

    #[tokio::test]
    async fn memory_keeps_the_newest_readings_and_counts_each_lost_one_once() {
        let (mut backlog, events) = backlog(|_| None);
        backlog.keep(readings(0..MEMORY as u64 + 3)).await;
        assert_eq!((dropped(&backlog), backlog.pop().unwrap().0.id), (3, 3));
        let shared = Arc::clone(&backlog.shared);
        backlog.close();
        assert_eq!(shared.metrics.dropped.load(Ordering::Relaxed), MEMORY as u64 + 2);
        assert_eq!(*events.lock().unwrap(), [Event::Unsent { readings: MEMORY as u64 - 1 }]);
    }

    #[tokio::test]
    async fn a_lost_connection_returns_its_readings_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let (mut backlog, _) = backlog(|config| open(folder.path(), config));
        backlog.keep(readings(0..2)).await;
        assert!(backlog.load().await);
        assert!(!backlog.load().await, "the loaded ones were not sent");
        assert_eq!(ids(&mut backlog), [(0, true), (1, false)]);
        backlog.push(readings(3..4));
        backlog.restore(readings(0..3)).await;
        assert!(backlog.load().await);
        assert_eq!(ids(&mut backlog), [(0, true), (1, true), (2, true), (3, false)]);
        let arrived: Vec<_> =
            readings(0..4).into_iter().map(|reading| Reading { historical: true, ..reading }).collect();
        backlog.arrived(&arrived).await;
        assert!(!backlog.load().await);
        let metrics = &backlog.shared.metrics;
        let counts = [&metrics.published, &metrics.dropped, &metrics.stored, &metrics.stored_bytes];
        assert_eq!(counts.map(|count| count.load(Ordering::Relaxed)), [4, 0, 0, 0]);
    }

    #[tokio::test]
    async fn a_disk_that_takes_nothing_is_tried_again_and_its_readings_are_sent() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("buffer");
        let (mut backlog, events) = backlog(|config| open(&path, config));
        let failed = |backlog: &Backlog| backlog.shared.metrics.buffer_failed.load(Ordering::Relaxed);
        std::fs::remove_dir_all(&path).unwrap();
        backlog.keep(readings(0..5)).await;
        backlog.keep(readings(5..MEMORY as u64 + 2)).await;
        assert!(failed(&backlog));
        assert_eq!((dropped(&backlog), backlog.unstored.len()), (2, MEMORY), "memory keeps the newest ones");
        std::fs::create_dir(&path).unwrap();
        backlog.keep(readings(MEMORY as u64 + 2..MEMORY as u64 + 3)).await;
        assert!(!failed(&backlog));
        assert!(matches!(events.lock().unwrap()[..], [Event::BufferFailed { .. }, Event::BufferWorks {}]));
        let stored = backlog.shared.metrics.stored.load(Ordering::Relaxed);
        assert_eq!((dropped(&backlog), backlog.unstored.len(), stored), (2, 0, MEMORY as u64 + 1));
        assert!(backlog.load().await);
        assert_eq!(backlog.pop().unwrap().0.id, 2);
    }

    #[tokio::test]
    async fn a_lost_connection_keeps_the_loaded_file_if_the_disk_takes_nothing() {
        const COUNT: u64 = 2 * MEMORY as u64;
        let folder = tempfile::tempdir().unwrap();
        let (path, away) = (folder.path().join("buffer"), folder.path().join("away"));
        let (mut backlog, _) = backlog(|config| {
            // one file takes all readings
            let buffer = Buffer { directory: path.clone(), mib: 256, hours: 1 };
            Some(Store::open(&buffer, config).unwrap())
        });
        backlog.keep(readings(0..COUNT)).await;
        assert!(backlog.load().await);
        let mut sent: Vec<_> = std::iter::from_fn(|| backlog.pop()).map(|(reading, _)| reading).collect();
        assert_eq!(sent.len() as u64, COUNT);
        // another reading that the broker has not acknowledged
        sent.extend(readings(COUNT..COUNT + 1));
        std::fs::rename(&path, &away).unwrap();
        backlog.restore(sent).await;
        assert_eq!((dropped(&backlog), backlog.unstored.len()), (0, 1));
        std::fs::rename(&away, &path).unwrap();
        backlog.keep(readings(COUNT + 1..COUNT + 2)).await;
        let mut returned = Vec::new();
        while backlog.load().await {
            let loaded: Vec<_> = std::iter::from_fn(|| backlog.pop()).map(|(reading, _)| reading).collect();
            backlog.arrived(&loaded).await;
            returned.extend(loaded.iter().map(|reading| reading.id));
        }
        assert!(returned.into_iter().eq(0..COUNT + 2));
        assert_eq!(dropped(&backlog), 0);
    }

    #[tokio::test]
    async fn readings_that_the_disk_has_not_taken_are_sent_from_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("buffer");
        let (mut backlog, _) = backlog(|config| open(&path, config));
        std::fs::remove_dir_all(&path).unwrap();
        backlog.keep(readings(0..2)).await;
        assert!(backlog.load().await);
        assert_eq!((ids(&mut backlog), dropped(&backlog)), (vec![(0, true), (1, false)], 0));
    }
}
