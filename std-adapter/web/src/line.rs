//! The WebSocket of a page, and the heartbeats of its jog.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{Message, WebSocket};
use bcap_live::jog::Grip;
use serde::Deserialize;
use serde_json::json;
use tokio::time::{Interval, MissedTickBehavior, interval, timeout};

/// The longest time for a message to a page. A page that does not take it is closed.
const SEND: Duration = Duration::from_secs(10);

/// How often a page that holds a robot gets a pulse, to which it answers with a heartbeat.
const PULSE: Duration = Duration::from_millis(40);

/// The pulses whose heartbeats count.
const PULSES: usize = 8;

/// The longest time without a heartbeat for a page that may make calls that move.
const LOST: Duration = Duration::from_secs(2);

/// The most orders that wait while one is carried out.
const WAITING: usize = 32;

/// The answer of a page to a pulse: it is open, visible, and its scripts run. It has no answer.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Beat {
    beat: u64,
}

/// The WebSocket of a page, and the heartbeats of its jog.
pub(crate) struct Line {
    socket: WebSocket,
    /// Orders that arrived while another one was carried out.
    waiting: VecDeque<String>,
    pub(crate) grip: Option<Arc<Grip>>,
    /// The time of the last pulse with a heartbeat, if the page must send them without a jog.
    watched: Option<Instant>,
    pulse: Interval,
    /// The number of the last pulse.
    last: u64,
    /// When the last pulses were sent, the latest last.
    sent: VecDeque<Instant>,
}

impl Line {
    pub(crate) fn new(socket: WebSocket) -> Self {
        let mut pulse = interval(PULSE);
        pulse.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self { socket, waiting: VecDeque::new(), grip: None, watched: None, pulse, last: 0, sent: VecDeque::new() }
    }

    /// Sets whether the page must send heartbeats without a jog.
    pub(crate) fn watch(&mut self, is_watched: bool) {
        self.watched = is_watched.then(|| self.watched.unwrap_or_else(Instant::now));
    }

    /// Returns whether a page that must send heartbeats has sent none for too long.
    pub(crate) fn is_lost(&self) -> bool {
        self.watched.is_some_and(|last| last.elapsed() > LOST)
    }

    pub(crate) async fn send(&mut self, text: String) -> Option<()> {
        timeout(SEND, self.socket.send(Message::Text(text.into()))).await.ok()?.ok()
    }

    /// Waits for the next order. Sends pulses and records heartbeats meanwhile. `None` is the end of the page.
    pub(crate) async fn order(&mut self) -> Option<String> {
        if let Some(text) = self.waiting.pop_front() {
            return Some(text);
        }
        loop {
            if let Some(text) = self.next().await? {
                return Some(text);
            }
        }
    }

    /// Takes orders while another one is carried out. Ends only at the end of the page.
    pub(crate) async fn hold(&mut self) -> Option<()> {
        while self.waiting.len() < WAITING {
            if let Some(text) = self.next().await? {
                self.waiting.push_back(text);
            }
        }
        // backpressure: a page that sends this much gets no pulse either, which ends its jog
        std::future::pending().await
    }

    /// Sends a pulse, or receives an order or a heartbeat.
    async fn next(&mut self) -> Option<Option<String>> {
        tokio::select! {
            _ = self.pulse.tick(), if self.grip.is_some() || self.watched.is_some() => {
                self.last += 1;
                self.sent.push_back(Instant::now());
                if self.sent.len() > PULSES {
                    self.sent.pop_front();
                }
                self.send(json!({ "t": "pulse", "n": self.last }).to_string()).await?;
                Some(None)
            }
            message = self.socket.recv() => match message {
                Some(Ok(Message::Text(text))) => match serde_json::from_str::<Beat>(&text) {
                    Ok(Beat { beat }) => {
                        self.beat(beat);
                        Some(None)
                    }
                    Err(_) => Some(Some(text.as_str().to_owned())),
                },
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Some(None),
                _ => None,
            },
        }
    }

    /// Records a heartbeat. It counts from the time of its pulse, so that heartbeats that were held up on the way are old.
    fn beat(&mut self, number: u64) {
        let Some(age) = self.last.checked_sub(number).and_then(|age| usize::try_from(age).ok()) else { return };
        let Some(sent) = self.sent.iter().rev().nth(age) else { return };
        if let Some(last) = &mut self.watched {
            *last = *sent;
        }
        if let Some(grip) = &self.grip {
            grip.beat(*sent);
        }
    }
}
