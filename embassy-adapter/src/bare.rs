//! Clients and servers for smoltcp alone: whoever polls the interface polls these, and nothing is awaited.
//!
//! ```text
//!   loop { interface.poll ─► poll_tcp, poll_udp, TcpServer::poll ─► interface.poll ─► sleep }
//! ```
//!
//! A client is the core's [`Client`], a server the core's sessions; the functions here carry their bytes to and from a
//! socket of smoltcp. The sockets, and their memory, are the caller's.
//!
//! # Examples
//!
//! A loop that reads a variable again and again:
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

use core::fmt;

use bcap_core::bcap::Client;
use bcap_core::bcap::client::Event;
use bcap_core::handler::PeerId;
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use smoltcp::socket::tcp::{self, RecvError};
use smoltcp::socket::udp;
use smoltcp::wire::IpEndpoint;

use bcap_core::endpoint::Endpoint;
pub use bcap_core::endpoint::Serve;

/// The silence after which a peer is asked whether it is still there.
const KEEP_ALIVE: smoltcp::time::Duration = smoltcp::time::Duration::from_secs(5);
/// How long a peer may leave that, or data, without an acknowledgement.
const LOST: smoltcp::time::Duration = smoltcp::time::Duration::from_secs(15);

/// Why a connection cannot be used any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LinkError {
    /// The peer has closed the connection in order.
    Closed,
    /// The peer refused or reset the connection, or vanished.
    Reset,
    /// The request does not fit the socket's memory, or the peer has no address.
    Unsendable,
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Closed => "the peer has closed the connection",
            Self::Reset => "the connection was refused, reset or lost",
            Self::Unsendable => "the datagram does not fit the socket or has no destination",
        })
    }
}

impl core::error::Error for LinkError {}

/// Returns a point in time as smoltcp counts it.
#[must_use]
pub fn to_smoltcp(now: Instant) -> smoltcp::time::Instant {
    smoltcp::time::Instant::from_micros(i64::try_from(now.as_micros()).unwrap_or(i64::MAX))
}

/// Sets a TCP socket up for short messages: no delay, and a peer that vanished is noticed after 15 s.
pub fn set_up(socket: &mut tcp::Socket<'_>) {
    socket.set_nagle_enabled(false);
    socket.set_keep_alive(Some(KEEP_ALIVE));
    socket.set_timeout(Some(LOST));
}

/// Moves the bytes of a client over TCP, and returns the next thing that has happened.
///
/// It is to be called until it returns `None`, whenever the interface was polled, and when the client's
/// [`poll_timeout`](Client::poll_timeout) is due. A reply can be looked at until it is called again. While the socket
/// is still connecting nothing happens.
///
/// # Errors
///
/// A [`LinkError`] when the connection is over; the socket is to be connected again, and the client to be
/// [reset](Client::reset).
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

/// Moves the datagrams of a client over UDP, and returns the next thing that has happened.
///
/// It is to be called like [`poll_tcp`]. Datagrams from others than `peer` are dropped.
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
            // from a stranger, or longer than any frame
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
/// For more connections at the same time there are more of these on the same port, with a socket each.
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
    /// What the numbers of peers grow by.
    stride: u32,
}

impl<S> TcpServer<S> {
    /// Makes a server for a port; it is number `index` of `count` servers of the same handler, counted from 0.
    ///
    /// The two keep the peers of several servers apart.
    #[must_use]
    pub const fn new(port: u16, index: u32, count: u32) -> Self {
        Self { port, session: None, peer: PeerId(index), stride: count }
    }

    /// Tells whether a peer is connected.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        self.session.is_some()
    }

    /// Goes on as far as it can; a new connection has a session of `make`.
    ///
    /// It is to be called whenever the interface was polled, and when [`poll_timeout`](Self::poll_timeout) is due.
    pub fn poll<H>(&mut self, socket: &mut tcp::Socket<'_>, make: impl FnOnce() -> S, handler: &mut H, now: Instant)
    where
        H: ?Sized,
        S: Serve<H>,
    {
        if !socket.is_open() && self.session.is_none() {
            set_up(socket);
            // a port that is 0 is the only error there is
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

    /// Returns when [`poll`](Self::poll) is to be called even if no bytes come.
    #[must_use]
    pub fn poll_timeout<H: ?Sized>(&self) -> Option<Instant>
    where
        S: Serve<H>,
    {
        self.session.as_ref().and_then(Endpoint::poll_timeout)
    }
}

/// Moves the bytes of a session until nothing moves.
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

/// Gives a socket as much as it takes.
fn send(socket: &mut tcp::Socket<'_>, bytes: &[u8]) -> Result<usize, LinkError> {
    if bytes.is_empty() {
        return Ok(0);
    }
    socket.send_slice(bytes).map_err(|_| LinkError::Reset)
}

/// Takes what a socket has; without room only its state is looked at.
fn receive(socket: &mut tcp::Socket<'_>, room: Option<&mut [u8]>) -> Result<usize, LinkError> {
    socket.recv_slice(room.unwrap_or_default()).map_err(|error| match error {
        RecvError::Finished => LinkError::Closed,
        RecvError::InvalidState => LinkError::Reset,
    })
}

#[cfg(test)]
mod tests;
