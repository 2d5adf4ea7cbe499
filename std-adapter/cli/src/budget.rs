//! The time limits of a command.

use std::time::{Duration, Instant};

use crate::args::LinkArgs;

/// The time limit of each answer, and of the whole command if the user gave one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    /// The time limit of an answer or keep-alive.
    answer: Duration,
    /// The time limit of the whole command.
    total: Option<Duration>,
    began: Instant,
}

impl Budget {
    /// Starts the time limits of the command line; `--timeout` limits the whole command.
    pub(crate) fn start(link: &LinkArgs) -> Self {
        Self { answer: link.timeout(), total: link.limit(), began: Instant::now() }
    }

    /// Reduces the time limit of an answer to at most `most`.
    pub(crate) fn answer_within(self, most: Duration) -> Self {
        Self { answer: self.answer.min(most), ..self }
    }

    /// Restarts the time limit of the whole command, for a command that works in rounds.
    pub(crate) fn restart(&mut self) {
        self.began = Instant::now();
    }

    /// Returns the time limit of an answer or keep-alive.
    pub(crate) const fn answer(&self) -> Duration {
        self.answer
    }

    /// Returns the time limit of the whole command.
    pub(crate) const fn total(&self) -> Option<Duration> {
        self.total
    }

    /// Returns the remaining time of the whole command; zero if it is exhausted.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.total.map(|total| total.saturating_sub(self.began.elapsed()))
    }

    /// Returns the time limit for one of `count` attempts made in turn.
    pub(crate) fn share(&self, count: usize) -> Duration {
        let count = u32::try_from(count).unwrap_or(u32::MAX).max(1);
        // a socket's timeout cannot be zero
        self.left().map_or(self.answer, |left| left / count).max(Duration::from_millis(1))
    }
}
