//! b-CAP over UDP: one socket, one task, a session for each peer.
//!
//! Handlers do not block, so one task serves all peers. Each peer has its own session, so a long call of one peer does not
//! delay the others. The core selects the peers that get a session ([`datagrams`]).

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use bcap_core::bcap::server::{Config, Handler};
use bcap_core::limits::UDP_RECEIVE_MAX;
use bcap_core::peers::datagrams::{self, Received};
use bcap_core::peers::{REFUSAL, refusal};
use bcap_core::time::Instant;
use tokio::net::UdpSocket;
use tokio::sync::watch;

use super::limits::Limits;
use super::shared::{Changes, ServerState};
use crate::clock::{now, until};

/// The maximum number of open handles of one peer.
const OBJECTS: usize = 1000;

type Peer = datagrams::Peer<SocketAddr, OBJECTS>;

/// Serves a socket until the server stops.
pub(super) async fn serve<H: Handler + Send + 'static>(
    socket: UdpSocket,
    shared: Arc<ServerState<H>>,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) -> io::Result<()> {
    let changes = shared.changes();
    let mut peers = Peers { socket, shared, changes, limits, slots: Vec::new() };
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
    peers.remove(|_| true);
    Ok(())
}

struct Peers<H> {
    socket: UdpSocket,
    shared: Arc<ServerState<H>>,
    changes: Changes<H>,
    limits: Limits,
    /// Grows up to `limits.udp_peers`.
    slots: Vec<Option<Peer>>,
}

impl<H: Handler + Send + 'static> Peers<H> {
    /// Passes a datagram to the session of its sender, and runs it.
    async fn datagram(&mut self, bytes: &[u8], from: SocketAddr) {
        // the last slot is the spare one; others are free where peers were removed
        if self.slots.len() < self.limits.udp_peers && self.slots.last().is_none_or(Option::is_some) {
            self.slots.push(None);
        }
        let rules = (&self.limits.udp_slots(), Config { invoke_timeout_max: self.limits.call, ..Config::UDP });
        // register before the handler runs, so that no change is missed
        self.changes.wait(self.changes.waiting().max(1));
        match datagrams::receive(&mut self.slots, (bytes, from), rules, &*self.shared, now()) {
            Received::Passed(index) => self.run(index).await,
            Received::Refused(serial) => {
                tracing::warn!(%from, limit = self.limits.udp_peers, "too many UDP peers");
                let _ = self.socket.send_to(refusal(serial, &mut [0; REFUSAL]), from).await;
            }
            Received::Dropped => {}
        }
        self.update_waiting();
    }

    /// Runs the session of one peer and sends its replies.
    async fn run(&mut self, index: usize) {
        let Some(Some(peer)) = self.slots.get_mut(index) else { return };
        loop {
            let progressed = peer.step(&*self.shared, now());
            let bytes = peer.transmit();
            if !bytes.is_empty() {
                // a datagram has no connection to close
                let tapped = self.shared.tapped(peer.id(), bytes).unwrap_or_default();
                if !tapped.is_empty()
                    && let Err(error) = self.socket.send_to(&tapped, peer.address()).await
                {
                    tracing::debug!(address = %peer.address(), %error, "UDP send");
                }
                peer.transmitted();
            }
            if !progressed {
                return;
            }
        }
    }

    /// Runs the sessions whose handler waits, and removes lost peers.
    async fn run_all(&mut self) {
        let (now, limit) = (now(), self.limits.udp_lost);
        self.remove(|peer| !peer.is_running() && now.saturating_since(peer.last_received()) >= limit);
        for index in 0..self.slots.len() {
            if self.slots[index].as_ref().is_some_and(Peer::is_running) {
                self.run(index).await;
            }
        }
        self.update_waiting();
    }

    /// Registers the number of running requests for changes.
    fn update_waiting(&mut self) {
        self.changes.wait(self.slots.iter().flatten().filter(|peer| peer.is_running()).count());
    }

    /// Returns the earliest deadline of all peers.
    fn next_deadline(&self) -> Option<Instant> {
        let lost = |peer: &Peer| peer.last_received().saturating_add(self.limits.udp_lost);
        self.slots.iter().flatten().map(|peer| peer.poll_timeout().unwrap_or_else(|| lost(peer))).min()
    }

    /// Closes sessions and frees their slots.
    fn remove(&mut self, is_removed: impl Fn(&Peer) -> bool) {
        for slot in &mut self.slots {
            if let Some(mut peer) = slot.take_if(|peer| is_removed(peer)) {
                tracing::debug!(peer = peer.id().0, address = %peer.address(), "UDP peer removed");
                peer.close(&*self.shared, now());
            }
        }
    }
}
