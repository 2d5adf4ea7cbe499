//! Writes captures: payloads in packets with IPv4 and TCP or UDP headers, in the format of libpcap.

use std::path::Path;

use bcap_fuzz::corpus::Inputs;
use etherparse::{Ipv4Header, PacketBuilder};

/// The port of b-CAP.
pub(crate) const BCAP: u16 = 5007;
/// The port of RAC.
pub(crate) const RAC: u16 = 5006;

/// The largest payload of a TCP segment.
const SEGMENT: usize = 1400;
/// The link type of packets that begin with an IP header.
const RAW_IP: u32 = 101;

/// The sender of a packet.
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

    /// The packet that opens the connection.
    pub(crate) fn syn(&self) -> Vec<u8> {
        let mut packet = Vec::new();
        let builder = PacketBuilder::ipv4(self.client, SERVER, 64).tcp(CLIENT_PORT, self.port, self.next[0], 64_000);
        builder.syn().write(&mut packet, &[]).unwrap();
        packet
    }

    /// Skips bytes of one side, as if a segment were lost in the capture.
    pub(crate) fn skip(&mut self, from: From, bytes: usize) {
        self.next[usize::from(from == From::Server)] += u32::try_from(bytes).unwrap();
    }
}

/// A capture in memory; one millisecond passes between two packets, unless a test changes the clock.
pub(crate) struct Capture {
    bytes: Vec<u8>,
    /// The time of the last packet.
    pub(crate) micros: u32,
    /// The microseconds between two packets.
    pub(crate) step: i32,
    /// The number of packets.
    pub(crate) packets: u32,
}

const CLIENT_PORT: u16 = 40_000;
const SERVER: [u8; 4] = [192, 168, 0, 1];

impl Capture {
    pub(crate) fn new() -> Self {
        Self::of_link(RAW_IP)
    }

    /// A capture of another link type; [`packet`](Self::packet) gets its headers too.
    pub(crate) fn of_link(link: u32) -> Self {
        let mut bytes = Vec::new();
        // the magic of microseconds, version 2.4, two unused fields, the snap length, the link type
        for field in [0xa1b2_c3d4, 0x0004_0002, 0, 0, 0x0004_0000, link] {
            bytes.extend(field.to_le_bytes());
        }
        Self { bytes, micros: 0, step: 1000, packets: 0 }
    }

    /// Adds a packet of raw IP.
    pub(crate) fn packet(&mut self, packet: &[u8]) {
        self.micros = self.micros.checked_add_signed(self.step).unwrap();
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
            flow.skip(from, part.len());
            self.packet(&packet);
        }
    }

    /// Adds a datagram.
    pub(crate) fn udp(&mut self, flow: &Flow, from: From, payload: &[u8]) {
        self.packet(&datagram(flow, from, payload));
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

/// A datagram in an IPv4 packet.
fn datagram(flow: &Flow, from: From, payload: &[u8]) -> Vec<u8> {
    let builder = match from {
        From::Client => PacketBuilder::ipv4(flow.client, SERVER, 64).udp(CLIENT_PORT, flow.port),
        From::Server => PacketBuilder::ipv4(SERVER, flow.client, 64).udp(flow.port, CLIENT_PORT),
    };
    let mut packet = Vec::new();
    builder.write(&mut packet, payload).unwrap();
    packet
}

/// Returns the IPv4 packets of a datagram in fragments of `size` bytes, a multiple of 8.
pub(crate) fn fragments(flow: &Flow, from: From, payload: &[u8], size: usize) -> Vec<Vec<u8>> {
    let packet = datagram(flow, from, payload);
    let (header, rest) = Ipv4Header::from_slice(&packet).unwrap();
    let count = rest.len().div_ceil(size);
    let fragment = |(number, part): (usize, &[u8])| {
        let mut header = header.clone();
        (header.dont_fragment, header.more_fragments) = (false, number + 1 < count);
        header.fragment_offset = u16::try_from(number * size / 8).unwrap().try_into().unwrap();
        header.set_payload_len(part.len()).unwrap();
        header.header_checksum = header.calc_header_checksum();
        let mut bytes = Vec::new();
        header.write(&mut bytes).unwrap();
        bytes.extend(part);
        bytes
    };
    rest.chunks(size).enumerate().map(fragment).collect()
}

/// Bytes from hexadecimal digits.
pub(crate) fn unhex(text: &str) -> Vec<u8> {
    (0..text.len() / 2).map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).unwrap()).collect()
}

