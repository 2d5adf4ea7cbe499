//! Packets with IP and TCP or UDP headers around recorded bytes.

use std::net::{IpAddr, Ipv6Addr};

use etherparse::{IpHeaders, PacketBuilder, PacketBuilderStep, TcpHeader, TcpOptionElement};

use super::ends::Ends;
use crate::role::Role;

/// The maximum size of a TCP segment in bytes. With its headers it must be shorter than 64 KiB.
const SEGMENT: usize = 32 << 10;
/// The maximum size of a UDP datagram over IPv4 in bytes.
const DATAGRAM: usize = 65_507;
const HOPS: u8 = 64;
/// With the scale of the handshake more than a gigabyte, so that no tool sees a full window.
const WINDOW: u16 = u16::MAX;
const WINDOW_SCALE: u8 = 14;

/// One connection: the next sequence numbers of its two directions.
#[derive(Debug)]
pub(super) struct Flow {
    ends: Ends,
    client: u32,
    server: u32,
}

impl Flow {
    /// Creates a flow. `number` makes its sequence numbers differ from an earlier flow with the same ports.
    pub(super) fn new(ends: Ends, number: u32) -> Self {
        // far apart for consecutive numbers
        let first = number.wrapping_mul(0x9e37_79b1);
        Self { ends, client: first, server: first.wrapping_add(1 << 30) }
    }

    /// Returns the packets that open a connection; none for UDP.
    pub(super) fn handshake(&self) -> Vec<Vec<u8>> {
        if !self.ends.is_tcp {
            return Vec::new();
        }
        let (client, server) = (self.client, self.server);
        let syn = TcpHeader { syn: true, ..self.header(Role::Request, client.wrapping_sub(1), None) };
        let accepted = self.header(Role::Response, server.wrapping_sub(1), Some(client));
        let accepted = TcpHeader { syn: true, ..accepted };
        let last = self.header(Role::Request, client, Some(server));
        [(Role::Request, syn), (Role::Response, accepted), (Role::Request, last)]
            .map(|(sender, mut header)| {
                if header.syn {
                    // one option always fits
                    let _ = header.set_options(&[TcpOptionElement::WindowScale(WINDOW_SCALE)]);
                }
                self.tcp(sender, header, &[])
            })
            .into()
    }

    /// Returns the packets of sent bytes.
    pub(super) fn send(&mut self, sender: Role, bytes: &[u8]) -> Vec<Vec<u8>> {
        if !self.ends.is_tcp {
            return vec![self.udp(sender, bytes.get(..DATAGRAM).unwrap_or(bytes))];
        }
        let segment = |part: &[u8]| {
            let header = TcpHeader { psh: true, ..self.next_header(sender) };
            let packet = self.tcp(sender, header, part);
            let sequence = if sender == Role::Request { &mut self.client } else { &mut self.server };
            *sequence = sequence.wrapping_add(u32::try_from(part.len()).unwrap_or(0));
            packet
        };
        bytes.chunks(SEGMENT).map(segment).collect()
    }

    /// Returns the packets that close a connection; none for UDP.
    pub(super) fn close(&mut self) -> Vec<Vec<u8>> {
        if !self.ends.is_tcp {
            return Vec::new();
        }
        let first = TcpHeader { fin: true, ..self.next_header(Role::Request) };
        let first = self.tcp(Role::Request, first, &[]);
        self.client = self.client.wrapping_add(1);
        let second = TcpHeader { fin: true, ..self.next_header(Role::Response) };
        let second = self.tcp(Role::Response, second, &[]);
        self.server = self.server.wrapping_add(1);
        vec![first, second, self.tcp(Role::Request, self.next_header(Role::Request), &[])]
    }

    /// The header of a segment that acknowledges all preceding bytes.
    fn next_header(&self, sender: Role) -> TcpHeader {
        match sender {
            Role::Request => self.header(sender, self.client, Some(self.server)),
            Role::Response => self.header(sender, self.server, Some(self.client)),
        }
    }

    fn header(&self, sender: Role, sequence: u32, acknowledged: Option<u32>) -> TcpHeader {
        let (from, to) = self.ports(sender);
        let header = TcpHeader::new(from, to, sequence, WINDOW);
        TcpHeader { ack: acknowledged.is_some(), acknowledgment_number: acknowledged.unwrap_or(0), ..header }
    }

    fn tcp(&self, sender: Role, header: TcpHeader, payload: &[u8]) -> Vec<u8> {
        let mut packet = Vec::new();
        // writing to a vector fails only for a payload that is too long, which `SEGMENT` excludes
        let _ = self.ip(sender).tcp_header(header).write(&mut packet, payload);
        packet
    }

    fn udp(&self, sender: Role, payload: &[u8]) -> Vec<u8> {
        let (from, to) = self.ports(sender);
        let mut packet = Vec::new();
        // as above, with `DATAGRAM`
        let _ = self.ip(sender).udp(from, to).write(&mut packet, payload);
        packet
    }

    fn ports(&self, sender: Role) -> (u16, u16) {
        let (client, server) = (self.ends.client.port(), self.ends.server.port());
        if sender == Role::Request { (client, server) } else { (server, client) }
    }

    /// The IP header; if only one end has an IPv4 address, it is mapped to IPv6.
    fn ip(&self, sender: Role) -> PacketBuilderStep<IpHeaders> {
        let (client, server) = (self.ends.client.ip().to_canonical(), self.ends.server.ip().to_canonical());
        let (from, to) = if sender == Role::Request { (client, server) } else { (server, client) };
        match (from, to) {
            (IpAddr::V4(from), IpAddr::V4(to)) => PacketBuilder::ipv4(from.octets(), to.octets(), HOPS),
            (from, to) => PacketBuilder::ipv6(mapped(from).octets(), mapped(to).octets(), HOPS),
        }
    }
}

fn mapped(address: IpAddr) -> Ipv6Addr {
    match address {
        IpAddr::V4(address) => address.to_ipv6_mapped(),
        IpAddr::V6(address) => address,
    }
}
