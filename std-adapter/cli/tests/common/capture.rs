//! Writes captures: payloads in packets with IPv4 and TCP or UDP headers, in the format of libpcap.
#![allow(dead_code, reason = "every test file uses its own part of this")]

use std::path::Path;

use etherparse::PacketBuilder;

/// The largest payload of a TCP segment.
const SEGMENT: usize = 1400;
/// The link type of packets that begin with an IP header.
const RAW_IP: u32 = 101;

/// Who sends a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum From {
    Client,
    Server,
}

/// A TCP connection of the client 10.x.y.z to the server 192.168.0.1, or a pair of UDP ports.
#[derive(Clone, Debug)]
pub(crate) struct Flow {
    client: [u8; 4],
    port: u16,
    /// The next sequence numbers of client and server.
    next: [u32; 2],
}

impl Flow {
    /// The flow with a number, to a port of the server.
    pub(crate) fn new(number: u32, port: u16) -> Self {
        let [_, b, c, d] = number.to_be_bytes();
        Self { client: [10, b, c, d], port, next: [1000, 5000] }
    }
}

/// A capture in memory; one millisecond passes between two packets.
pub(crate) struct Capture {
    bytes: Vec<u8>,
    micros: u32,
    /// The number of packets.
    pub(crate) packets: u32,
}

const CLIENT_PORT: u16 = 40_000;
const SERVER: [u8; 4] = [192, 168, 0, 1];

impl Capture {
    pub(crate) fn new() -> Self {
        let mut bytes = Vec::new();
        // the magic of microseconds, version 2.4, two unused fields, the snap length, the link type
        for field in [0xa1b2_c3d4, 0x0004_0002, 0, 0, 0x0004_0000, RAW_IP] {
            bytes.extend(field.to_le_bytes());
        }
        Self { bytes, micros: 0, packets: 0 }
    }

    /// Adds a packet of raw IP.
    pub(crate) fn packet(&mut self, packet: &[u8]) {
        self.micros += 1000;
        self.packets += 1;
        let length = u32::try_from(packet.len()).unwrap();
        for field in [self.micros / 1_000_000, self.micros % 1_000_000, length, length] {
            self.bytes.extend(field.to_le_bytes());
        }
        self.bytes.extend(packet);
    }

    /// Adds bytes of a TCP connection, in as many segments as needed.
    pub(crate) fn tcp(&mut self, flow: &mut Flow, from: From, payload: &[u8]) {
        for part in payload.chunks(SEGMENT) {
            let packet = segment(flow, from, part);
            flow.next[usize::from(from == From::Server)] += u32::try_from(part.len()).unwrap();
            self.packet(&packet);
        }
    }

    /// Adds a datagram.
    pub(crate) fn udp(&mut self, flow: &Flow, from: From, payload: &[u8]) {
        let builder = match from {
            From::Client => PacketBuilder::ipv4(flow.client, SERVER, 64).udp(CLIENT_PORT, flow.port),
            From::Server => PacketBuilder::ipv4(SERVER, flow.client, 64).udp(flow.port, CLIENT_PORT),
        };
        let mut packet = Vec::new();
        builder.write(&mut packet, payload).unwrap();
        self.packet(&packet);
    }

    pub(crate) fn save(&self, path: &Path) {
        std::fs::write(path, &self.bytes).unwrap();
    }
}

/// A TCP segment at the next sequence number, which it does not change.
pub(crate) fn segment(flow: &Flow, from: From, payload: &[u8]) -> Vec<u8> {
    let [client, server] = flow.next;
    let builder = match from {
        From::Client => {
            PacketBuilder::ipv4(flow.client, SERVER, 64).tcp(CLIENT_PORT, flow.port, client, 64_000).ack(server).psh()
        }
        From::Server => {
            PacketBuilder::ipv4(SERVER, flow.client, 64).tcp(flow.port, CLIENT_PORT, server, 64_000).ack(client).psh()
        }
    };
    let mut packet = Vec::new();
    builder.write(&mut packet, payload).unwrap();
    packet
}
