//! Clients and servers for smoltcp without embassy: the loop that polls the interface polls them too; nothing is async.
//!
//! ```text
//!   loop { interface.poll ─► poll_tcp, poll_udp, TcpServer::poll, UdpServer::poll ─► interface.poll ─► sleep }
//! ```
//!
//! The client is the core's [`Client`], the server runs the core's sessions. The functions here move their bytes to and
//! from a smoltcp socket. The caller owns the sockets and their buffers.
//!
//! # Examples
//!
//! A loop that reads a variable repeatedly:
//!
//! ```
//! use bcap_core::bcap::Client;
//! use bcap_core::bcap::call::{self, VariableHandle};
//! use bcap_core::bcap::client::Event;
//! use bcap_core::time::Instant;
//! use bcap_embassy::bare::{self, LinkError};
//! use smoltcp::iface::{Interface, SocketHandle, SocketSet};
//! use smoltcp::phy::Device;
//! use smoltcp::socket::tcp;
//!
//! fn watch<D: Device>(
//!     device: &mut D,
//!     interface: &mut Interface,
//!     sockets: &mut SocketSet<'_>,
//!     robot: SocketHandle,
//!     client: &mut Client<[u8; 512]>,
//!     clock: impl Fn() -> Instant,
//! ) -> Result<(), LinkError> {
//!     loop {
//!         let now = clock();
//!         interface.poll(bare::to_smoltcp(now), device, sockets);
//!         match bare::poll_tcp(client, sockets.get_mut::<tcp::Socket<'_>>(robot), now)? {
//!             Some(Event::Replied(result)) if result.is_ok() => {
//!                 let _value = client.reply().and_then(|reply| reply.value());
//!             }
//!             Some(_) => {}
//!             None if !client.is_busy() => {
//!                 let _ = client.start(&call::variable_get_value(VariableHandle(1)), client.timing(), now);
//!             }
//!             None => {}
//!         }
//!     }
//! }
//! ```

use core::cell::{Cell, RefCell};
use core::fmt;
use core::time::Duration;

use bcap_core::bcap::Client;
use bcap_core::bcap::client::Event;
use bcap_core::bcap::server::{Config, Handler};
use bcap_core::handler::PeerId;
use bcap_core::limits::UDP_RECEIVE_MAX;
use bcap_core::peers::datagrams::{self, Peer, Received, SharedState, UdpSession};
use bcap_core::peers::{REFUSAL, Slots, refusal};
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use smoltcp::socket::tcp::{self, RecvError};
use smoltcp::socket::udp;
use smoltcp::wire::IpEndpoint;

use bcap_core::endpoint::Endpoint;
pub use bcap_core::endpoint::Serve;

/// The time without traffic after which a TCP keep-alive is sent.
const KEEP_ALIVE: smoltcp::time::Duration = smoltcp::time::Duration::from_secs(5);
/// The time without an acknowledgement, of data or of a keep-alive, after which the connection is reset.
const TIMEOUT: smoltcp::time::Duration = smoltcp::time::Duration::from_secs(15);

/// How long a peer over UDP with a service must be silent before another peer may take its slot.
const UDP_IDLE: Duration = Duration::from_secs(10);
/// How long a reply may wait until the address of its peer is resolved.
const UNSENT: Duration = Duration::from_millis(100);

/// Why a connection can no longer be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LinkError {
    /// The peer closed the connection.
    Closed,
    /// The peer refused or reset the connection, or stopped responding.
    Reset,
    /// The request does not fit into the socket's buffer, or the peer's address is invalid.
    Unsendable,
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Closed => "the peer closed the connection",
            Self::Reset => "the connection was refused, reset or lost",
            Self::Unsendable => "the datagram does not fit into the socket's buffer or has no valid destination",
        })
    }
}

impl core::error::Error for LinkError {}

/// Converts an instant to smoltcp's type.
#[must_use]
pub fn to_smoltcp(now: Instant) -> smoltcp::time::Instant {
    smoltcp::time::Instant::from_micros(i64::try_from(now.as_micros()).unwrap_or(i64::MAX))
}

/// Configures a TCP socket for short messages: no Nagle delay, a keep-alive after 5 s and a timeout of 15 s.
pub fn set_up(socket: &mut tcp::Socket<'_>) {
    socket.set_nagle_enabled(false);
    socket.set_keep_alive(Some(KEEP_ALIVE));
    socket.set_timeout(Some(TIMEOUT));
}

