//! The primary host of Sparkplug: nothing is published while it is offline. Readings wait in the buffer.
//!
//! The host says on the retained topic `spBv1.0/STATE/HOST` whether it is online. If it goes offline, the node announces its
//! death and ends the connection, as the specification demands. The next connection waits for the host.

use rumqttc::Publish;
use serde::Deserialize;

use super::connection::Phase;
use super::{CLOSE, Publisher};
use crate::event::Event;

/// The state message of the host.
#[derive(Debug, Deserialize)]
struct HostState {
    online: bool,
    /// Milliseconds since 1970.
    timestamp: u64,
}

impl Publisher {
    /// Returns the topic of the primary host, if there is one.
    pub(super) fn host_topic(&self) -> Option<String> {
        self.config().primary_host.as_ref().map(|host| format!("spBv1.0/STATE/{host}"))
    }

    /// Subscribes to the state of the primary host; returns whether there is one to wait for.
    pub(super) fn waits_for_host(&mut self) -> bool {
        let Some(topic) = self.host_topic() else { return false };
        if let Some(connection) = &mut self.link {
            connection.flush();
            connection.subscribe([topic]);
        }
        true
    }

    /// Handles a state of the primary host; returns whether the message is one.
    pub(super) async fn saw_host(&mut self, publish: &Publish) -> bool {
        if self.host_topic().is_none_or(|topic| topic != publish.topic) {
            return false;
        }
        let Ok(HostState { online, timestamp }) = serde_json::from_slice(&publish.payload) else { return true };
        // a state of an earlier connection of the host may arrive late
        let is_late = timestamp < self.host_since;
        self.host_since = self.host_since.max(timestamp);
        let is_begun = self.link.as_ref().map(|connection| connection.phase != Phase::Waiting);
        if is_late || is_begun.is_none_or(|is_begun| is_begun == online) {
            return true;
        }
        (self.shared.report)(&Event::PrimaryHost { online });
        if online {
            self.begin().await;
        } else {
            self.leave();
        }
        true
    }

    /// Announces the death of the node, and ends the connection.
    fn leave(&mut self) {
        let death = self.encoder.death(&self.shared.config);
        if let (Some(connection), Some(death)) = (&mut self.link, death) {
            // the channel of the link has room for more than the window; the event of the disconnection follows
            connection.send(death);
            // a broker that does not acknowledge must not delay it: after this time an error replaces that event
            let _ = connection.link.client.try_disconnect_with_timeout(CLOSE);
            connection.phase = Phase::Waiting;
        }
    }
}
