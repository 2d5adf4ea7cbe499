//! The trace of the arm: its position every 8 ms, for the log of StartLog and for a [`Recorder`].

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::time::Instant;

use crate::kinematics::Axes;

/// The interval of the trace: a control cycle.
pub const INTERVAL: Duration = Duration::from_millis(8);

/// The largest number of points in the log; a full log drops its oldest point. 80 s are more than the 30 s of the public
/// sample `Get_Syslog.py`.
const CAPACITY: usize = 10_000;

/// A point of the trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePoint {
    /// When.
    pub at: Instant,
    /// J1 to J8, in degrees or mm.
    pub axes: [f64; 8],
    /// X Y Z in mm and RX RY RZ in degrees of the tool centre point in work coordinates.
    pub position: [f64; 6],
    /// The present tool.
    pub tool: i32,
    /// The present work coordinates.
    pub work: i32,
}

type Tell = dyn Fn(&TracePoint) + Send + Sync;

/// Receives the points of the trace while the arm moves, and the first point at rest.
#[derive(Clone, Default)]
pub struct Recorder(Option<Arc<Tell>>);

impl Recorder {
    /// Makes a recorder of a function.
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

/// The log, and the time of the next point.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trace {
    log: VecDeque<TracePoint>,
    logging: bool,
    next: Instant,
    last: Option<Axes>,
    /// The recorder has the present point of rest.
    rested: bool,
}

impl Trace {
    /// Executes StartLog.
    pub(crate) fn start(&mut self, now: Instant) {
        if !self.logging {
            (self.logging, self.next) = (true, now);
        }
    }

    /// Executes StopLog; returns whether the log was running.
    pub(crate) fn stop(&mut self) -> bool {
        std::mem::take(&mut self.logging)
    }

    pub(crate) fn clear(&mut self) {
        self.log.clear();
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
        if !self.logging && !recorder.is_on() {
            return None;
        }
        if rest && (self.rested || !recorder.is_on()) {
            let kept = if self.logging { INTERVAL * CAPACITY as u32 } else { INTERVAL };
            let behind = until.saturating_since(self.next).saturating_sub(kept);
            let skipped = u64::try_from(behind.as_micros() / INTERVAL.as_micros()).unwrap_or(0);
            self.next = self.next.saturating_add(Duration::from_micros(skipped * INTERVAL.as_micros() as u64));
        }
        (self.next <= until).then_some(self.next)
    }

    /// Records the point whose time has come.
    pub(crate) fn take(&mut self, recorder: &Recorder, point: &TracePoint, rest: bool) {
        self.next = point.at.saturating_add(INTERVAL);
        if self.logging {
            if self.log.len() >= CAPACITY {
                self.log.pop_front();
            }
            self.log.push_back(*point);
        }
        let moved = self.last.replace(point.axes) != Some(point.axes);
        if let Some(tell) = recorder.0.as_ref().filter(|_| !rest || moved || !self.rested) {
            tell(point);
        }
        self.rested = rest;
    }
}
