//! The scan of one controller: reads each point at its interval, one call after another, and reports changes. Variables
//! with the same deadline are one request to the task of the controller, which saves most of the cost of a reading.
//!
//! It does not use `Controller::subscribe`: a subscription skips a reading that was replaced before it was taken, has no time
//! of the reading, and cannot read the pose of the robot.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::bcap::{FunctionId, call};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::asynch::{Controller, State as Session};
use bcap_std::{Error, TaskStatus};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use crate::config::Config;
use crate::event::Event;
use crate::metrics::{CellMetrics, Metrics};
use crate::point::{Point, Source};
use crate::queue::{Item, Queue, State};
use crate::reading::{Quality, Reading, Value, now_ms};
use crate::stream::{ReadError, StreamCheck};

/// The maximum number of variables that are read together. Commands for the controller wait during that.
const BATCH: usize = 32;

/// Initial pause of a point that does not respond. It doubles with each timeout, up to a maximum.
const PAUSE: Duration = Duration::from_secs(4);
/// The maximum number of doublings of a pause: 256 s.
const DOUBLINGS: u32 = 6;

/// The state that all scans share.
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
    pub(crate) stream: StreamCheck,
}

/// A point, and its last report.
struct Scanned<'a> {
    index: usize,
    point: &'a Point,
    deadline: Instant,
    /// When the last attempt to read it ended.
    attempted: Option<Instant>,
    /// Its timeouts in a row, while the controller replied to other calls.
    timeouts: u32,
    last: Option<(Option<Value>, Quality)>,
    /// The losses of the queue before its last report. A later loss may be this report, so the next reading is reported again.
    losses: u64,
}

impl<'a> Scanned<'a> {
    fn new(index: usize, point: &'a Point) -> Self {
        Self { index, point, deadline: Instant::now(), attempted: None, timeouts: 0, last: None, losses: 0 }
    }
}

