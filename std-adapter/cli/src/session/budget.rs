//! The time limits of a command.

use std::time::{Duration, Instant};

use bcap_core::bcap::client::Timing;
use bcap_std::{Address, NetworkAddress, Protocol};

use crate::link::LinkArgs;

/// The time limit of each answer, and of the whole command if the user gave one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    /// The time limit of an answer or keep-alive.
    answer: Duration,
    /// The time limit of the whole command.
    total: Option<Duration>,
    /// The attempts of a call over UDP.
    attempts: u8,
    began: Instant,
}

impl Budget {
    /// Starts the time limits of the command line; `--timeout` limits the whole command.
    pub(crate) fn start(link: &LinkArgs) -> Self {
        Self { answer: link.timeout(), total: link.limit(), attempts: link.attempts(), began: Instant::now() }
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

    /// Returns whether the time of the whole command is over.
    pub(crate) fn is_exhausted(&self) -> bool {
        self.left().is_some_and(|left| left.is_zero())
    }

    /// Returns the end of the whole command.
    pub(crate) fn deadline(&self) -> Option<bcap_core::time::Instant> {
        self.left().map(|left| bcap_std::now().saturating_add(left))
    }

    /// Returns the time limit for one of `count` attempts made in turn.
    pub(crate) fn share(&self, count: usize) -> Duration {
        let count = u32::try_from(count).unwrap_or(u32::MAX).max(1);
        // a socket's timeout cannot be zero
        self.left().map_or(self.answer, |left| left / count).max(Duration::from_millis(1))
    }

    /// Returns `timing` with the time limit of an answer, which the attempts over UDP share. Over a serial line it is not
    /// below the time that the line needs at its baud rate.
    pub(crate) fn timing(&self, timing: Timing, target: &Address) -> Timing {
        let share = (self.answer / u32::from(self.attempts)).max(Duration::from_millis(1));
        match target {
            Address::Network(NetworkAddress { protocol: Protocol::Udp, .. }) => {
                Timing { attempts: self.attempts, attempt_timeout: share, ..timing }
            }
            Address::Serial(_) => Timing { attempt_timeout: timing.attempt_timeout.max(share), ..timing },
            _ => Timing { attempt_timeout: self.answer, ..timing },
        }
    }
}
