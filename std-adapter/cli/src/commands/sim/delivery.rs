//! The server of a virtual controller, and the effect of a scenario on the bytes of a reply.

use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use bcap_core::handler::PeerId;
use bcap_sim::Controller;
use bcap_sim::pace::Paced;
use bcap_sim::scenario::Delivery;
use bcap_std::server::Server;

/// Makes the controller that a server and a page share.
pub(super) fn shared(controller: Controller) -> Arc<Mutex<Paced>> {
    Arc::new(Mutex::new(Paced::new(controller)))
}

/// Makes the server. It is one type with and without a page, because each type is compiled for all protocols.
pub(super) fn server(shared: &Arc<Mutex<Paced>>) -> Server<Paced> {
    Server::with_shared(Arc::clone(shared))
        .tap(|paced, peer, bytes| deliver(paced.controller(), peer, bytes))
        .on_connect(|paced, peer, address| paced.controller().connected(peer, address))
}

/// Applies the scenario to the bytes of a reply: sends them, drops them, or closes the connection.
pub(super) fn deliver(controller: &mut Controller, peer: PeerId, bytes: &mut Vec<u8>) -> ControlFlow<()> {
    match controller.deliver(peer, bytes) {
        Delivery::Send => {}
        Delivery::Drop => bytes.clear(),
        Delivery::Disconnect => return ControlFlow::Break(()),
    }
    ControlFlow::Continue(())
}
