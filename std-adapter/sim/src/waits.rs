//! The event that each client's waiting call waits for.

use std::collections::{BTreeMap, BTreeSet};

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// The event that a call waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wait {
    /// The end of the motion with this number, or the begin of its pass.
    Motion(u64),
    /// The motion with this number has covered this part of its path, in thousandths of a percent.
    Part(u64, u32),
    /// The motor is on.
    Servo,
    /// The arm is at rest.
    Rest,
    /// No task runs, and the arm is at rest.
    Tasks,
    /// The hand is at rest.
    Hand,
    /// The buffer of Slave Mode has room for the pose.
    Stored,
    /// Slave Mode has ended.
    Left,
    /// The motion was stopped, which is reported at this time.
    Stopped(Instant),
    /// The event has occurred; this is the call's result.
    Over(HResult),
}

/// The waiting calls, at most one for each client.
#[derive(Clone, Debug, Default)]
pub(crate) struct Waits {
    by_peer: BTreeMap<PeerId, Wait>,
    /// The clients whose motions were stopped, and when that is reported to them.
    stopped: BTreeSet<(Instant, PeerId)>,
}

impl Waits {
    pub(crate) fn begin(&mut self, peer: PeerId, wait: Wait) {
        self.by_peer.insert(peer, wait);
    }

    pub(crate) fn get(&self, peer: PeerId) -> Option<Wait> {
        self.by_peer.get(&peer).copied()
    }

    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.by_peer.remove(&peer);
    }

    /// Ends all calls that wait for this event; `result` is their code.
    pub(crate) fn end(&mut self, event: Wait, result: HResult) {
        self.by_peer.values_mut().filter(|wait| **wait == event).for_each(|wait| *wait = Wait::Over(result));
    }

    /// Stops a motion of a client, which is reported at this time.
    pub(crate) fn stop(&mut self, motion: u64, mover: PeerId, report: Instant) {
        let is_of = |wait: &&mut Wait| match wait {
            Wait::Motion(id) | Wait::Part(id, _) => *id == motion,
            _ => false,
        };
        self.by_peer.values_mut().filter(is_of).for_each(|wait| *wait = Wait::Stopped(report));
        self.stopped.insert((report, mover));
    }

    /// Returns the first stop that is reported by `now`, once, and ends the calls that wait for its report.
    pub(crate) fn next_stopped(&mut self, now: Instant) -> Option<(Instant, PeerId)> {
        let (at, mover) = self.stopped.first().copied().filter(|(at, _)| *at <= now)?;
        self.stopped.pop_first();
        self.end(Wait::Stopped(at), HResult::E_MOTION_STOPPED);
        Some((at, mover))
    }

    /// Ends all calls that wait for a part of a motion that it has covered; `covered` is 0 to 1.
    pub(crate) fn cover(&mut self, motion: u64, covered: f64, result: HResult) {
        let is_covered = |wait: &&mut Wait| match wait {
            Wait::Part(id, part) => *id == motion && f64::from(*part) <= covered * 1e5,
            _ => false,
        };
        self.by_peer.values_mut().filter(is_covered).for_each(|wait| *wait = Wait::Over(result));
    }
}
