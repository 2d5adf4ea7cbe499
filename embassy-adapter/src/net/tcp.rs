//! A TCP socket of embassy-net as a transport.

use core::fmt;
#[cfg(feature = "server")]
use core::future::poll_fn;
#[cfg(feature = "server")]
use core::pin::pin;
#[cfg(feature = "server")]
use core::task::{Context, Poll, Waker};

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
#[cfg(feature = "server")]
use embassy_futures::select::select;
#[cfg(feature = "server")]
use embassy_net::IpAddress;
#[cfg(feature = "server")]
use embassy_net::tcp::State;
use embassy_net::tcp::{ConnectError, TcpSocket};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::{Duration, Timer, with_timeout};

use super::link::{is_down, wait};
#[cfg(feature = "server")]
use super::{Backlog, Place, evicted};
use super::{NetError, Usage};
use crate::clock::{now, ticks};

/// The timeouts of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Options {
    /// Time limit of connecting, and of the handshake of a client.
    pub connect_timeout: Duration,
    /// The time without traffic after which a TCP keep-alive is sent.
    pub keep_alive: Duration,
    /// The time without an acknowledgement, of data or of a keep-alive, after which the connection is reset.
    ///
    /// smoltcp retransmits after one second at the earliest, so less than 3 s breaks good connections.
    pub lost: Duration,
    /// Where the use of the buffers is counted, if anywhere.
    pub usage: Option<&'static Usage>,
    /// The listeners of a port, if there are several on it.
    #[cfg(feature = "server")]
    pub backlog: Option<&'static Backlog>,
}

impl Default for Options {
    /// 3 s to connect, a keep-alive after 5 s, a reset after 15 s without an acknowledgement; the use of buffers is not
    /// counted.
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(3),
            keep_alive: Duration::from_secs(5),
            lost: Duration::from_secs(15),
            usage: None,
            #[cfg(feature = "server")]
            backlog: None,
        }
    }
}

/// The number and interval of the checks whether a socket has sent its reset.
const RESET_TRIES: u32 = 100;
const RESET_INTERVAL: Duration = Duration::from_millis(1);

/// A socket that connects; dropping this aborts the handshake.
struct Handshake<'a, 's>(&'a mut TcpSocket<'s>);

impl Drop for Handshake<'_, '_> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// A TCP socket as a transport; it can be connected again and again.
pub struct TcpTransport<'s> {
    stack: Stack<'s>,
    socket: TcpSocket<'s>,
    options: Options,
}

impl<'s> TcpTransport<'s> {
    /// Creates a transport that is not connected; `rx` and `tx` are the socket's buffers.
    ///
    /// embassy-net panics when the stack's `StackResources` have no free socket.
    #[must_use]
    pub fn new(stack: Stack<'s>, rx: &'s mut [u8], tx: &'s mut [u8], options: Options) -> Self {
        Self { stack, socket: TcpSocket::new(stack, rx, tx), options }
    }

    /// Connects to a peer; resets an earlier connection.
    ///
    /// Also [reset](bcap_core::bcap::Client::reset) the client that uses the transport.
    ///
    /// # Errors
    ///
    /// A [`NetError`] when connecting fails.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future leaves the transport not connected.
    pub async fn connect(&mut self, peer: impl Into<IpEndpoint>) -> Result<(), NetError> {
        if is_down(self.stack) {
            return Err(NetError::Down);
        }
        self.reset().await;
        let handshake = Handshake(&mut self.socket);
        let connected = with_timeout(self.options.connect_timeout, handshake.0.connect(peer.into())).await;
        let result = match connected {
            Ok(Ok(())) => Ok(()),
            Ok(Err(ConnectError::NoRoute)) => Err(NetError::NoRoute),
            Ok(Err(ConnectError::TimedOut)) | Err(_) => Err(NetError::Timeout),
            Ok(Err(ConnectError::ConnectionReset | ConnectError::InvalidState)) => Err(NetError::Reset),
        };
        result?;
        core::mem::forget(handshake);
        self.set_up();
        Ok(())
    }

