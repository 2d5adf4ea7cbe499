//! How a client reaches its peer: options, names, addresses and errors.

use std::collections::hash_map::RandomState;
use std::fmt::Debug;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::time::Duration;

use bcap_core::bcap::client::{Config, Timing};
use bcap_core::limits::UDP_RECEIVE_MAX;
use socket2::{SockRef, TcpKeepalive};

/// How to connect.
///
/// The defaults are those of the core ([`Config::TCP`], [`Config::UDP`]), 3 s to connect, and keep-alive probes after
/// 60 s of silence, which detect a peer that has disappeared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// How long connecting may take for each address of a name.
    pub connect_timeout: Duration,
    /// The time limits of TCP calls and the strictness of the client.
    pub tcp: Config,
    /// The time limits and attempts of UDP calls.
    pub udp: Config,
    /// The time limit of requests over RAC.
    pub rac: bcap_core::rac::client::Config,
    /// The silence on TCP after which the operating system probes the peer; `None` never does.
    pub keep_alive: Option<Duration>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(3),
            tcp: Config::TCP,
            udp: Config::UDP,
            rac: bcap_core::rac::client::Config::TCP,
            keep_alive: Some(Duration::from_secs(60)),
        }
    }
}

impl Options {
    /// Returns options with this time limit for connecting and for each attempt of a call.
    #[must_use]
    pub const fn timeout(self, timeout: Duration) -> Self {
        Self {
            connect_timeout: timeout,
            tcp: Config { timing: Timing { attempt_timeout: timeout, ..self.tcp.timing }, ..self.tcp },
            udp: Config { timing: Timing { attempt_timeout: timeout, ..self.udp.timing }, ..self.udp },
            rac: bcap_core::rac::client::Config { timeout },
            ..self
        }
    }
}

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The name has no address or could not be looked up.
    #[error("the address {name} cannot be found")]
    Resolve {
        /// The name.
        name: String,
        /// The error of the look-up.
        source: io::Error,
    },
    /// No address of the name accepted the connection; the error is that of the last one.
    #[error("cannot connect to {address}")]
    Connect {
        /// The last address.
        address: SocketAddr,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An option of the socket could not be set.
    #[error("cannot set up the socket")]
    Setup(#[source] io::Error),
}

impl ConnectError {
    /// Tells whether the peer did not answer in time.
    #[must_use]
    pub fn is_timeout(&self) -> bool {
        matches!(self, Self::Connect { source, .. } if source.kind() == io::ErrorKind::TimedOut)
    }
}

/// Keeps the kind of the error of the operating system, and writes both errors in one line.
impl From<ConnectError> for io::Error {
    fn from(error: ConnectError) -> Self {
        let (ConnectError::Resolve { source, .. } | ConnectError::Connect { source, .. } | ConnectError::Setup(source)) =
            &error;
        Self::new(source.kind(), format!("{error}: {source}"))
    }
}

/// Looks a name up and tries its addresses in turn.
pub(crate) fn first_address<A: ToSocketAddrs + Debug, T>(
    name: A,
    mut connect: impl FnMut(SocketAddr) -> io::Result<T>,
) -> Result<T, ConnectError> {
    let written = format!("{name:?}");
    let unresolved = |source| ConnectError::Resolve { name: written.clone(), source };
    let mut last = None;
    for address in name.to_socket_addrs().map_err(unresolved)? {
        match connect(address) {
            Ok(connected) => return Ok(connected),
            Err(source) => last = Some(ConnectError::Connect { address, source }),
        }
    }
    Err(last.unwrap_or_else(|| unresolved(no_address())))
}

pub(crate) fn no_address() -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, "the name has no address")
}

/// Connects a TCP stream and sets it up for short messages.
pub(crate) fn tcp<A: ToSocketAddrs + Debug>(name: A, options: &Options) -> Result<TcpStream, ConnectError> {
    let stream = first_address(name, |address| TcpStream::connect_timeout(&address, options.connect_timeout))?;
    set_up_tcp(SockRef::from(&stream), options.keep_alive).map_err(ConnectError::Setup)?;
    Ok(stream)
}

/// Sets up a TCP socket for short messages: no delay, and probes of a silent peer.
pub(crate) fn set_up_tcp(socket: SockRef<'_>, keep_alive: Option<Duration>) -> io::Result<()> {
    socket.set_tcp_nodelay(true)?;
    match keep_alive {
        Some(time) => {
            let probes = TcpKeepalive::new().with_time(time).with_interval(time.min(Duration::from_secs(10)));
            socket.set_tcp_keepalive(&probes)
        }
        None => socket.set_keepalive(false),
    }
}

/// Makes a UDP socket for one peer: the operating system drops datagrams of other addresses.
pub(crate) fn udp<A: ToSocketAddrs + Debug>(name: A) -> Result<UdpSocket, ConnectError> {
    first_address(name, |address| {
        let any: SocketAddr = if address.is_ipv4() {
            (std::net::Ipv4Addr::UNSPECIFIED, 0).into()
        } else {
            (std::net::Ipv6Addr::UNSPECIFIED, 0).into()
        };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        Ok(socket)
    })
}

/// Memory for one datagram: one byte above the limit, to detect longer datagrams.
pub(crate) const DATAGRAM_ROOM: usize = UDP_RECEIVE_MAX + 1;
/// The first memory of a stream's client, which grows with its frames.
pub(crate) const STREAM_ROOM: usize = 1024;

/// Returns an unpredictable serial for the first call over UDP.
pub(crate) fn random_serial() -> u16 {
    // the keys of the standard library's hash maps are random
    let random = RandomState::new().build_hasher().finish();
    u16::try_from(random % u64::from(u16::MAX)).unwrap_or(0) + 1
}
