//! The common part of the commands that listen.

use std::net::SocketAddr;
use std::{fmt, io};

use bcap_std::Protocol;
use tokio::net::TcpListener;
use tokio::runtime::{self, Runtime};

use crate::failure::Failure;

/// Makes the runtime of a command that serves: one thread is enough for a controller or a gateway.
pub(crate) fn runtime() -> io::Result<Runtime> {
    runtime::Builder::new_current_thread().enable_all().build()
}

/// Parses `[tcp:|udp:]IP:PORT`, an address to listen on.
pub(crate) fn address(text: &str) -> Result<(Protocol, SocketAddr), String> {
    let (protocol, address) = match text.split_once(':') {
        Some(("tcp", rest)) => (Protocol::Tcp, rest),
        Some(("udp", rest)) => (Protocol::Udp, rest),
        _ => (Protocol::Tcp, text),
    };
    let address = address.parse().map_err(|error| format!("{error}: write [tcp:|udp:]IP:PORT"))?;
    Ok((protocol, address))
}

/// The addresses of a controller, or of a proxy before one.
pub(crate) struct Listening {
    pub(crate) bcap: SocketAddr,
    pub(crate) udp: SocketAddr,
    /// `None` without RAC.
    pub(crate) rac: Option<SocketAddr>,
}

/// Writes the line `ready`.
impl fmt::Display for Listening {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ready bcap={} udp={}", self.bcap, self.udp)?;
        self.rac.map_or(Ok(()), |rac| write!(f, " rac={rac}"))
    }
}

/// Listens over TCP at the address of an option.
pub(crate) async fn tcp(option: &str, address: SocketAddr) -> Result<TcpListener, Failure> {
    TcpListener::bind(address).await.map_err(|error| taken(option, address, &error))
}

/// Listens over TCP if the option has an address.
pub(crate) async fn tcp_if(option: &str, address: Option<SocketAddr>) -> Result<Option<TcpListener>, Failure> {
    match address {
        Some(address) => tcp(option, address).await.map(Some),
        None => Ok(None),
    }
}

/// Describes why an address cannot be listened on.
pub(crate) fn taken(option: &str, address: SocketAddr, error: &io::Error) -> Failure {
    Failure::Connection {
        message: format!("cannot listen on {address}: {error}"),
        hint: format!("choose another address with {option}; port 0 takes a free one"),
    }
}
