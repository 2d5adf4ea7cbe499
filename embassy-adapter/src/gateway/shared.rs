//! The state that all tasks of a gateway share: the gateway, the connected clients and the tasks to wake.

use core::cell::RefCell;
use core::fmt;
use core::future::poll_fn;
use core::net::{Ipv4Addr, SocketAddrV4};
use core::task::{Context, Poll};
use core::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use bcap_gateway::{Event, Gateway};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::waitqueue::WakerRegistration;

use super::{Denial, Log, Report};
use crate::clock::now;
use crate::error::NetError;
use crate::server::Ended;

/// A gateway that several tasks share; `SESSIONS` is at least the number of its client slots.
///
/// `M` is embassy's mutex: `NoopRawMutex` for one executor, `CriticalSectionRawMutex` for several.
pub struct SharedGateway<'m, M: RawMutex, const SESSIONS: usize> {
    inner: Mutex<M, RefCell<Inner<'m, SESSIONS>>>,
}

pub(super) struct Inner<'m, const SESSIONS: usize> {
    pub(super) gateway: Gateway<'m>,
    clients: [Client; SESSIONS],
    robot: Notify,
    /// The error that ended the last connection to the robot, or that prevented it.
    cause: Option<NetError>,
    log: Log,
}

/// A client slot.
struct Client {
    peer: Option<PeerId>,
    endpoint: Option<SocketAddrV4>,
    /// The time of its connection, or of the last bytes from it or to it.
    last_active: Instant,
    /// Whether its session must end to make room for another client.
    evicted: bool,
    notify: Notify,
}

impl Client {
    const FREE: Self =
        Self { peer: None, endpoint: None, last_active: Instant::ZERO, evicted: false, notify: Notify::new() };
}

/// Returns the IPv4 address of a client.
fn address(client: Option<SocketAddrV4>) -> Option<Ipv4Addr> {
    client.map(|client| *client.ip())
}

/// Wakes one task; a notification without a waiting task stays pending.
struct Notify {
    pending: bool,
    waker: WakerRegistration,
}

impl Notify {
    const fn new() -> Self {
        Self { pending: false, waker: WakerRegistration::new() }
    }

    fn notify(&mut self) {
        self.pending = true;
        self.waker.wake();
    }

    fn poll(&mut self, cx: &Context<'_>) -> Poll<()> {
        if core::mem::take(&mut self.pending) {
            return Poll::Ready(());
        }
        self.waker.register(cx.waker());
        Poll::Pending
    }
}

impl<'m, M: RawMutex, const SESSIONS: usize> SharedGateway<'m, M, SESSIONS> {
    /// Wraps a gateway; `log` receives its reports.
    #[must_use]
    pub const fn new(gateway: Gateway<'m>, log: Log) -> Self {
        const { assert!(SESSIONS > 0) };
        let clients = [const { Client::FREE }; SESSIONS];
        let inner = Inner { gateway, clients, robot: Notify::new(), cause: None, log };
        Self { inner: Mutex::new(RefCell::new(inner)) }
    }

    /// Calls `work` with the gateway, for example to read its counters or whether the robot is connected.
    ///
    /// Returns `None` when the gateway is already borrowed, which happens only when the log callback calls this.
    pub fn view<T>(&self, work: impl FnOnce(&Gateway<'m>) -> T) -> Option<T> {
        self.with(|inner| work(&inner.gateway))
    }

    /// Returns the number of clients with a slot.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.with(|inner| inner.clients.iter().filter(|client| client.peer.is_some()).count()).unwrap_or_default()
    }

