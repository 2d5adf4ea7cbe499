//! Confirms readings of QoS 0, which Sparkplug demands and MQTT does not acknowledge.
//!
//! A broker handles the packets of a connection in their order, and answers an UNSUBSCRIBE also if there is no such
//! subscription. At most one UNSUBSCRIBE is pending. Its UNSUBACK confirms everything sent before it.

use std::collections::VecDeque;

use crate::reading::Reading;

/// No message is sent while this many readings are unconfirmed. Below this limit the window counts messages, and a message has
/// up to 100 readings. So at most about 20,000 readings are unconfirmed.
const LIMIT: usize = 10_000;

/// The topic that is unsubscribed. Nothing subscribes to it.
pub(super) const TOPIC: &str = "bcap/confirm";

/// Readings that were written to the connection.
#[derive(Debug, Default)]
pub(super) struct Unconfirmed {
    readings: VecDeque<Reading>,
    /// Whether an UNSUBSCRIBE was passed to the link, and its UNSUBACK has not arrived.
    is_asking: bool,
    /// How many readings the UNSUBACK confirms.
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

    /// Sends an UNSUBSCRIBE with a function if there is something to confirm and none is pending. The function returns whether
    /// the link took it; if not, the next call sends it.
    pub(super) fn ask(&mut self, send: impl FnOnce() -> bool) {
        if !self.is_empty() && !self.is_asking {
            self.is_asking = send();
        }
    }

    /// The UNSUBSCRIBE was written.
    pub(super) fn asked(&mut self) {
        self.asked = self.readings.len();
    }

    /// The UNSUBACK has arrived: returns the readings that it confirms.
    pub(super) fn confirmed(&mut self) -> Vec<Reading> {
        self.is_asking = false;
        let count = std::mem::take(&mut self.asked).min(self.readings.len());
        self.readings.drain(..count).collect()
    }

    pub(super) fn into_readings(self) -> VecDeque<Reading> {
        self.readings
    }
}
