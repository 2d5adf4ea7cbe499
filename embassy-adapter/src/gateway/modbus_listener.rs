//! TCP listeners for clients of Modbus over embassy-net.

use bcap_core::rac::Request;
use bcap_gateway::modbus::{Entry, Front};
use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::clients::serve;
use super::listener::{accept, answer_full, end};
use super::{Denial, ModbusLink, SharedGateway};
use crate::net::{Options, TcpTransport};
use crate::server::{Ended, Limits};

/// A TCP listener that serves one client of Modbus at a time; use several on the same port to serve several clients, and one
/// that [refuses](Self::refuse) further clients.
#[derive(Debug)]
pub struct ModbusListener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
    map: &'s [Entry],
    front: Front<'s>,
}

impl<'s> ModbusListener<'s> {
    /// Creates a listener; `rx` and `tx` are its socket's buffers, and `map` says which variables its clients see.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, map: &'s [Entry], [rx, tx]: [&'s mut [u8]; 2], options: Options) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), port, map, front: Front::new(map) }
    }

    /// Serves clients forever, one after another.
    #[expect(clippy::large_futures, reason = "32 bytes above the limit on a host, for one transport inside another")]
    pub async fn run<M: RawMutex, const N: usize>(&mut self, shared: &SharedGateway<'_, M, N>, limits: &Limits) -> ! {
        loop {
            let client = accept(&mut self.transport, self.port, shared).await;
            let permits = |request: &Request<'_>| {
                let permitted = shared
                    .view(|gateway| gateway.config().rules.permits(request, client.map(|client| *client.ip())).is_ok());
                permitted.unwrap_or_default()
            };
            self.front = Front::new(self.map);
            let mut link = ModbusLink::new(&mut self.transport, &mut self.front, permits);
            let ended = serve(&mut link, client, shared, limits).await;
            if ended.is_none() {
                shared.deny(client, Denial::Full);
                answer_full(&mut link).await;
            }
            end(&mut self.transport, matches!(ended, Some(Ended::Evicted))).await;
        }
    }

    /// Answers the first request of each client with exception 06, "server device busy", and closes its connection, forever.
    ///
    /// It is for one listener more than serve clients: the network resets connections that no listener accepts, and a client
    /// cannot tell that from a board that failed.
    pub async fn refuse<M: RawMutex, const N: usize>(&mut self, shared: &SharedGateway<'_, M, N>) -> ! {
        loop {
            let client = accept(&mut self.transport, self.port, shared).await;
            shared.deny(client, Denial::Full);
            self.front = Front::new(self.map);
            let mut link = ModbusLink::new(&mut self.transport, &mut self.front, |_: &Request<'_>| true);
            answer_full(&mut link).await;
            end(&mut self.transport, false).await;
        }
    }
}
