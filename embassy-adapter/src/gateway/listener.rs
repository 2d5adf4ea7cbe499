//! TCP listeners for PLCs over embassy-net.

use core::net::SocketAddrV4;
use core::time::Duration;

use bcap_gateway::driver::{Ended, Front, Limits, refuse};
use embassy_net::{IpAddress, IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::SharedGateway;
use super::clients::{CHUNK, serve};
use crate::net::{Options, TcpTransport};

/// The pause before listening again after listening failed.
const PAUSE_MS: u64 = 100;

/// How long to wait for the first request of a client without a slot.
pub(super) const REFUSAL_TIME: Duration = Duration::from_millis(500);

/// A TCP listener that serves one PLC at a time; use several on the same port, with one [`Backlog`](crate::net::Backlog), to
/// serve several PLCs concurrently.
///
/// With one listener more than the gateway has slots, a PLC without a slot gets the answer E_MAX_CONNECT to its first line.
/// The network resets connections that no listener accepts.
#[derive(Debug)]
pub struct Listener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
}

impl<'s> Listener<'s> {
    /// Creates a listener; `rx` and `tx` are its socket's buffers.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8]) -> Self {
        Self::with_options(stack, port, rx, tx, Options::default())
    }

    /// Creates a listener with other timeouts of its connections.
    #[must_use]
    pub fn with_options(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8], options: Options) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), port }
    }

    /// Serves PLCs forever, in sequence.
    pub async fn run<M: RawMutex, const N: usize>(&mut self, shared: &SharedGateway<'_, M, N>, limits: &Limits) -> ! {
        loop {
            let client = accept(&mut self.transport, self.port, shared).await;
            let ended = serve(&mut self.transport, Front::Rac, client, shared, limits).await;
            if ended.is_none() {
                refuse(&mut self.transport, Front::Rac, REFUSAL_TIME, &mut [0; CHUNK]).await;
            }
            end(&mut self.transport, matches!(ended, Some(Ended::Evicted))).await;
        }
    }
}

/// Waits for a client that the rules admit, and returns its address.
pub(super) async fn accept<M: RawMutex, const N: usize>(
    transport: &mut TcpTransport<'_>,
    port: u16,
    shared: &SharedGateway<'_, M, N>,
) -> Option<SocketAddrV4> {
    loop {
        // its place is free after the handshake
        if transport.accept(port).await.map(drop).is_err() {
            Timer::after_millis(PAUSE_MS).await;
            continue;
        }
        let client = transport.socket().remote_endpoint();
        let client = client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), port }| SocketAddrV4::new(address, port));
        if shared.admits(client) {
            return client;
        }
        transport.reset().await;
    }
}

/// Ends the connection of a client. An evicted one was idle, so it would not confirm the end if it were gone.
pub(super) async fn end(transport: &mut TcpTransport<'_>, is_evicted: bool) {
    match is_evicted {
        true => transport.reset().await,
        false => transport.close().await,
    }
}
