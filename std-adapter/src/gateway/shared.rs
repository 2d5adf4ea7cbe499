//! The state that all tasks of a gateway share: the gateway itself, its clients, and the wakers of the tasks.

use std::collections::HashMap;
use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use bcap_gateway::{Counters, Event, Gateway};
use tokio::sync::Notify;

use super::front::Front;
use super::report::{Denial, Ended, Report};
use super::traffic::Tap;
use crate::clock::now;
use crate::server::{Admission, SlotState, Slots};

/// Receives every report.
type Log = Box<dyn FnMut(&Report<'_>) + Send>;

/// A gateway that many tasks use.
pub(super) struct GatewayState {
    inner: Mutex<Inner>,
    /// Wakes the robot's task.
    pub(super) robot: Notify,
}

pub(super) struct Inner {
    pub(super) gateway: Gateway<'static>,
    clients: HashMap<PeerId, Client>,
    /// Why the last connection to the robot ended or could not be opened.
    cause: Option<io::Error>,
    log: Log,
    pub(super) tap: Tap,
}

/// A client with a slot.
struct Client {
    address: SocketAddr,
    /// The time of the last received or sent bytes.
    last_active: Instant,
    /// Whether its front is busy.
    is_busy: bool,
    /// Wakes its task.
    wake: Arc<Notify>,
}

impl GatewayState {
    pub(super) fn new(gateway: Gateway<'static>, log: Log) -> Self {
        let inner = Inner { gateway, clients: HashMap::new(), cause: None, log, tap: Tap::default() };
        Self { inner: Mutex::new(inner), robot: Notify::new() }
    }

    /// Locks the gateway; nothing may be awaited under the lock.
    pub(super) fn lock(&self) -> MutexGuard<'_, Inner> {
        // a log that panicked has left the gateway in order
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Polls the gateway, reports its events, and wakes the tasks that they concern.
    pub(super) fn step(&self) {
        let inner = &mut *self.lock();
        while let Some(event) = inner.gateway.poll_event(now()) {
            if let Some(peer) = event.peer() {
                let Some(client) = inner.clients.get(&peer) else { continue };
                client.wake.notify_one();
                let (client, line) = (client.address, inner.gateway.line(peer));
                (inner.log)(&Report::Answered { client, line, event });
            } else {
                let cause = inner.cause.take().filter(|_| matches!(event, Event::RobotDown { .. }));
                (inner.log)(&Report::Robot { event, cause: cause.as_ref() });
                // the step of a client may have found the event
                self.robot.notify_one();
            }
        }
    }

    /// Returns the counts of the gateway so far.
    pub(super) fn counters(&self) -> Counters {
        *self.lock().gateway.counters()
    }
}

/// Returns the IPv4 address of a client for the rules; `None` for a client over IPv6. A listener for both versions
/// reports a client over IPv4 as `::ffff:10.0.0.5`.
pub(super) fn ipv4(client: SocketAddr) -> Option<Ipv4Addr> {
    match client.ip().to_canonical() {
        IpAddr::V4(address) => Some(address),
        IpAddr::V6(_) => None,
    }
}

impl Inner {
    /// Tells whether the rules allow a client to connect; logs it if they do not.
    pub(super) fn admits(&mut self, client: SocketAddr) -> bool {
        let admitted = self.gateway.config().rules.admits(ipv4(client));
        if !admitted {
            (self.log)(&Report::Denied { client, reason: Denial::Address });
        }
        admitted
    }

    /// Gives a client a slot, if necessary the slot of another client; `None` when it gets no slot.
    pub(super) fn open(&mut self, slots: &Slots, address: SocketAddr) -> Option<(PeerId, Arc<Notify>)> {
        let taken = self.clients.iter().map(|(peer, client)| (*peer, client.address.ip(), self.state(*peer, client)));
        let admission = slots.admit(taken, address.ip(), now());
        if let Admission::Instead(peer) = admission {
            self.close(peer, Some(Ended::Evicted));
        }
        let peer = if matches!(admission, Admission::Refused) { None } else { self.gateway.open_from(ipv4(address)) };
        let Some(peer) = peer else {
            (self.log)(&Report::Denied { client: address, reason: Denial::Full });
            return None;
        };
        let wake = Arc::new(Notify::new());
        self.clients.insert(peer, Client { address, last_active: now(), is_busy: false, wake: Arc::clone(&wake) });
        (self.log)(&Report::Connected { client: address });
        Some((peer, wake))
    }

    fn state(&self, peer: PeerId, client: &Client) -> SlotState {
        match client.is_busy || self.gateway.is_running(peer) || !self.gateway.transmit(peer).is_empty() {
            true => SlotState::Busy,
            false => SlotState::Idle(client.last_active),
        }
    }

    /// Tells whether a client still has its slot.
    pub(super) fn is_open(&self, peer: PeerId) -> bool {
        self.clients.contains_key(&peer)
    }

    /// Frees the slot of a client, and ends its task if that still runs.
    pub(super) fn close(&mut self, peer: PeerId, ended: Option<Ended>) {
        self.gateway.close(peer);
        if let Some(client) = self.clients.remove(&peer) {
            client.wake.notify_one();
            (self.log)(&Report::Disconnected { client: client.address, ended });
        }
    }

    /// Records that bytes of a client were received or sent.
    pub(super) fn moved(&mut self, peer: PeerId, front: &Front) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.last_active = now();
        }
        self.exchanged(peer, front);
    }

    /// Records whether the front of a client is busy, after lines or bytes have moved.
    pub(super) fn exchanged(&mut self, peer: PeerId, front: &Front) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.is_busy = front.is_busy();
        }
    }

    /// Records that the connection to the robot ended or could not be opened, and why.
    pub(super) fn robot_lost(&mut self, cause: io::Error) {
        self.cause = Some(cause);
        self.gateway.robot_closed(now());
    }
}

