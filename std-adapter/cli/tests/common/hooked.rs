//! A virtual controller whose answers to some calls are replaced.

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;

/// Returns the answer to a call; `None` lets the virtual controller answer.
type Hook = Box<dyn FnMut(&Request<'_>) -> Option<HResult> + Send>;

pub(crate) struct Hooked {
    pub(crate) controller: Controller,
    hook: Hook,
}

impl Hooked {
    pub(crate) fn new(controller: Controller) -> Self {
        Self { controller, hook: Box::new(|_| None) }
    }

    /// Asks `hook` first from now on.
    pub(crate) fn set(&mut self, hook: impl FnMut(&Request<'_>) -> Option<HResult> + Send + 'static) {
        self.hook = Box::new(hook);
    }
}

impl Handler for Hooked {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        match (self.hook)(request) {
            Some(code) => code.into(),
            None => Handler::call(&mut self.controller, peer, request, reply, now),
        }
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        Handler::resume(&mut self.controller, peer, request, reply, now)
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(&mut self.controller, peer, now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(&mut self.controller, peer, now);
    }
}

impl rac::server::Handler for Hooked {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        rac::server::Handler::call(&mut self.controller, peer, request, reply, now)
    }
}
