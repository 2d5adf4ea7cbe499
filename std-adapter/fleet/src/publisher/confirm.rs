//! Confirms readings of QoS 0, which Sparkplug demands: they have no acknowledgements of their own.
//!
//! A broker handles the packets of a connection in their order, and answers an UNSUBSCRIBE also if there is no such
//! subscription. So the answer confirms all that was sent before. There is at most one question at a time: the more is sent,
//! the more each answer confirms.

use std::collections::VecDeque;

use crate::reading::Reading;

/// The most readings without confirmation.
const LIMIT: usize = 10_000;

/// The topic that is unsubscribed. Nothing subscribes to it.
pub(super) const TOPIC: &str = "bcap/confirm";

/// Readings that were written to the connection.
#[derive(Debug, Default)]
pub(super) struct Unconfirmed {
    readings: VecDeque<Reading>,
    /// Whether a question was given to the link, or waits for its answer.
    is_asking: bool,
    /// How many readings the answer confirms.
    asked: usize,
}

impl Unconfirmed {
    pub(super) fn room(&self) -> usize {
        LIMIT.saturating_sub(self.readings.len())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.readings.is_empty()
    }

    /// A message was written.
    pub(super) fn push(&mut self, readings: Vec<Reading>) {
        self.readings.extend(readings);
    }

    /// Asks with a function if there is something to confirm. The function says whether the link took the question; if not,
    /// the next call asks.
    pub(super) fn ask(&mut self, send: impl FnOnce() -> bool) {
        if !self.is_empty() && !self.is_asking {
            self.is_asking = send();
        }
    }

    /// The question was written.
    pub(super) fn asked(&mut self) {
        self.asked = self.readings.len();
    }

    /// The answer has arrived: returns the readings that it confirms.
    pub(super) fn confirmed(&mut self) -> Vec<Reading> {
        self.is_asking = false;
        let count = std::mem::take(&mut self.asked).min(self.readings.len());
        self.readings.drain(..count).collect()
    }

    pub(super) fn into_readings(self) -> VecDeque<Reading> {
        self.readings
    }
}
