//! The effect of a scenario on the bytes of a reply.

use std::ops::ControlFlow;

use bcap_core::handler::PeerId;
use bcap_sim::Controller;
use bcap_sim::scenario::Delivery;

/// Applies the scenario to the bytes of a reply: sends them, drops them, or closes the connection.
pub(super) fn deliver(controller: &mut Controller, peer: PeerId, bytes: &mut Vec<u8>) -> ControlFlow<()> {
    match controller.deliver(peer, bytes) {
        Delivery::Send => {}
        Delivery::Drop => bytes.clear(),
        Delivery::Disconnect => return ControlFlow::Break(()),
    }
    ControlFlow::Continue(())
}