/// Moves a client's bytes over TCP and returns the next event.
///
/// Call it after each poll of the interface, and when the client's [`poll_timeout`](Client::poll_timeout) is reached,
/// until it returns `None`. A reply can be read until the next call. While the socket is connecting, no bytes move.
///
/// # Errors
///
/// A [`LinkError`] when the connection ended. Connect the socket again and [reset](Client::reset) the client.
pub fn poll_tcp<T: Storage, R: Storage>(
    client: &mut Client<T, R>,
    socket: &mut tcp::Socket<'_>,
    now: Instant,
) -> Result<Option<Event>, LinkError> {
    if matches!(socket.state(), tcp::State::SynSent | tcp::State::SynReceived) {
        return Ok(client.handle_timeout(now));
    }
    send(socket, client.transmit()).map(|count| client.transmitted(count))?;
    loop {
        if let Some(event) = client.poll_event(now) {
            return Ok(Some(event));
        }
        match receive(socket, socket.can_recv().then(|| client.receive_buffer()))? {
            0 => break,
            count => client.received(count),
        }
    }
    let event = client.handle_timeout(now);
    send(socket, client.transmit()).map(|count| client.transmitted(count))?;
    Ok(event)
}

/// Moves a client's datagrams over UDP and returns the next event.
///
/// Call it like [`poll_tcp`]. Datagrams that are not from `peer` are dropped.
///
/// # Errors
///
/// [`LinkError::Unsendable`] when the socket cannot send to the peer at all.
pub fn poll_udp<T: Storage, R: Storage>(
    client: &mut Client<T, R>,
    socket: &mut udp::Socket<'_>,
    peer: IpEndpoint,
    now: Instant,
) -> Result<Option<Event>, LinkError> {
    loop {
        if let Some(event) = client.poll_event(now) {
            return Ok(Some(event));
        }
        if !socket.can_recv() {
            break;
        }
        match socket.recv_slice(client.receive_buffer()) {
            Ok((count, from)) if from.endpoint == peer => client.received(count),
            // from another sender, or longer than any frame
            Ok(_) | Err(udp::RecvError::Truncated) => {}
            Err(udp::RecvError::Exhausted) => break,
        }
    }
    let event = client.handle_timeout(now);
    let bytes = client.transmit();
    if !bytes.is_empty() {
        match socket.send_slice(bytes, peer) {
            Ok(()) => client.transmitted(usize::MAX),
            Err(udp::SendError::BufferFull) if socket.send_queue() > 0 => {}
            Err(_) => return Err(LinkError::Unsendable),
        }
    }
    Ok(event)
}

/// A server on one TCP socket: it listens, serves a connection, and listens again.
///
/// Use several on the same port, with a socket each, to serve several connections concurrently.
///
/// # Examples
///
/// ```
/// use bcap_core::rac::server::{Config, Handler, Session};
/// use bcap_core::time::Instant;
/// use bcap_embassy::bare::TcpServer;
/// use smoltcp::socket::tcp;
///
/// fn serve(
///     server: &mut TcpServer<Session<[u8; 64]>>,
///     socket: &mut tcp::Socket<'_>,
///     handler: &mut impl Handler,
///     now: Instant,
/// ) {
///     server.poll(socket, || Session::new(Config::TCP, [0; 64]), handler, now);
/// }
/// ```
#[derive(Debug)]
pub struct TcpServer<S> {
    port: u16,
    session: Option<S>,
    peer: PeerId,
    /// The increment of the peer number for each connection.
    stride: u32,
}

impl<S> TcpServer<S> {
    /// Creates the server `index`, counted from 0, of `count` servers that share a handler.
    ///
    /// `index` and `count` make the [`PeerId`]s of these servers distinct.
    #[must_use]
    pub const fn new(port: u16, index: u32, count: u32) -> Self {
        Self { port, session: None, peer: PeerId(index), stride: count }
    }

