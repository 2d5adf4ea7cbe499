//! The time that a command may take.

use std::time::{Duration, Instant};

use crate::args::LinkArgs;

/// The time for each answer, and for all of them if the user has limited it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    /// How long to wait for an answer, or for the next keep-alive.
    answer: Duration,
    /// How long everything may take.
    total: Option<Duration>,
    began: Instant,
}

impl Budget {
    /// Begins with what the command line says: `--timeout` limits everything.
    pub(crate) fn start(link: &LinkArgs) -> Self {
        Self { answer: link.timeout(), total: link.limit(), began: Instant::now() }
    }

    /// Waits for an answer for no longer than this.
    pub(crate) fn answer_within(self, most: Duration) -> Self {
        Self { answer: self.answer.min(most), ..self }
    }

    /// Begins again, for a command that does the same until it is stopped.
    pub(crate) fn restart(&mut self) {
        self.began = Instant::now();
    }

    /// Returns how long to wait for an answer, or for the next keep-alive.
    pub(crate) const fn answer(&self) -> Duration {
        self.answer
    }

    /// Returns how long everything may take.
    pub(crate) const fn total(&self) -> Option<Duration> {
        self.total
    }

    /// Returns how much of the total is left; zero when it is exhausted.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.total.map(|total| total.saturating_sub(self.began.elapsed()))
    }

    /// Returns how long to wait for one of `count` things that are tried in turn.
    pub(crate) fn share(&self, count: usize) -> Duration {
        let count = u32::try_from(count).unwrap_or(u32::MAX).max(1);
        // a socket's timeout cannot be zero
        self.left().map_or(self.answer, |left| left / count).max(Duration::from_millis(1))
    }
}
