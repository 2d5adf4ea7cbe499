//! The trace of the arm: its position every 8 ms, for the control log and for a [`Recorder`].

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::kinematics::Axes;

/// The interval of the trace: a control cycle.
pub const INTERVAL: Duration = Duration::from_millis(8);

/// The lengths of the log that SetCtrlLogMaxTime accepts, in s, and the intervals of SetCtrlLogInterval, in ms.
const LENGTHS: std::ops::RangeInclusive<i32> = 10..=240;
const INTERVALS: std::ops::RangeInclusive<i32> = 8..=32;

/// The codes of real controllers for settings of the control log out of range.
const LOG_INTERVAL: HResult = HResult::from_u32(0x8120_1A83);
const LOG_LENGTH: HResult = HResult::from_u32(0x8120_1A84);

/// A point of the trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePoint {
    /// When.
    pub at: Instant,
    /// J1 to J8, in degrees or mm.
    pub axes: [f64; 8],
    /// X Y Z in mm and RX RY RZ in degrees of the tool centre point in work coordinates.
    pub position: [f64; 6],
    /// The current tool.
    pub tool: i32,
    /// The current work coordinates.
    pub work: i32,
}

type TraceCallback = dyn Fn(&TracePoint) + Send + Sync;

/// Receives the points of the trace while the arm moves, and the first point at rest.
#[derive(Clone, Default)]
pub struct Recorder(Option<Arc<TraceCallback>>);

impl Recorder {
    /// Creates a recorder of a function.
    #[must_use]
    pub fn new(tell: impl Fn(&TracePoint) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(tell)))
    }

    const fn is_on(&self) -> bool {
        self.0.is_some()
    }
}

impl fmt::Debug for Recorder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Recorder")
    }
}

/// The control log, a ring of points; and the points of the recorder.
///
/// ```text
///  ClearLog: empty, records ──── StartLog: ends when the ring is full again ────> ended
///                 └───────────── StopLog ────────────────────────────────────────> ended
/// ```
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    log: VecDeque<TracePoint>,
    /// The time of the next point of the log, while it records.
    next: Option<Instant>,
    /// The number of points after which the log ends.
    left: Option<usize>,
    /// In s.
    length: i32,
    /// In ms.
    interval: i32,
    /// The time of the next point of the recorder.
    next_told: Instant,
    last: Option<Axes>,
    /// The recorder has received the current point of rest.
    rested: bool,
}

impl Default for Trace {
    /// A log of 10 s with a point every 8 ms, as on a real RC8.
    fn default() -> Self {
        let log = VecDeque::new();
        let (length, interval) = (*LENGTHS.start(), *INTERVALS.start());
        Self { log, next: None, left: None, length, interval, next_told: Instant::ZERO, last: None, rested: false }
    }
}

impl Trace {
    /// Executes ClearLog: empties the log, and records from now on.
    pub(crate) fn clear(&mut self, now: Instant) {
        self.log.clear();
        (self.next, self.left) = (Some(now), None);
    }

    /// Executes StartLog. The log ends by itself when the number of further points reaches its capacity.
    ///
    /// # Errors
    ///
    /// `E_INVALIDARG` for a log that does not record.
    pub(crate) fn start(&mut self) -> Result<(), HResult> {
        self.next.ok_or(HResult::E_INVALIDARG)?;
        self.left = self.left.or(Some(self.capacity()));
        Ok(())
    }

    /// Executes StopLog.
    ///
    /// # Errors
    ///
    /// `E_INVALIDARG` for a log that does not record.
    pub(crate) fn stop(&mut self) -> Result<(), HResult> {
        self.next.take().map(drop).ok_or(HResult::E_INVALIDARG)
    }

    /// Returns the length of the log in s.
    pub(crate) fn length(&self) -> i32 {
        self.length
    }

    /// Returns the interval of the log in ms.
    pub(crate) fn interval(&self) -> i32 {
        self.interval
    }

    /// Sets the length of the log in s.
    ///
    /// # Errors
    ///
    /// `LOG_LENGTH` for a length that is too short or too long.
    pub(crate) fn set_length(&mut self, seconds: i32) -> Result<(), HResult> {
        self.length = Some(seconds).filter(|n| LENGTHS.contains(n)).ok_or(LOG_LENGTH)?;
        Ok(())
    }

    /// Sets the interval of the log in ms.
    ///
    /// # Errors
    ///
    /// `LOG_INTERVAL` for an interval that is too short or too long.
    pub(crate) fn set_interval(&mut self, millis: i32) -> Result<(), HResult> {
        self.interval = Some(millis).filter(|n| INTERVALS.contains(n)).ok_or(LOG_INTERVAL)?;
        Ok(())
    }

    fn step(&self) -> Duration {
        Duration::from_millis(self.interval.unsigned_abs().into())
    }

    /// Returns the largest number of points in the log; a full log drops its oldest point.
    fn capacity(&self) -> usize {
        usize::try_from(self.length * 1000 / self.interval).unwrap_or(0)
    }

    pub(crate) fn len(&self) -> usize {
        self.log.len()
    }

    /// Returns a point of the log; 0 is the oldest.
    pub(crate) fn get(&self, n: usize) -> Option<&TracePoint> {
        self.log.get(n)
    }

    /// Returns the time of the next point, if it is not after `until`. While the arm is at rest, skips points that
    /// neither the recorder nor the log would keep.
    pub(crate) fn next(&mut self, recorder: &Recorder, until: Instant, rest: bool) -> Option<Instant> {
        let step = self.step();
        if let (Some(next), true, None) = (self.next, rest, self.left) {
            self.next = Some(skipped(next, until, step, step * u32::try_from(self.capacity()).unwrap_or(0)));
        }
        if rest && self.rested {
            self.next_told = skipped(self.next_told, until, INTERVAL, INTERVAL);
        }
        let told = recorder.is_on().then_some(self.next_told);
        self.next.into_iter().chain(told).min().filter(|next| *next <= until)
    }

    /// Records a point, if its time has been reached.
    pub(crate) fn take(&mut self, recorder: &Recorder, point: &TracePoint, rest: bool) {
        if self.next.is_some_and(|next| next <= point.at) {
            self.log_point(point);
        }
        if self.next_told > point.at {
            return;
        }
        self.next_told = point.at.saturating_add(INTERVAL);
        let moved = self.last.replace(point.axes) != Some(point.axes);
        if let Some(tell) = recorder.0.as_ref().filter(|_| !rest || moved || !self.rested) {
            tell(point);
        }
        self.rested = rest;
    }

    fn log_point(&mut self, point: &TracePoint) {
        while self.log.len() >= self.capacity() {
            self.log.pop_front();
        }
        self.log.push_back(*point);
        self.left = self.left.map(|left| left.saturating_sub(1));
        self.next = Some(point.at.saturating_add(self.step())).filter(|_| self.left != Some(0));
    }
}

/// Skips the points between a time and `until`, except for the last `kept` of that time.
fn skipped(next: Instant, until: Instant, step: Duration, kept: Duration) -> Instant {
    let behind = until.saturating_since(next).saturating_sub(kept);
    let steps = u64::try_from(behind.as_micros() / step.as_micros().max(1)).unwrap_or(0);
    next.saturating_add(Duration::from_micros(steps * step.as_micros() as u64))
}
