//! A link in memory between a client and the virtual controller, which is ready at every other poll.

use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use std::cell::RefCell;
use std::collections::{BTreeSet, VecDeque};
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;
use std::time::Duration;

use bcap_core::bcap::server::{self, Handler, Request, Session};
use bcap_core::bcap::{FunctionId, Link};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use bcap_sim::{Controller, Profile};
use bcap_testkit::network::answer_to;

/// The controller, the time, and the calls that were executed, in order.
pub(crate) struct World {
    pub(crate) now: Instant,
    pub(crate) log: Vec<String>,
    pub(crate) controller: Controller,
}

impl World {
    pub(crate) fn new() -> Rc<RefCell<Self>> {
        let mut config = bcap_sim::Config::new(Profile::Rc8);
        config.motor_on_delay = Duration::from_millis(1);
        let controller = Controller::new(config);
        Rc::new(RefCell::new(Self { now: Instant::from_millis(1), log: Vec::new(), controller }))
    }
}

/// Executes calls, and logs each of them once.
///
/// Controller_Connect with the name `token 7` is answered by the harness: its handle says which call it belongs to.
struct Logged<'a>(&'a mut World);

impl Handler for Logged<'_> {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let arguments: Vec<String> = request.args.iter().map(|value| format!("{value:?}")).collect();
        self.0.log.push(format!("{}({})", request.function, arguments.join(", ")));
        let name = request.text(0).to_string();
        match name.strip_prefix("token ").and_then(|token| token.parse().ok()) {
            Some(token) if request.function == FunctionId::CONTROLLER_CONNECT => {
                reply.set(&answer_to(token)).expect("a handle fits");
                HResult::S_OK.into()
            }
            _ => Handler::call(&mut self.0.controller, peer, request, reply, now),
        }
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        Handler::resume(&mut self.0.controller, peer, request, reply, now)
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(&mut self.0.controller, peer, now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(&mut self.0.controller, peer, now);
    }
}

/// One connection to the controller.
///
/// It is ready at every other poll, for `piece` bytes of a stream or for a datagram. Its futures lose nothing when they
/// are dropped. While it waits, time jumps to the next event.
pub(crate) struct Wire {
    kind: Link,
    /// The number of bytes of a stream that are taken together.
    pub(crate) piece: usize,
    peer: PeerId,
    session: Session<[u8; 1024], [u8; 1024], 128>,
    world: Rc<RefCell<World>>,
    ready: bool,
    /// Frames that the server has sent and the client has not received.
    pending: VecDeque<Vec<u8>>,
    /// Everything that is sent before this time is lost.
    pub(crate) deaf_until: Instant,
    /// When bytes were sent, and until when the client was ready to wait for sending or receiving.
    pub(crate) sent: BTreeSet<Instant>,
    pub(crate) limits: BTreeSet<Instant>,
}

impl Wire {
    pub(crate) fn new(kind: Link, peer: u32, world: &Rc<RefCell<World>>) -> Self {
        let config = match kind {
            Link::Stream => server::Config::TCP,
            Link::Datagram => server::Config::UDP,
            Link::Serial => server::Config::SERIAL,
        };
        Self {
            kind,
            piece: usize::MAX,
            peer: PeerId(peer),
            session: Session::new(config, [0; 1024], [0; 1024]),
            world: Rc::clone(world),
            ready: false,
            pending: VecDeque::new(),
            deaf_until: Instant::ZERO,
            sent: BTreeSet::new(),
            limits: BTreeSet::new(),
        }
    }

    /// Returns how many objects the client has open.
    pub(crate) fn open_objects(&self) -> usize {
        self.session.open_objects()
    }

    /// Runs the server until it needs more time to make progress.
    fn serve(&mut self) {
        let mut world = self.world.borrow_mut();
        let now = world.now;
        loop {
            let event = self.session.run(&mut Logged(&mut world), self.peer, now);
            let bytes = self.session.transmit();
            if !bytes.is_empty() {
                let pieces = if self.kind == Link::Datagram { bytes.len() } else { self.piece.min(bytes.len()) };
                self.pending.extend(bytes.chunks(pieces).map(<[u8]>::to_vec));
                self.session.transmitted(usize::MAX);
            } else if event.is_none() {
                return;
            }
        }
    }

    /// Lets time pass until the server has executed the call that it works at.
    pub(crate) fn settle(&mut self) {
        self.serve();
        while self.session.is_running() {
            let Some(at) = self.session.poll_timeout() else { return };
            let now = self.world.borrow().now;
            self.world.borrow_mut().now = now.max(at);
            self.serve();
        }
    }

    /// Sends `bytes`, as far as they are taken.
    fn put(&mut self, bytes: &[u8]) -> usize {
        let count = if self.kind == Link::Datagram { bytes.len() } else { bytes.len().min(self.piece) };
        let now = self.world.borrow().now;
        self.sent.insert(now);
        if now >= self.deaf_until {
            self.serve();
            if let Some(room) = self.session.receive_buffer().get_mut(..count) {
                room.copy_from_slice(&bytes[..count]);
                self.session.received(count);
            }
        }
        count
    }

    /// Receives a piece; without one, lets time pass. Returns `None` when no event has happened yet.
    fn take(&mut self, buffer: &mut [u8], until: Instant) -> Option<Option<usize>> {
        self.serve();
        if let Some(piece) = self.pending.pop_front() {
            let count = piece.len().min(buffer.len());
            buffer[..count].copy_from_slice(&piece[..count]);
            if count < piece.len() && self.kind != Link::Datagram {
                self.pending.push_front(piece[count..].to_vec());
            }
            return Some(Some(count));
        }
        let mut world = self.world.borrow_mut();
        match self.session.poll_timeout().filter(|at| *at < until) {
            Some(at) => {
                world.now = world.now.max(at);
                None
            }
            None => {
                world.now = world.now.max(until);
                Some(None)
            }
        }
    }

    fn poll<T>(&mut self, work: impl FnOnce(&mut Self) -> Option<T>) -> Poll<T> {
        self.ready = !self.ready;
        if self.ready {
            return Poll::Pending;
        }
        work(self).map_or(Poll::Pending, Poll::Ready)
    }
}

impl Transport for Wire {
    type Error = Infallible;

    fn now(&self) -> Instant {
        self.world.borrow().now
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Infallible> {
        self.limits.insert(until);
        Ok(Some(poll_fn(|_| self.poll(|wire| Some(wire.put(bytes)))).await))
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Infallible> {
        // a deadline in the past reads the bytes that arrived before the call, and does not wait
        if until > self.now() {
            self.limits.insert(until);
        }
        Ok(poll_fn(|_| self.poll(|wire| wire.take(buffer, until))).await)
    }

    async fn sleep_until(&mut self, at: Instant) {
        poll_fn(|_| {
            self.poll(|wire| {
                let mut world = wire.world.borrow_mut();
                world.now = world.now.max(at);
                Some(())
            })
        })
        .await;
    }
}
