//! Modbus TCP in front of the gateway, for PLCs that do not speak RAC.
//!
//! A Modbus client takes a slot of the gateway as a PLC with RAC does, and the same rules apply to it.
//! [`bcap_gateway::modbus`] defines how registers and coils become variables.

use bcap_core::io::asynch::Transport;
use bcap_core::rac::Request;
use bcap_core::time::Instant;
use bcap_gateway::modbus::Front;

/// A connection of a Modbus client as a transport of RAC, for [`serve`](super::serve): any stream, such as TCP.
#[derive(Debug)]
pub struct ModbusLink<'a, 'm, X, P> {
    link: &'a mut X,
    front: &'a mut Front<'m>,
    permits: P,
}

impl<'a, 'm, X: Transport, P: Fn(&Request<'_>) -> bool> ModbusLink<'a, 'm, X, P> {
    /// Wraps a new connection, with a new front. `permits` tells whether the rules permit a request
    /// ([`Rules::permits`](bcap_gateway::Rules::permits)).
    pub const fn new(link: &'a mut X, front: &'a mut Front<'m>, permits: P) -> Self {
        Self { link, front, permits }
    }

    /// Sends the rest of a response; `None` at `until`.
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

    /// Returns bytes of a line, 0 after bytes that are not Modbus, and `None` after a part of a frame.
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
            if self.front.is_receiving() && !self.front.is_broken() {
                return Ok(None);
            }
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.link.sleep_until(at).await;
    }

    fn is_receiving(&self) -> bool {
        self.front.is_receiving()
    }
}
