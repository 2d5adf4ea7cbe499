//! A connection to the device, which records its bytes.

use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use bcap_core::limits::Limits;

use crate::frame::Role;
use crate::record::{Ends, Recorder};

/// How long the device may take to close its side after the fuzzer has closed.
const CLOSING: Duration = Duration::from_millis(200);

/// What a device sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    Bcap,
    Rac,
}

/// What came.
#[derive(Debug)]
pub(super) enum Received {
    /// A frame, or a line with its CR; bytes that are neither if no more came in time.
    Packet(Vec<u8>),
    /// The device closed or reset the connection.
    Closed,
    /// Nothing came in time.
    Silence,
}

/// A connection.
#[derive(Debug)]
pub(super) struct Wire {
    stream: TcpStream,
    protocol: Protocol,
    received: Vec<u8>,
    tape: Option<(Recorder, Ends)>,
    /// Whether the device took no more bytes within the time limit.
    is_stuck: bool,
}

impl Wire {
    /// Connects to the first address that accepts.
    pub(super) fn connect(
        addresses: &[SocketAddr],
        protocol: Protocol,
        timeout: Duration,
        recorder: Option<&Recorder>,
    ) -> io::Result<Self> {
        let mut last = io::Error::from(io::ErrorKind::NotFound);
        for address in addresses {
            match TcpStream::connect_timeout(address, timeout) {
                Ok(stream) => {
                    stream.set_write_timeout(Some(timeout))?;
                    return Self::new(stream, protocol, recorder);
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn new(stream: TcpStream, protocol: Protocol, recorder: Option<&Recorder>) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        // the peer may have closed the connection already
        let ends = stream
            .local_addr()
            .and_then(|client| stream.peer_addr().map(|server| Ends { is_tcp: true, client, server }));
        let tape = recorder.cloned().zip(ends.ok());
        if let Some((recorder, ends)) = &tape {
            recorder.opened(*ends);
        }
        Ok(Self { stream, protocol, received: Vec::new(), tape, is_stuck: false })
    }

    /// Sends bytes. An error is not reported: the next receive returns what the device sent before, and then that it closed the
    /// connection, or silence if it took no more bytes.
    pub(super) fn send(&mut self, bytes: &[u8]) {
        self.record(Role::Request, bytes);
        self.is_stuck |= self.stream.write_all(bytes).is_err_and(|error| is_timeout(&error));
    }

    /// Returns whether the device took no more bytes within the time limit.
    pub(super) const fn is_stuck(&self) -> bool {
        self.is_stuck
    }

    /// Receives a packet.
    pub(super) fn receive(&mut self, limit: Duration) -> io::Result<Received> {
        let until = Instant::now() + limit;
        let mut buffer = vec![0; 1 << 16];
        loop {
            if let Some(length) = self.packet_length() {
                let rest = self.received.split_off(length);
                return Ok(Received::Packet(std::mem::replace(&mut self.received, rest)));
            }
            let left = until.saturating_duration_since(Instant::now());
            let is_empty = self.received.is_empty();
            let end = |wire: &mut Self, end| {
                Ok(if is_empty { end } else { Received::Packet(std::mem::take(&mut wire.received)) })
            };
            if left.is_zero() || self.is_stuck {
                return end(self, Received::Silence);
            }
            self.stream.set_read_timeout(Some(left))?;
            match self.stream.read(&mut buffer) {
                Ok(0) => return end(self, Received::Closed),
                Ok(count) => {
                    let bytes = buffer.get(..count).unwrap_or_default();
                    self.record(Role::Response, bytes);
                    self.received.extend_from_slice(bytes);
                }
                Err(error) if is_timeout(&error) => {}
                Err(_) => return end(self, Received::Closed),
            }
        }
    }

    /// Returns the length of the packet at the front; of bytes that cannot be one, that of all bytes.
    fn packet_length(&self) -> Option<usize> {
        if self.protocol == Protocol::Rac {
            return self.received.iter().position(|byte| *byte == b'\r').map(|at| at + 1);
        }
        let (first, rest) = self.received.split_first()?;
        let length = u32::from_le_bytes(rest.get(..4)?.try_into().ok()?);
        if *first != 1 || !(16..=Limits::STREAM.frame).contains(&length) {
            return Some(self.received.len());
        }
        usize::try_from(length).ok().filter(|length| *length <= self.received.len())
    }

    /// Closes the connection, and waits shortly for the device to do so too, so that it has noticed.
    pub(super) fn close(mut self) {
        let _ = self.stream.shutdown(Shutdown::Write);
        let until = Instant::now() + CLOSING;
        while let Some(left) = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            match self.receive(left) {
                Ok(Received::Packet(_)) => {}
                Ok(Received::Closed | Received::Silence) | Err(_) => return,
            }
        }
    }

    fn record(&self, sender: Role, bytes: &[u8]) {
        if let Some((recorder, ends)) = &self.tape {
            recorder.bytes(recorder.now(), *ends, sender, bytes);
        }
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        if let Some((recorder, ends)) = &self.tape {
            recorder.closed(*ends);
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}
