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
use super::shared::{Changes, ServerState, Tapped};
use crate::clock::{now, until};

/// The maximum number of open handles of one peer.
const OBJECTS: usize = 1000;
/// The receive buffer of a session: a running request, and one that arrives meanwhile.
const RECEIVE_BUFFER: usize = 2 * UDP_RECEIVE_MAX;

struct Peer {
    id: PeerId,
    session: Box<Session<[u8; UDP_SEND_MAX], [u8; RECEIVE_BUFFER], OBJECTS>>,
    last_seen: Instant,
}

impl Peer {
    fn state(&self) -> SlotState {
        if self.session.is_running() {
            SlotState::Busy
        } else if self.session.open_objects() == 0 {
            // after Service_Stop the peer is kept only to answer retransmissions
            SlotState::Over
        } else {
            SlotState::Idle(self.last_seen)
        }
    }
}

/// Serves a socket until the server stops.
pub(super) async fn serve<H: Handler + Send + 'static>(
    socket: UdpSocket,
    shared: Arc<ServerState<H>>,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) -> io::Result<()> {
    let changes = shared.changes();
    let mut peers = Peers { socket, shared, changes, limits, known: HashMap::new() };
    let mut buffer = [0; UDP_RECEIVE_MAX + 1];
    loop {
        let deadline = peers.next_deadline();
        tokio::select! {
            received = peers.socket.recv_from(&mut buffer) => match received {
                Ok((count, from)) => peers.datagram(&buffer[..count], from).await,
                // an ICMP error for an earlier reply (port unreachable) does not affect the socket
                Err(error) => tracing::debug!(%error, "UDP receive"),
            },
            () = tokio::time::sleep(until(deadline.unwrap_or(Instant::ZERO))), if deadline.is_some() => {
                peers.run_all().await;
            }
            () = peers.changes.next() => peers.run_all().await,
            _ = stopped.changed() => break,
        }
    }
    peers.close();
    Ok(())
}

struct Peers<H> {
    socket: UdpSocket,
    shared: Arc<ServerState<H>>,
    changes: Changes<H>,
    limits: Limits,
    known: HashMap<SocketAddr, Peer>,
}

impl<H: Handler + Send + 'static> Peers<H> {
    /// Passes a datagram to the session of its sender.
    async fn datagram(&mut self, bytes: &[u8], from: SocketAddr) {
        if !self.known.contains_key(&from) && !self.accept(bytes, from).await {
            return;
        }
        let Some(peer) = self.known.get_mut(&from) else { return };
        peer.last_seen = now();
        // a full buffer drops the datagram; its sender retransmits it
        let Some(buffer) = peer.session.receive_buffer().get_mut(..bytes.len()) else { return };
        buffer.copy_from_slice(bytes);
        peer.session.received(bytes.len());
        // register before the handler runs, so that no change made meanwhile is missed
        self.changes.wait(self.changes.waiting().max(1));
        self.run(from).await;
        self.update_waiting();
    }

    /// Creates a session for a new peer; `false` if the datagram is not a valid frame or there is no slot.
    async fn accept(&mut self, bytes: &[u8], from: SocketAddr) -> bool {
        // an invalid datagram gets no session
        let Ok(frame) = Decoder::UDP.decode_datagram(bytes) else { return false };
        if !self.reserve_slot(from) {
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
        let session = Box::new(Session::new(config, [0; UDP_SEND_MAX], [0; RECEIVE_BUFFER]));
        let id = self.shared.next_peer();
        self.shared.connected(id, from.ip());
        self.known.insert(from, Peer { id, session, last_seen: now() });
        true
    }

    /// Reserves a slot for a new peer, and removes the peer that loses it; `false` if there is no slot.
    fn reserve_slot(&mut self, from: SocketAddr) -> bool {
        let taken = self.known.iter().map(|(address, peer)| (*address, address.ip(), peer.state()));
        match self.limits.udp_slots().admit(taken, from.ip(), now()) {
            Admission::Free => true,
            Admission::Instead(address) => {
                self.remove(address);
                true
            }
            Admission::Refused => false,
        }
    }

    /// Runs the session of one peer and sends its replies.
    async fn run(&mut self, address: SocketAddr) {
        let Some(peer) = self.known.get_mut(&address) else { return };
        let mut changed = false;
        loop {
            let event = peer.session.run(&mut self.shared.handler(), peer.id, now());
            let bytes = peer.session.transmit();
            if !bytes.is_empty() {
                let tapped = self.shared.tapped(peer.id, bytes).unwrap_or(Tapped::Replaced(Vec::new()));
                let bytes = if let Tapped::Replaced(replacement) = &tapped { replacement } else { bytes };
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
            self.shared.notify_change();
        }
    }

    /// Runs the sessions whose handler waits, and removes lost peers.
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
            self.remove(address);
        }
        for (address, _) in running {
            self.run(address).await;
        }
        self.update_waiting();
    }

    /// Registers the number of running requests for changes.
    fn update_waiting(&mut self) {
        self.changes.wait(self.known.values().filter(|peer| peer.session.is_running()).count());
    }

    /// Returns the earliest deadline of all peers.
    fn next_deadline(&self) -> Option<Instant> {
        self.known
            .values()
            .map(|peer| match peer.session.poll_timeout() {
                Some(deadline) => deadline,
                None => peer.last_seen.saturating_add(self.limits.udp_lost),
            })
            .min()
    }

    /// Closes the session of a peer and frees its slot.
    fn remove(&mut self, address: SocketAddr) {
        if let Some(mut peer) = self.known.remove(&address) {
            tracing::debug!(peer = peer.id.0, %address, "UDP peer removed");
            peer.session.close(&mut self.shared.handler(), peer.id, now());
            self.shared.notify_change();
        }
    }

    fn close(&mut self) {
        let addresses: Vec<_> = self.known.keys().copied().collect();
        addresses.into_iter().for_each(|address| self.remove(address));
    }
}