impl Scan {
    /// Scans until the controller is closed.
    pub(crate) async fn run(self) {
        let shared = Arc::clone(&self.shared);
        let points = &shared.config.controllers[self.cell].points;
        let mut scanned: Vec<_> = (0..).zip(points).map(|(index, point)| Scanned::new(index, point)).collect();
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
                        biased;
                        // first, because it reports readings from before the loss
                        never = self.read_while_active(&mut scanned) => match never {},
                        next = states.next() => next,
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
            scanned.deadline = now + offset(scanned.point.interval, cell, cells);
            scanned.timeouts = 0;
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
            // so that the next active period reports its first readings, and no loss of a session before them
            scanned.iter_mut().for_each(|scanned| scanned.last = None);
        }
    }

    /// Reads all points at their deadlines.
    async fn read_all(&self, scanned: &mut [Scanned<'_>]) -> std::convert::Infallible {
        let mut began = None;
        // whether the controller replied to the last call
        let mut replied = true;
        loop {
            let Some(next) = scanned.iter().map(|scanned| scanned.deadline).min() else { std::future::pending().await };
            if next > Instant::now() {
                if let Some(began) = began.take() {
                    self.metrics().scan_us.store(micros(Instant::now() - began), Ordering::Relaxed);
                }
                sleep_until(next).await;
            }
            let now = Instant::now();
            began.get_or_insert(now);
            let batch = batch(scanned, now);
            let sources: Vec<_> = batch.iter().map(|index| &scanned[*index].point.source).collect();
            let readings = read_batch(&self.controller, &self.stream, &sources).await;
            let ended = Instant::now();
            self.metrics().read_us.fetch_add(micros(ended - now), Ordering::Relaxed);
            // after a timeout the rest of the batch is not read; after a loss of the session the state follows
            let (mut stopped, mut is_first) = (None, false);
            let mut batch = batch.into_iter();
            for ((time, value), index) in readings.into_iter().zip(batch.by_ref()) {
                let scanned = &mut scanned[index];
                let has_no_reply =
                    matches!(&value, Err(ReadError::Failed(error @ Error::NoReply { .. })) if !error.is_lost());
                // two timeouts in a row are the fault of the controller, not of the second point
                scanned.timeouts = if has_no_reply { scanned.timeouts + u32::from(replied) } else { 0 };
                scanned.attempted = Some(ended);
                (stopped, is_first) = (has_no_reply.then_some(time), replied);
                replied = !has_no_reply;
                self.reschedule(scanned, ended);
                self.count(scanned, time, value);
            }
            for index in batch {
                // after the first timeout in a row the other points keep their deadlines, because they may get a reply
                if stopped.is_none() || !is_first {
                    self.reschedule(&mut scanned[index], ended);
                }
                if let Some(time) = stopped {
                    self.fail(&mut scanned[index], time);
                }
            }
        }
    }

    /// Sets the next deadline of a point. Deadlines stay on their grid; deadlines that have passed are left out.
    fn reschedule(&self, scanned: &mut Scanned<'_>, ended: Instant) {
        let interval = scanned.point.interval;
        let (deadline, missed) = first_after(scanned.deadline + interval, interval, ended);
        self.metrics().overruns.fetch_add(missed.into(), Ordering::Relaxed);
        (scanned.deadline, _) = first_after(deadline, interval, ended + pause(scanned.timeouts));
    }

    /// Counts the readings, and reports them.
    fn count(&self, scanned: &mut Scanned<'_>, time: u64, value: Result<Option<Value>, ReadError>) {
        match value {
            // the state follows, and marks all points
            Err(ReadError::Failed(Error::NotConnected { .. } | Error::Closed)) => {}
            Err(ReadError::Skipped(reason)) => self.skip(scanned, time, reason),
            Err(_) => self.fail(scanned, time),
            Ok(value) => {
                self.metrics().readings.fetch_add(1, Ordering::Relaxed);
                let quality = if value.is_some() { Quality::Good } else { Quality::Bad };
                self.push(scanned, time, value, quality);
            }
        }
    }

    /// Counts a point that was not read because a stream of Slave Mode runs, and reports the first time.
    fn skip(&self, scanned: &mut Scanned<'_>, time: u64, reason: String) {
        self.metrics().skipped.fetch_add(1, Ordering::Relaxed);
        if scanned.last.as_ref().is_none_or(|(_, quality)| *quality != Quality::Skipped) {
            let controller = self.shared.config.controllers[self.cell].name.clone();
            (self.shared.report)(&Event::Skipped { controller, variable: scanned.point.name.clone(), reason });
        }
        self.push(scanned, time, None, Quality::Skipped);
    }

    /// Counts a point that could not be read, and reports it.
    fn fail(&self, scanned: &mut Scanned<'_>, time: u64) {
        self.metrics().errors.fetch_add(1, Ordering::Relaxed);
        self.push(scanned, time, None, Quality::Bad);
    }

    /// Reports a reading unless it counts as equal to the last reading.
    fn push(&self, scanned: &mut Scanned<'_>, time: u64, value: Option<Value>, quality: Quality) {
        let Point { dead_band, on_change, .. } = *scanned.point;
        let is_same = |(last, was): &(Option<Value>, Quality)| {
            *was == quality
                && match (last, &value) {
                    (Some(last), Some(value)) => last.is_near(value, dead_band),
                    (last, value) => last.is_none() && value.is_none(),
                }
        };
        let losses = self.shared.queue.losses();
        if on_change && scanned.losses == losses && scanned.last.as_ref().is_some_and(is_same) {
            return;
        }
        if matches!(&scanned.point.source, Source::Controller(name) if name == "@ERROR_CODE")
            && let Some(Value::Integer(code)) = &value
            && scanned.last.as_ref().and_then(|(last, _)| last.as_ref()) != value.as_ref()
        {
            self.report_error(*code);
        }
        (scanned.last, scanned.losses) = (Some((value.clone(), quality)), losses);
        let id = self.shared.next_id.fetch_add(1, Ordering::Relaxed);
        let reading = Reading { cell: self.cell, point: scanned.index, time, id, value, quality, historical: false };
        self.shared.queue.push(Item::Reading(reading));
    }

    /// Reports a new latest error.
    fn report_error(&self, code: i64) {
        let Some(code) = i32::try_from(code).ok().filter(|code| *code != 0).map(HResult) else { return };
        (self.shared.report)(&Event::RobotError {
            controller: self.shared.config.controllers[self.cell].name.clone(),
            code: format!("0x{:08X}", code.to_u32()),
            meaning: code.meaning(),
            remedy: code.hint().map(|hint| hint.to_string()),
        });
    }

    /// Reports that no value is known.
    fn lose(&self, scanned: &mut [Scanned<'_>]) {
        for scanned in scanned {
            let may_be_lost = scanned.losses != self.shared.queue.losses();
            if scanned.last.as_ref().is_some_and(|(_, quality)| *quality == Quality::Good || may_be_lost) {
                self.push(scanned, now_ms(), None, Quality::Bad);
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

/// Returns the delay of a controller's first reading.
fn offset(interval: Duration, cell: usize, cells: usize) -> Duration {
    let (cell, cells) = (u32::try_from(cell).unwrap_or(0), u32::try_from(cells).unwrap_or(u32::MAX));
    interval / cells.max(1) * cell
}

/// Returns the first deadline of a grid that has not passed at `time`, and the number of missed ones.
fn first_after(deadline: Instant, interval: Duration, time: Instant) -> (Instant, u32) {
    if deadline >= time {
        return (deadline, 0);
    }
    let missed = u32::try_from((time - deadline).as_nanos().div_ceil(interval.as_nanos())).unwrap_or(u32::MAX);
    (deadline.checked_add(interval * missed).unwrap_or(time + interval), missed)
}

/// Returns how long a point is not read after a number of timeouts.
fn pause(timeouts: u32) -> Duration {
    match timeouts.checked_sub(1) {
        None => Duration::ZERO,
        Some(more) => PAUSE * 2_u32.pow(more.min(DOUBLINGS)),
    }
}

/// Reads a point once; `None` if its value has no counterpart.
pub(crate) async fn read(
    controller: &Controller,
    stream: &StreamCheck,
    source: &Source,
) -> Result<Option<Value>, ReadError> {
    let value: OwnedVariant = match source {
        Source::Controller(name) => controller.read(name).await?,
        Source::Robot(name) => controller.robot().await?.read(name).await?,
        Source::Pose => controller.robot().await?.execute("CurPos", ()).await?,
        Source::Joints => controller.robot().await?.execute("CurJnt", ()).await?,
        Source::Task(name) => return Ok(Some(Value::Text(status(controller, stream, name).await?))),
        Source::Tasks => return Ok(Some(Value::Texts(statuses(controller, stream).await?))),
    };
    Ok(Value::of(&value.as_variant()))
}

/// Reads the status of a task.
async fn status(controller: &Controller, stream: &StreamCheck, name: &str) -> Result<String, ReadError> {
    stream.require(controller, FunctionId::TASK_EXECUTE, Some("GetStatus")).await?;
    Ok(match controller.task(name).await?.status().await? {
        TaskStatus::None => "none".into(),
        TaskStatus::Suspended => "suspended".into(),
        TaskStatus::Ready => "ready".into(),
        TaskStatus::Running => "running".into(),
        TaskStatus::StoppedAtStep => "stopped_at_step".into(),
        TaskStatus::Other(number) => number.to_string(),
        other => format!("{other:?}"),
    })
}

/// Reads the statuses of all tasks.
async fn statuses(controller: &Controller, stream: &StreamCheck) -> Result<BTreeMap<String, String>, ReadError> {
    stream.require(controller, FunctionId::CONTROLLER_GET_TASK_NAMES, None).await?;
    let names = controller.call(call::controller_get_task_names(controller.handle().await?, "")).await?;
    let names: Vec<String> =
        names.convert().map_err(|source| Error::Value { object: "the names of the tasks".into(), source })?;
    let mut statuses = BTreeMap::new();
    for name in names {
        let status = status(controller, stream, &name).await?;
        statuses.insert(name, status);
    }
    Ok(statuses)
}

/// Returns the points to read next: points whose deadline has passed, the least recently read first, so that none
/// starves when others time out. Variables of the controller are read together. Other points, and points that timed
/// out, are read one at a time.
fn batch(scanned: &[Scanned<'_>], now: Instant) -> Vec<usize> {
    let mut ready: Vec<_> = (0..scanned.len()).filter(|index| scanned[*index].deadline <= now).collect();
    ready.sort_by_key(|index| scanned[*index].attempted);
    let is_joined = |index: &usize| {
        let Scanned { point, timeouts, .. } = &scanned[*index];
        matches!(point.source, Source::Controller(_)) && *timeouts == 0
    };
    let joined = ready.iter().take(BATCH).take_while(|index| is_joined(index)).count();
    ready.truncate(joined.max(1));
    ready
}

/// Reads points, and returns for each when its reply arrived and its value. After a timeout or a loss
/// of the session the rest is missing.
async fn read_batch(
    controller: &Controller,
    stream: &StreamCheck,
    sources: &[&Source],
) -> Vec<(u64, Result<Option<Value>, ReadError>)> {
    let names: Option<Vec<_>> = sources.iter().map(|source| source.variable()).collect();
    let Some(names) = names else {
        let value = match sources.first() {
            Some(source) => read(controller, stream, source).await,
            None => Ok(None),
        };
        return vec![(now_ms(), value)];
    };
    match controller.read_each(&names).await {
        // there is no session, and no point was read
        Err(_) => Vec::new(),
        Ok(values) => {
            let (now, ended) = (now_ms(), std::time::Instant::now());
            let time = |arrived| now.saturating_sub(millis(ended.saturating_duration_since(arrived)));
            let convert = |value: OwnedVariant| Value::of(&value.as_variant());
            values
                .into_iter()
                .map(|(arrived, value)| (time(arrived), value.map(convert).map_err(ReadError::Failed)))
                .collect()
        }
    }
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use bcap_std::Settings;

    use super::*;

    #[test]
    fn the_scans_are_spread_over_the_interval() {
        let second = Duration::from_secs(1);
        let offsets: Vec<_> = (0..4).map(|cell| offset(second, cell, 4).as_millis()).collect();
        assert_eq!(offsets, [0, 250, 500, 750]);
    }

    #[test]
    fn deadlines_stay_on_their_grid() {
        let (start, ms) = (Instant::now(), Duration::from_millis);
        assert_eq!(first_after(start, ms(10), start), (start, 0));
        assert_eq!(first_after(start, ms(10), start + ms(1)), (start + ms(10), 1));
        assert_eq!(first_after(start, ms(10), start + ms(10)), (start + ms(10), 1));
        assert_eq!(first_after(start, ms(10), start + ms(3001)), (start + ms(3010), 301));
    }

    #[test]
    fn a_pause_doubles_up_to_its_maximum() {
        let pauses: Vec<_> = [0, 1, 2, 3, 7, 8, u32::MAX].map(|timeouts| pause(timeouts).as_secs()).into();
        assert_eq!(pauses, [0, 4, 8, 16, 256, 256, 256]);
    }

    fn points(sources: impl IntoIterator<Item = Source>) -> Vec<Point> {
        let interval = Duration::from_millis(100);
        let point = |source| Point {
            name: String::new(),
            source,
            kind: None,
            interval,
            on_change: true,
            dead_band: 0.0,
            joined: false,
        };
        sources.into_iter().map(point).collect()
    }

    #[tokio::test]
    async fn a_value_is_reported_again_after_the_queue_has_dropped_readings() {
        let text = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"h\"\n[[controller]]\nname = \"a\"\n\
            address = \"tcp:127.0.0.1\"\n[[controller.publish]]\nnames = [\"I1\"]\n";
        let metrics = Arc::new(Metrics::new(1));
        let shared = Arc::new(Shared {
            config: Config::parse(text).unwrap(),
            queue: Queue::new(Arc::clone(&metrics)),
            metrics,
            report: Box::new(|_| {}),
            reads: watch::Sender::new(true),
            next_id: AtomicU64::new(0),
        });
        let controller = Controller::spawn("tcp:127.0.0.1:1", &Settings::rc8()).unwrap();
        let scan = Scan { shared: Arc::clone(&shared), cell: 0, controller, stream: StreamCheck::default() };
        let points = points([Source::Controller("I1".into())]);
        let (mut scanned, queue) = (Scanned::new(0, &points[0]), &shared.queue);
        let mut read = || scan.count(&mut scanned, 0, Ok(Some(Value::Integer(1))));
        read();
        let (point, value, quality) = (1, None, Quality::Good);
        let other = Reading { cell: 0, point, time: 0, id: 0, value, quality, historical: false };
        while queue.losses() == 0 {
            queue.push(Item::Reading(other.clone()));
        }
        let left = || -> Vec<_> { std::iter::from_fn(|| queue.pop()).collect() };
        let is_other = |item: &Item| matches!(item, Item::Reading(Reading { point: 1, .. }));
        assert!(left().iter().all(is_other), "its report is lost");
        for reports in [1, 0] {
            read();
            assert_eq!(left().len(), reports);
        }
    }

    #[test]
    fn a_point_that_timed_out_is_read_alone_and_the_others_before_it_is_read_again() {
        let variable = || Source::Controller("I1".into());
        let points = points([variable(), variable(), variable(), Source::Pose]);
        let mut scanned: Vec<_> = (0..).zip(&points).map(|(index, point)| Scanned::new(index, point)).collect();
        let now = Instant::now();
        assert_eq!(batch(&scanned, now), [0, 1, 2]);
        // the first point timed out, and the others were not read
        let mut read = |batch: &[usize], ms| {
            batch.iter().for_each(|index| scanned[*index].attempted = Some(now + Duration::from_millis(ms)));
            scanned[0].timeouts = 1;
            super::batch(&scanned, now)
        };
        assert_eq!(read(&[0], 1), [1, 2]);
        assert_eq!(read(&[1, 2], 2), [3]);
        assert_eq!(read(&[3], 3), [0]);
        assert_eq!(read(&[0], 4), [1, 2]);
        scanned[1].deadline = now + Duration::from_millis(5);
        assert_eq!(batch(&scanned, now), [2], "the deadline of the other one has not passed");
    }
}
