//! b-CAP over UDP: one socket, one task, a session for each peer.
//!
//! Handlers do not block, so one task serves all peers. Each peer has its own session, so a long call of one peer does not
//! delay the others.

use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::limits::{UDP_RECEIVE_MAX, UDP_SEND_MAX};
use bcap_core::time::Instant;
use tokio::net::UdpSocket;
use tokio::sync::watch;

use super::admission::{Admission, SlotState};
use super::limits::Limits;
use super::shared::{Changes, Shared, Tapped};
use crate::clock::{now, until};

/// The most open handles of one peer.
const OBJECTS: usize = 1000;
/// Room for a running request and the next one.
const ROOM: usize = 2 * UDP_RECEIVE_MAX;

struct Peer {
    id: PeerId,
    session: Box<Session<[u8; UDP_SEND_MAX], [u8; ROOM], OBJECTS>>,
    last_seen: Instant,
}

impl Peer {
    fn state(&self) -> SlotState {
        if self.session.is_running() {
            SlotState::Busy
        } else if self.session.open_objects() == 0 {
            // after Service_Stop; it is kept only to answer retransmissions
            SlotState::Over
        } else {
            SlotState::Idle(self.last_seen)
        }
    }
}

/// Serves a socket until the server stops.
pub(super) async fn serve<H: Handler + Send + 'static>(
    socket: UdpSocket,
    shared: Arc<Shared<H>>,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) -> io::Result<()> {
    let changes = shared.changes();
    let mut peers = Peers { socket, shared, changes, limits, known: HashMap::new() };
    let mut buffer = [0; UDP_RECEIVE_MAX + 1];
    loop {
        let due = peers.due();
        tokio::select! {
            received = peers.socket.recv_from(&mut buffer) => match received {
                Ok((count, from)) => peers.datagram(&buffer[..count], from).await,
                // an earlier reply could not be delivered; the socket is still valid
                Err(error) => tracing::debug!(%error, "UDP receive"),
            },
            () = tokio::time::sleep(until(due.unwrap_or(Instant::ZERO))), if due.is_some() => peers.run_all().await,
            () = peers.changes.next() => peers.run_all().await,
            _ = stopped.changed() => break,
        }
    }
    peers.close();
    Ok(())
}

struct Peers<H> {
    socket: UdpSocket,
    shared: Arc<Shared<H>>,
    changes: Changes<H>,
    limits: Limits,
    known: HashMap<SocketAddr, Peer>,
}

impl<H: Handler + Send + 'static> Peers<H> {
    /// Gives a datagram to its peer's session.
    async fn datagram(&mut self, bytes: &[u8], from: SocketAddr) {
        if !self.known.contains_key(&from) && !self.welcome(bytes, from).await {
            return;
        }
        let Some(peer) = self.known.get_mut(&from) else { return };
        peer.last_seen = now();
        let room = peer.session.receive_buffer();
        // a datagram that finds no room is lost, as datagrams are; its sender will repeat it
        let Some(room) = room.get_mut(..bytes.len()) else { return };
        room.copy_from_slice(bytes);
        peer.session.received(bytes.len());
        // said beforehand: what others change while the handler is asked must not be missed
        self.changes.wait(self.changes.waiting().max(1));
        self.run(from).await;
        self.listen_for_changes();
    }

    /// Makes a session for a peer that is not known; `false` when it is no peer, or there is no place.
    async fn welcome(&mut self, bytes: &[u8], from: SocketAddr) -> bool {
        // garbage makes no peers
        let Ok(frame) = Decoder::UDP.decode_datagram(bytes) else { return false };
        if !self.make_room(from) {
            tracing::warn!(%from, limit = self.limits.udp_peers, "too many UDP peers");
            let mut reply = [0; 16];
            let reply =
                FrameWriter::new(&mut reply).and_then(|reply| reply.finish(frame.serial, 0, HResult::E_MAX_CONNECT.0));
            if let Ok(reply) = reply {
                let _ = self.socket.send_to(reply, from).await;
            }
            return false;
        }
        let config = Config { invoke_timeout_max: self.limits.call, ..Config::UDP };
        let session = Box::new(Session::new(config, [0; UDP_SEND_MAX], [0; ROOM]));
        self.known.insert(from, Peer { id: self.shared.next_peer(), session, last_seen: now() });
        true
    }

    /// Makes sure of a slot for a new peer, and forgets the peer that loses it; `false` without a slot.
    fn make_room(&mut self, from: SocketAddr) -> bool {
        let taken = self.known.iter().map(|(address, peer)| (*address, address.ip(), peer.state()));
        match self.limits.udp_slots().admit(taken, from.ip(), now()) {
            Admission::Free => true,
            Admission::Instead(address) => {
                self.forget(address);
                true
            }
            Admission::Refused => false,
        }
    }

    /// Runs the session of one peer and sends what it has to say.
    async fn run(&mut self, address: SocketAddr) {
        let Some(peer) = self.known.get_mut(&address) else { return };
        let mut changed = false;
        loop {
            let event = peer.session.run(&mut self.shared.handler(), peer.id, now());
            let bytes = peer.session.transmit();
            if !bytes.is_empty() {
                let tapped = self.shared.tapped(peer.id, bytes).unwrap_or(Tapped::Instead(Vec::new()));
                let bytes = if let Tapped::Instead(instead) = &tapped { instead } else { bytes };
                if !bytes.is_empty()
                    && let Err(error) = self.socket.send_to(bytes, address).await
                {
                    tracing::debug!(%address, %error, "UDP send");
                }
                peer.session.transmitted(usize::MAX);
            }
            let Some(event) = event else { break };
            tracing::trace!(peer = peer.id.0, ?event);
            changed = true;
        }
        if changed {
            self.shared.has_changed();
        }
    }

    /// Runs the sessions whose handler waits, and forgets peers that are lost.
    async fn run_all(&mut self) {
        let now = now();
        let lost =
            |peer: &Peer| now.saturating_since(peer.last_seen) >= self.limits.udp_lost && !peer.session.is_running();
        let (gone, running): (Vec<_>, Vec<_>) = self
            .known
            .iter()
            .filter(|(_, peer)| peer.session.is_running() || lost(peer))
            .map(|(address, peer)| (*address, lost(peer)))
            .partition(|(_, lost)| *lost);
        for (address, _) in gone {
            self.forget(address);
        }
        for (address, _) in running {
            self.run(address).await;
        }
        self.listen_for_changes();
    }

    fn listen_for_changes(&mut self) {
        self.changes.wait(self.known.values().filter(|peer| peer.session.is_running()).count());
    }

    /// Returns when something is due even if nothing comes.
    fn due(&self) -> Option<Instant> {
        self.known
            .values()
            .map(|peer| match peer.session.poll_timeout() {
                Some(due) => due,
                None => peer.last_seen.saturating_add(self.limits.udp_lost),
            })
            .min()
    }

    fn forget(&mut self, address: SocketAddr) {
        if let Some(mut peer) = self.known.remove(&address) {
            tracing::debug!(peer = peer.id.0, %address, "UDP peer forgotten");
            peer.session.close(&mut self.shared.handler(), peer.id, now());
            self.shared.has_changed();
        }
    }

    fn close(&mut self) {
        let addresses: Vec<_> = self.known.keys().copied().collect();
        addresses.into_iter().for_each(|address| self.forget(address));
    }
}
