//! The server of a virtual controller, and the effect of a scenario on the bytes of a reply.

use std::net::IpAddr;
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
    let tap = |paced: &mut Paced, peer, bytes: &mut Vec<u8>| deliver(paced.controller(), peer, bytes);
    let connected = |paced: &mut Paced, peer, address: IpAddr| paced.controller().connected(peer, address);
    Server::with_shared(Arc::clone(shared)).tap(tap).on_connect(connected)
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