    /// Waits for a peer to connect to `port`, and returns its slot in the backlog, marked as unfinished.
    ///
    /// A handshake that takes longer than [`Options::connect_timeout`], or that makes room for another, is aborted.
    ///
    /// # Errors
    ///
    /// A [`NetError`] when the port is 0.
    ///
    /// # Cancel safety
    ///
    /// After the future is dropped, the next use of the transport resets a peer that is just connecting.
    #[cfg(feature = "server")]
    pub(crate) async fn accept(&mut self, port: u16) -> Result<Option<Place>, NetError> {
        self.reset().await;
        loop {
            let place = self.options.backlog.and_then(Backlog::join);
            self.listen(port)?;
            self.leaves(State::Listen).await;
            if let Some(place) = &place {
                place.begin(self.peer_address());
            }
            let handshake = select(self.leaves(State::SynReceived), evicted(place.as_ref()));
            let _ = with_timeout(self.options.connect_timeout, handshake).await;
            // a reset by the peer makes it listen again
            if !matches!(self.socket.state(), State::Listen | State::SynReceived | State::Closed) {
                self.set_up();
                if let Some(place) = &place {
                    place.connected(self.peer_address());
                }
                return Ok(place);
            }
            // not a reset of the transport: the peer may not exist, and the listener would wait for it
            self.socket.abort();
        }
    }

    #[cfg(feature = "server")]
    fn peer_address(&self) -> Option<IpAddress> {
        self.socket.remote_endpoint().map(|peer| peer.addr)
    }

    /// Starts to listen.
    #[cfg(feature = "server")]
    fn listen(&mut self, port: u16) -> Result<(), NetError> {
        // the first poll of the future listens; its end does not say how a handshake went
        match pin!(self.socket.accept(port)).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(Err(_)) => Err(NetError::Reset),
            _ => Ok(()),
        }
    }

    /// Waits until the socket leaves a state in which it cannot send.
    #[cfg(feature = "server")]
    async fn leaves(&self, state: State) {
        poll_fn(|cx| match self.socket.state() == state {
            // registers the task for changes of the state
            true => pin!(self.socket.wait_write_ready()).poll(cx),
            false => Poll::Ready(()),
        })
        .await;
    }

    /// Closes the connection after the sent bytes are acknowledged; resets it after [`Options::connect_timeout`].
    ///
    /// # Cancel safety
    ///
    /// After the future is dropped, the connection continues to close.
    pub async fn close(&mut self) {
        self.socket.close();
        if with_timeout(self.options.connect_timeout, self.socket.flush()).await.is_err() {
            self.socket.abort();
        }
    }

    /// Resets the connection, if there is one, and waits until the reset was sent to the peer.
    ///
    /// A socket that is reused immediately would never send the reset, and the peer would keep its end until it probes.
    pub(crate) async fn reset(&mut self) {
        self.socket.abort();
        // checked repeatedly, because smoltcp wakes no task after a reset; without a route to the peer it cannot be sent
        for _ in 0..RESET_TRIES {
            if with_timeout(RESET_INTERVAL, self.socket.flush()).await.is_ok() {
                return;
            }
        }
    }

    /// Returns the socket.
    pub const fn socket(&mut self) -> &mut TcpSocket<'s> {
        &mut self.socket
    }

    fn set_up(&mut self) {
        // a request is one segment and must be sent immediately
        self.socket.set_nagle_enabled(false);
        self.socket.set_keep_alive(Some(self.options.keep_alive));
        self.socket.set_timeout(Some(self.options.lost));
    }
}

impl fmt::Debug for TcpTransport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TcpTransport").field("options", &self.options).finish_non_exhaustive()
    }
}

impl Transport for TcpTransport<'_> {
    type Error = NetError;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, NetError> {
        let sent = wait(self.stack, until, self.socket.write(bytes)).await?;
        if let Some(usage) = self.options.usage {
            usage.has_sent(self.socket.send_queue());
        }
        sent.transpose().map_err(|_| NetError::Reset)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, NetError> {
        let received = wait(self.stack, until, self.socket.read(buffer)).await?;
        if let (Some(usage), Some(Ok(count))) = (self.options.usage, received) {
            usage.has_received(self.socket.recv_queue().saturating_add(count));
        }
        received.transpose().map_err(|_| NetError::Reset)
    }

    async fn sleep_until(&mut self, at: Instant) {
        Timer::at(ticks(at)).await;
    }
}