    /// Returns whether a peer is connected.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.session.is_some()
    }

    /// Performs all work that is possible without waiting; `make` creates the session of a new connection.
    ///
    /// Call it after each poll of the interface, and when [`poll_timeout`](Self::poll_timeout) is reached.
    pub fn poll<H>(&mut self, socket: &mut tcp::Socket<'_>, make: impl FnOnce() -> S, handler: &mut H, now: Instant)
    where
        H: ?Sized,
        S: Serve<H>,
    {
        if !socket.is_open() && self.session.is_none() {
            set_up(socket);
            // the only possible error is port 0
            let _ = socket.listen(self.port);
            return;
        }
        if self.session.is_none() && socket.may_send() {
            self.peer = PeerId(self.peer.0.wrapping_add(self.stride));
            self.session = Some(make());
        }
        let Some(session) = &mut self.session else { return };
        if pump(session, socket, handler, self.peer, now).is_err() {
            session.close(handler, self.peer, now);
            self.session = None;
            socket.close();
        }
    }

    /// Returns when [`poll`](Self::poll) must be called if no bytes arrive before.
    #[must_use]
    pub fn poll_timeout<H: ?Sized>(&self) -> Option<Instant>
    where
        S: Serve<H>,
    {
        self.session.as_ref().and_then(Endpoint::poll_timeout)
    }
}

/// A peer over UDP with its session: about 1.6 KiB, and 8 bytes for each of its `OBJECTS`.
pub type UdpPeer<const OBJECTS: usize> = Peer<IpEndpoint, OBJECTS>;

/// A server of b-CAP on one UDP socket, for up to `PEERS` peers with up to `OBJECTS` handles each.
///
/// A peer that was silent for 10 s, or has no service, makes room for another peer. Datagrams that are not b-CAP take no slot
/// and get no answer.
///
/// A request from an address that does not exist delays all replies by up to a second. The image of the gateway drops such
/// packets before smoltcp gets them (`bcap-board`).
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::server::Handler;
/// use bcap_core::time::Instant;
/// use bcap_embassy::bare::UdpServer;
/// use smoltcp::socket::udp;
///
/// fn serve(server: &mut UdpServer<2, 16>, socket: &mut udp::Socket<'_>, handler: &mut impl Handler, now: Instant) {
///     if !socket.is_open() {
///         let _ = socket.bind(5007);
///     }
///     server.poll(socket, handler, now);
/// }
/// ```
#[derive(Debug)]
pub struct UdpServer<const PEERS: usize, const OBJECTS: usize> {
    peers: [Option<UdpPeer<OBJECTS>>; PEERS],
    last: u32,
    stride: u32,
    /// Since when datagrams wait to be sent.
    unsent: Option<Instant>,
}

impl<const PEERS: usize, const OBJECTS: usize> UdpServer<PEERS, OBJECTS> {
    const SLOTS: Slots = Slots { total: PEERS, per_host: usize::MAX, evict_after: Some(UDP_IDLE) };

    /// Creates the server `index`, counted from 0, of `count` servers that share a handler, as [`TcpServer::new`].
    #[must_use]
    pub const fn new(index: u32, count: u32) -> Self {
        Self { peers: [const { None }; PEERS], last: index, stride: count, unsent: None }
    }

    /// Performs all work that is possible without waiting; the caller binds the socket.
    ///
    /// Call it after each poll of the interface, and when [`poll_timeout`](Self::poll_timeout) is reached.
    pub fn poll<H: Handler + ?Sized>(&mut self, socket: &mut udp::Socket<'_>, handler: &mut H, now: Instant) {
        let Self { peers, last, stride, unsent } = self;
        discard_unsent(socket, unsent, now);
        let shared = Shared { handler: RefCell::new(handler), last: Cell::new(*last), stride: *stride };
        run_peers(peers, socket, &shared, now);
        // without room for answers, requests wait in the socket
        while socket.can_recv() && socket.can_send() {
            receive_datagram(peers, socket, (&Self::SLOTS, &shared), now);
            run_peers(peers, socket, &shared, now);
        }
        *last = shared.last.get();
        *unsent = (socket.send_queue() > 0).then(|| unsent.unwrap_or(now));
    }

    /// Returns when [`poll`](Self::poll) must be called if no datagram arrives before.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let unsent = self.unsent.map(|since| since.saturating_add(UNSENT));
        self.peers.iter().flatten().filter_map(Peer::poll_timeout).chain(unsent).min()
    }
}

/// Discards all datagrams of a socket whose unsent ones have waited for [`UNSENT`].
///
/// smoltcp keeps a datagram to an address that it cannot resolve or reach, and sends no other datagram before it, nor within a
/// second after its ARP request. The peers of the discarded datagrams repeat their requests.
fn discard_unsent(socket: &mut udp::Socket<'_>, unsent: &mut Option<Instant>, now: Instant) {
    *unsent = unsent.filter(|_| socket.send_queue() > 0);
    if unsent.is_some_and(|since| now >= since.saturating_add(UNSENT)) {
        *unsent = None;
        let port = socket.endpoint();
        socket.close();
        // the socket was bound to it, and is free now
        let _ = socket.bind(port);
    }
}