    /// Calls `work` with the shared state; `None` when it is already borrowed.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Inner<'m, SESSIONS>) -> T) -> Option<T> {
        self.inner.lock(|inner| inner.try_borrow_mut().ok().map(|mut inner| work(&mut inner)))
    }

    /// Polls the gateway until it has no event, and wakes the clients that its events concern; for the robot's task.
    pub(super) fn poll(&self) {
        // one event for each lock, so that a busy client does not block interrupts for long
        while self.with(Inner::poll_event).unwrap_or_default() {}
    }

    /// Polls the gateway for a client's task, and wakes the robot's task when it has bytes to send or an earlier deadline.
    pub(super) fn poll_for_client(&self) {
        let before = self.next_poll();
        self.poll();
        let after = self.next_poll();
        self.with(|inner| {
            if !inner.gateway.robot_transmit().is_empty() || after < before {
                inner.robot.notify();
            }
        });
    }

    /// Returns when the gateway must be polled again if no bytes arrive before.
    pub(super) fn next_poll(&self) -> Instant {
        self.view(|gateway| gateway.poll_timeout()).flatten().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Opens a session for a client; `None` when all slots are in use.
    pub(super) fn open(&self, endpoint: Option<SocketAddrV4>) -> Option<PeerId> {
        self.with(|inner| {
            let client = inner.clients.iter_mut().find(|client| client.peer.is_none())?;
            let peer = inner.gateway.open_from(address(endpoint))?;
            *client = Client { peer: Some(peer), endpoint, last_active: now(), ..Client::FREE };
            (inner.log)(&Report::Connected { client: endpoint });
            Some(peer)
        })?
    }

    /// Tells whether the rules allow a client to connect; logs it if they do not. For custom listeners.
    pub fn admits(&self, endpoint: Option<SocketAddrV4>) -> bool {
        let admits = |inner: &mut Inner<'m, SESSIONS>| inner.gateway.config().rules.admits(address(endpoint));
        let admitted = self.with(admits).unwrap_or_default();
        if !admitted {
            self.deny(endpoint, Denial::Address);
        }
        admitted
    }

    /// Logs that a client is not served. For custom listeners.
    pub fn deny(&self, client: Option<SocketAddrV4>, reason: Denial) {
        self.with(|inner| (inner.log)(&Report::Denied { client, reason }));
    }

    /// Ends the session of the client that has been idle for the longest time, preferably one with the address of the new
    /// client; `false` when no client has been idle for `after`.
    pub(super) fn evict(&self, endpoint: Option<SocketAddrV4>, after: Duration) -> bool {
        let now = now();
        let evicted = self.with(|inner| {
            let Inner { clients, gateway, .. } = inner;
            // a client that waits for an answer or receives it keeps its slot
            let is_busy = |peer| gateway.is_running(peer) || !gateway.transmit(peer).is_empty();
            let is_idle = |client: &&mut Client| {
                let is_busy = client.peer.is_some_and(is_busy);
                !client.evicted && !is_busy && now.saturating_since(client.last_active) >= after
            };
            let rank = |client: &&mut Client| {
                (address(client.endpoint) == address(endpoint), now.saturating_since(client.last_active))
            };
            let idle = clients.iter_mut().filter(|client| client.peer.is_some()).filter(is_idle).max_by_key(rank)?;
            idle.evicted = true;
            idle.notify.notify();
            Some(())
        });
        evicted.flatten().is_some()
    }

    /// Tells whether a client's session must end to make room for another client.
    pub(super) fn is_evicted(&self, peer: PeerId) -> bool {
        self.with(|inner| inner.client(peer).is_some_and(|client| client.evicted)).unwrap_or_default()
    }

    /// Closes a client's session and frees its slot.
    pub(super) fn close(&self, peer: PeerId, ended: Option<Ended<()>>) {
        self.with(|inner| {
            inner.gateway.close(peer);
            if let Some(client) = inner.client(peer) {
                let client = core::mem::replace(client, Client::FREE);
                (inner.log)(&Report::Disconnected { client: client.endpoint, ended });
            }
        });
    }

    /// Waits until an event concerns a client.
    pub(super) async fn wait_for_client(&self, peer: PeerId) {
        poll_fn(|cx| {
            self.with(|inner| inner.client(peer).map_or(Poll::Pending, |client| client.notify.poll(cx)))
                .unwrap_or(Poll::Pending)
        })
        .await;
    }

    /// Waits until a change concerns the robot's task.
    pub(super) async fn wait_for_robot(&self) {
        poll_fn(|cx| self.with(|inner| inner.robot.poll(cx)).unwrap_or(Poll::Pending)).await;
    }
}

impl<const SESSIONS: usize> Inner<'_, SESSIONS> {
    /// Handles the gateway's next event; `false` without an event.
    fn poll_event(&mut self) -> bool {
        let Some(event) = self.gateway.poll_event(now()) else { return false };
        match event.peer() {
            Some(peer) => {
                let mut endpoint = None;
                if let Some(client) = self.client(peer) {
                    endpoint = client.endpoint;
                    client.notify.notify();
                }
                (self.log)(&Report::Answered { client: endpoint, line: self.gateway.line(peer), event });
            }
            None => {
                // a client's task may have polled this event
                self.robot.notify();
                let cause = self.cause.take();
                let cause = cause.filter(|_| matches!(event, Event::RobotDown { .. }));
                (self.log)(&Report::Robot { event, cause });
            }
        }
        true
    }

    fn client(&mut self, peer: PeerId) -> Option<&mut Client> {
        self.clients.iter_mut().find(|client| client.peer == Some(peer))
    }

    /// Passes bytes from a client to the gateway.
    pub(super) fn received(&mut self, peer: PeerId, bytes: &[u8]) {
        if let Some(room) = self.gateway.receive_buffer(peer).get_mut(..bytes.len()) {
            room.copy_from_slice(bytes);
            self.gateway.received(peer, bytes.len());
        }
        self.moved(peer);
    }

    /// Records that a client's transport has taken bytes of its answer.
    pub(super) fn transmitted(&mut self, peer: PeerId, count: usize) {
        self.gateway.transmitted(peer, count);
        self.moved(peer);
    }

    fn moved(&mut self, peer: PeerId) {
        if let Some(client) = self.client(peer) {
            client.last_active = now();
        }
    }

    /// Records that the connection to the robot failed.
    pub(super) fn robot_failed(&mut self, cause: NetError) {
        self.cause = Some(cause);
        self.gateway.robot_closed(now());
    }
}

impl<M: RawMutex, const SESSIONS: usize> fmt::Debug for SharedGateway<'_, M, SESSIONS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SharedGateway").field("sessions", &SESSIONS).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_gateway::{Config, Memory};
    use embassy_sync::blocking_mutex::raw::NoopRawMutex;

    #[test]
    fn a_client_keeps_its_slot_until_its_answer_is_sent() -> Result<(), &'static str> {
        let mut memory = Memory::<1, 4>::new();
        let shared: SharedGateway<'_, NoopRawMutex, 1> =
            SharedGateway::new(Gateway::new(Config::RC8, &mut memory), |_| {});
        let peer = shared.open(None).ok_or("no slot")?;
        shared.with(|inner| inner.received(peer, b"GET:RC8:1:I:\r"));
        shared.poll();
        let answer = shared.view(|gateway| gateway.transmit(peer).len()).ok_or("borrowed")?;
        assert_eq!(answer, "-2147481342\r".len());
        assert!(!shared.evict(None, Duration::ZERO), "the answer is not sent");
        shared.with(|inner| inner.transmitted(peer, 4));
        assert!(!shared.evict(None, Duration::ZERO), "a part of it is not sent");
        shared.with(|inner| inner.transmitted(peer, answer - 4));
        assert!(!shared.evict(None, Duration::from_secs(3600)), "it was active");
        assert!(shared.evict(None, Duration::ZERO) && shared.is_evicted(peer), "it is idle");
        Ok(())
    }
}
