//! When the next pose of a stream is sent, and how well that is kept.
//!
//! ```text
//!  mode   the next pose is sent
//!   0     after S_OK at once, which fills the buffer; after S_BUF_FULL one cycle after the last one's time;
//!         after E_BUF_FULL the same pose again, a cycle later
//!   1     one cycle after the last one's time; cycles that were missed are left out
//!   2     at once: the answer is withheld until there is room
//! ```
//!
//! Times are absolute: a cycle that was late does not shift those after it.

use core::time::Duration;

use super::config::Config;
use super::mode::Mode;
use super::stats::Stats;
use crate::time::{Instant, micros_u32};

/// When the next pose is sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    /// Whether a pose is in the frame that the controller has not taken.
    pub(super) loaded: bool,
    /// When it is to be sent.
    pub(super) due: Instant,
    /// Whether `due` is a cycle after the one before, and not as soon as possible.
    steady: bool,
    /// Poses that the controller has taken of this stream.
    pub(super) taken: u32,
    last_sent: Instant,
    /// Since when the controller has answered E_BUF_FULL.
    refused_since: Option<Instant>,
    /// When the controller's buffer will be empty.
    empty_at: Option<Instant>,
}

impl Pacer {
    pub(super) const fn new(now: Instant) -> Self {
        Self { loaded: false, due: now, steady: false, taken: 0, last_sent: now, refused_since: None, empty_at: None }
    }

    /// Takes note that the pose is sent now.
    pub(super) fn sending(&mut self, config: &Config, stats: &mut Stats, now: Instant) {
        if self.steady {
            let (behind, cycle) = (micros_u32(now.saturating_since(self.due)), micros_u32(config.cycle));
            let interval = micros_u32(now.saturating_since(self.last_sent));
            let (late, off) = match config.format.mode.mode {
                Mode::Mode0 | Mode::Mode1 => (behind, behind),
                Mode::Mode2 => (interval.saturating_sub(cycle), interval.abs_diff(cycle)),
            };
            stats.jitter.record(off);
            if late > micros_u32(config.late_after) {
                stats.late = stats.late.saturating_add(1);
            }
            if let Some(margin) = self.margin(now) {
                stats.least_margin = Some(stats.least_margin.map_or(margin, |least| least.min(margin)));
            }
            // the grid stays where it is; cycles that have passed are left out
            let missed = behind.checked_div(cycle).unwrap_or(0);
            self.due = self.due.saturating_add(config.cycles(missed));
        } else {
            self.due = now;
        }
        self.last_sent = now;
    }

    /// Takes note that the pose was not stored; `true` when that has gone on for too long.
    pub(super) fn refused(&mut self, config: &Config, now: Instant) -> bool {
        let since = *self.refused_since.get_or_insert(now);
        self.due = now.saturating_add(config.cycle);
        self.steady = true;
        now.saturating_since(since) >= config.stall
    }

    /// Takes note that the pose was stored, and schedules the next one.
    pub(super) fn stored(&mut self, config: &Config, full: bool, now: Instant) {
        self.loaded = false;
        self.refused_since = None;
        self.taken = self.taken.saturating_add(1);
        let mode = config.format.mode.mode;
        match mode {
            Mode::Mode0 if full => {
                self.due = self.due.saturating_add(config.cycle);
                self.steady = true;
            }
            Mode::Mode0 => {
                self.due = now;
                self.steady = false;
            }
            Mode::Mode1 => {
                self.due = self.due.saturating_add(config.cycle);
                self.steady = true;
            }
            Mode::Mode2 => {
                self.due = now;
                // the controller may take one while the buffer is filled, and the first that is withheld comes within a
                // cycle of its own
                self.steady = self.taken > mode.buffer().saturating_add(2);
            }
        }
        if mode != Mode::Mode1 {
            let most = now.saturating_add(config.cycles(mode.buffer()));
            let one_more = self.empty_at.unwrap_or(now).max(now).saturating_add(config.cycle);
            self.empty_at = Some(if full { most } else { one_more.min(most) });
        }
    }

    /// Returns how long the controller's buffer will last.
    pub(super) fn margin(&self, now: Instant) -> Option<Duration> {
        self.empty_at.map(|at| at.saturating_since(now))
    }
}
