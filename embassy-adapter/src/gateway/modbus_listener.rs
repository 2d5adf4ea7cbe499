//! TCP listeners for clients of Modbus over embassy-net.

use bcap_gateway::driver::{Denial, Ended, Front, Limits, refuse};
use bcap_gateway::modbus::{self, Entry};
use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::SharedGateway;
use super::clients::{CHUNK, serve};
use super::listener::{REFUSAL_TIME, accept, end};
use crate::net::{Options, TcpTransport};

/// A TCP listener that serves one client of Modbus at a time; use several on the same port to serve several clients, and one
/// that [refuses](Self::refuse) further clients.
#[derive(Debug)]
pub struct ModbusListener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
    map: &'s [Entry],
    session: modbus::Session<'s>,
}

impl<'s> ModbusListener<'s> {
    /// Creates a listener; `rx` and `tx` are its socket's buffers, and `map` lists the variables that its clients can access.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, map: &'s [Entry], [rx, tx]: [&'s mut [u8]; 2], options: Options) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), port, map, session: modbus::Session::new(map) }
    }

    /// Serves clients forever, in sequence.
    pub async fn run<M: RawMutex, const N: usize>(&mut self, shared: &SharedGateway<'_, M, N>, limits: &Limits) -> ! {
        loop {
            let client = accept(&mut self.transport, self.port, shared).await;
            self.session = modbus::Session::new(self.map);
            let ended = serve(&mut self.transport, Front::Modbus(&mut self.session), client, shared, limits).await;
            if ended.is_none() {
                self.refuse_client().await;
            }
            end(&mut self.transport, matches!(ended, Some(Ended::Evicted))).await;
        }
    }

    /// Answers the first request of each client with exception 06, "server device busy", and closes its connection, forever.
    ///
    /// Use it for one listener in addition to those that serve clients: the network resets connections that no listener
    /// accepts, and a client cannot distinguish that from a board that failed.
    pub async fn refuse<M: RawMutex, const N: usize>(&mut self, shared: &SharedGateway<'_, M, N>) -> ! {
        loop {
            let client = accept(&mut self.transport, self.port, shared).await;
            shared.deny(client, Denial::Full);
            self.session = modbus::Session::new(self.map);
            self.refuse_client().await;
            end(&mut self.transport, false).await;
        }
    }

    async fn refuse_client(&mut self) {
        refuse(&mut self.transport, Front::Modbus(&mut self.session), REFUSAL_TIME, &mut [0; CHUNK]).await;
    }
}
