//! Active and standby: of the processes with the same group and node, one is active. The others watch it.
//!
//! | role    | client id          | work of the process                                                          |
//! |---------|--------------------|------------------------------------------------------------------------------|
//! | active  | the node's         | reads, publishes, executes commands, repeats `online` on the topic of its state |
//! | watcher | its own topic      | reads this topic; keeps its sessions with the controllers without reading |
//!
//! The broker is the lock. It keeps one connection for a client id, and closes the older one. A watcher takes over by
//! connecting with the client id of the node: from then on the earlier process cannot publish. It takes over when it sees
//! `offline` or the will of the active process, or no `online` for some time.
//!
//! **Commands.** The active process accepts a command only if the broker has acknowledged a message that it sent less than
//! `after` ago. So it accepts no command later than `after` following a takeover, and no command that expires later than
//! `after` and `longest_seconds` following it. The new process refuses all of these, with an additional `after` for clocks that
//! differ. So no command is accepted by both, no matter what the watcher received and when the earlier process continues.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher as _, Hasher as _};
use std::time::Duration;

use serde::Deserialize;
use tokio::time::Instant;

/// The range of the delay of a takeover in milliseconds: an active process that lost its connection is faster, and two watchers
/// rarely take over at the same time.
const DELAY_MS: (u64, u64) = (10, 50);

/// The part of `after` between two `online`.
const BEATS: u32 = 4;

/// The role of this process, and when it changes.
#[derive(Debug)]
pub(crate) struct Failover {
    /// The name of this process.
    instance: String,
    after: Duration,
    is_active: bool,
    /// When to take over; `None` before the subscription, and if this process is active.
    takeover: Option<Instant>,
    /// Whether the takeover was put off once, because this process had stopped.
    is_put_off: bool,
    /// The process that was online last.
    online: Option<String>,
    /// When to repeat `online`; `None` if the broker has not accepted this process as the active one.
    beat: Option<Instant>,
    /// When the latest message that the broker has acknowledged was sent.
    proven: Option<Instant>,
}

/// The state of a node, as a process has published it.
#[derive(Debug, Deserialize)]
pub(crate) struct Seen {
    state: String,
    pub(crate) instance: Option<String>,
    #[serde(rename = "bdSeq")]
    pub(crate) bd_seq: Option<u8>,
}

impl Failover {
    pub(crate) fn new(after: Duration) -> Self {
        let instance = format!("{:016x}", random());
        Self {
            instance,
            after,
            is_active: false,
            takeover: None,
            is_put_off: false,
            online: None,
            beat: None,
            proven: None,
        }
    }

    pub(crate) fn instance(&self) -> &str {
        &self.instance
    }

    pub(crate) const fn after(&self) -> Duration {
        self.after
    }

    /// Returns whether the connection is, or will be, the active process's connection.
    pub(crate) const fn is_active(&self) -> bool {
        self.is_active
    }

    /// Returns whether no other process can have been active for `after`: commands are accepted.
    pub(crate) fn is_proven(&self, now: Instant) -> bool {
        self.proven.is_some_and(|sent| now.saturating_duration_since(sent) < self.after)
    }

    /// Returns when something must be done: to take over, or to repeat `online`.
    pub(crate) const fn wake(&self) -> Option<Instant> {
        if self.is_active { self.beat } else { self.takeover }
    }

    /// The connection is lost.
    pub(crate) fn lost(&mut self) {
        (self.is_active, self.takeover, self.beat, self.proven) = (false, None, None, None);
    }

    /// The broker has confirmed the subscription of a watcher.
    pub(crate) fn subscribed(&mut self, now: Instant) {
        self.takeover.get_or_insert(now + self.after);
    }

    /// A watcher has received a state; returns whether another process is active now.
    pub(crate) fn saw(&mut self, seen: &Seen, is_retained: bool, now: Instant) -> bool {
        let is_own = seen.instance.as_ref() == Some(&self.instance);
        if seen.state == "online" {
            self.online.clone_from(&seen.instance);
            self.is_put_off = false;
            // no other process was active since
            self.takeover = Some(if is_own { now } else { now + self.after });
            return !is_own && !is_retained;
        }
        // the will of an earlier process may follow the first message of a later one
        if self.online.is_none() || self.online == seen.instance {
            if is_own {
                self.takeover = Some(now);
            } else {
                self.saw_death(now);
            }
        }
        false
    }

    /// A watcher has received the end of the process that was online last.
    pub(crate) fn saw_death(&mut self, now: Instant) {
        let (least, most) = DELAY_MS;
        self.takeover = Some(now + Duration::from_millis(least + random() % (most - least)));
    }

