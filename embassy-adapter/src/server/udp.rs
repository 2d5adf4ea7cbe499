//! b-CAP over one UDP socket, for as many peers as the caller provides slots.

use bcap_core::endpoint::{Endpoint, ServerEndpoint};
use core::fmt;

use bcap_core::bcap::server::{self, Config, Handler};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::limits::{UDP_RECEIVE_MAX, UDP_SEND_MAX};
use bcap_core::time::Instant;
use embassy_futures::select::{Either3, select3};
use embassy_net::IpEndpoint;
use embassy_net::udp::UdpSocket;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::{Limits, SharedHandler};
use crate::clock::{now, ticks};

/// Bytes for a running request and one that arrives meanwhile.
const RECEIVE_BUFFER: usize = 2 * UDP_RECEIVE_MAX;

/// A peer with its session: about 1.6 KiB, and 8 bytes for each of its `OBJECTS`.
#[derive(Debug)]
pub struct UdpPeer<const OBJECTS: usize> {
    endpoint: IpEndpoint,
    id: PeerId,
    last_received: Instant,
    session: server::Session<[u8; UDP_SEND_MAX], [u8; RECEIVE_BUFFER], OBJECTS>,
}

/// A server of b-CAP over UDP.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::server::Handler;
/// use bcap_embassy::server::{Limits, SharedHandler, UdpPeer, UdpServer};
/// use embassy_net::udp::UdpSocket;
/// use embassy_sync::blocking_mutex::raw::NoopRawMutex;
///
/// async fn serve<H: Handler>(mut socket: UdpSocket<'_>, shared: &SharedHandler<NoopRawMutex, H, 4>) -> ! {
///     let _ = socket.bind(5007);
///     let mut peers: [Option<UdpPeer<16>>; 2] = [None, None];
///     UdpServer::new(&mut socket, &mut peers, shared, Limits::default()).run().await
/// }
/// ```
pub struct UdpServer<'a, 's, M: RawMutex, H, const N: usize, const OBJECTS: usize> {
    socket: &'a mut UdpSocket<'s>,
    peers: &'a mut [Option<UdpPeer<OBJECTS>>],
    shared: &'a SharedHandler<M, H, N>,
    limits: Limits,
}

impl<'a, 's, M: RawMutex, H: Handler, const N: usize, const OBJECTS: usize> UdpServer<'a, 's, M, H, N, OBJECTS> {
    /// Creates a server on a bound socket; `peers` are its peer slots.
    #[must_use]
    pub const fn new(
        socket: &'a mut UdpSocket<'s>,
        peers: &'a mut [Option<UdpPeer<OBJECTS>>],
        shared: &'a SharedHandler<M, H, N>,
        limits: Limits,
    ) -> Self {
        Self { socket, peers, shared, limits }
    }

    /// Serves forever.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future keeps the sessions in their slots; another server can continue them.
    pub async fn run(&mut self) -> ! {
        loop {
            let seen = self.shared.changes();
            self.run_all().await;
            let deadline = self.next_poll();
            let waiting = self.peers.iter().flatten().any(|peer| peer.session.is_running());
            let changed =
                async { if waiting { self.shared.changed(seen).await } else { core::future::pending().await } };
            let arrived = self.socket.wait_recv_ready();
            match select3(arrived, Timer::at(ticks(deadline)), changed).await {
                Either3::First(()) => self.receive().await,
                Either3::Second(()) | Either3::Third(()) => {}
            }
        }
    }

    /// Receives a datagram and passes it to its peer's session.
    async fn receive(&mut self) {
        let now = now();
        // read in place, in the socket's buffer
        let Self { socket, peers, shared, limits } = self;
        let refused = socket
            .recv_from_with(|bytes, from| {
                let from = from.endpoint;
                if bytes.len() > UDP_RECEIVE_MAX {
                    return None;
                }
                let known = peers.iter_mut().flatten().find(|peer| peer.endpoint == from);
                let peer = match known {
                    Some(peer) => peer,
                    None => {
                        // an invalid datagram must not take a slot
                        let serial = Decoder::UDP.decode_datagram(bytes).ok()?.serial;
                        match open_slot(peers, shared, limits, from, now) {
                            Some(peer) => peer,
                            None => return Some((serial, from)),
                        }
                    }
                };
                peer.last_received = now;
                // a datagram that does not fit is dropped; its sender will retransmit it
                peer.session.receive_buffer().get_mut(..bytes.len())?.copy_from_slice(bytes);
                peer.session.received(bytes.len());
                None
            })
            .await;
        if let Some((serial, from)) = refused {
            let mut reply = [0; 16];
            let reply = FrameWriter::new(&mut reply).and_then(|r| r.finish(serial, 0, HResult::E_MAX_CONNECT.0));
            if let Ok(reply) = reply {
                // a lost reply is retransmitted on request
                let _ = self.socket.send_to(reply, from).await;
            }
        }
    }

    /// Runs all sessions and sends their replies.
    async fn run_all(&mut self) {
        let Self { socket, peers, shared, .. } = self;
        for peer in peers.iter_mut().flatten() {
            loop {
                let progressed = shared.step(&mut peer.session, peer.id, now());
                if !peer.session.transmit().is_empty() {
                    let _ = socket.send_to(peer.session.transmit(), peer.endpoint).await;
                    peer.session.transmitted(usize::MAX);
                }
                if !progressed {
                    break;
                }
            }
        }
    }

    fn next_poll(&self) -> Instant {
        let deadline = self.peers.iter().flatten().filter_map(|peer| peer.session.poll_timeout());
        deadline.min().unwrap_or(Instant::FAR_FUTURE)
    }
}

/// Opens a session for a new peer, in a free slot, in the slot of a peer without a service, or in the slot of an idle
/// peer.
///
/// A peer has a service from Service_Start to Service_Stop. Returns `None` when all slots have peers with a service that were not
/// idle for [`Limits::udp_idle`].
///
/// Not inlined: otherwise the temporary session would take stack or future memory while datagrams are received.
#[inline(never)]
fn open_slot<'p, M: RawMutex, H: Handler, const N: usize, const OBJECTS: usize>(
    peers: &'p mut [Option<UdpPeer<OBJECTS>>],
    shared: &SharedHandler<M, H, N>,
    limits: &Limits,
    endpoint: IpEndpoint,
    now: Instant,
) -> Option<&'p mut UdpPeer<OBJECTS>> {
    let has_service = |peer: &UdpPeer<OBJECTS>| peer.session.is_running() || peer.session.open_objects() > 0;
    let is_idle = |peer: &UdpPeer<OBJECTS>| {
        !peer.session.is_running() && now.saturating_since(peer.last_received) >= limits.udp_idle
    };
    let slot = peers
        .iter_mut()
        .filter(|slot| slot.as_ref().is_none_or(|peer| !has_service(peer) || is_idle(peer)))
        .min_by_key(|slot| slot.as_ref().map(|peer| (has_service(peer), peer.last_received)))?;
    if let Some(old) = slot {
        shared.close(&mut old.session, old.id, now);
    }
    let session = server::Session::new(Config::UDP, [0; UDP_SEND_MAX], [0; RECEIVE_BUFFER]);
    Some(slot.insert(UdpPeer { endpoint, id: shared.next_peer(), last_received: now, session }))
}

impl<M: RawMutex, H, const N: usize, const OBJECTS: usize> fmt::Debug for UdpServer<'_, '_, M, H, N, OBJECTS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("UdpServer").field("peers", &self.peers.len()).finish_non_exhaustive()
    }
}