/// Packets around the inputs of a corpus: as bytes of a stream, of a datagram and of a line, and inside valid frames.
pub(crate) fn wrapped(inputs: &Inputs) -> Capture {
    let mut capture = Capture::new();
    for (number, bytes) in (0_u32..).zip(inputs.values()) {
        let mut stream = Flow::new(2 * number, BCAP);
        let halves = bytes.split_at(bytes.len() / 2);
        for from in [From::Client, From::Server] {
            capture.tcp(&mut stream, from, halves.0);
            capture.tcp(&mut stream, from, halves.1);
        }
        // a new connection, because the bytes above may have announced a long frame
        let mut stream = Flow::new(2 * number + 1, BCAP);
        let lines = [b"0,", &bytes[..], b"\r"].concat();
        for (from, code) in [(From::Client, 102), (From::Client, 64), (From::Server, 0), (From::Server, 0x900)] {
            for frame in [frame(code, &argument(bytes)), frame(code, bytes)] {
                capture.tcp(&mut stream, from, &frame);
                capture.udp(&stream, from, &frame);
            }
            capture.udp(&stream, from, bytes);
            let mut text = Flow::new(4 * number + u32::from(code == 0), RAC);
            capture.tcp(&mut text, from, bytes);
            capture.tcp(&mut text, from, &lines);
        }
    }
    capture
}

/// A frame with these bytes between header and EOT.
pub(crate) fn frame(code: u32, body: &[u8]) -> Vec<u8> {
    let length = u32::try_from(body.len() + 16).unwrap();
    let head = [&[1][..], &length.to_le_bytes(), &[7, 0, 0, 0], &code.to_le_bytes(), &[1, 0]].concat();
    [&head, body, &[4]].concat()
}

/// An argument with these bytes as its value.
pub(crate) fn argument(value: &[u8]) -> Vec<u8> {
    [&u32::try_from(value.len()).unwrap().to_le_bytes(), value].concat()
}

/// A frame with a serial number, its first attempt's, a code and arguments.
pub(crate) fn numbered(serial: u8, first: u8, code: u32, arguments: &[Vec<u8>]) -> Vec<u8> {
    let body: Vec<u8> = arguments.iter().flat_map(|value| argument(value)).collect();
    let mut frame = frame(code, &body);
    (frame[5], frame[7], frame[13]) = (serial, first, u8::try_from(arguments.len()).unwrap());
    frame
}

/// An I4.
pub(crate) fn i4(number: u8) -> Vec<u8> {
    vec![3, 0, 1, 0, 0, 0, number, 0, 0, 0]
}

/// A BSTR.
pub(crate) fn bstr(text: &str) -> Vec<u8> {
    let data: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    [&[8, 0, 1, 0, 0, 0], &u32::try_from(data.len()).unwrap().to_le_bytes()[..], &data].concat()
}

/// An array of R8.
pub(crate) fn r8(numbers: &[f64]) -> Vec<u8> {
    let count = u32::try_from(numbers.len()).unwrap().to_le_bytes();
    let data: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    [&[5, 0x20][..], &count, &data].concat()
}

/// An array of VARIANT.
pub(crate) fn list(values: &[Vec<u8>]) -> Vec<u8> {
    [&[12, 0x20][..], &u32::try_from(values.len()).unwrap().to_le_bytes(), &values.concat()].concat()
}
