//! A connection to the broker, with its messages until the broker has them.

use std::collections::{HashMap, VecDeque};
use std::time::Duration;

use rumqttc::{PublishOptions, QoS};
use tokio::time::Instant;

use super::confirm::{self, Unconfirmed};
use crate::broker::{Link, LinkEvent, WINDOW};
use crate::config::Config;
use crate::message::Message;
use crate::reading::Reading;

/// A message passed to the link, until the broker confirms it.
struct Sent {
    at: Instant,
    readings: Vec<Reading>,
    /// Whether its acknowledgement confirms the messages before it.
    confirms: bool,
}

/// The progress of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// No messages are published: the broker has not accepted the connection, or the primary host is offline.
    Waiting,
    /// The node is born when the broker has answered all subscriptions, so that no command to it is lost.
    Subscribing,
    /// Messages are published.
    Up,
}

/// A connection and its messages.
pub(super) struct Connection {
    pub(super) link: Link,
    pub(super) phase: Phase,
    /// When the connection was accepted.
    pub(super) began: Instant,
    /// The number of subscriptions that the broker has not answered.
    pub(super) subscribing: usize,
    confirm: Message,
    /// Messages to give to the link.
    pub(super) out: VecDeque<Message>,
    /// Messages to give to the link before those: answers to commands, and the repeated state of the node. They have no readings.
    pub(super) urgent: VecDeque<Message>,
    /// Messages that the link has not sent.
    sent: VecDeque<Sent>,
    /// Messages that the broker has not acknowledged, by packet.
    waiting: HashMap<u16, Sent>,
    /// Messages without acknowledgements.
    unconfirmed: Unconfirmed,
}

impl Connection {
    pub(super) fn new(link: Link, config: &Config) -> Self {
        let (out, urgent, sent, waiting, unconfirmed, subscribing) = Default::default();
        let (phase, began, confirm) = (Phase::Waiting, Instant::now(), confirm::message(config));
        Self { link, phase, began, subscribing, confirm, out, urgent, sent, waiting, unconfirmed }
    }

    pub(super) fn is_up(&self) -> bool {
        self.phase == Phase::Up
    }

    /// Messages are published from now on.
    pub(super) fn rise(&mut self) {
        (self.phase, self.began) = (Phase::Up, Instant::now());
    }

    /// Subscribes to topics.
    pub(super) fn subscribe(&mut self, topics: impl IntoIterator<Item = String>) {
        for topic in topics {
            // the channel of the link has room; after a loss the event follows
            self.subscribing += usize::from(self.link.client.try_subscribe(topic, QoS::AtLeastOnce).is_ok());
        }
    }

    pub(super) fn room(&self) -> usize {
        usize::from(WINDOW).min(self.unconfirmed.room()).saturating_sub(self.in_flight() + self.unsent())
    }

    fn in_flight(&self) -> usize {
        self.sent.len() + self.waiting.len()
    }

    fn unsent(&self) -> usize {
        self.urgent.len() + self.out.len()
    }

    /// Returns whether the broker has all messages.
    pub(super) fn is_idle(&self) -> bool {
        self.unsent() == 0 && self.in_flight() == 0 && self.unconfirmed.is_empty()
    }

    /// Returns how long it has lasted since the broker accepted it.
    pub(super) fn age(&self) -> Duration {
        if self.is_up() { self.began.elapsed() } else { Duration::ZERO }
    }

    /// Gives messages to the link.
    pub(super) fn flush(&mut self) {
        while self.in_flight() < usize::from(WINDOW) {
            let Some(message) = self.urgent.pop_front().or_else(|| self.out.pop_front()) else { break };
            self.send(message);
        }
        if self.in_flight() < usize::from(WINDOW) && self.unconfirmed.asks() {
            self.transmit(self.confirm.clone(), true);
        }
    }

    pub(super) fn send(&mut self, message: Message) {
        self.transmit(message, false);
    }

    fn transmit(&mut self, message: Message, confirms: bool) {
        let Message { topic, payload, qos, retain, readings, .. } = message;
        // the channel of the link has room for more than the window; after a loss the event follows
        let _ = self.link.client.try_publish(topic, payload, PublishOptions::new(qos).retain(retain));
        self.sent.push_back(Sent { at: Instant::now(), readings, confirms });
    }

    /// The link has written a message: as this packet, or as 0 if the broker will not acknowledge it.
    pub(super) fn written(&mut self, packet: u16) {
        let Some(sent) = self.sent.pop_front() else { return };
        if sent.confirms {
            self.unconfirmed.asked();
        }
        if packet == 0 {
            self.unconfirmed.push(sent.readings);
        } else {
            self.waiting.insert(packet, sent);
        }
    }

    /// The broker has acknowledged a packet: returns when it was sent, and the readings that have arrived.
    pub(super) fn acknowledged(&mut self, packet: u16) -> Option<(Instant, Vec<Reading>)> {
        let Sent { at, mut readings, confirms } = self.waiting.remove(&packet)?;
        if confirms {
            readings.extend(self.unconfirmed.confirmed());
        }
        Some((at, readings))
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
