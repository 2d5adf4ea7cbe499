//! One transport over any kind of socket.

use std::{fmt, io};

use bcap_core::bcap::Client;
use bcap_core::bcap::client::Config;
use bcap_core::time::Instant;

use super::{Connection, TcpTransport, Transport, UdpTransport, connect_tcp, connect_udp};
use crate::address::{Address, Protocol};
use crate::connect::{ConnectError, STREAM_ROOM};
use crate::settings::Settings;

/// A TCP or UDP socket, or a transport of the user.
pub(super) enum Socket {
    Tcp(TcpTransport),
    Udp(UdpTransport),
    Other(Box<dyn Transport<Error = io::Error> + Send>),
}

impl fmt::Debug for Socket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(tcp) => tcp.fmt(f),
            Self::Udp(udp) => udp.fmt(f),
            Self::Other(_) => f.write_str("Other"),
        }
    }
}

/// Connects with the time limits of the settings.
pub(super) fn connect(address: &Address, settings: &Settings) -> Result<Connection<Socket, Vec<u8>>, ConnectError> {
    let mut options = settings.options;
    options.tcp.timing = settings.service.timing(options.tcp.timing);
    options.udp.timing = settings.service.timing(options.udp.timing);
    let peer = (address.host.as_str(), address.port);
    match address.protocol {
        Protocol::Tcp => Ok(wrap(connect_tcp(peer, &options)?, Socket::Tcp)),
        Protocol::Udp => Ok(wrap(connect_udp(peer, &options)?, Socket::Udp)),
    }
}

/// Combines a stream of the user with a client.
pub(super) fn over(
    stream: impl Transport<Error = io::Error> + Send + 'static,
    settings: &Settings,
) -> Connection<Socket, Vec<u8>> {
    let tcp = settings.options.tcp;
    let config = Config { timing: settings.service.timing(tcp.timing), ..tcp };
    let client = Client::new(config, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM]);
    Connection::new(Socket::Other(Box::new(stream)), client)
}

fn wrap<X: Transport>(connection: Connection<X, Vec<u8>>, socket: fn(X) -> Socket) -> Connection<Socket, Vec<u8>> {
    let (transport, client): (X, Client<Vec<u8>>) = connection.into_parts();
    Connection::new(socket(transport), client)
}

impl Transport for Socket {
    type Error = io::Error;

    fn now(&self) -> Instant {
        match self {
            Self::Other(other) => other.now(),
            Self::Tcp(_) | Self::Udp(_) => crate::now(),
        }
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => tcp.send(bytes, until),
            Self::Udp(udp) => udp.send(bytes, until),
            Self::Other(other) => other.send(bytes, until),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        match self {
            Self::Tcp(tcp) => tcp.receive(buffer, until),
            Self::Udp(udp) => udp.receive(buffer, until),
            Self::Other(other) => other.receive(buffer, until),
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        match self {
            Self::Other(other) => other.sleep_until(at),
            Self::Tcp(_) | Self::Udp(_) => super::sleep_until(at),
        }
    }
}
