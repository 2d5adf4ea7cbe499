//! b-CAP over one UDP socket, for as many peers as the caller has places for.

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

use super::{Limits, Shared};
use crate::clock::{now, ticks};

/// Room for a request that runs and one that comes meanwhile.
const ROOM: usize = 2 * UDP_RECEIVE_MAX;

/// A peer with its session: about 1.6 KiB, and 8 bytes for each of its `OBJECTS`.
#[derive(Debug)]
pub struct UdpPeer<const OBJECTS: usize> {
    endpoint: IpEndpoint,
    id: PeerId,
    heard: Instant,
    session: server::Session<[u8; UDP_SEND_MAX], [u8; ROOM], OBJECTS>,
}

/// A server of b-CAP over UDP.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::server::Handler;
/// use bcap_embassy::server::{Limits, Shared, UdpPeer, UdpServer};
/// use embassy_net::udp::UdpSocket;
/// use embassy_sync::blocking_mutex::raw::NoopRawMutex;
///
/// async fn serve<H: Handler>(mut socket: UdpSocket<'_>, shared: &Shared<NoopRawMutex, H, 4>) -> ! {
///     let _ = socket.bind(5007);
///     let mut peers: [Option<UdpPeer<16>>; 2] = [None, None];
///     UdpServer::new(&mut socket, &mut peers, shared, Limits::default()).run().await
/// }
/// ```
pub struct UdpServer<'a, 's, M: RawMutex, H, const N: usize, const OBJECTS: usize> {
    socket: &'a mut UdpSocket<'s>,
    peers: &'a mut [Option<UdpPeer<OBJECTS>>],
    shared: &'a Shared<M, H, N>,
    limits: Limits,
}

impl<'a, 's, M: RawMutex, H: Handler, const N: usize, const OBJECTS: usize> UdpServer<'a, 's, M, H, N, OBJECTS> {
    /// Makes a server of a socket that is bound, with places for peers.
    #[must_use]
    pub const fn new(
        socket: &'a mut UdpSocket<'s>,
        peers: &'a mut [Option<UdpPeer<OBJECTS>>],
        shared: &'a Shared<M, H, N>,
        limits: Limits,
    ) -> Self {
        Self { socket, peers, shared, limits }
    }

    /// Serves for ever.
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped the peers keep their places, and another server can go on with them.
    pub async fn run(&mut self) -> ! {
        loop {
            let seen = self.shared.changes();
            self.run_all().await;
            let due = self.due();
            let waiting = self.peers.iter().flatten().any(|peer| peer.session.is_running());
            let changed =
                async { if waiting { self.shared.changed(seen).await } else { core::future::pending().await } };
            let arrived = self.socket.wait_recv_ready();
            match select3(arrived, Timer::at(ticks(due)), changed).await {
                Either3::First(()) => self.receive().await,
                Either3::Second(()) | Either3::Third(()) => {}
            }
        }
    }

    /// Takes the datagram that has come, and gives it to its peer's session.
    async fn receive(&mut self) {
        let now = now();
        // looked at where it lies, in the socket's memory
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
                        // garbage makes no peers
                        let serial = Decoder::UDP.decode_datagram(bytes).ok()?.serial;
                        match welcome(peers, shared, limits, from, now) {
                            Some(peer) => peer,
                            None => return Some((serial, from)),
                        }
                    }
                };
                peer.heard = now;
                // a datagram that finds no room is lost, as datagrams are; its sender will repeat it
                peer.session.receive_buffer().get_mut(..bytes.len())?.copy_from_slice(bytes);
                peer.session.received(bytes.len());
                None
            })
            .await;
        if let Some((serial, from)) = refused {
            let mut reply = [0; 16];
            let reply = FrameWriter::new(&mut reply).and_then(|r| r.finish(serial, 0, HResult::E_MAX_CONNECT.0));
            if let Ok(reply) = reply {
                // whether it arrives is the network's affair
                let _ = self.socket.send_to(reply, from).await;
            }
        }
    }

    /// Lets all sessions go on, and sends what they have to say.
    async fn run_all(&mut self) {
        let Self { socket, peers, shared, .. } = self;
        for peer in peers.iter_mut().flatten() {
            loop {
                let stepped = shared.step(&mut peer.session, peer.id, now());
                if !peer.session.transmit().is_empty() {
                    let _ = socket.send_to(peer.session.transmit(), peer.endpoint).await;
                    peer.session.transmitted(usize::MAX);
                }
                if !stepped {
                    break;
                }
            }
        }
    }

    fn due(&self) -> Instant {
        let due = self.peers.iter().flatten().filter_map(|peer| peer.session.poll_timeout());
        due.min().unwrap_or(Instant::FAR_FUTURE)
    }
}

/// Finds a place for a peer that is not known: a free one, or that of the peer that was silent longest.
///
/// Not inlined: a session is made on the stack, and would stay there as long as datagrams are received.
#[inline(never)]
fn welcome<'p, M: RawMutex, H: Handler, const N: usize, const OBJECTS: usize>(
    peers: &'p mut [Option<UdpPeer<OBJECTS>>],
    shared: &Shared<M, H, N>,
    limits: &Limits,
    endpoint: IpEndpoint,
    now: Instant,
) -> Option<&'p mut UdpPeer<OBJECTS>> {
    let quiet =
        |peer: &UdpPeer<OBJECTS>| !peer.session.is_running() && now.saturating_since(peer.heard) >= limits.udp_idle;
    let slot = peers
        .iter_mut()
        .filter(|slot| slot.as_ref().is_none_or(quiet))
        .min_by_key(|slot| slot.as_ref().map(|peer| peer.heard))?;
    if let Some(old) = slot {
        shared.close(&mut old.session, old.id, now);
    }
    let session = server::Session::new(Config::UDP, [0; UDP_SEND_MAX], [0; ROOM]);
    Some(slot.insert(UdpPeer { endpoint, id: shared.next_peer(), heard: now, session }))
}

impl<M: RawMutex, H, const N: usize, const OBJECTS: usize> fmt::Debug for UdpServer<'_, '_, M, H, N, OBJECTS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("UdpServer").field("peers", &self.peers.len()).finish_non_exhaustive()
    }
}
