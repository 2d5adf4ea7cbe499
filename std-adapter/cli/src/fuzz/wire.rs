//! A connection to the device, which records its bytes.

use std::collections::HashMap;
use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::limits::Limits;
use bcap_testkit::frame::TestFrame;

use super::gate::{Gate, TAIL};
use bcap_capture::Role;
use bcap_capture::record::{Ends, Recorder};

/// How long the device may take to close its side after the fuzzer has closed.
const CLOSING: Duration = Duration::from_millis(200);

/// The serial numbers of Service_Stop over UDP, relative to the last one.
const STOPS: [u16; 4] = [1, 0x2000, 0x6000, 0xa000];

/// A message of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    Bcap,
    /// b-CAP over UDP.
    Datagrams,
    Rac,
}

/// The socket of a connection.
#[derive(Debug)]
enum Socket {
    Tcp(TcpStream),
    /// A separate port, so that the device takes it for another client.
    Udp(UdpSocket),
}

/// The result of a receive.
#[derive(Debug)]
pub(super) enum Received {
    /// A frame, or a line with its CR; bytes that are neither if no more came in time.
    Packet(Vec<u8>),
    /// The device closed or reset the connection, or has closed its port for datagrams.
    Closed,
    /// Nothing came in time.
    Silence,
}

/// A connection.
#[derive(Debug)]
pub(super) struct Wire {
    socket: Socket,
    protocol: Protocol,
    received: Vec<u8>,
    tape: Option<(Recorder, Ends)>,
    /// Whether the device took no more bytes within the time limit.
    is_stuck: bool,
    /// The serial numbers of the datagrams that were sent, each with the number of replies that may still arrive.
    sent: HashMap<u16, u32>,
    last: u16,
    /// The last bytes that were sent in datagrams.
    tail: Vec<u8>,
    has_received: bool,
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
            let socket = match protocol {
                Protocol::Datagrams => datagrams(address).map(Socket::Udp),
                Protocol::Bcap | Protocol::Rac => stream(address, timeout).map(Socket::Tcp),
            };
            match socket {
                Ok(socket) => return Ok(Self::new(socket, protocol, recorder)),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn new(socket: Socket, protocol: Protocol, recorder: Option<&Recorder>) -> Self {
        // the peer may have closed the connection already
        let (client, server) = match &socket {
            Socket::Tcp(stream) => (stream.local_addr(), stream.peer_addr()),
            Socket::Udp(socket) => (socket.local_addr(), socket.peer_addr()),
        };
        let is_tcp = matches!(socket, Socket::Tcp(_));
        let ends = client.and_then(|client| server.map(|server| Ends { is_tcp, client, server }));
        let tape = recorder.cloned().zip(ends.ok());
        if let Some((recorder, ends)) = &tape {
            recorder.opened(*ends);
        }
        Self {
            socket,
            protocol,
            received: Vec::new(),
            tape,
            is_stuck: false,
            sent: HashMap::new(),
            last: 0,
            tail: Vec::new(),
            has_received: false,
        }
    }

    /// Returns whether the device has sent anything.
    pub(super) const fn has_received(&self) -> bool {
        self.has_received
    }

    /// Sends bytes. An error is not reported: the next receive returns what the device sent before, and then that it closed the
    /// connection, or silence if it took no more bytes.
    pub(super) fn send(&mut self, bytes: &[u8]) {
        match &mut self.socket {
            Socket::Tcp(stream) => {
                let result = stream.write_all(bytes);
                self.is_stuck |= result.is_err_and(|error| is_timeout(&error));
            }
            Socket::Udp(socket) => {
                let serial = serial_of(bytes);
                self.last = serial.unwrap_or(0);
                // one that is too long for IP is not sent
                if socket.send(bytes).is_err() {
                    return;
                }
                if let Some(serial) = serial {
                    *self.sent.entry(serial).or_default() += 1;
                }
                self.tail.extend_from_slice(bytes);
                self.tail.drain(..self.tail.len().saturating_sub(TAIL));
            }
        }
        self.record(Role::Request, bytes);
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
            let read = match &mut self.socket {
                Socket::Tcp(stream) => stream.set_read_timeout(Some(left)).and_then(|()| stream.read(&mut buffer)),
                Socket::Udp(socket) => socket.set_read_timeout(Some(left)).and_then(|()| socket.recv(&mut buffer)),
            };
            match read {
                Ok(count) if self.protocol == Protocol::Datagrams => {
                    self.has_received = true;
                    let bytes = buffer.get(..count).unwrap_or_default();
                    self.record(Role::Response, bytes);
                    return Ok(Received::Packet(bytes.to_vec()));
                }
                Ok(0) => return end(self, Received::Closed),
                Ok(count) => {
                    let bytes = buffer.get(..count).unwrap_or_default();
                    self.record(Role::Response, bytes);
                    self.received.extend_from_slice(bytes);
                    self.has_received = true;
                }
                Err(error) if is_timeout(&error) => {}
                Err(_) => return end(self, Received::Closed),
            }
        }
    }

    /// Returns the length of the packet at the front; for bytes that cannot be a frame, the length of all bytes.
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

    /// Closes the connection, and waits shortly for the device to do so too, so that it has noticed. Over UDP it ends the session.
    /// Returns whether the device has closed its port for datagrams.
    pub(super) fn close(mut self, gate: &Gate) -> bool {
        let Socket::Tcp(stream) = &self.socket else { return self.stop(gate) };
        let _ = stream.shutdown(Shutdown::Write);
        let until = Instant::now() + CLOSING;
        while let Some(left) = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            match self.receive(left) {
                Ok(Received::Packet(_)) => {}
                Ok(Received::Closed | Received::Silence) | Err(_) => break,
            }
        }
        false
    }

    /// Sends Service_Stop until it is answered, because the device keeps a slot for the port. A device may take a serial number for an
    /// old one after the strange ones of a session, so they are far apart.
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
            while let Some(left) = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
                match self.receive(left) {
                    Ok(Received::Packet(reply)) if reply.get(5..7) == Some(&serial.to_le_bytes()) => return false,
                    Ok(Received::Packet(_)) => {}
                    Ok(Received::Closed) => return true,
                    Err(_) => return false,
                    Ok(Received::Silence) => break,
                }
            }
        }
        false
    }

    pub(super) fn is_datagrams(&self) -> bool {
        self.protocol == Protocol::Datagrams
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

fn stream(address: &SocketAddr, timeout: Duration) -> io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(address, timeout)?;
    stream.set_write_timeout(Some(timeout))?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

fn datagrams(address: &SocketAddr) -> io::Result<UdpSocket> {
    let any: SocketAddr = if address.is_ipv4() { ([0; 4], 0).into() } else { ([0_u16; 8], 0).into() };
    let socket = UdpSocket::bind(any)?;
    socket.connect(address)?;
    Ok(socket)
}

/// Returns the serial number of a frame; `None` for bytes that are too short.
pub(super) fn serial_of(bytes: &[u8]) -> Option<u16> {
    bytes.get(5..7)?.try_into().ok().map(u16::from_le_bytes)
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}
