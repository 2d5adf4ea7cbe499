//! Modbus TCP in front of the gateway, for PLCs that do not speak RAC.
//!
//! A Modbus client takes a slot of the gateway as a PLC with RAC does, and the same rules apply to it.
//! [`bcap_core::modbus`] defines how registers and coils become variables.

use bcap_core::io::asynch::Transport;
use bcap_core::modbus::{Entry, Front};
use bcap_core::rac::Request;
use bcap_core::time::Instant;
use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::clients::{accept, answer_full, end, serve};
use super::shared::address;
use super::{Denial, SharedGateway};
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
                let permitted = shared.view(|gateway| gateway.config().rules.permits(request, address(client)).is_ok());
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

/// A connection of a Modbus client as a transport of RAC, for [`serve`](super::serve): any stream, such as TCP.
#[derive(Debug)]
pub struct ModbusLink<'a, 'm, X, P> {
    link: &'a mut X,
    front: &'a mut Front<'m>,
    permits: P,
}

impl<'a, 'm, X: Transport, P: Fn(&Request<'_>) -> bool> ModbusLink<'a, 'm, X, P> {
    /// Wraps a new connection, with a new front. `permits` tells whether the rules permit a request
    /// ([`Rules::permits`](bcap_core::gateway::Rules::permits)).
    pub const fn new(link: &'a mut X, front: &'a mut Front<'m>, permits: P) -> Self {
        Self { link, front, permits }
    }

    /// Sends what is left of a response; `None` at `until`.
    async fn flush(&mut self, until: Instant) -> Result<Option<()>, X::Error> {
        while !self.front.transmit().is_empty() {
            match self.link.send(self.front.transmit(), until).await? {
                Some(count) => self.front.transmitted(count),
                None => return Ok(None),
            }
        }
        // a request that arrived after the one before begins now
        self.front.received(&[], &self.permits);
        Ok(Some(()))
    }
}

impl<X: Transport, P: Fn(&Request<'_>) -> bool> Transport for ModbusLink<'_, '_, X, P> {
    type Error = X::Error;

    fn now(&self) -> Instant {
        self.link.now()
    }

    /// Takes all bytes of a reply, and sends the response that they complete.
    async fn send(&mut self, reply: &[u8], until: Instant) -> Result<Option<usize>, X::Error> {
        self.front.replied(reply, &self.permits);
        Ok(self.flush(until).await?.map(|()| reply.len()))
    }

    /// Returns bytes of a line, and 0 after bytes that are not Modbus.
    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, X::Error> {
        loop {
            // left over from a `send` that was dropped
            if self.flush(until).await?.is_none() {
                return Ok(None);
            }
            let line = self.front.line();
            if !line.is_empty() {
                let count = buffer.iter_mut().zip(line).map(|(to, from)| *to = *from).count();
                self.front.line_taken(count);
                return Ok(Some(count));
            }
            let room = self.front.room().min(buffer.len());
            let Some(room) = buffer.get_mut(..room).filter(|room| !room.is_empty() && !self.front.is_broken()) else {
                return Ok(Some(0));
            };
            match self.link.receive(room, until).await? {
                Some(count @ 1..) => self.front.received(room.get(..count).unwrap_or_default(), &self.permits),
                ended => return Ok(ended),
            }
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.link.sleep_until(at).await;
    }
}
