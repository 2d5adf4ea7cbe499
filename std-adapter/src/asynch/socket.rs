//! One transport over any kind of socket.

use std::pin::Pin;
use std::{fmt, io};

use bcap_core::bcap::Client;
use bcap_core::time::Instant;
use socket2::SockRef;
use tokio::net::TcpStream;

#[cfg(feature = "serial")]
use super::SerialTransport;
use super::{Connection, SendTransport, TcpTransport, Transport, UdpTransport, connect_tcp, connect_udp};
use crate::CallError;
use crate::address::{Address, NetworkAddress, Protocol};
use crate::blocking::socket::Blocking;
use crate::connect::ConnectError;
use crate::settings::Settings;

/// A TCP or UDP socket, a serial line, or a transport of the user.
pub(crate) enum Socket {
    Tcp(TcpTransport),
    Udp(UdpTransport),
    #[cfg(feature = "serial")]
    Serial(SerialTransport),
    Other(Box<dyn Boxed>),
}

/// A client over a [`Socket`].
pub(super) type SocketConnection = Connection<Socket, Vec<u8>>;

/// A future of a [`Boxed`] transport, and of a function of a session.
pub(super) type BoxFuture<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// A [`SendTransport`] as a trait object.
pub(crate) trait Boxed: Send + Sync {
    fn now(&self) -> Instant;
    fn send<'a>(&'a mut self, bytes: &'a [u8], until: Instant) -> BoxFuture<'a, io::Result<Option<usize>>>;
    fn receive<'a>(&'a mut self, buffer: &'a mut [u8], until: Instant) -> BoxFuture<'a, io::Result<Option<usize>>>;
    fn sleep_until(&mut self, at: Instant) -> BoxFuture<'_, ()>;
}

impl<X: SendTransport<Error = io::Error> + Send + Sync> Boxed for X {
    fn now(&self) -> Instant {
        SendTransport::now(self)
    }

    fn send<'a>(&'a mut self, bytes: &'a [u8], until: Instant) -> BoxFuture<'a, io::Result<Option<usize>>> {
        Box::pin(SendTransport::send(self, bytes, until))
    }

    fn receive<'a>(&'a mut self, buffer: &'a mut [u8], until: Instant) -> BoxFuture<'a, io::Result<Option<usize>>> {
        Box::pin(SendTransport::receive(self, buffer, until))
    }

    fn sleep_until(&mut self, at: Instant) -> BoxFuture<'_, ()> {
        Box::pin(SendTransport::sleep_until(self, at))
    }
}

impl fmt::Debug for Socket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(tcp) => tcp.fmt(f),
            Self::Udp(udp) => udp.fmt(f),
            #[cfg(feature = "serial")]
            Self::Serial(line) => line.fmt(f),
            Self::Other(_) => f.write_str("Other"),
        }
    }
}

/// Connects with the time limits of the settings.
pub(super) async fn connect(address: &Address, settings: &Settings) -> Result<SocketConnection, ConnectError> {
    let options = settings.socket_options();
    match address {
        Address::Network(NetworkAddress { protocol, host, port }) => {
            let peer = (host.as_str(), *port);
            match protocol {
                Protocol::Tcp => Ok(wrap(connect_tcp(peer, &options).await?, Socket::Tcp)),
                Protocol::Udp => Ok(wrap(connect_udp(peer, &options).await?, Socket::Udp)),
            }
        }
        #[cfg(feature = "serial")]
        Address::Serial(line) => Ok(wrap(super::connect_serial(line, &options)?, Socket::Serial)),
        #[cfg(not(feature = "serial"))]
        Address::Serial(line) => Err(ConnectError::NoSerial { path: line.path.clone() }),
    }
}

/// Combines a stream of the user with a client.
pub(super) fn over(
    stream: impl SendTransport<Error = io::Error> + Send + Sync + 'static,
    settings: &Settings,
) -> SocketConnection {
    Connection::new(Socket::Other(Box::new(stream)), settings.socket_options().tcp_client())
}