impl fmt::Debug for GatewayState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GatewayState").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bcap_gateway::modbus::Entry;
    use bcap_gateway::{Config, Memory};

    use super::*;

    #[test]
    fn a_client_of_modbus_keeps_its_slot_while_its_request_runs_and_until_its_response_is_sent() {
        let gateway = Gateway::new(Config::RC8, Box::leak(Box::new(Memory::<1, 8>::new())));
        let state = GatewayState::new(gateway, Box::new(|_| {}));
        let inner = &mut *state.lock();
        let slots = Slots { total: 1, per_address: 1, evict_after: Duration::ZERO };
        let [plc, other] = [([192, 0, 2, 1], 1).into(), ([192, 0, 2, 2], 1).into()];
        let (peer, _) = inner.open(&slots, plc).unwrap();

        let map = Box::leak(Box::new([Entry::registers("0=I/0-1").unwrap()]));
        let mut front = Front::new(Some(map), None);
        let Front::Modbus(modbus, _) = &mut front else { unreachable!() };
        modbus.received(&[0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 4], |_| true);
        inner.moved(peer, &front);
        assert!(inner.open(&slots, other).is_none(), "the line for I0 is not in the gateway yet");

        let Front::Modbus(modbus, _) = &mut front else { unreachable!() };
        for _ in 0..2 {
            modbus.line_taken(modbus.line().len());
            modbus.replied(b"0,3,7\r", |_| true);
        }
        let response = modbus.transmit().len();
        assert_eq!(response, 17);
        inner.exchanged(peer, &front);
        assert!(inner.open(&slots, other).is_none(), "the response is not sent");

        let Front::Modbus(modbus, _) = &mut front else { unreachable!() };
        modbus.transmitted(response);
        inner.moved(peer, &front);
        assert!(inner.open(&slots, other).is_some() && !inner.is_open(peer), "it is idle");
    }
}
