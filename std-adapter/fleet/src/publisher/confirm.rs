//! Confirms readings of QoS 0, which Sparkplug demands and MQTT does not acknowledge.
//!
//! A broker handles the packets of a connection in their order. So the acknowledgement of an empty message of QoS 1 confirms
//! everything sent before it. At most one such message is pending.

use std::collections::VecDeque;

use rumqttc::QoS;

use crate::config::Config;
use crate::message::Message;
use crate::reading::Reading;

/// No message is sent while this many readings are unconfirmed. Below this limit the window counts messages, and a message has
/// up to 100 readings. So at most about 20,000 readings are unconfirmed.
const LIMIT: usize = 10_000;

/// The message that confirms the messages before it. Its topic has no subscribers.
pub(super) fn message(config: &Config) -> Message {
    let topic = crate::json::topic(config, &config.node, "confirm");
    let (payload, readings) = Default::default();
    Message { topic, payload, qos: QoS::AtLeastOnce, retain: false, entries: 0, readings }
}

/// Readings that were written to the connection.
#[derive(Debug, Default)]
pub(super) struct Unconfirmed {
    readings: VecDeque<Reading>,
    /// Whether a message to confirm was passed to the link, and its acknowledgement has not arrived.
    is_asking: bool,
    /// The number of readings that the acknowledgement confirms.
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

    /// Returns whether the link must send a message to confirm now.
    pub(super) fn asks(&mut self) -> bool {
        let asks = !self.is_empty() && !self.is_asking;
        self.is_asking |= asks;
        asks
    }

    /// The message to confirm was written.
    pub(super) fn asked(&mut self) {
        self.asked = self.readings.len();
    }

    /// Its acknowledgement has arrived: returns the readings that it confirms.
    pub(super) fn confirmed(&mut self) -> Vec<Reading> {
        self.is_asking = false;
        let count = std::mem::take(&mut self.asked).min(self.readings.len());
        self.readings.drain(..count).collect()
    }

    pub(super) fn into_readings(self) -> VecDeque<Reading> {
        self.readings
    }
}
