//! The common part of the commands that listen.

use std::io;
use std::net::SocketAddr;

use tokio::runtime::{self, Runtime};

use crate::failure::Failure;

/// Makes the runtime of a command that serves: one thread is enough for a controller or a gateway.
pub(crate) fn runtime() -> io::Result<Runtime> {
    runtime::Builder::new_current_thread().enable_all().build()
}

/// Describes why an address cannot be listened on.
pub(crate) fn taken(option: &str, address: SocketAddr, error: &io::Error) -> Failure {
    Failure::Connection {
        message: format!("cannot listen on {address}: {error}"),
        hint: format!("choose another address with {option}; port 0 takes a free one"),
    }
}