    /// Postpones the takeover if it is late: this process, or its machine, had stopped, and messages of the active process may
    /// wait to be read. Returns whether it was postponed; a process that is always late takes over the second time.
    pub(crate) fn put_off(&mut self, now: Instant) -> bool {
        let is_late = self.takeover.is_some_and(|takeover| now > takeover + self.after / BEATS);
        if !is_late || self.is_put_off {
            return false;
        }
        (self.takeover, self.is_put_off) = (Some(now + self.after), true);
        true
    }

    /// Makes the next connection the active process's connection.
    pub(crate) fn take_over(&mut self) {
        (self.is_active, self.takeover, self.is_put_off) = (true, None, false);
        self.online = Some(self.instance.clone());
    }

    /// This process has published `online`, and repeats it later.
    pub(crate) fn beaten(&mut self, now: Instant) {
        self.beat = Some(now + self.after / BEATS);
    }

    /// Records that the broker has acknowledged a message that was sent at this time.
    pub(crate) fn prove(&mut self, sent: Instant) {
        self.proven = self.proven.max(Some(sent));
    }
}

fn random() -> u64 {
    RandomState::new().build_hasher().finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    const AFTER: Duration = Duration::from_secs(2);

    fn seen(state: &str, instance: &str) -> Seen {
        Seen { state: state.into(), instance: Some(instance.into()), bd_seq: None }
    }

    #[test]
    fn a_watcher_takes_over_when_nothing_arrives() {
        let (mut standby, now) = (Failover::new(AFTER), Instant::now());
        assert_eq!(standby.wake(), None, "without a subscription nothing can arrive");
        standby.subscribed(now);
        assert_eq!(standby.wake(), Some(now + AFTER));
        let later = now + Duration::from_secs(1);
        assert!(standby.saw(&seen("online", "b"), false, later));
        assert_eq!(standby.wake(), Some(later + AFTER));
        assert!(!standby.saw(&seen("online", "b"), true, later), "a retained message may be old");
    }

    #[test]
    fn a_watcher_takes_over_soon_after_offline() {
        let (mut standby, now) = (Failover::new(AFTER), Instant::now());
        standby.saw(&seen("online", "b"), false, now);
        standby.saw(&seen("offline", "a"), false, now);
        assert_eq!(standby.wake(), Some(now + AFTER), "the will of an earlier process");
        standby.saw(&seen("offline", "b"), false, now);
        assert!(standby.wake().unwrap() < now + Duration::from_millis(DELAY_MS.1));
        assert!(standby.saw(&seen("online", "c"), false, now));
        assert_eq!(standby.wake(), Some(now + AFTER), "a third process was faster");
    }

    #[test]
    fn the_process_that_was_active_goes_on_at_once() {
        let (mut standby, now) = (Failover::new(AFTER), Instant::now());
        let own = standby.instance().to_owned();
        standby.saw(&seen("online", "b"), false, now);
        for state in ["online", "offline"] {
            standby.take_over();
            standby.lost();
            standby.saw(&seen(state, &own), true, now);
            assert_eq!(standby.wake(), Some(now), "{state}");
        }
    }

    #[test]
    fn a_watcher_that_was_stopped_puts_the_takeover_off_once() {
        let (mut standby, now) = (Failover::new(AFTER), Instant::now());
        standby.subscribed(now);
        assert!(!standby.put_off(now + AFTER + AFTER / 4), "in time");
        let late = now + AFTER * 10;
        assert!(standby.put_off(late));
        assert_eq!(standby.wake(), Some(late + AFTER));
        assert!(!standby.put_off(late + AFTER * 10), "it takes over when nothing has arrived");
        standby.saw(&seen("online", "b"), false, late);
        assert!(standby.put_off(late + AFTER * 10), "the active process was seen in between");
    }

    #[test]
    fn a_proof_lasts_until_a_watcher_may_take_over() {
        let (mut standby, now) = (Failover::new(AFTER), Instant::now());
        standby.take_over();
        standby.beaten(now);
        assert_eq!((standby.wake(), standby.is_proven(now)), (Some(now + AFTER / BEATS), false));
        standby.prove(now);
        standby.prove(now - Duration::from_secs(1));
        assert!(standby.is_proven(now + AFTER - Duration::from_millis(1)) && !standby.is_proven(now + AFTER));
        standby.lost();
        assert!(!standby.is_proven(now), "another connection needs a proof of its own");
    }
}
