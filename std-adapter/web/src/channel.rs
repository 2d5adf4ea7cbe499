//! The WebSocket of a page, and the heartbeats of its jog.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use bcap_live::jog::Grip;
use serde::Deserialize;
use serde_json::json;
use tokio::time::{Interval, MissedTickBehavior, interval, timeout};

use crate::app::App;
use crate::control::Client;
use crate::motions::{self, SharedMotions};
use crate::order::Order;
use crate::robot::LONGEST_WAIT;
use crate::text::safe;
use crate::threads::lock;

/// Maximum time to send a message to a page. A page that does not accept it in time is closed.
const SEND: Duration = Duration::from_secs(10);

/// Interval of the pulses to a page that holds a robot. The page answers each pulse with a heartbeat.
const PULSE: Duration = Duration::from_millis(40);

/// Number of pulses whose heartbeats count: the pulses of the last [`LOST`].
const PULSES: usize = 50;

/// Maximum time without a heartbeat for a page that may make calls that move the robot.
const LOST: Duration = Duration::from_secs(2);

/// Maximum time without any message from a page. Its browser answers a ping every second, even while the page is hidden.
const SILENT: Duration = Duration::from_secs(10);

/// The maximum number of orders that wait while one is carried out.
const PENDING: usize = 32;

/// Reply of a page to a pulse: it is open, visible, and its scripts run. The server does not acknowledge it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Beat {
    beat: u64,
    /// The number of the press whose button is held; 0 without one.
    held: u64,
}

/// The WebSocket of a page, and the heartbeats of its jog.
pub(crate) struct Channel {
    socket: WebSocket,
    /// Orders that arrived while another order was running.
    pending: VecDeque<Received>,
    app: Arc<App>,
    client: Client,
    /// Number of orders that ended motions of the page while another order was running.
    ends: u64,
    motions: SharedMotions,
    /// When the last message of the page arrived.
    last_seen: Instant,
    /// The time of the last pulse with a heartbeat, if the page must send them without a jog.
    watched: Option<Instant>,
    pulse: Interval,
    /// The number of the last pulse.
    last: u64,
    /// The times of the last pulses, in reverse order.
    sent: VecDeque<Instant>,
}

/// An order of a page, with its time of receipt and the count of ends and revocations before it.
pub(crate) struct Received {
    /// The order with its number; `None` if the text is not an order.
    pub(crate) order: Option<(u64, Order)>,
    since: Instant,
    ends: u64,
}

impl Channel {
    pub(crate) fn new(socket: WebSocket, app: Arc<App>, client: Client, motions: SharedMotions) -> Self {
        let mut pulse = interval(PULSE);
        pulse.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (pending, sent, last_seen) = (VecDeque::new(), VecDeque::new(), Instant::now());
        Self { socket, pending, app, client, ends: 0, motions, last_seen, watched: None, pulse, last: 0, sent }
    }

    /// Sets whether the page must send heartbeats without a jog.
    pub(crate) fn watch(&mut self, is_watched: bool) {
        self.watched = is_watched.then(|| self.watched.unwrap_or_else(Instant::now));
    }

    /// Shows a page that the server is alive. Ends a page whose heartbeats are missing for too long, if it must send them, and
    /// a page whose browser does not answer.
    pub(crate) async fn alive(&mut self) -> Option<()> {
        if self.watched.is_some_and(|last| last.elapsed() > LOST) || self.last_seen.elapsed() > SILENT {
            return None;
        }
        timeout(SEND, self.socket.send(Message::Ping(Bytes::new()))).await.ok()?.ok()?;
        self.send(json!({ "t": "tick" }).to_string()).await
    }

    pub(crate) async fn send(&mut self, text: String) -> Option<()> {
        timeout(SEND, self.socket.send(Message::Text(text.into()))).await.ok()?.ok()
    }

    /// Returns the next order; `None` at the end of the page.
    pub(crate) async fn order(&mut self) -> Option<Received> {
        match self.pending.pop_front() {
            None => self.receive().await.map(|text| self.received(&text)),
            pending => pending,
        }
    }

    fn received(&self, text: &str) -> Received {
        Received { order: Order::parse(text), since: Instant::now(), ends: self.count_ends() }
    }

