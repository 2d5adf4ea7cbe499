//! The reports of a gateway, with the addresses and errors of a board.

use core::net::SocketAddrV4;

use bcap_gateway::driver;

use crate::error::NetError;

/// An event of the gateway, for a log. The address of a client is `None` on a serial line.
pub type Report<'a> = driver::Report<'a, Option<SocketAddrV4>, NetError, ()>;

/// A callback that receives reports for a log.
///
/// It runs while the gateway is borrowed, so it must not call the [`SharedGateway`](super::SharedGateway).
pub type Log = fn(&Report<'_>);
