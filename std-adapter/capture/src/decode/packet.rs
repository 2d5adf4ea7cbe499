//! The headers of a packet: from its link layer to TCP or UDP.

use std::net::{IpAddr, SocketAddr};

use etherparse::{EtherType, IpNumber, LaxNetSlice, LaxSlicedPacket, TcpSlice, TransportSlice, UdpSlice};
use pcap_parser::Linktype;

use super::file::Packet;
use super::fragments::{Fragment, Key};

/// A TCP segment or a UDP datagram.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment<'a> {
    /// Nanoseconds since 1970.
    pub(crate) at: u64,
    pub(crate) from: SocketAddr,
    pub(crate) to: SocketAddr,
    /// The control fields of a TCP segment; `None` for a datagram.
    pub(crate) tcp: Option<Tcp>,
    pub(crate) payload: &'a [u8],
}

/// The fields of TCP that the reassembly needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tcp {
    pub(crate) sequence: u32,
    /// The acknowledged number, if the segment acknowledges.
    pub(crate) acknowledged: Option<u32>,
    pub(crate) syn: bool,
}

impl Tcp {
    /// Returns the first sequence number of the client, if the segment opens a connection.
    pub(crate) fn opens(&self) -> Option<u32> {
        (self.syn && self.acknowledged.is_none()).then_some(self.sequence)
    }
}

/// Why a packet has no segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Skipped<'a> {
    /// The link type is unknown.
    Link(i32),
    /// A fragment of an IPv4 packet.
    Fragment(Fragment<'a>),
    /// A fragment of an IPv6 packet, or of which the capture has only a part.
    Unusable,
    /// Another protocol, or a packet that is cut off inside its headers.
    Other,
}

/// Parses the headers of a packet.
pub(crate) fn segment<'a>(packet: &Packet<'a>) -> Result<Segment<'a>, Skipped<'a>> {
    let sliced = sliced(packet.link, packet.bytes)?;
    let (from, to) = match &sliced.net {
        Some(LaxNetSlice::Ipv4(ip)) if ip.payload().fragmented => {
            return Err(Fragment::new(ip).map_or(Skipped::Unusable, Skipped::Fragment));
        }
        Some(LaxNetSlice::Ipv4(ip)) => {
            (IpAddr::V4(ip.header().source_addr()), IpAddr::V4(ip.header().destination_addr()))
        }
        Some(LaxNetSlice::Ipv6(ip)) if ip.payload().fragmented => return Err(Skipped::Unusable),
        Some(LaxNetSlice::Ipv6(ip)) => {
            (IpAddr::V6(ip.header().source_addr()), IpAddr::V6(ip.header().destination_addr()))
        }
        Some(LaxNetSlice::Arp(_)) | None => return Err(Skipped::Other),
    };
    of_transport(packet.at, from, to, sliced.transport.as_ref())
}

/// Parses the payload of a packet that was reassembled.
pub(crate) fn reassembled(at: u64, key: Key, payload: &[u8]) -> Result<Segment<'_>, Skipped<'_>> {
    let transport = match key.protocol {
        IpNumber::TCP => TcpSlice::from_slice(payload).ok().map(TransportSlice::Tcp),
        IpNumber::UDP => UdpSlice::from_slice(payload).ok().map(TransportSlice::Udp),
        _ => None,
    };
    of_transport(at, key.from.into(), key.to.into(), transport.as_ref())
}

fn of_transport<'a>(
    at: u64,
    from: IpAddr,
    to: IpAddr,
    transport: Option<&TransportSlice<'a>>,
) -> Result<Segment<'a>, Skipped<'a>> {
    let (ports, tcp, payload) = match transport {
        Some(TransportSlice::Tcp(tcp)) => {
            let fields = Tcp {
                sequence: tcp.sequence_number(),
                acknowledged: tcp.ack().then(|| tcp.acknowledgment_number()),
                syn: tcp.syn(),
            };
            ((tcp.source_port(), tcp.destination_port()), Some(fields), tcp.payload())
        }
        Some(TransportSlice::Udp(udp)) => ((udp.source_port(), udp.destination_port()), None, udp.payload()),
        _ => return Err(Skipped::Other),
    };
    Ok(Segment { at, from: SocketAddr::new(from, ports.0), to: SocketAddr::new(to, ports.1), tcp, payload })
}

/// Finds the IP header after the header of the link layer.
fn sliced(link: Linktype, bytes: &[u8]) -> Result<LaxSlicedPacket<'_>, Skipped<'_>> {
    const RAW_OF_BSD: i32 = 12;
    const RAW_OF_OPENBSD: i32 = 14;
    const LOOP: Linktype = Linktype(108);
    const SLL: Linktype = Linktype(113);
    const SLL2: Linktype = Linktype(276);
    let ip = |bytes| LaxSlicedPacket::from_ip(bytes).map_err(|_| Skipped::Other);
    let rest = |count: usize| bytes.get(count..).ok_or(Skipped::Other);
    let ether_type = |at: usize| {
        let field = bytes.get(at..).and_then(<[u8]>::first_chunk).ok_or(Skipped::Other)?;
        Ok(EtherType(u16::from_be_bytes(*field)))
    };
    match link {
        Linktype::ETHERNET => LaxSlicedPacket::from_ethernet(bytes).map_err(|_| Skipped::Other),
        // an address family, in the byte order of the capturing machine; the version is in the IP header too
        Linktype::NULL | LOOP => ip(rest(4)?),
        Linktype::RAW | Linktype::IPV4 | Linktype::IPV6 | Linktype(RAW_OF_BSD | RAW_OF_OPENBSD) => ip(bytes),
        SLL => Ok(LaxSlicedPacket::from_ether_type(ether_type(14)?, rest(16)?)),
        SLL2 => Ok(LaxSlicedPacket::from_ether_type(ether_type(0)?, rest(20)?)),
        Linktype(other) => Err(Skipped::Link(other)),
    }
}
