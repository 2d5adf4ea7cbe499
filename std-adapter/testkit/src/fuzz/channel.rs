//! A connection to the device. Over UDP it stores the sent serials and bytes, because replies and frames of datagrams may
//! overlap.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;

use super::gate::{Gate, TAIL};
use crate::frame::{TestFrame, field};
use crate::wire::{Link, Received, Recorder, Wire};

/// The time limit for the device to close its side after the fuzzer has closed.
const CLOSING: Duration = Duration::from_millis(200);

/// The serial numbers of Service_Stop over UDP, relative to the last serial.
const STOPS: [u16; 4] = [1, 0x2000, 0x6000, 0xa000];

/// The protocol of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// b-CAP over this link.
    Bcap(Link),
    /// RAC.
    Rac,
}

impl Protocol {
    /// Returns whether packets are datagrams.
    #[must_use]
    pub const fn is_datagrams(self) -> bool {
        matches!(self, Self::Bcap(Link::Udp))
    }
}

/// A connection.
#[derive(Debug)]
pub(super) struct Channel {
    wire: Wire,
    protocol: Protocol,
    /// The serial numbers of the datagrams that were sent, each with the number of replies that may still arrive.
    sent: HashMap<u16, u32>,
    last: u16,
    /// The last bytes that were sent in datagrams.
    tail: Vec<u8>,
}

impl Channel {
    /// Connects to the first address that accepts.
    pub(super) fn connect(
        addresses: &[SocketAddr],
        protocol: Protocol,
        timeout: Duration,
        recorder: Option<&dyn Recorder>,
    ) -> io::Result<Self> {
        let mut last = io::Error::from(io::ErrorKind::NotFound);
        for address in addresses {
            let wire = match protocol {
                Protocol::Bcap(link) => Wire::connect(link, *address, timeout),
                Protocol::Rac => Wire::connect_rac(*address, timeout),
            };
            match wire {
                Ok(wire) => {
                    let wire = wire.recorded(recorder);
                    return Ok(Self { wire, protocol, sent: HashMap::new(), last: 0, tail: Vec::new() });
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Sends bytes. An error is not reported: the next receive returns what the device sent before, and then that it closed the
    /// connection, or silence if it accepted no more bytes.
    pub(super) fn send(&mut self, bytes: &[u8]) {
        let serial = field::serial(bytes);
        self.last = serial.unwrap_or(0);
        // a datagram that is too long for IP is not sent
        if self.wire.send(bytes).is_err() || !self.is_datagrams() {
            return;
        }
        if let Some(serial) = serial {
            *self.sent.entry(serial).or_default() += 1;
        }
        self.tail.extend_from_slice(bytes);
        self.tail.drain(..self.tail.len().saturating_sub(TAIL));
    }

    /// Returns the last bytes that were sent in datagrams.
    pub(super) fn tail(&self) -> &[u8] {
        &self.tail
    }

    /// Records a reply with this serial number. Returns whether a datagram with it was sent and not replied to before. An S_EXECUTING
    /// is not counted.
    pub(super) fn takes_reply(&mut self, serial: u16, is_executing: bool) -> bool {
        match self.sent.get_mut(&serial) {
            Some(_) if is_executing => true,
            Some(count @ 1..) => {
                *count -= 1;
                true
            }
            _ => false,
        }
    }

    pub(super) const fn is_stuck(&self) -> bool {
        self.wire.is_stuck()
    }

    pub(super) const fn has_received(&self) -> bool {
        self.wire.has_received()
    }

    pub(super) const fn is_datagrams(&self) -> bool {
        self.protocol.is_datagrams()
    }

    pub(super) fn receive(&mut self, limit: Duration) -> Received {
        self.wire.receive(limit)
    }

    /// Closes the connection, and waits briefly until the device has closed it too. Over UDP it ends the session. Returns
    /// whether the device has closed its port for datagrams.
    pub(super) fn close(self, gate: &Gate) -> bool {
        if self.is_datagrams() {
            return self.stop(gate);
        }
        self.wire.close(CLOSING);
        false
    }

    /// Sends Service_Stop until it is answered, because the device keeps a slot for the port. After the unusual serials of a
    /// session, a device may treat a serial as old, so several serials that are far apart are tried.
    fn stop(mut self, gate: &Gate) -> bool {
        let last = self.last;
        for ahead in STOPS {
            let serial = last.wrapping_add(ahead).max(1);
            let code = FunctionId::SERVICE_STOP.0;
            let bytes = TestFrame { serial, reserved: 0, code, args: vec![] }.to_wire(false);
            if !gate.has_joint(&self.tail, &bytes) {
                continue;
            }
            self.send(&bytes);
            let until = Instant::now() + CLOSING / 4;
            loop {
                match self.receive(until.saturating_duration_since(Instant::now())) {
                    Received::Packet(reply) if field::serial(&reply) == Some(serial) => return false,
                    Received::Packet(_) => {}
                    Received::Closed => return true,
                    Received::Silence => break,
                }
            }
        }
        false
    }
}
