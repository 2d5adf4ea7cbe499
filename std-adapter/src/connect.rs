//! How a client connects: options, name resolution, socket settings, and errors.

use std::collections::hash_map::RandomState;
use std::fmt::Debug;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::time::Duration;

use bcap_core::bcap::Client;
use bcap_core::bcap::client::{Config, Timing};
use bcap_core::limits::UDP_RECEIVE_MAX;
use bcap_core::rac;
use socket2::{SockRef, TcpKeepalive};

/// The options of a connection.
///
/// The defaults are the configurations of the core ([`Config::TCP`], [`Config::UDP`], [`Config::SERIAL`]), 3 s to
/// connect, and TCP keep-alive probes after 60 s of silence. The probes detect a peer that has vanished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Options {
    /// The time limit for connecting to each address of a name.
    pub connect_timeout: Duration,
    /// The time limits of TCP calls, and the strictness of decoding.
    pub tcp: Config,
    /// The time limits and attempts of UDP calls.
    pub udp: Config,
    /// The time limits and attempts of calls over a serial line, without the time that the line takes for a request and its
    /// reply.
    pub serial: Config,
    /// The time limit of RAC requests.
    pub rac: rac::client::Config,
    /// The silence on TCP after which the operating system probes the peer; `None` disables probes.
    pub keep_alive: Option<Duration>,
}

setters! { Options {
    connect_timeout: Duration;
    tcp: Config;
    udp: Config;
    serial: Config;
    rac: rac::client::Config;
    keep_alive: Option<Duration>;
} }

impl Default for Options {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(3),
            tcp: Config::TCP,
            udp: Config::UDP,
            serial: Config::SERIAL,
            rac: rac::client::Config::TCP,
            keep_alive: Some(Duration::from_secs(60)),
        }
    }
}

impl Options {
    /// Returns these options with `timeout` for connecting, for each attempt of a call, and for RAC requests.
    #[must_use]
    pub const fn timeout(self, timeout: Duration) -> Self {
        Self {
            connect_timeout: timeout,
            tcp: Config { timing: Timing { attempt_timeout: timeout, ..self.tcp.timing }, ..self.tcp },
            udp: Config { timing: Timing { attempt_timeout: timeout, ..self.udp.timing }, ..self.udp },
            serial: Config { timing: Timing { attempt_timeout: timeout, ..self.serial.timing }, ..self.serial },
            rac: rac::client::Config { timeout },
            ..self
        }
    }

    /// Creates a client for TCP.
    pub(crate) fn tcp_client(&self) -> Client<Vec<u8>> {
        Client::new(self.tcp, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM])
    }

    /// Creates a client for UDP.
    pub(crate) fn udp_client(&self) -> Client<Vec<u8>> {
        let mut client = Client::new(self.udp, vec![0; DATAGRAM_ROOM], vec![0; DATAGRAM_ROOM]);
        client.set_next_serial(random_serial());
        client
    }

    /// Creates a RAC client.
    pub(crate) fn rac_client(&self) -> rac::Client<[u8; rac::MAX_VALUE]> {
        rac::Client::new(self.rac, [0; rac::MAX_VALUE])
    }
}

/// Why a connection was not established.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The name has no address, or its resolution failed.
    #[error("cannot resolve the address {name}")]
    Resolve {
        /// The name, as the caller gave it.
        name: String,
        /// The resolver's error.
        source: io::Error,
    },
    /// No address of the name accepted the connection; this is the error of the last address.
    #[error("cannot connect to {address}")]
    Connect {
        /// The last address.
        address: SocketAddr,
        /// The operating system's error.
        source: io::Error,
    },
    /// An option of the socket could not be set.
    #[error("cannot set up the socket")]
    Setup(#[source] io::Error),
    /// The device of a serial line could not be opened or set up.
    #[error("cannot open the serial line {path}")]
    Serial {
        /// The device.
        path: String,
        /// The operating system's error.
        source: io::Error,
    },
    /// This build has no serial lines.
    #[error("cannot open the serial line {path}: enable the feature `serial` of bcap-std")]
    NoSerial {
        /// The device.
        path: String,
    },
}

