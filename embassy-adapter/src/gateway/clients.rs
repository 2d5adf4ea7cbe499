//! The PLC side of a gateway: sessions over any transport.

use core::net::SocketAddrV4;

use bcap_core::io::asynch::Transport;
use bcap_gateway::driver::{self, Ended, Front, Limits};
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::SharedGateway;

/// The size of the buffer through which bytes move; most lines are shorter.
pub(super) const CHUNK: usize = 64;

/// Serves one PLC until its session ends, and returns the reason; `None` if it gets no slot, because all are in use, the rules
/// do not allow it to connect, or the gateway stops. A caller that serves a line again after `None` should wait first.
///
/// When all slots are in use, it first ends the session of the client that has been idle for the longest time, at least
/// [`Limits::evict_after`], preferably one with the same address.
///
/// `client` is the PLC's address, for rules and the log; `front` says which protocol it speaks.
///
/// # Cancel safety
///
/// Dropping the future frees the slot and leaves the transport open.
pub fn serve<'a, X: Transport, M: RawMutex, const N: usize>(
    transport: &'a mut X,
    front: Front<'a, '_>,
    client: Option<SocketAddrV4>,
    shared: &'a SharedGateway<'_, M, N>,
    limits: &'a Limits,
) -> impl Future<Output = Option<Ended<X::Error>>> {
    driver::serve::<_, _, CHUNK>(transport, front, client, shared, limits, |_| ())
}
