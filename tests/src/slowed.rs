//! A virtual controller with a slow clock, so that even a busy machine meets its deadlines.
//!
//! Its cycle of 8 ms takes [`SLOWNESS`] times as long, or another factor, and its buffer lasts as much longer: a test in real
//! time can then assert that nothing was late without measuring the machine.

use std::time::Duration;

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;

/// The real time of one second on the controller's clock, in seconds.
pub const SLOWNESS: u32 = 8;

/// The controller's cycle in real time.
pub const CYCLE: Duration = bcap_sim::slave::CYCLE.saturating_mul(SLOWNESS);

/// The controller.
#[derive(Debug)]
pub struct Slowed<const TIMES: u32 = SLOWNESS>(pub Controller);

/// Returns the time of a controller that is [`SLOWNESS`] times as slow.
#[must_use]
pub fn inner(at: Instant) -> Instant {
    Slowed::<SLOWNESS>::inner(at)
}

impl<const TIMES: u32> Slowed<TIMES> {
    fn inner(at: Instant) -> Instant {
        Instant::from_micros(at.as_micros() / u64::from(TIMES))
    }

    fn outer(outcome: Outcome) -> Outcome {
        match outcome {
            Outcome::Wait(at) => Outcome::Wait(Instant::from_micros(at.as_micros().saturating_mul(TIMES.into()))),
            done => done,
        }
    }
}

impl<const TIMES: u32> Handler for Slowed<TIMES> {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        Self::outer(Handler::call(&mut self.0, peer, request, reply, Self::inner(now)))
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        Self::outer(Handler::resume(&mut self.0, peer, request, reply, Self::inner(now)))
    }

    fn release(&mut self, peer: PeerId, request: &Request<'_>, now: Instant) {
        Handler::release(&mut self.0, peer, request, Self::inner(now));
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(&mut self.0, peer, Self::inner(now));
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(&mut self.0, peer, Self::inner(now));
    }
}

impl<const TIMES: u32> rac::server::Handler for Slowed<TIMES> {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        Self::outer(rac::server::Handler::call(&mut self.0, peer, request, reply, Self::inner(now)))
    }
}
