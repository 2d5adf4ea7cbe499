//! The publisher of a node with several processes: it watches, takes over, and shows that it is active.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use rumqttc::{Publish, SubscribeReasonCode};
use tokio::time::Instant;

use super::Publisher;
use super::connection::Phase;
use crate::event::Event;
use crate::json;
use crate::message::Message;
use crate::reading::now_ms;
use crate::standby::{Failover, Seen};

impl Publisher {
    /// Returns whether this process has the connection of the node.
    pub(super) fn is_active(&self) -> bool {
        self.is_up() && !self.is_watcher()
    }

    /// Returns whether the connection is, or will be, a watcher's connection.
    pub(super) fn is_watcher(&self) -> bool {
        self.standby.as_ref().is_some_and(|standby| !standby.is_active())
    }

    /// Returns whether readings of the backlog can be sent. A watcher sends them too, unless they need a birth.
    pub(super) fn sends_backlog(&self) -> bool {
        self.is_active() || self.is_up() && !self.encoder.has_births()
    }

    /// Returns whether a retained message says whether this node is online.
    pub(super) fn shows_state(&self) -> bool {
        self.standby.is_some() || !self.encoder.has_births()
    }

    /// Returns whether commands can be accepted: no other process can be active by now.
    pub(super) fn is_proven(&self) -> bool {
        self.standby.as_ref().is_none_or(|standby| standby.is_proven(Instant::now()))
    }

    /// Returns the message that says whether this node is online.
    pub(super) fn node_state(&self, online: bool) -> Message {
        let instance = self.standby.as_ref().map(Failover::instance);
        let bd_seq = self.encoder.bd_seq().filter(|_| instance.is_some());
        json::node(&self.shared.config, online, now_ms(), instance, bd_seq)
    }

    /// The broker has accepted the connection of a watcher.
    pub(super) fn watch(&mut self) {
        let topics = [self.encoder.death_topic(self.config()), Some(self.state_topic())];
        if let Some(connection) = &mut self.link {
            connection.rise();
            connection.subscribe(topics.into_iter().flatten());
        }
    }

    /// Handles the broker's answer to a subscription. After a refusal a watcher would receive nothing and take over, and a node
    /// would wait for its primary host forever; only the subscription of commands may fail.
    pub(super) async fn subscribed(&mut self, codes: &[SubscribeReasonCode]) {
        let Some(connection) = &mut self.link else { return };
        connection.subscribing = connection.subscribing.saturating_sub(1);
        let is_for_commands = connection.phase == Phase::Subscribing;
        if codes.contains(&SubscribeReasonCode::Failure) {
            if !is_for_commands {
                let topic = self.host_topic().filter(|_| !self.is_watcher()).unwrap_or_else(|| self.state_topic());
                return self.lose(format!("the broker refuses the subscription of {topic}")).await;
            }
            (self.shared.report)(&Event::CommandsDenied {});
        }
        match self.standby.as_mut().filter(|standby| !standby.is_active()) {
            Some(standby) => standby.subscribed(Instant::now()),
            None => self.rise().await,
        }
    }

    /// Returns the topic of the state of this node.
    pub(super) fn state_topic(&self) -> String {
        json::topic(&self.shared.config, &self.shared.config.node, "state")
    }

    /// The broker has accepted this process as the active one. Call it before messages are sent.
    pub(super) fn activate(&mut self) {
        let shared = Arc::clone(&self.shared);
        let Some(standby) = &mut self.standby else { return };
        let now = now_ms();
        // another process may have accepted commands until now; the clocks of the two may differ
        let margin = u64::try_from((standby.after() * 2).as_millis()).unwrap_or(u64::MAX);
        self.commands.begin(now.saturating_add(margin));
        // ids above the ids of the other process
        shared.next_id.fetch_max(now.saturating_mul(1000), Ordering::Relaxed);
        standby.beaten(Instant::now());
        let instance = standby.instance().to_owned();
        shared.metrics.active.store(true, Ordering::Relaxed);
        (shared.report)(&Event::Active { instance });
    }

    /// Lets the scans read, if they do not yet.
    pub(super) fn start_reading(&mut self) {
        if *self.shared.reads.borrow() {
            return;
        }
        // the latest values of an earlier time as the active process
        let unsent = self.take_unsent();
        self.backlog.push(unsent);
        self.cells.iter_mut().for_each(|cell| cell.latest.fill(None));
        self.shared.reads.send_replace(true);
    }

    /// A watcher has received the state of the node, or its death.
    pub(super) fn saw(&mut self, publish: &Publish) {
        let is_death = publish.topic != self.state_topic();
        let Some(standby) = self.standby.as_mut().filter(|standby| !standby.is_active()) else { return };
        if is_death {
            // the death of an earlier birth may arrive late
            if self.encoder.is_death(&publish.payload) {
                standby.saw_death(Instant::now());
            }
            return;
        }
        let Ok(seen) = serde_json::from_slice::<Seen>(&publish.payload) else { return };
        if let Some(bd_seq) = seen.bd_seq {
            self.encoder.follow(bd_seq);
        }
        if standby.saw(&seen, publish.retain, Instant::now()) && !std::mem::replace(&mut self.stands_by, true) {
            self.shared.reads.send_replace(false);
            self.shared.metrics.active.store(false, Ordering::Relaxed);
            (self.shared.report)(&Event::Standby { active: seen.instance });
        }
    }

    /// Takes over, puts that off, or shows that this process is active.
    pub(super) async fn tick(&mut self) {
        let Some(standby) = &mut self.standby else { return };
        if standby.is_active() {
            standby.beaten(Instant::now());
            let state = self.node_state(true);
            if let Some(connection) = &mut self.link {
                // readings must not delay it
                connection.urgent.push_front(state);
                connection.flush();
            }
            return;
        }
        if standby.put_off(Instant::now()) {
            return;
        }
        standby.take_over();
        self.stands_by = false;
        self.recover().await;
        self.connect();
    }

    /// The broker has acknowledged a message that was sent at this time.
    pub(super) fn prove(&mut self, sent: Instant) {
        if let Some(standby) = self.standby.as_mut().filter(|standby| standby.is_active()) {
            standby.prove(sent);
        }
    }
}
