//! A virtual controller with a slow clock, so that even a busy machine meets its deadlines.
//!
//! Its cycle of 8 ms takes [`SLOWNESS`] times as long, and its buffer lasts as much longer: a test in real time can then
//! assert that nothing was late without measuring the machine.

use std::time::Duration;

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;

/// The real time of one second on the controller's clock, in seconds.
pub const SLOWNESS: u32 = 4;

/// The controller's cycle in real time.
pub const CYCLE: Duration = bcap_sim::slave::CYCLE.saturating_mul(SLOWNESS);

/// The controller.
#[derive(Debug)]
pub struct Slowed(pub Controller);

/// Returns the controller's time.
#[must_use]
pub fn inner(at: Instant) -> Instant {
    Instant::from_micros(at.as_micros() / u64::from(SLOWNESS))
}

fn outer(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Wait(at) => Outcome::Wait(Instant::from_micros(at.as_micros().saturating_mul(SLOWNESS.into()))),
        done => done,
    }
}

impl Handler for Slowed {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        outer(Handler::call(&mut self.0, peer, request, reply, inner(now)))
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        outer(Handler::resume(&mut self.0, peer, request, reply, inner(now)))
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(&mut self.0, peer, inner(now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(&mut self.0, peer, inner(now));
    }
}

impl rac::server::Handler for Slowed {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        outer(rac::server::Handler::call(&mut self.0, peer, request, reply, inner(now)))
    }
}
