//! b-CAP over one UDP socket, for as many peers as the caller provides slots.

use core::fmt;

use bcap_core::bcap::server::{Config, Handler};
use bcap_core::handler::PeerId;
use bcap_core::limits::UDP_RECEIVE_MAX;
use bcap_core::peers::datagrams::{self, Peer, Received, SharedState, UdpSession};
use bcap_core::peers::{REFUSAL, Slots, refusal};
use bcap_core::time::Instant;
use embassy_futures::select::{Either3, select3};
use embassy_net::IpEndpoint;
use embassy_net::udp::UdpSocket;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Timer, with_timeout};

use super::{Limits, SharedHandler};
use crate::clock::{now, ticks};
use crate::net::discard;

/// How long a reply may wait until the address of its peer is resolved.
const UNSENT: Duration = Duration::from_millis(100);

/// A peer with its session: about 1.6 KiB, and 8 bytes for each of its `OBJECTS`.
pub type UdpPeer<const OBJECTS: usize> = Peer<IpEndpoint, OBJECTS>;

/// A server of b-CAP over UDP.
///
/// A request from an address that does not exist delays all replies by up to a second. The image of the gateway drops such
/// packets before smoltcp gets them (`bcap-board`).
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
    slots: Slots,
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
        let slots = Slots { total: peers.len(), per_host: usize::MAX, evict_after: Some(limits.udp_idle) };
        Self { socket, peers, shared, slots }
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
            let waiting = self.peers.iter().flatten().any(Peer::is_running);
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
        let Self { socket, peers, shared, slots } = self;
        let (received, from) = socket
            .recv_from_with(|bytes, from| {
                let from = from.endpoint;
                if bytes.len() > UDP_RECEIVE_MAX {
                    return (Received::Dropped, from);
                }
                (datagrams::receive(peers, (bytes, from), (slots, Config::UDP), *shared, now), from)
            })
            .await;
        if let Received::Refused(serial) = received {
            // a lost reply is retransmitted on request
            send(self.socket, refusal(serial, &mut [0; REFUSAL]), from).await;
        }
    }

    /// Runs all sessions and sends their replies.
    async fn run_all(&mut self) {
        let Self { socket, peers, shared, .. } = self;
        for peer in peers.iter_mut().flatten() {
            loop {
                let progressed = peer.step(*shared, now());
                if !peer.transmit().is_empty() {
                    send(socket, peer.transmit(), peer.address()).await;
                    peer.transmitted();
                }
                if !progressed {
                    break;
                }
            }
        }
    }

    fn next_poll(&self) -> Instant {
        self.peers.iter().flatten().filter_map(Peer::poll_timeout).min().unwrap_or(Instant::FAR_FUTURE)
    }
}

/// Sends a datagram once the previous datagram was sent.
///
/// smoltcp keeps a datagram to an address that it cannot resolve or reach, and sends no other datagram before it, nor within a
/// second after its ARP request. So it is discarded after [`UNSENT`], with all other datagrams in the socket; their peers
/// repeat the requests.
async fn send(socket: &mut UdpSocket<'_>, bytes: &[u8], to: IpEndpoint) {
    if with_timeout(UNSENT, socket.flush()).await.is_err() {
        discard(socket);
    }
    // a reply that cannot be sent at all is also lost
    let _ = socket.send_to(bytes, to).await;
}

impl<M: RawMutex, H: Handler, const N: usize, const OBJECTS: usize> SharedState<UdpSession<OBJECTS>>
    for SharedHandler<M, H, N>
{
    type Address = IpEndpoint;

    fn is_same_host(one: IpEndpoint, other: IpEndpoint) -> bool {
        one.addr == other.addr
    }

    fn connect(&self, _: IpEndpoint) -> PeerId {
        self.next_peer()
    }

    fn step(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) -> bool {
        self.step(session, peer, now)
    }

    fn close(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) {
        self.close(session, peer, now);
    }
}

impl<M: RawMutex, H, const N: usize, const OBJECTS: usize> fmt::Debug for UdpServer<'_, '_, M, H, N, OBJECTS> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("UdpServer").field("peers", &self.peers.len()).finish_non_exhaustive()
    }
}
