//! The send times of the poses of a stream, and their jitter.
//!
//! ```text
//!  mode   the next pose is sent
//!   0     after S_OK at once, which fills the buffer; after S_BUF_FULL one cycle after the last deadline;
//!         after E_BUF_FULL the same pose again, one cycle later
//!   1     one cycle after the last deadline; missed cycles are skipped
//!   2     at once: the controller delays its reply until there is room
//! ```
//!
//! Deadlines are absolute: a late cycle does not shift later ones.

use core::time::Duration;

use super::config::Config;
use super::mode::Mode;
use super::stats::Stats;
use crate::time::{Instant, micros_u32};

/// Computes the deadline of each pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    /// Whether the frame contains a pose that the controller has not stored.
    pub(super) loaded: bool,
    /// The deadline of that pose.
    pub(super) deadline: Instant,
    /// Whether `deadline` is one cycle after the previous one, instead of as soon as possible.
    steady: bool,
    /// Poses of this stream that the controller has stored.
    pub(super) taken: u32,
    last_sent: Instant,
    /// The first of the current replies E_BUF_FULL.
    refused_since: Option<Instant>,
    /// The estimated time at which the controller's buffer is empty.
    empty_at: Option<Instant>,
}

impl Pacer {
    pub(super) const fn new(now: Instant) -> Self {
        Self {
            loaded: false,
            deadline: now,
            steady: false,
            taken: 0,
            last_sent: now,
            refused_since: None,
            empty_at: None,
        }
    }

    /// Records that the pose is sent now.
    pub(super) fn sending(&mut self, config: &Config, stats: &mut Stats, now: Instant) {
        if self.steady {
            let (overrun, cycle) = (micros_u32(now.saturating_since(self.deadline)), micros_u32(config.cycle));
            let interval = micros_u32(now.saturating_since(self.last_sent));
            let (late, off) = match config.format.mode.mode {
                Mode::Mode0 | Mode::Mode1 => (overrun, overrun),
                Mode::Mode2 => (interval.saturating_sub(cycle), interval.abs_diff(cycle)),
            };
            stats.jitter.record(off);
            if late > micros_u32(config.late_after) {
                stats.late = stats.late.saturating_add(1);
            }
            if let Some(margin) = self.margin(now) {
                stats.least_margin = Some(stats.least_margin.map_or(margin, |least| least.min(margin)));
            }
            // the grid of deadlines does not move; missed cycles are skipped
            let missed = overrun.checked_div(cycle).unwrap_or(0);
            self.deadline = self.deadline.saturating_add(config.cycles(missed));
        } else {
            self.deadline = now;
        }
        self.last_sent = now;
    }

    /// Records that the pose was not stored; `true` when this has lasted for [`Config::stall`].
    pub(super) fn refused(&mut self, config: &Config, now: Instant) -> bool {
        let since = *self.refused_since.get_or_insert(now);
        self.deadline = now.saturating_add(config.cycle);
        self.steady = true;
        now.saturating_since(since) >= config.stall
    }

    /// Records that the pose was stored, and schedules the next pose.
    pub(super) fn stored(&mut self, config: &Config, full: bool, now: Instant) {
        self.loaded = false;
        self.refused_since = None;
        self.taken = self.taken.saturating_add(1);
        let mode = config.format.mode.mode;
        match mode {
            Mode::Mode0 if full => {
                self.deadline = self.deadline.saturating_add(config.cycle);
                self.steady = true;
            }
            Mode::Mode0 => {
                self.deadline = now;
                self.steady = false;
            }
            Mode::Mode1 => {
                self.deadline = self.deadline.saturating_add(config.cycle);
                self.steady = true;
            }
            Mode::Mode2 => {
                self.deadline = now;
                // the controller may execute a pose while the buffer fills, and its first delayed reply arrives within one
                // cycle
                self.steady = self.taken > mode.buffer().saturating_add(2);
            }
        }
        if mode != Mode::Mode1 {
            let most = now.saturating_add(config.cycles(mode.buffer()));
            let one_more = self.empty_at.unwrap_or(now).max(now).saturating_add(config.cycle);
            self.empty_at = Some(if full { most } else { one_more.min(most) });
        }
    }

    /// Returns an estimate of how long the controller's buffer will last.
    pub(super) fn margin(&self, now: Instant) -> Option<Duration> {
        self.empty_at.map(|at| at.saturating_since(now))
    }
}
