//! The state that all tasks of a gateway share: the gateway, the connected clients and the tasks to wake.

use core::fmt;
use core::future::poll_fn;
use core::net::Ipv4Addr;
use core::task::Poll;

use bcap_core::handler::PeerId;
use bcap_core::peers::{Admission, Holder, Slots};
use bcap_core::time::Instant;

use super::client::{Client, Connected};
use super::notify::Notify;
use super::{Denial, Ended, Front, Limits, Lock, Platform, Report};
use crate::{Event, Gateway};

/// A gateway that several tasks share.
pub struct SharedGateway<'m, P: Platform> {
    shared: P::Lock<Shared<'m, P>>,
}

/// The state under the lock of a [`SharedGateway`].
pub struct Shared<'m, P: Platform> {
    pub(super) gateway: Gateway<'m>,
    clients: P::Clients,
    robot: Notify,
    /// The error that ended the last connection to the robot, or that prevented it.
    cause: Option<P::Cause>,
    is_stopping: bool,
    log: P::Log,
}

impl<'m, P: Platform> SharedGateway<'m, P> {
    /// Wraps a gateway; `log` receives its reports.
    #[must_use]
    pub fn new(gateway: Gateway<'m>, log: P::Log) -> Self {
        let clients = P::clients(gateway.capacity());
        let robot = Notify::default();
        Self { shared: P::Lock::new(Shared { gateway, clients, robot, cause: None, is_stopping: false, log }) }
    }

    /// Calls `work` with the gateway, for example to read its counters or whether the robot is connected.
    ///
    /// Returns `None` when the gateway is already in use, which happens only when the log calls this.
    pub fn view<T>(&self, work: impl FnOnce(&Gateway<'m>) -> T) -> Option<T> {
        self.with(|shared| work(&shared.gateway))
    }

    /// Returns the number of clients with a slot.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.with(|shared| shared.connected().count()).unwrap_or_default()
    }

    /// Returns whether the rules allow a client to connect; logs it if they do not. For custom listeners, which reset such a
    /// connection immediately. [`serve`](super::serve) checks it again.
    pub fn admits(&self, client: P::Address) -> bool {
        let admitted = self.view(|gateway| gateway.config().rules.admits(P::ipv4(client))).unwrap_or_default();
        if !admitted {
            self.deny(client, Denial::Address);
        }
        admitted
    }

    /// Logs that a client is not served. For custom listeners.
    pub fn deny(&self, client: P::Address, reason: Denial) {
        self.with(|shared| (shared.log)(&Report::Denied { client, reason }));
    }

    /// Ends the sessions of all clients as soon as their running requests are answered. New clients are not served.
    pub fn stop(&self) {
        self.with(|shared| {
            shared.is_stopping = true;
            shared.clients.as_mut().iter_mut().for_each(|client| client.notify.notify());
        });
    }

    /// Calls `work` with the shared state; `None` when it is already in use.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Shared<'m, P>) -> T) -> Option<T> {
        self.shared.with(work)
    }

    /// Polls the gateway until it has no event, and wakes the clients that its events concern; for the robot's task.
    pub(super) fn poll(&self) {
        // one event for each lock, so that a busy client does not block interrupts for long
        while self.with(Shared::poll_event).unwrap_or_default() {}
    }

    /// Polls the gateway for a client's task, and wakes the robot's task when it has bytes to send or an earlier deadline.
    pub(super) fn poll_for_client(&self) {
        let before = self.next_poll();
        self.poll();
        let after = self.next_poll();
        self.with(|shared| {
            if !shared.gateway.robot_transmit().is_empty() || after < before {
                shared.robot.notify();
            }
        });
    }

    /// Returns when the gateway must be polled again if no bytes arrive before.
    pub(super) fn next_poll(&self) -> Instant {
        self.view(|gateway| gateway.poll_timeout()).flatten().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Assigns a slot to a client, if necessary the slot of an idle client; `None` if there is no slot for it, or the rules do
    /// not allow it to connect.
    pub(super) fn open(&self, client: P::Address, limits: &Limits) -> Option<PeerId> {
        self.with(|shared| shared.open(client, limits))?
    }

    /// Closes a client's session and frees its slot.
    pub(super) fn close(&self, peer: PeerId, ended: Option<Ended<P::Failure>>) {
        self.with(|shared| shared.close(peer, ended));
    }

    /// Waits until an event concerns a client.
    pub(super) async fn wait_for_client(&self, peer: PeerId) {
        poll_fn(|cx| {
            let poll = |shared: &mut Shared<'m, P>| {
                // an evicted client is woken immediately
                shared.client(peer).map_or(Poll::Ready(()), |client| client.notify.poll(cx))
            };
            self.with(poll).unwrap_or(Poll::Pending)
        })
        .await;
    }

    /// Waits until a change concerns the robot's task.
    pub(super) async fn wait_for_robot(&self) {
        poll_fn(|cx| self.with(|shared| shared.robot.poll(cx)).unwrap_or(Poll::Pending)).await;
    }
}

