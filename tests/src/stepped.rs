//! A virtual controller whose clock advances only when a client calls or waits.
//!
//! Each new call takes [`CALL`]; a call that has to wait moves the clock to the end of its wait. So a stream of 500
//! cycles takes milliseconds on real sockets, and a busy machine cannot make it late.

use std::sync::mpsc::Sender;
use std::time::Duration;

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;

/// The time that a new call takes on the controller's clock.
pub const CALL: Duration = Duration::from_millis(1);

/// The interval at which the server polls a call that waits on hold, in real time.
const LOOK: Duration = Duration::from_millis(1);

/// A call that waits without moving the clock.
#[derive(Debug)]
enum Hold {
    /// The next call that has to wait; the sender gets a message when it does.
    Next(Sender<()>),
    /// The call of this client.
    Of(PeerId),
}

/// The controller and its clock.
#[derive(Debug)]
pub struct Stepped {
    /// The controller.
    pub controller: Controller,
    now: Instant,
    hold: Option<Hold>,
}

impl Stepped {
    /// Sets the clock of a controller to zero.
    #[must_use]
    pub const fn new(controller: Controller) -> Self {
        Self { controller, now: Instant::ZERO, hold: None }
    }

    /// Returns the time on the controller's clock.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Moves the clock forward.
    pub fn pass(&mut self, time: Duration) {
        self.now = self.now + time;
        self.controller.advance(self.now);
    }

    /// Makes the next call that has to wait do so without moving the clock, so that another client can call in the meantime;
    /// `waits` gets a message when there is such a call.
    pub fn hold_next(&mut self, waits: Sender<()>) {
        self.hold = Some(Hold::Next(waits));
    }

    /// Ends the hold: the held call moves the clock again.
    pub fn release(&mut self) {
        self.hold = None;
    }

    /// Returns whether a call of this client waits without moving the clock.
    fn holds(&mut self, peer: PeerId) -> bool {
        if let Some(Hold::Next(waits)) = &self.hold {
            // without a receiver the test has ended
            let _ = waits.send(());
            self.hold = Some(Hold::Of(peer));
        }
        matches!(self.hold, Some(Hold::Of(held)) if held == peer)
    }

    /// Moves the clock until a call ends, unless it is held.
    fn finish(
        &mut self,
        mut outcome: Outcome,
        peer: PeerId,
        request: &Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        while let Outcome::Wait(at) = outcome {
            if self.holds(peer) || at == Instant::FAR_FUTURE {
                return Outcome::Wait(now + LOOK);
            }
            self.now = at.max(self.now + Duration::from_micros(1));
            outcome = Handler::resume(&mut self.controller, peer, request, reply, self.now);
        }
        outcome
    }
}

impl Handler for Stepped {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.now = self.now + CALL;
        let outcome = Handler::call(&mut self.controller, peer, request, reply, self.now);
        self.finish(outcome, peer, request, reply, now)
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let outcome = Handler::resume(&mut self.controller, peer, request, reply, self.now);
        self.finish(outcome, peer, request, reply, now)
    }

    fn abandoned(&mut self, peer: PeerId, _: Instant) {
        Handler::abandoned(&mut self.controller, peer, self.now);
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        Handler::left(&mut self.controller, peer, self.now);
    }
}

impl rac::server::Handler for Stepped {
    fn call(&mut self, _: PeerId, _: &rac::Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        HResult::E_NOTIMPL.into()
    }
}
