//! The scan of one controller: reads each point at its interval, one call after another, and reports changes.
//!
//! It reads by itself, and not with `Controller::subscribe`: a subscription skips a reading that was replaced before it was
//! taken, has no time of the reading, and cannot read the pose of the robot.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::variant::OwnedVariant;
use bcap_std::Error;
use bcap_std::asynch::{Controller, State as Session};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use crate::config::Config;
use crate::event::Event;
use crate::metrics::{CellMetrics, Metrics};
use crate::point::{Point, Source};
use crate::queue::{Item, Queue, State};
use crate::reading::{Quality, Reading, Value, now_ms};

/// What all scans share.
pub(crate) struct Shared {
    pub(crate) config: Config,
    pub(crate) queue: Queue,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) report: Box<dyn Fn(&Event) + Send + Sync>,
    /// Whether variables are read; a standby does not.
    pub(crate) reads: watch::Sender<bool>,
    /// The id of the next reading. It begins with the time, so that the ids of a later process are higher.
    pub(crate) next_id: AtomicU64,
}

/// The scan of one controller.
pub(crate) struct Scan {
    pub(crate) shared: Arc<Shared>,
    pub(crate) cell: usize,
    pub(crate) controller: Controller,
}

/// A point, and what was reported last.
struct Scanned<'a> {
    index: usize,
    point: &'a Point,
    due: Instant,
    last: Option<(Option<Value>, Quality)>,
}

impl Scan {
    /// Scans until the controller is closed.
    pub(crate) async fn run(self) {
        let shared = Arc::clone(&self.shared);
        let points = &shared.config.controllers[self.cell].points;
        let mut scanned: Vec<_> =
            (0..).zip(points).map(|(index, point)| Scanned { index, point, due: Instant::now(), last: None }).collect();
        let mut states = self.controller.states();
        let mut state = states.next().await;
        // each failed attempt to connect is a state, mostly with the same reason
        let mut reported = None;
        loop {
            match state {
                None | Some(Session::Closed) => return,
                Some(Session::Connected) => {
                    self.report(None);
                    reported = None;
                    state = tokio::select! {
                        next = states.next() => next,
                        never = self.read_while_active(&mut scanned) => match never {},
                    };
                }
                Some(Session::Disconnected { reason, .. }) => {
                    if reported.as_ref() != Some(&reason) {
                        self.report(Some(reason.clone()));
                        reported = Some(reason);
                    }
                    self.lose(&mut scanned);
                    state = states.next().await;
                }
                // no reading is possible, and the reason follows
                Some(_) => state = states.next().await,
            }
        }
    }

