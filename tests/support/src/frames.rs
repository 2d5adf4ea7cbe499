//! Frames for a board, as tests send them.

use std::net::Ipv4Addr;

use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol, EthernetRepr, IpProtocol,
    Ipv4Packet, Ipv4Repr, TcpControl, TcpPacket, TcpRepr, TcpSeqNumber, UdpPacket, UdpRepr,
};

/// The header of Ethernet.
const ETHERNET: usize = 14;
/// The sender of all frames.
const SENDER: EthernetAddress = EthernetAddress([2, 0, 0, 0, 0, 0xfe]);

/// The head of a packet: the MAC address of the board, the sender's address, the destination, the protocol.
pub type Head = ([u8; 6], Ipv4Addr, Ipv4Addr, IpProtocol);

/// Creates a frame whose payload of `len` bytes is written by `write`.
pub fn packet((mac, from, to, protocol): Head, len: usize, write: impl FnOnce(&mut [u8])) -> Vec<u8> {
    let ip = Ipv4Repr { src_addr: from, dst_addr: to, next_header: protocol, payload_len: len, hop_limit: 64 };
    let ethernet = EthernetRepr { src_addr: SENDER, dst_addr: EthernetAddress(mac), ethertype: EthernetProtocol::Ipv4 };
    let mut frame = vec![0; ETHERNET + ip.buffer_len() + len];
    ethernet.emit(&mut EthernetFrame::new_unchecked(&mut frame[..]));
    ip.emit(&mut Ipv4Packet::new_unchecked(&mut frame[ETHERNET..]), &ChecksumCapabilities::default());
    write(&mut frame[ETHERNET + ip.buffer_len()..]);
    frame
}

/// Makes the frame of a UDP datagram.
pub fn datagram(mac: [u8; 6], from: Ipv4Addr, to: Ipv4Addr, [src_port, dst_port]: [u16; 2], payload: &[u8]) -> Vec<u8> {
    let udp = UdpRepr { src_port, dst_port };
    let write = |bytes: &mut [u8]| {
        let mut packet = UdpPacket::new_unchecked(bytes);
        let copy = |room: &mut [u8]| room.copy_from_slice(payload);
        udp.emit(&mut packet, &from.into(), &to.into(), payload.len(), copy, &ChecksumCapabilities::default());
    };
    packet((mac, from, to, IpProtocol::Udp), udp.header_len() + payload.len(), write)
}

/// Makes the frame that begins a connection to a port.
pub fn syn(mac: [u8; 6], from: Ipv4Addr, to: Ipv4Addr, [source, port]: [u16; 2]) -> Vec<u8> {
    let tcp = TcpRepr {
        src_port: source,
        dst_port: port,
        control: TcpControl::Syn,
        seq_number: TcpSeqNumber(1),
        ack_number: None,
        window_len: 1000,
        window_scale: None,
        max_seg_size: None,
        sack_permitted: false,
        sack_ranges: [None; 3],
        timestamp: None,
        payload: &[],
    };
    let write = |payload: &mut [u8]| {
        let mut packet = TcpPacket::new_unchecked(payload);
        tcp.emit(&mut packet, &from.into(), &to.into(), &ChecksumCapabilities::default());
    };
    packet((mac, from, to, IpProtocol::Tcp), tcp.buffer_len(), write)
}

/// Makes the ARP reply of a machine that has this address, to the board.
pub fn arp_reply(mac: [u8; 6], board: Ipv4Addr, address: Ipv4Addr) -> Vec<u8> {
    arp(mac, ArpOperation::Reply, address, board)
}

/// Makes the ARP request of a machine that has the address `from`, for the board.
pub fn arp_request(mac: [u8; 6], board: Ipv4Addr, from: Ipv4Addr) -> Vec<u8> {
    arp(mac, ArpOperation::Request, from, board)
}

fn arp(mac: [u8; 6], operation: ArpOperation, from: Ipv4Addr, board: Ipv4Addr) -> Vec<u8> {
    let ethernet = EthernetRepr { src_addr: SENDER, dst_addr: EthernetAddress(mac), ethertype: EthernetProtocol::Arp };
    let arp = ArpRepr::EthernetIpv4 {
        operation,
        source_hardware_addr: SENDER,
        source_protocol_addr: from,
        target_hardware_addr: EthernetAddress(mac),
        target_protocol_addr: board,
    };
    let mut frame = vec![0; ETHERNET + arp.buffer_len()];
    ethernet.emit(&mut EthernetFrame::new_unchecked(&mut frame[..]));
    arp.emit(&mut ArpPacket::new_unchecked(&mut frame[ETHERNET..]));
    frame
}