    /// Returns the count of ends and revocations.
    fn count_ends(&self) -> u64 {
        self.ends + self.app.robots.iter().map(|robot| robot.revoked()).sum::<u64>()
    }

    /// Returns why an order that changes something is too late, if it is.
    pub(crate) fn why_late(&self, order: &Received) -> Option<&'static str> {
        if order.since.elapsed() > LONGEST_WAIT {
            return Some("it waited for more than 2 s behind other orders; nothing was done");
        }
        let why = "HALT was pressed, or something was ended, before it began; nothing was done";
        (order.ends != self.count_ends()).then_some(why)
    }

    /// Receives orders while another order is running. Ends only at the end of the page.
    pub(crate) async fn hold(&mut self) -> Option<()> {
        while self.pending.len() < PENDING {
            let text = self.receive().await?;
            let mut received = self.received(&text);
            if let Some((_, order)) = &received.order {
                self.end_early(order);
            }
            // an order does not end itself
            received.ends = self.count_ends();
            self.pending.push_back(received);
        }
        // backpressure: a page that sends this much gets no pulse either, which ends its jog, and later the page
        std::future::pending().await
    }

    /// Immediately ends the motions that this order ends, because the running order may take a minute.
    fn end_early(&mut self, order: &Order) {
        match order {
            Order::Lift { .. } => drop(self.grip().map(|grip| grip.lift())),
            Order::EndJog { why, .. } => drop(self.grip().map(|grip| grip.end(&safe(why)))),
            Order::EndRecovery { robot } => {
                let recovery = lock(&self.motions).recovery.clone().filter(|(of, _)| of == robot);
                if let Some((robot, recovery)) = recovery {
                    motions::end_recovery(&self.app, robot, recovery, "the user ended it");
                }
            }
            Order::EndWork { robot } => {
                // the order itself, carried out later, has the answer
                return drop(self.app.robots.get(*robot).map(|robot| robot.end_work(self.client)));
            }
            Order::Release { robot } => {
                let robot = self.app.robots.get(*robot).filter(|robot| robot.control.user(self.client).is_ok());
                if let Some(robot) = robot {
                    robot.revoke();
                }
                motions::end(&self.motions, &self.app, "the control was released");
            }
            Order::Show { .. } => {
                motions::end(&self.motions, &self.app, "the screen was left");
                // the page answers no pulse on another screen
                self.watched = None;
            }
            _ => return,
        }
        self.ends += 1;
    }

    fn grip(&self) -> Option<Arc<Grip>> {
        lock(&self.motions).grip.as_ref().map(|(_, grip)| Arc::clone(grip))
    }

    /// Receives the next order. Sends pulses and records heartbeats while it waits.
    async fn receive(&mut self) -> Option<String> {
        loop {
            tokio::select! {
                _ = self.pulse.tick(), if self.watched.is_some() || self.grip().is_some() => {
                    self.last += 1;
                    self.sent.push_front(Instant::now());
                    self.sent.truncate(PULSES);
                    self.send(json!({ "t": "pulse", "n": self.last }).to_string()).await?;
                }
                message = self.socket.recv() => match message?.ok().inspect(|_| self.last_seen = Instant::now())? {
                    Message::Text(text) => match serde_json::from_str(&text) {
                        Ok(beat) => self.beat(&beat),
                        Err(_) => return Some(text.as_str().to_owned()),
                    },
                    Message::Ping(_) | Message::Pong(_) => {}
                    _ => return None,
                },
            }
        }
    }

    /// Records a heartbeat. It counts from the time of its pulse, so that heartbeats that were held up on the way are old. One with the
    /// number of another press lifts the button, because the page does not hold it any more.
    fn beat(&mut self, beat: &Beat) {
        let Some(age) = self.last.checked_sub(beat.beat).and_then(|age| usize::try_from(age).ok()) else { return };
        let Some(sent) = self.sent.get(age) else { return };
        if let Some(last) = &mut self.watched {
            *last = (*last).max(*sent);
        }
        let mut motions = lock(&self.motions);
        let is_lifted = std::mem::replace(&mut motions.press, beat.held) != beat.held;
        if let Some((_, grip)) = &motions.grip {
            grip.beat(*sent);
            if is_lifted {
                grip.lift();
            }
        }
    }
}
