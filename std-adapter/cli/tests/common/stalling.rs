//! A virtual controller that stops answering at a chosen call.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;

pub(crate) struct Stalling {
    pub(crate) controller: Controller,
    function: FunctionId,
    /// The calls of the function that are answered.
    left: Option<u32>,
    /// All calls of the function so far.
    pub(crate) count: u32,
    stalled: SyncSender<()>,
}

impl Stalling {
    /// Answers this many calls of a function. The receiver gets a message when the next one has arrived.
    pub(crate) fn after(controller: Controller, function: FunctionId, left: u32) -> (Self, Receiver<()>) {
        let (stalled, receiver) = sync_channel(1);
        (Self { controller, function, left: Some(left), count: 0, stalled }, receiver)
    }

    /// Answers all further calls.
    pub(crate) fn go_on(&mut self) {
        self.left = None;
    }
}

impl Handler for Stalling {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        if request.function == self.function {
            self.count += 1;
            if self.left == Some(0) {
                let _ = self.stalled.try_send(());
                return Outcome::Wait(now + Duration::from_secs(3600));
            }
            self.left = self.left.map(|left| left - 1);
        }
        Handler::call(&mut self.controller, peer, request, reply, now)
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        if request.function == self.function && self.left == Some(0) {
            // a keep-alive asks again
            return Outcome::Wait(now + Duration::from_secs(3600));
        }
        if request.function == self.function {
            return Handler::call(&mut self.controller, peer, request, reply, now);
        }
        Handler::resume(&mut self.controller, peer, request, reply, now)
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(&mut self.controller, peer, now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(&mut self.controller, peer, now);
    }
}

impl rac::server::Handler for Stalling {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        rac::server::Handler::call(&mut self.controller, peer, request, reply, now)
    }
}
