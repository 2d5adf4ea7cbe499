//! The common part of the commands that listen.

use std::io;
use std::net::SocketAddr;

use bcap_std::Protocol;
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

/// Describes why an address cannot be listened on.
pub(crate) fn taken(option: &str, address: SocketAddr, error: &io::Error) -> Failure {
    Failure::Connection {
        message: format!("cannot listen on {address}: {error}"),
        hint: format!("choose another address with {option}; port 0 takes a free one"),
    }
}
