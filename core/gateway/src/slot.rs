//! A slot: the memory for one PLC, with its session, its token bucket and its waiting request.

use core::net::Ipv4Addr;
use core::time::Duration;

use super::event::{Asked, Event};
use super::rules::{Pace, Refusal};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::server::{self, Config, Session};
use bcap_core::time::Instant;
use bcap_core::variant::Encode;

/// Bytes of a slot's memory for a value: enough for the longest string that fits a line, in a request and a reply.
const VALUE: usize = 512;

/// The memory for one PLC.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) session: Session<[u8; VALUE]>,
    /// The client.
    pub(super) peer: Option<PeerId>,
    /// The client's address, if it has one.
    pub(super) address: Option<Ipv4Addr>,
    /// Outlives the client, so a new connection does not get a full bucket.
    pub(super) pace: Pace,
    pub(super) waiting: Option<Waiting>,
}

/// A request that has passed the rules and waits for the robot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    /// Unique; the lower one was received first.
    pub(super) ticket: u32,
    pub(super) asked: Asked,
    /// The answer if the session with the robot ends.
    pub(super) if_down: HResult,
    since: Instant,
}

impl Waiting {
    pub(super) const fn new(ticket: u32, asked: Asked, since: Instant) -> Self {
        Self { ticket, asked, if_down: HResult::E_NOT_CONNECTED, since }
    }
}

impl Slot {
    /// All zero, so that a static of slots needs no memory in the flash; `open` sets the time limit.
    pub(super) const FREE: Self = Self {
        session: Session::new(Config { invoke_timeout: Duration::ZERO }, [0; VALUE]),
        peer: None,
        address: None,
        pace: Pace::NEW,
        waiting: None,
    };

    /// Assigns the slot to a client.
    pub(super) fn open(&mut self, peer: PeerId, address: Option<Ipv4Addr>, request_timeout: Duration) {
        self.session = Session::new(Config { invoke_timeout: request_timeout }, [0; VALUE]);
        self.peer = Some(peer);
        self.address = address;
        self.waiting = None;
    }

    /// Frees the slot, and drops its waiting request.
    pub(super) fn close(&mut self) {
        self.peer = None;
        self.waiting = None;
    }

    /// Replies to the waiting request, and returns the event.
    pub(super) fn answer<T: Encode + ?Sized>(&mut self, result: HResult, value: &T, now: Instant) -> Option<Event> {
        match self.session.respond_with(result, value)? {
            server::Event::Served { result, .. } => self.answered(result, now),
            _ => None,
        }
    }

    /// Removes the waiting request, which got its reply, and returns the event.
    pub(super) fn answered(&mut self, result: HResult, now: Instant) -> Option<Event> {
        let Waiting { asked, since, .. } = self.waiting.take()?;
        Some(Event::answered(self.peer?, asked, result, now.saturating_since(since)))
    }

    /// Replies to a request with a refusal, even if it waits for the robot.
    pub(super) fn refuse(&mut self, refusal: Refusal) -> Option<Event> {
        self.waiting = None;
        let _ = self.session.respond(refusal.hresult())?;
        Some(Event::Refused { peer: self.peer?, refusal })
    }
}