    /// Spreads the first readings of all controllers over the interval, so that they do not poll at the same time.
    fn spread(&self, scanned: &mut [Scanned<'_>]) {
        let (cell, cells) = (self.cell, self.shared.config.controllers.len());
        let now = Instant::now();
        for scanned in scanned {
            scanned.due = now + offset(scanned.point.interval, cell, cells);
        }
    }

    /// Reads while this process is the active one of its node.
    async fn read_while_active(&self, scanned: &mut [Scanned<'_>]) -> std::convert::Infallible {
        let mut reads = self.shared.reads.subscribe();
        loop {
            // the sender is not dropped before this
            let _ = reads.wait_for(|reads| *reads).await;
            self.spread(scanned);
            tokio::select! {
                never = self.read_all(scanned) => match never {},
                _ = reads.wait_for(|reads| !*reads) => {}
            }
            // the first readings of the next time are reported, and the end of the session is not
            scanned.iter_mut().for_each(|scanned| scanned.last = None);
        }
    }

    async fn read_all(&self, scanned: &mut [Scanned<'_>]) -> std::convert::Infallible {
        loop {
            let Some(next) = scanned.iter_mut().min_by_key(|scanned| scanned.due) else { std::future::pending().await };
            sleep_until(next.due).await;
            let began = Instant::now();
            let reading = read(&self.controller, &next.point.source).await;
            let ended = Instant::now();
            let metrics = self.metrics();
            metrics.read_us.fetch_add(micros(ended - began), Ordering::Relaxed);
            // deadlines stay on their grid; those that have passed are left out
            next.due += next.point.interval;
            if next.due < ended {
                let missed = (ended - next.due).as_nanos() / next.point.interval.as_nanos() + 1;
                let missed = u32::try_from(missed).unwrap_or(u32::MAX);
                metrics.overruns.fetch_add(missed.into(), Ordering::Relaxed);
                next.due = next.due.checked_add(next.point.interval * missed).unwrap_or(ended + next.point.interval);
            }
            match reading {
                // the state follows, and marks all points
                Err(Error::NotConnected { .. } | Error::Closed) => {}
                Err(_) => {
                    metrics.errors.fetch_add(1, Ordering::Relaxed);
                    self.push(next, None, Quality::Bad);
                }
                Ok(value) => {
                    metrics.readings.fetch_add(1, Ordering::Relaxed);
                    let quality = if value.is_some() { Quality::Good } else { Quality::Bad };
                    self.push(next, value, quality);
                }
            }
        }
    }

    /// Reports a reading unless it counts as equal to the last one.
    fn push(&self, scanned: &mut Scanned<'_>, value: Option<Value>, quality: Quality) {
        let Point { dead_band, on_change, .. } = *scanned.point;
        let is_same = |(last, was): &(Option<Value>, Quality)| {
            *was == quality
                && match (last, &value) {
                    (Some(last), Some(value)) => last.is_near(value, dead_band),
                    (last, value) => last.is_none() && value.is_none(),
                }
        };
        if on_change && scanned.last.as_ref().is_some_and(is_same) {
            return;
        }
        scanned.last = Some((value.clone(), quality));
        let id = self.shared.next_id.fetch_add(1, Ordering::Relaxed);
        let reading =
            Reading { cell: self.cell, point: scanned.index, time: now_ms(), id, value, quality, historical: false };
        self.shared.queue.push(Item::Reading(reading));
    }

    /// Reports that no value is known.
    fn lose(&self, scanned: &mut [Scanned<'_>]) {
        for scanned in scanned {
            if scanned.last.as_ref().is_some_and(|(_, quality)| *quality == Quality::Good) {
                self.push(scanned, None, Quality::Bad);
            }
            // the first reading of the next session is always reported
            scanned.last = None;
        }
    }

    /// Reports a change of the session.
    fn report(&self, down: Option<String>) {
        let controller = self.shared.config.controllers[self.cell].name.clone();
        self.metrics().up.store(down.is_none(), Ordering::Relaxed);
        (self.shared.report)(&match &down {
            None => Event::RobotUp { controller },
            Some(reason) => Event::RobotDown { controller, reason: reason.clone() },
        });
        self.shared.queue.push(Item::State(State { cell: self.cell, down, time: now_ms() }));
    }

    fn metrics(&self) -> &CellMetrics {
        &self.shared.metrics.cells[self.cell]
    }
}

/// Returns when a controller's first reading is due.
fn offset(interval: Duration, cell: usize, cells: usize) -> Duration {
    let (cell, cells) = (u32::try_from(cell).unwrap_or(0), u32::try_from(cells).unwrap_or(u32::MAX));
    interval / cells.max(1) * cell
}

/// Reads a point once; `None` if its value has no counterpart.
pub(crate) async fn read(controller: &Controller, source: &Source) -> Result<Option<Value>, Error> {
    let value: OwnedVariant = match source {
        Source::Controller(name) => controller.read(name).await?,
        Source::Robot(name) => controller.robot().await?.read(name).await?,
        Source::Pose => controller.robot().await?.execute("CurPos", ()).await?,
        Source::Joints => controller.robot().await?.execute("CurJnt", ()).await?,
    };
    Ok(Value::of(&value.as_variant()))
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scans_are_spread_over_the_interval() {
        let second = Duration::from_secs(1);
        let offsets: Vec<_> = (0..4).map(|cell| offset(second, cell, 4).as_millis()).collect();
        assert_eq!(offsets, [0, 250, 500, 750]);
    }
}