impl ConnectError {
    /// Returns the text with the error of the operating system.
    pub(crate) fn in_full(&self) -> String {
        match self {
            Self::Resolve { source, .. }
            | Self::Connect { source, .. }
            | Self::Setup(source)
            | Self::Serial { source, .. } => format!("{self}: {source}"),
            Self::NoSerial { .. } => self.to_string(),
        }
    }

    /// Returns whether the peer did not answer in time.
    #[must_use]
    pub fn is_timeout(&self) -> bool {
        matches!(self, Self::Connect { source, .. } if source.kind() == io::ErrorKind::TimedOut)
    }
}

/// Keeps the kind of the error of the operating system, and writes both errors in one line.
impl From<ConnectError> for io::Error {
    fn from(error: ConnectError) -> Self {
        let kind = match &error {
            ConnectError::Resolve { source, .. }
            | ConnectError::Connect { source, .. }
            | ConnectError::Setup(source)
            | ConnectError::Serial { source, .. } => source.kind(),
            ConnectError::NoSerial { .. } => io::ErrorKind::Unsupported,
        };
        Self::new(kind, error.in_full())
    }
}

/// Resolves a name and tries its addresses in turn.
pub(crate) fn first_address<A: ToSocketAddrs + Debug, T>(
    name: A,
    mut connect: impl FnMut(SocketAddr) -> io::Result<T>,
) -> Result<T, ConnectError> {
    let text = host_and_port(&name);
    let unresolved = |source| ConnectError::Resolve { name: text.clone(), source };
    let mut last = None;
    for address in name.to_socket_addrs().map_err(unresolved)? {
        match connect(address) {
            Ok(connected) => return Ok(connected),
            Err(source) => last = Some(ConnectError::Connect { address, source }),
        }
    }
    Err(last.unwrap_or_else(|| unresolved(no_address())))
}

/// Returns the text of a name for errors: `robot.local:5007` for `("robot.local", 5007)`.
pub(crate) fn host_and_port(name: &impl Debug) -> String {
    format!("{name:?}").replace("\", ", ":").replace(['(', ')', '"'], "")
}

pub(crate) fn no_address() -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, "the name has no address")
}

/// Connects a TCP stream and configures it for short messages.
pub(crate) fn tcp<A: ToSocketAddrs + Debug>(name: A, options: &Options) -> Result<TcpStream, ConnectError> {
    let stream = first_address(name, |address| TcpStream::connect_timeout(&address, options.connect_timeout))?;
    set_up_tcp(SockRef::from(&stream), options.keep_alive).map_err(ConnectError::Setup)?;
    Ok(stream)
}

/// Configures a TCP socket for short messages: `TCP_NODELAY`, and keep-alive probes of a silent peer.
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

/// Creates a connected UDP socket: the operating system drops datagrams of other peers.
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

/// Creates a client for a serial line.
#[cfg(feature = "serial")]
pub(crate) fn serial_client(config: Config) -> Client<Vec<u8>> {
    let mut client = Client::new(config, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM]);
    client.set_next_serial(random_serial());
    client
}

/// The buffer for one datagram: one byte more than the limit, so that a longer datagram is detected.
pub(crate) const DATAGRAM_ROOM: usize = UDP_RECEIVE_MAX + 1;
/// The initial buffer of a stream's client; it grows with its frames.
pub(crate) const STREAM_ROOM: usize = 1024;

/// Returns an unpredictable serial for the first call over UDP, so that replies are hard to forge.
pub(crate) fn random_serial() -> u16 {
    // the standard library seeds its hash maps with random keys
    let random = RandomState::new().build_hasher().finish();
    u16::try_from(random % u64::from(u16::MAX)).unwrap_or(0) + 1
}
