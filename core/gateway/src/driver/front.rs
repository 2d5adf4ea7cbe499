//! The protocol of a client: RAC, or Modbus TCP, whose requests become lines of RAC.

use core::net::Ipv4Addr;

use bcap_core::handler::PeerId;
use bcap_core::rac::Request;

use crate::{Gateway, Rules, modbus};

/// The protocol of a client. A client of Modbus has a session.
#[derive(Debug)]
pub enum Front<'a, 'm> {
    /// The client speaks RAC.
    Rac,
    /// The client speaks Modbus TCP.
    Modbus(&'a mut modbus::Session<'m>),
}

impl Front<'_, '_> {
    /// Moves lines and replies between a client of Modbus and the gateway. After `true` the gateway must be polled.
    pub(super) fn exchange(&mut self, gateway: &mut Gateway<'_>, peer: PeerId, client: Option<Ipv4Addr>) -> bool {
        let Self::Modbus(session) = self else { return false };
        let rules = gateway.config().rules;
        let reply = gateway.transmit(peer);
        let replied = reply.len();
        if replied > 0 {
            session.replied(reply, permits(&rules, client));
            gateway.transmitted(peer, replied);
        }
        let count = gateway.receive_buffer(peer).iter_mut().zip(session.line()).map(|(to, from)| *to = *from).count();
        if count > 0 {
            session.line_taken(count);
            gateway.received(peer, count);
        }
        replied > 0 || count > 0
    }

    /// Returns the number of bytes to send to the client.
    pub(super) fn to_send(&self, gateway: &Gateway<'_>, peer: PeerId) -> usize {
        match self {
            Self::Rac => gateway.transmit(peer).len(),
            Self::Modbus(session) => session.transmit().len(),
        }
    }

    /// Returns the bytes to send to the client, which are `line` for a client of RAC.
    pub(super) fn answer<'b>(&'b self, line: &'b [u8]) -> &'b [u8] {
        match self {
            Self::Rac => line,
            Self::Modbus(session) => session.transmit(),
        }
    }

    /// Returns the number of bytes of the client that there is room for; 0 while a request runs, because the end of the
    /// connection would end the session, and a PUT that is executed would have no event.
    pub(super) fn room(&self, gateway: &mut Gateway<'_>, peer: PeerId) -> usize {
        match self {
            Self::Rac => gateway.receive_buffer(peer).len(),
            Self::Modbus(session) if session.is_running() => 0,
            Self::Modbus(session) => session.room(),
        }
    }

    /// Passes on bytes from the client; they fit.
    pub(super) fn received(&mut self, gateway: &mut Gateway<'_>, peer: PeerId, client: Option<Ipv4Addr>, bytes: &[u8]) {
        match self {
            Self::Rac => {
                if let Some(room) = gateway.receive_buffer(peer).get_mut(..bytes.len()) {
                    room.copy_from_slice(bytes);
                    gateway.received(peer, bytes.len());
                }
            }
            Self::Modbus(session) => session.received(bytes, permits(&gateway.config().rules, client)),
        }
    }

    /// Records that the client's link has taken some of the bytes to send.
    pub(super) fn transmitted(
        &mut self,
        gateway: &mut Gateway<'_>,
        peer: PeerId,
        client: Option<Ipv4Addr>,
        count: usize,
    ) {
        match self {
            Self::Rac => gateway.transmitted(peer, count),
            Self::Modbus(session) => {
                session.transmitted(count);
                // the next request may have arrived
                session.received(&[], permits(&gateway.config().rules, client));
            }
        }
    }

    /// Returns whether a request runs.
    pub(super) fn is_running(&self, gateway: &Gateway<'_>, peer: PeerId) -> bool {
        match self {
            Self::Rac => gateway.is_running(peer),
            Self::Modbus(session) => session.is_running(),
        }
    }

    /// Returns whether a request of a client of Modbus runs or bytes of its response are left to send. Its client keeps its
    /// slot until then, even between two lines, when the gateway itself has no request of it.
    pub(super) fn is_busy(&self) -> bool {
        matches!(self, Self::Modbus(session) if session.is_running() || !session.transmit().is_empty())
    }

    /// Returns whether a part of a request has arrived.
    pub(super) fn is_receiving(&self, gateway: &Gateway<'_>, peer: PeerId) -> bool {
        match self {
            Self::Rac => gateway.is_receiving(peer),
            Self::Modbus(session) => session.is_receiving(),
        }
    }

    /// Returns whether a client of Modbus sent other bytes.
    pub(super) fn is_broken(&self) -> bool {
        matches!(self, Self::Modbus(session) if session.is_broken())
    }
}

/// Returns whether the rules permit a request of a client.
fn permits(rules: &Rules<'_>, client: Option<Ipv4Addr>) -> impl Fn(&Request<'_>) -> bool {
    move |request| rules.permits(request, client).is_ok()
}
