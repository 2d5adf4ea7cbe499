//! The events of a fleet as lines of JSON. A thread prints them, so that a slow reader of the output delays nothing.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_fleet::Event;
use serde::Serialize;

use crate::now;
use crate::output::print_json;

/// The maximum number of queued events.
const BACKLOG: usize = 4096;

/// The longest time that the end waits for the output.
const CLOSE: Duration = Duration::from_secs(2);

/// An event with its time in UTC.
#[derive(Serialize)]
struct Line {
    time: String,
    #[serde(flatten)]
    event: Event,
}

/// The queue of events, from any thread.
#[derive(Clone)]
pub(crate) struct Events {
    lines: SyncSender<Line>,
    dropped: Arc<AtomicU64>,
}

/// The thread that prints the events.
pub(crate) struct Printer {
    thread: JoinHandle<()>,
    dropped: Arc<AtomicU64>,
}

/// Starts the thread.
pub(crate) fn start() -> io::Result<(Events, Printer)> {
    let (lines, queue) = sync_channel(BACKLOG);
    let dropped = Arc::new(AtomicU64::new(0));
    let thread = thread::Builder::new().name("events".into()).spawn(move || print(&queue))?;
    Ok((Events { lines, dropped: Arc::clone(&dropped) }, Printer { thread, dropped }))
}

impl Events {
    /// Queues an event. If the queue is full, the event is dropped and counted.
    pub(crate) fn add(&self, event: &Event) {
        if self.lines.try_send(Line { time: now(), event: event.clone() }).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Printer {
    /// Waits until all events are printed; all [`Events`] must have been dropped. Returns the number of dropped events.
    pub(crate) fn finish(self) -> u64 {
        let until = Instant::now() + CLOSE;
        while !self.thread.is_finished() && Instant::now() < until {
            thread::sleep(Duration::from_millis(1));
        }
        self.dropped.load(Ordering::Relaxed)
    }
}

fn print(queue: &Receiver<Line>) {
    while let Ok(line) = queue.recv() {
        if print_json(&line).is_err() {
            return;
        }
    }
}