/// The handler, and the numbers of the peers, during a poll.
struct Shared<'h, H: ?Sized> {
    handler: RefCell<&'h mut H>,
    last: Cell<u32>,
    stride: u32,
}

impl<H: Handler + ?Sized, const OBJECTS: usize> SharedState<UdpSession<OBJECTS>> for Shared<'_, H> {
    type Address = IpEndpoint;

    fn is_same_host(one: IpEndpoint, other: IpEndpoint) -> bool {
        one.addr == other.addr
    }

    fn connect(&self, _: IpEndpoint) -> PeerId {
        self.last.set(self.last.get().wrapping_add(self.stride));
        PeerId(self.last.get())
    }

    fn step(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) -> bool {
        // a handler has no access to the server, so it is not borrowed twice
        self.handler.try_borrow_mut().is_ok_and(|mut handler| session.run(&mut **handler, peer, now).is_some())
    }

    fn close(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) {
        if let Ok(mut handler) = self.handler.try_borrow_mut() {
            session.close(&mut **handler, peer, now);
        }
    }
}

/// Runs all sessions and sends their replies; a reply without room in the socket waits.
fn run_peers<H: Handler + ?Sized, const OBJECTS: usize>(
    peers: &mut [Option<UdpPeer<OBJECTS>>],
    socket: &mut udp::Socket<'_>,
    shared: &Shared<'_, H>,
    now: Instant,
) {
    for peer in peers.iter_mut().flatten() {
        loop {
            let progressed = peer.step(shared, now);
            if !peer.transmit().is_empty() {
                match socket.send_slice(peer.transmit(), peer.address()) {
                    Err(udp::SendError::BufferFull) if socket.send_queue() > 0 => break,
                    // a reply that cannot be sent at all is lost; its peer repeats the request
                    Ok(()) | Err(_) => peer.transmitted(),
                }
            }
            if !progressed {
                break;
            }
        }
    }
}

/// Passes a datagram to the session of its peer, or refuses a new peer.
fn receive_datagram<H: Handler + ?Sized, const OBJECTS: usize>(
    peers: &mut [Option<UdpPeer<OBJECTS>>],
    socket: &mut udp::Socket<'_>,
    (slots, shared): (&Slots, &Shared<'_, H>),
    now: Instant,
) {
    let Ok((bytes, from)) = socket.recv() else { return };
    if bytes.len() > UDP_RECEIVE_MAX {
        return;
    }
    if let Received::Refused(serial) =
        datagrams::receive(peers, (bytes, from.endpoint), (slots, Config::UDP), shared, now)
    {
        // a lost reply is retransmitted on request
        let _ = socket.send_slice(refusal(serial, &mut [0; REFUSAL]), from.endpoint);
    }
}

/// Moves a session's bytes until neither direction makes progress.
fn pump<S, H>(
    session: &mut S,
    socket: &mut tcp::Socket<'_>,
    handler: &mut H,
    peer: PeerId,
    now: Instant,
) -> Result<(), LinkError>
where
    S: Serve<H>,
    H: ?Sized,
{
    loop {
        while session.run(handler, peer, now).is_some() {}
        let sent = send(socket, session.transmit())?;
        session.transmitted(sent);
        if session.is_finished() {
            return Err(LinkError::Closed);
        }
        let unsent = !session.transmit().is_empty();
        let received = receive(socket, (!unsent).then(|| session.receive_buffer()))?;
        session.received(received);
        if sent == 0 && received == 0 {
            return Ok(());
        }
    }
}

/// Sends as many bytes as fit into the socket's buffer.
fn send(socket: &mut tcp::Socket<'_>, bytes: &[u8]) -> Result<usize, LinkError> {
    if bytes.is_empty() {
        return Ok(0);
    }
    socket.send_slice(bytes).map_err(|_| LinkError::Reset)
}

/// Receives into `room`; without room, only checks the socket's state.
fn receive(socket: &mut tcp::Socket<'_>, room: Option<&mut [u8]>) -> Result<usize, LinkError> {
    socket.recv_slice(room.unwrap_or_default()).map_err(|error| match error {
        RecvError::Finished => LinkError::Closed,
        RecvError::InvalidState => LinkError::Reset,
    })
}

#[cfg(test)]
mod tests;