impl<P: Platform> Shared<'_, P> {
    /// Handles the gateway's next event; `false` without an event.
    fn poll_event(&mut self) -> bool {
        let Some(event) = self.gateway.poll_event(P::now()) else { return false };
        match event.peer() {
            Some(peer) => {
                let Some((client, address)) = self.client(peer).and_then(|client| {
                    let address = client.connected.as_ref()?.address;
                    Some((client, address))
                }) else {
                    return true;
                };
                client.notify.notify();
                (self.log)(&Report::Answered { client: address, line: self.gateway.line(peer), event });
            }
            None => {
                // a client's task may have polled this event
                self.robot.notify();
                let cause = self.cause.take().filter(|_| matches!(event, Event::RobotDown { .. }));
                (self.log)(&Report::Robot { event, cause: cause.as_ref() });
            }
        }
        true
    }

    fn open(&mut self, address: P::Address, limits: &Limits) -> Option<PeerId> {
        let is_admitted = self.gateway.config().rules.admits(P::ipv4(address));
        let peer = if is_admitted && !self.is_stopping { self.take_slot(address, limits) } else { None };
        let report = match peer {
            Some(_) => Report::Connected { client: address },
            None if is_admitted => Report::Denied { client: address, reason: Denial::Full },
            None => Report::Denied { client: address, reason: Denial::Address },
        };
        (self.log)(&report);
        peer
    }

    /// Assigns a slot by the rules of [`Slots`].
    fn take_slot(&mut self, address: P::Address, limits: &Limits) -> Option<PeerId> {
        let Self { clients, gateway, .. } = self;
        let clients = clients.as_mut();
        let slots = Slots {
            total: gateway.capacity().min(clients.len()),
            per_host: limits.connections_per_address,
            evict_after: limits.evict_after,
        };
        let connected = clients.iter().filter_map(|client| client.connected.as_ref());
        let holders = connected.map(|connected| Holder {
            key: connected.peer,
            is_same_host: P::is_same_host(connected.address, address),
            state: connected.state(gateway),
        });
        match slots.admit(holders, P::now()) {
            Admission::Free => {}
            Admission::Instead(peer) => self.close(peer, Some(Ended::Evicted)),
            Admission::Refused => return None,
        }
        let client = self.clients.as_mut().iter_mut().find(|client| client.connected.is_none())?;
        let peer = self.gateway.open_from(P::ipv4(address))?;
        client.connected = Some(Connected { peer, address, last_active: P::now(), is_busy: false });
        Some(peer)
    }

    fn close(&mut self, peer: PeerId, ended: Option<Ended<P::Failure>>) {
        self.gateway.close(peer);
        if let Some(client) = self.client(peer)
            && let Some(connected) = client.connected.take()
        {
            client.notify.notify();
            client.notify = Notify::default();
            (self.log)(&Report::Disconnected { client: connected.address, ended });
        }
    }

    fn connected(&mut self) -> impl Iterator<Item = &Connected<P::Address>> {
        self.clients.as_mut().iter().filter_map(|client| client.connected.as_ref())
    }

    fn client(&mut self, peer: PeerId) -> Option<&mut Client<P::Address>> {
        let is_peer = |connected: &Connected<P::Address>| connected.peer == peer;
        self.clients.as_mut().iter_mut().find(|client| client.connected.as_ref().is_some_and(is_peer))
    }

    /// Returns the address of a client; `None` when it has lost its slot.
    pub(super) fn address(&mut self, peer: PeerId) -> Option<P::Address> {
        self.client(peer)?.connected.as_ref().map(|connected| connected.address)
    }

    pub(super) const fn is_stopping(&self) -> bool {
        self.is_stopping
    }

    /// Passes on bytes from a client; they fit.
    pub(super) fn received(
        &mut self,
        front: &mut Front<'_, '_>,
        (peer, address): (PeerId, Option<Ipv4Addr>),
        bytes: &[u8],
    ) {
        front.received(&mut self.gateway, peer, address, bytes);
        self.moved(peer, front);
    }

    /// Records that the link of a client has taken some of the bytes to send.
    pub(super) fn transmitted(
        &mut self,
        front: &mut Front<'_, '_>,
        (peer, address): (PeerId, Option<Ipv4Addr>),
        count: usize,
    ) {
        front.transmitted(&mut self.gateway, peer, address, count);
        self.moved(peer, front);
    }

    /// Records that bytes of a client were received or sent.
    pub(super) fn moved(&mut self, peer: PeerId, front: &Front<'_, '_>) {
        if let Some(connected) = self.client(peer).and_then(|client| client.connected.as_mut()) {
            connected.last_active = P::now();
            connected.is_busy = front.is_busy();
        }
    }

    /// Records whether a client waits for an answer or receives it.
    pub(super) fn exchanged(&mut self, peer: PeerId, front: &Front<'_, '_>) {
        if let Some(connected) = self.client(peer).and_then(|client| client.connected.as_mut()) {
            connected.is_busy = front.is_busy();
        }
    }

    /// Records that the connection to the robot failed.
    pub(super) fn robot_failed(&mut self, cause: P::Cause) {
        self.cause = Some(cause);
        self.gateway.robot_closed(P::now());
    }
}

impl<P: Platform> fmt::Debug for SharedGateway<'_, P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SharedGateway").finish_non_exhaustive()
    }
}

impl<P: Platform> fmt::Debug for Shared<'_, P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}