fn wrap<X: Transport>(connection: Connection<X, Vec<u8>>, socket: fn(X) -> Socket) -> SocketConnection {
    let (transport, client): (X, Client<Vec<u8>>) = connection.into_parts();
    Connection::new(socket(transport), client)
}

impl Socket {
    /// Returns the same connection with calls that block, for the end of a session whose runtime has ended. `None` for a stream of
    /// the caller, and if the operating system refuses.
    pub(super) fn into_blocking(self, address: Option<&Address>) -> Option<Blocking> {
        let blocking = match self {
            Self::Tcp(tcp) => {
                let stream = std::net::TcpStream::from(SockRef::from(tcp.stream()).try_clone().ok()?);
                stream.set_nonblocking(false).ok()?;
                Blocking::new(crate::blocking::TcpTransport::new(stream))
            }
            Self::Udp(udp) => {
                let socket = std::net::UdpSocket::from(SockRef::from(udp.socket()).try_clone().ok()?);
                socket.set_nonblocking(false).ok()?;
                Blocking::new(crate::blocking::UdpTransport::new(socket))
            }
            #[cfg(feature = "serial")]
            Self::Serial(port) => {
                // this process has the device for itself
                drop(port);
                let Some(Address::Serial(line)) = address else { return None };
                let connection = crate::blocking::connect_serial(line, &crate::Options::default()).ok()?;
                Blocking::new(connection.into_parts().0)
            }
            Self::Other(_) => return None,
        };
        let _ = address;
        Some(blocking)
    }

    /// Waits until `at`, or indefinitely; returns the error if the connection is lost during the wait.
    pub(super) async fn idle_until(&mut self, at: Option<Instant>) -> Option<CallError> {
        let waited = async |socket: Option<&mut Self>| match (at, socket) {
            (Some(at), Some(socket)) => SendTransport::sleep_until(socket, at).await,
            (Some(at), None) => tokio::time::sleep(crate::clock::until(at)).await,
            (None, _) => std::future::pending().await,
        };
        match self {
            Self::Tcp(tcp) => tokio::select! {
                error = lost(tcp.stream()) => Some(error),
                () = waited(None) => None,
            },
            #[cfg(feature = "serial")]
            Self::Serial(line) => tokio::select! {
                () = line.unplugged() => Some(CallError::Disconnected),
                () = waited(None) => None,
            },
            Self::Udp(_) | Self::Other(_) => {
                waited(Some(self)).await;
                None
            }
        }
    }
}

/// Waits until the peer closes the stream, or the stream fails, which can happen between two calls.
async fn lost(stream: &TcpStream) -> CallError {
    loop {
        match stream.peek(&mut [0]).await {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return CallError::Io(error),
            Ok(0) => return CallError::Disconnected,
            // bytes without a request, which the next call drops
            Ok(_) => std::future::pending().await,
        }
    }
}

impl SendTransport for Socket {
    type Error = io::Error;

    fn now(&self) -> Instant {
        match self {
            Self::Other(other) => other.now(),
            _ => crate::now(),
        }
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => SendTransport::send(tcp, bytes, until).await,
            Self::Udp(udp) => SendTransport::send(udp, bytes, until).await,
            #[cfg(feature = "serial")]
            Self::Serial(line) => SendTransport::send(line, bytes, until).await,
            Self::Other(other) => other.send(bytes, until).await,
        }
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => SendTransport::receive(tcp, buffer, until).await,
            Self::Udp(udp) => SendTransport::receive(udp, buffer, until).await,
            #[cfg(feature = "serial")]
            Self::Serial(line) => SendTransport::receive(line, buffer, until).await,
            Self::Other(other) => other.receive(buffer, until).await,
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        match self {
            Self::Other(other) => other.sleep_until(at).await,
            _ => tokio::time::sleep(crate::clock::until(at)).await,
        }
    }
}
