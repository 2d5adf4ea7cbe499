//! A connection to the broker, with its messages until the broker has them.

use std::collections::{HashMap, VecDeque};
use std::time::Duration;

use rumqttc::PublishOptions;
use tokio::time::Instant;

use super::confirm::{self, Unconfirmed};
use crate::broker::{Link, LinkEvent, WINDOW};
use crate::message::Message;
use crate::reading::Reading;

/// A message passed to the link, until the broker confirms it.
pub(super) struct Sent {
    pub(super) at: Instant,
    pub(super) readings: Vec<Reading>,
}

/// A connection and its messages.
pub(super) struct Connection {
    pub(super) link: Link,
    /// Whether the broker has accepted it.
    pub(super) is_up: bool,
    pub(super) began: Instant,
    /// Messages to give to the link.
    pub(super) out: VecDeque<Message>,
    /// Messages that the link has not sent.
    pub(super) sent: VecDeque<Sent>,
    /// Messages that the broker has not acknowledged, by packet.
    pub(super) waiting: HashMap<u16, Sent>,
    /// Messages without acknowledgements.
    pub(super) unconfirmed: Unconfirmed,
}

impl Connection {
    pub(super) fn new(link: Link) -> Self {
        let (out, sent, waiting, unconfirmed) = Default::default();
        Self { link, is_up: false, began: Instant::now(), out, sent, waiting, unconfirmed }
    }

    pub(super) fn room(&self) -> usize {
        usize::from(WINDOW).min(self.unconfirmed.room()).saturating_sub(self.in_flight() + self.out.len())
    }

    fn in_flight(&self) -> usize {
        self.sent.len() + self.waiting.len()
    }

    /// Returns whether the broker has all messages.
    pub(super) fn is_idle(&self) -> bool {
        self.out.is_empty() && self.in_flight() == 0 && self.unconfirmed.is_empty()
    }

    /// Returns how long it has lasted since the broker accepted it.
    pub(super) fn age(&self) -> Duration {
        if self.is_up { self.began.elapsed() } else { Duration::ZERO }
    }

    /// Gives messages to the link.
    pub(super) fn flush(&mut self) {
        while self.in_flight() < usize::from(WINDOW) {
            let Some(message) = self.out.pop_front() else { break };
            self.send(message);
        }
        self.unconfirmed.ask(|| self.link.client.try_unsubscribe(confirm::TOPIC).is_ok());
    }

    pub(super) fn send(&mut self, message: Message) {
        let Message { topic, payload, qos, retain, readings } = message;
        // the channel of the link has room for more than the window; after a loss the event follows
        let _ = self.link.client.try_publish(topic, payload, PublishOptions::new(qos).retain(retain));
        self.sent.push_back(Sent { at: Instant::now(), readings });
    }

    /// The link has written a message: as this packet, or as 0 if the broker will not acknowledge it.
    pub(super) fn written(&mut self, packet: u16) {
        let Some(sent) = self.sent.pop_front() else { return };
        if packet == 0 {
            self.unconfirmed.push(sent.readings);
        } else {
            self.waiting.insert(packet, sent);
        }
    }

    /// Returns the readings that may not have arrived, the oldest first.
    pub(super) fn into_readings(self) -> Vec<Reading> {
        let out = self.out.into_iter().map(|message| message.readings);
        let sent = self.waiting.into_values().chain(self.sent).map(|sent| sent.readings);
        let mut readings: Vec<_> = sent.chain(out).flatten().chain(self.unconfirmed.into_readings()).collect();
        readings.sort_by_key(|reading| reading.id);
        readings
    }
}

/// Waits for the next event of a connection. Cancel-safe.
pub(super) async fn next(link: &mut Option<Connection>) -> Option<LinkEvent> {
    match link {
        Some(connection) => connection.link.events.recv().await,
        None => std::future::pending().await,
    }
}
