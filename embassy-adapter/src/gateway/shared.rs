//! What all tasks of a gateway share: the gateway itself, who sits where, and who is to be woken.

use core::cell::RefCell;
use core::fmt;
use core::future::poll_fn;
use core::task::{Context, Poll};

use bcap_core::gateway::{Event, Gateway};
use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use embassy_net::IpEndpoint;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::waitqueue::WakerRegistration;

use super::{Log, Report};
use crate::clock::now;
use crate::net::NetError;
use crate::server::Ended;

/// A gateway that many tasks use; `SESSIONS` is the number of its seats, or more.
///
/// The mutex is embassy's: `NoopRawMutex` for one executor, `CriticalSectionRawMutex` for more.
pub struct Shared<'m, M: RawMutex, const SESSIONS: usize> {
    inner: Mutex<M, RefCell<Inner<'m, SESSIONS>>>,
}

pub(super) struct Inner<'m, const SESSIONS: usize> {
    pub(super) gateway: Gateway<'m>,
    clients: [Client; SESSIONS],
    robot: Bell,
    /// Why the network ended the last connection to the robot, or had none to give.
    cause: Option<NetError>,
    log: Log,
}

/// Who has a seat.
struct Client {
    peer: Option<PeerId>,
    endpoint: Option<IpEndpoint>,
    bell: Bell,
}

impl Client {
    const NONE: Self = Self { peer: None, endpoint: None, bell: Bell::new() };
}

/// Wakes a task; a ring that nobody waits for is kept until somebody does.
struct Bell {
    rung: bool,
    waker: WakerRegistration,
}

impl Bell {
    const fn new() -> Self {
        Self { rung: false, waker: WakerRegistration::new() }
    }

    fn ring(&mut self) {
        self.rung = true;
        self.waker.wake();
    }

    fn poll(&mut self, cx: &Context<'_>) -> Poll<()> {
        if core::mem::take(&mut self.rung) {
            return Poll::Ready(());
        }
        self.waker.register(cx.waker());
        Poll::Pending
    }
}

impl<'m, M: RawMutex, const SESSIONS: usize> Shared<'m, M, SESSIONS> {
    /// Takes a gateway.
    #[must_use]
    pub const fn new(gateway: Gateway<'m>, log: Log) -> Self {
        const { assert!(SESSIONS > 0) };
        let clients = [const { Client::NONE }; SESSIONS];
        let inner = Inner { gateway, clients, robot: Bell::new(), cause: None, log };
        Self { inner: Mutex::new(RefCell::new(inner)) }
    }

    /// Lends the gateway to be looked at: its counters, and whether the robot is there.
    ///
    /// `None` when it is lent already, which only a log that calls it can bring about.
    pub fn view<T>(&self, work: impl FnOnce(&Gateway<'m>) -> T) -> Option<T> {
        self.with(|inner| work(&inner.gateway))
    }

    /// Lends all there is, for as long as nothing is awaited.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Inner<'m, SESSIONS>) -> T) -> Option<T> {
        self.inner.lock(|inner| inner.try_borrow_mut().ok().map(|mut inner| work(&mut inner)))
    }

    /// Lets the gateway take its steps, and tells the clients whom they concern; for the robot's task.
    pub(super) fn step(&self) {
        // one step for each lock, so that a chatty client does not keep interrupts out for long
        while self.with(Inner::step).unwrap_or_default() {}
    }

    /// Lets the gateway take its steps for a client, and wakes the robot's task when they concern it.
    pub(super) fn step_for_client(&self) {
        let before = self.due();
        self.step();
        let due = self.due();
        self.with(|inner| {
            if !inner.gateway.robot_transmit().is_empty() || due < before {
                inner.robot.ring();
            }
        });
    }

    /// Returns when the gateway must be asked again even if nothing else happens.
    pub(super) fn due(&self) -> Instant {
        self.view(|gateway| gateway.poll_timeout()).flatten().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Gives a client a seat, if there is one.
    pub(super) fn open(&self, endpoint: Option<IpEndpoint>) -> Option<PeerId> {
        self.with(|inner| {
            let client = inner.clients.iter_mut().find(|client| client.peer.is_none())?;
            let peer = inner.gateway.open()?;
            *client = Client { peer: Some(peer), endpoint, ..Client::NONE };
            (inner.log)(&Report::Connected { client: endpoint });
            Some(peer)
        })?
    }

    /// Frees the seat of a client that has gone.
    pub(super) fn close(&self, peer: PeerId, ended: Option<Ended<()>>) {
        self.with(|inner| {
            inner.gateway.close(peer);
            if let Some(client) = inner.client(peer) {
                let gone = core::mem::replace(client, Client::NONE);
                (inner.log)(&Report::Disconnected { client: gone.endpoint, ended });
            }
        });
    }

    /// Waits until something concerns a client.
    pub(super) async fn wait_for_client(&self, peer: PeerId) {
        poll_fn(|cx| {
            self.with(|inner| inner.client(peer).map_or(Poll::Pending, |client| client.bell.poll(cx)))
                .unwrap_or(Poll::Pending)
        })
        .await;
    }

    /// Waits until something concerns the robot's task.
    pub(super) async fn wait_for_robot(&self) {
        poll_fn(|cx| self.with(|inner| inner.robot.poll(cx)).unwrap_or(Poll::Pending)).await;
    }
}

impl<const SESSIONS: usize> Inner<'_, SESSIONS> {
    /// Takes one step; `false` when there is none to take.
    fn step(&mut self) -> bool {
        let Some(event) = self.gateway.poll_event(now()) else { return false };
        match event.peer() {
            Some(peer) => {
                let mut endpoint = None;
                if let Some(client) = self.client(peer) {
                    endpoint = client.endpoint;
                    client.bell.ring();
                }
                (self.log)(&Report::Answered { client: endpoint, line: self.gateway.line(peer), event });
            }
            None => {
                // a client's step may have found it out
                self.robot.ring();
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

    /// Takes note that there is no connection to the robot.
    pub(super) fn robot_lost(&mut self, cause: NetError) {
        self.cause = Some(cause);
        self.gateway.robot_closed(now());
    }
}

impl<M: RawMutex, const SESSIONS: usize> fmt::Debug for Shared<'_, M, SESSIONS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").field("sessions", &SESSIONS).finish_non_exhaustive()
    }
}
