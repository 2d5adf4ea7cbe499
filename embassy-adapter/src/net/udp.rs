//! An embassy-net UDP socket with one peer as a transport.

use core::fmt;

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_net::udp::{BindError, RecvError, SendError, UdpSocket};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::Timer;

use super::NetError;
use super::link::wait;
use crate::clock::{now, ticks};

/// A UDP socket with one peer as a transport; datagrams from other senders are dropped.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::client::Config;
/// use bcap_core::bcap::{Client, call};
/// use bcap_core::io::CallError;
/// use bcap_embassy::net::{Connection, NetError, UdpTransport};
/// use embassy_net::udp::{PacketMetadata, UdpSocket};
/// use embassy_net::{IpEndpoint, Stack};
///
/// async fn start(stack: Stack<'_>, robot: IpEndpoint) -> Result<(), CallError<NetError>> {
///     let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
///     let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
///     let socket = UdpSocket::new(stack, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
///     let transport = UdpTransport::new(stack, socket, robot).map_err(CallError::Io)?;
///     let (mut request, mut reply) = ([0; 488], [0; 505]);
///     let mut robot = Connection::new(transport, Client::new(Config::UDP, &mut request[..], &mut reply[..]));
///     robot.call(call::service_start("WDT=400")).await
/// }
/// ```
pub struct UdpTransport<'s> {
    stack: Stack<'s>,
    socket: UdpSocket<'s>,
    peer: IpEndpoint,
}

impl<'s> UdpTransport<'s> {
    /// Wraps a socket; binds it to a free port if it is not bound yet.
    ///
    /// # Errors
    ///
    /// [`NetError::NoRoute`] when the board has no address to bind to.
    pub fn new(stack: Stack<'s>, mut socket: UdpSocket<'s>, peer: impl Into<IpEndpoint>) -> Result<Self, NetError> {
        if !socket.is_open() {
            socket.bind(0).map_err(|error| match error {
                BindError::NoRoute => NetError::NoRoute,
                BindError::InvalidState => NetError::Reset,
            })?;
        }
        Ok(Self { stack, socket, peer: peer.into() })
    }

    /// Returns the socket.
    pub const fn socket(&mut self) -> &mut UdpSocket<'s> {
        &mut self.socket
    }

    /// [Discards](discard) the datagrams of its socket.
    pub(crate) fn discard(&mut self) {
        discard(&mut self.socket);
    }
}

/// Discards the datagrams that were not sent yet, for example because the address of the peer is not resolved, and those that
/// were not received yet. The port stays.
pub fn discard(socket: &mut UdpSocket<'_>) {
    let port = socket.endpoint();
    socket.close();
    // the socket was bound to it, and is free now
    let _ = socket.bind(port);
}

impl fmt::Debug for UdpTransport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("UdpTransport").field("peer", &self.peer).finish_non_exhaustive()
    }
}

impl Transport for UdpTransport<'_> {
    type Error = NetError;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, NetError> {
        let sent = wait(self.stack, until, self.socket.send_to(bytes, self.peer)).await?;
        match sent {
            Some(Ok(())) => Ok(Some(bytes.len())),
            Some(Err(error)) => Err(from_send_error(error)),
            None => Ok(None),
        }
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, NetError> {
        loop {
            match wait(self.stack, until, self.socket.recv_from(buffer)).await? {
                Some(Ok((count, from))) if from.endpoint == self.peer => return Ok(Some(count)),
                // from another sender, or longer than any frame: not a reply
                Some(Ok(_) | Err(RecvError::Truncated)) => {}
                None => return Ok(None),
            }
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        Timer::at(ticks(at)).await;
    }
}

pub(crate) const fn from_send_error(error: SendError) -> NetError {
    match error {
        SendError::NoRoute => NetError::NoRoute,
        SendError::SocketNotBound => NetError::Reset,
        SendError::PacketTooLarge => NetError::TooLarge,
    }
}
