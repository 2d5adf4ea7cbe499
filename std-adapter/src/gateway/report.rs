//! The reports of a gateway, with the addresses and errors of this platform.

use std::io;
use std::net::SocketAddr;

use bcap_gateway::driver;

/// A report of a gateway to its log.
pub type Report<'a> = driver::Report<'a, SocketAddr, io::Error, io::ErrorKind>;

/// Why the session of a client ended.
pub type Ended = driver::Ended<io::ErrorKind>;

/// Receives every report.
pub(super) type Log = Box<dyn FnMut(&Report<'_>) + Send>;
