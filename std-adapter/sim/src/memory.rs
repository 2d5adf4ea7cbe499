//! The virtual controller in memory: tests of a driver without sockets and without waiting.
//!
//! ```text
//!  a driver ─► Wire ─┬─► Network: the controller and its clock
//!  another  ─► Wire ─┘
//! ```
//!
//! A [`Wire`] is a transport of `bcap_core::io`, blocking and asynchronous. The clock stops until a client waits, then jumps to
//! the next event. So a motion of eight seconds takes no real time, and every run of a test is the same.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_core::bcap::server::{self, Session};
use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use bcap_core::handler::PeerId;
use bcap_core::io::{asynch, blocking};
use bcap_core::time::Instant;

use crate::config::Config;
use crate::controller::Controller;

/// The time that passes with each request, so that a client that polls without a pause sees the robot move.
const REQUEST: Duration = Duration::from_millis(1);
/// The first size of a session's buffers, which grow.
const ROOM: usize = 1024;

/// A virtual controller, its clock, and the wires to it.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call;
/// use bcap_core::bcap::client::{Client, Config};
/// use bcap_core::io::blocking::Connection;
/// use bcap_sim::Profile;
/// use bcap_sim::memory::Network;
///
/// let network = Network::new(bcap_sim::Config::new(Profile::Rc8));
/// let client = Client::new(Config::TCP, [0; 512], [0; 512]);
/// let mut robot = Connection::new(network.connect(), client);
/// robot.call(call::service_start("WDT=400"))?;
/// assert_eq!(network.controller().open_objects(), 0);
/// # Ok::<(), bcap_core::io::CallError<std::io::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Network {
    world: Arc<Mutex<World>>,
}

#[derive(Debug)]
struct World {
    controller: Controller,
    now: Instant,
    /// The number of the next client.
    next: u32,
}

/// One connection to the controller, over which frames travel as over TCP.
#[derive(Debug)]
pub struct Wire {
    world: Arc<Mutex<World>>,
    session: Session<Vec<u8>, Vec<u8>>,
    peer: PeerId,
}

impl Network {
    /// Creates a controller, at time zero.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let world = World { controller: Controller::new(config), now: Instant::ZERO, next: 1 };
        Self { world: Arc::new(Mutex::new(world)) }
    }

    /// Connects a client.
    #[must_use]
    pub fn connect(&self) -> Wire {
        let mut world = lock(&self.world);
        let peer = PeerId(world.next);
        world.next = world.next.wrapping_add(1);
        let session = Session::new(server::Config::TCP, vec![0; ROOM], vec![0; ROOM]);
        Wire { world: Arc::clone(&self.world), session, peer }
    }

    /// Returns the time on the controller's clock.
    #[must_use]
    pub fn now(&self) -> Instant {
        lock(&self.world).now
    }

    /// Lets time pass.
    pub fn pass(&self, time: Duration) {
        let mut world = lock(&self.world);
        let at = world.now + time;
        world.advance(at);
    }

    /// Returns the controller, to change or to check its state. Clients wait while the guard exists.
    #[must_use]
    pub fn controller(&self) -> impl std::ops::DerefMut<Target = Controller> + '_ {
        Guard(lock(&self.world))
    }
}

/// Gives access to the controller of a locked world.
struct Guard<'a>(MutexGuard<'a, World>);

impl std::ops::Deref for Guard<'_> {
    type Target = Controller;

    fn deref(&self) -> &Controller {
        &self.0.controller
    }
}

impl std::ops::DerefMut for Guard<'_> {
    fn deref_mut(&mut self) -> &mut Controller {
        &mut self.0.controller
    }
}

/// Locks a world; a test that panicked while it held the lock leaves the controller as it was.
fn lock(world: &Mutex<World>) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

impl World {
    fn advance(&mut self, to: Instant) {
        self.now = self.now.max(to);
        self.controller.advance(self.now);
    }
}

impl Wire {
    /// Answers the requests that have arrived, as far as that is possible now.
    fn serve(&mut self) {
        let mut world = lock(&self.world);
        let now = world.now;
        while self.session.run(&mut world.controller, self.peer, now).is_some() {}
    }

    /// Takes the bytes that there is room for.
    fn take(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        self.serve();
        if self.session.is_finished() {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        let room = self.session.receive_buffer();
        let count = room.len().min(bytes.len());
        room[..count].copy_from_slice(&bytes[..count]);
        self.session.received(count);
        let mut world = lock(&self.world);
        let at = world.now + REQUEST;
        world.advance(at);
        Ok(Some(count))
    }

    /// Gives out bytes, and lets time pass until there are some.
    fn give(&mut self, buffer: &mut [u8], until: Instant) -> Option<usize> {
        loop {
            self.serve();
            let bytes = self.session.transmit();
            if !bytes.is_empty() {
                let count = bytes.len().min(buffer.len());
                buffer[..count].copy_from_slice(&bytes[..count]);
                self.session.transmitted(count);
                return Some(count);
            }
            if self.session.is_finished() {
                return Some(0);
            }
            let mut world = lock(&self.world);
            if world.now >= until {
                return None;
            }
            let next = self.session.poll_timeout().unwrap_or(Instant::FAR_FUTURE).min(until);
            world.advance(next);
        }
    }

    fn advance(&self, to: Instant) {
        lock(&self.world).advance(to);
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        let mut world = lock(&self.world);
        let now = world.now;
        self.session.close(&mut world.controller, self.peer, now);
    }
}

impl blocking::Transport for Wire {
    type Error = io::Error;

    fn now(&self) -> Instant {
        lock(&self.world).now
    }

    fn send(&mut self, bytes: &[u8], _until: Instant) -> io::Result<Option<usize>> {
        self.take(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        Ok(self.give(buffer, until))
    }

    fn sleep_until(&mut self, at: Instant) {
        self.advance(at);
    }
}

impl asynch::SendTransport for Wire {
    type Error = io::Error;

    fn now(&self) -> Instant {
        lock(&self.world).now
    }

    async fn send(&mut self, bytes: &[u8], _until: Instant) -> io::Result<Option<usize>> {
        self.take(bytes)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        Ok(self.give(buffer, until))
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.advance(at);
    }
}
