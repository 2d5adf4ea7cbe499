//! The last packets of a session, with their bytes.

use std::collections::VecDeque;
use std::io;
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_capture::Role;
use bcap_capture::record::{self, Ends};
use bcap_core::bcap::header::field;

/// The maximum number of bytes that are kept, and of packets.
const BYTES: usize = 4 << 20;
const PACKETS: usize = 20_000;

/// A packet, at nanoseconds since 1970.
#[derive(Debug)]
struct Packet {
    at: u64,
    role: Role,
    bytes: Vec<u8>,
}

impl Packet {
    fn serial(&self) -> Option<u16> {
        self.bytes.get(field::SERIAL).and_then(<[u8]>::first_chunk).map(|serial| u16::from_le_bytes(*serial))
    }
}

/// The last packets. Packets of an earlier connection are kept until a new connection is opened.
#[derive(Debug, Default)]
pub struct Tape {
    packets: VecDeque<Packet>,
    size: usize,
    /// The number of packets at the front that belong to an earlier connection.
    older: usize,
    ends: Option<Ends>,
}

impl Tape {
    /// A connection is being opened.
    pub fn opens(&mut self) {
        self.older = self.packets.len();
    }

    /// The connection is open.
    pub fn connected(&mut self, ends: Option<Ends>) {
        self.ends = ends;
        for _ in 0..self.older {
            self.drop_first();
        }
        self.older = 0;
    }

    /// Adds a packet, and drops the oldest packets above 4 MiB and above 20,000 packets.
    pub fn push(&mut self, role: Role, bytes: &[u8]) {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let at = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
        self.packets.push_back(Packet { at, role, bytes: bytes.to_vec() });
        self.size += bytes.len();
        while self.size > BYTES || self.packets.len() > PACKETS {
            self.drop_first();
            self.older = self.older.saturating_sub(1);
        }
    }

    fn drop_first(&mut self) {
        self.size -= self.packets.pop_front().map_or(0, |packet| packet.bytes.len());
    }

    /// Returns the last request with a serial number and its replies.
    #[must_use]
    pub fn call(&self, serial: u16) -> Vec<(Role, &[u8])> {
        let mut found = Vec::new();
        for packet in self.packets.iter().rev().filter(|packet| packet.serial() == Some(serial)) {
            found.push((packet.role, packet.bytes.as_slice()));
            if packet.role == Role::Request {
                break;
            }
        }
        found.reverse();
        found
    }

    /// Returns the packets of the current connection, or of the last connection, as a pcapng file; `None` before the first
    /// connection.
    ///
    /// # Errors
    ///
    /// A packet that is too long for the format.
    #[must_use]
    pub fn pcapng(&self) -> Option<io::Result<Vec<u8>>> {
        let (ends, mut file) = (self.ends?, Vec::new());
        let packets = self.packets.iter().map(|packet| (packet.at, packet.role, packet.bytes.as_slice()));
        Some(record::write(&mut file, ends, packets).map(|()| file))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Variable_GetValue of handle 3, with serial 4.
    const GET: &[u8] = b"\x01\x1e\0\0\0\x04\0\0\0\x65\0\0\0\x01\0\x0a\0\0\0\x03\0\x01\0\0\0\x03\0\0\0\x04";

    #[test]
    fn the_last_call_with_a_serial_has_its_replies() {
        let mut tape = Tape::default();
        tape.push(Role::Request, b"older");
        tape.push(Role::Request, GET);
        tape.push(Role::Response, GET);
        tape.push(Role::Request, GET);
        tape.push(Role::Response, GET);
        assert_eq!(tape.call(4), [(Role::Request, GET), (Role::Response, GET)]);
        assert_eq!(tape.call(5), []);
    }

    #[test]
    fn memory_is_bounded_and_an_older_connection_is_dropped() {
        let mut tape = Tape::default();
        for _ in 0..5 {
            tape.push(Role::Response, &vec![0; BYTES / 4]);
        }
        assert_eq!((tape.packets.len(), tape.size), (4, BYTES));
        tape.opens();
        tape.push(Role::Request, GET);
        assert_eq!((tape.packets.len(), tape.older), (4, 3));
        tape.connected(None);
        assert_eq!((tape.packets.len(), tape.size, tape.older), (1, GET.len(), 0));
        assert!(tape.pcapng().is_none());
    }
}
