//! Frames of real and invented neighbors, alone and in front of smoltcp.

use std::collections::VecDeque;
use std::vec;
use std::vec::Vec;

use bcap_test_support::frames::{packet, syn};
use smoltcp::iface::{self, Interface, SocketSet};
use smoltcp::phy::{self, DeviceCapabilities, Medium};
use smoltcp::socket::tcp;
use smoltcp::time::Instant;
use smoltcp::wire::{EthernetAddress, IpCidr, IpProtocol, TcpPacket};

use super::*;

const BOARD: Mac = [2, 0, 0, 0, 0, 0x15];
const OWN: Own = (Ipv4Addr::new(10, 0, 2, 15), 24);
const ROUTE: Route = Route { own: OWN, router: None };
/// The sender of the frames of [`syn`], and another machine.
const MACHINE: Mac = [2, 0, 0, 0, 0, 0xfe];
const OTHER: Mac = [2, 0, 0, 0, 0, 0x77];
const PLC: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 2);

fn syn_from(from: impl Into<Ipv4Addr>) -> Vec<u8> {
    syn(BOARD, from.into(), OWN.0, [50_000, 5006])
}

fn answer(mac: Mac, address: Ipv4Addr) -> [u8; FRAME] {
    arp(BOARD, REPLY, (mac, address), (BOARD, OWN.0))
}

#[test]
fn an_unknown_sender_is_asked_for_and_passes_after_its_answer() {
    let mut neighbors = Neighbors::default();
    assert!(!neighbors.may_pass(&syn_from(PLC), ROUTE, BOARD, 1000));
    let request = neighbors.request(OWN, BOARD);
    assert_eq!(request, Some(arp([0xff; 6], REQUEST, (BOARD, OWN.0), ([0; 6], PLC))));
    assert_eq!(neighbors.request(OWN, BOARD), None, "once");
    assert!(neighbors.may_pass(&answer(MACHINE, PLC), ROUTE, BOARD, 1001), "the stack learns it, too");
    assert!(neighbors.may_pass(&syn_from(PLC), ROUTE, BOARD, 2000));
    assert_eq!(neighbors.request(OWN, BOARD), None);
}

#[test]
fn invented_senders_are_dropped_at_a_hundred_requests_a_second() {
    let mut neighbors = Neighbors::default();
    let asked = (0..1000_u32).filter(|now| {
        let from = [10, 0, 2, 20 + u8::try_from(now % 200).unwrap()];
        assert!(!neighbors.may_pass(&syn_from(from), ROUTE, BOARD, now + 1000));
        neighbors.request(OWN, BOARD).is_some()
    });
    assert_eq!(asked.count(), 100);
    assert!(neighbors.reply(OWN, BOARD).is_none());
}

#[test]
fn the_stack_is_told_about_a_known_sender_twice_a_second() {
    let mut neighbors = Neighbors::default();
    // a request for the board is as good as an answer
    let request = arp([0xff; 6], REQUEST, (MACHINE, PLC), ([0; 6], OWN.0));
    assert!(neighbors.may_pass(&request, ROUTE, BOARD, u32::MAX - 100));
    let told = (0..2000_u32).filter(|now| {
        assert!(neighbors.may_pass(&syn_from(PLC), ROUTE, BOARD, *now));
        let reply = neighbors.reply(OWN, BOARD);
        assert!(reply.is_none_or(|reply| reply == answer(MACHINE, PLC)));
        reply.is_some()
    });
    assert_eq!(told.count(), 4);
}

#[test]
fn a_machine_that_took_over_an_address_is_asked_for_and_not_told() {
    let mut neighbors = Neighbors::default();
    assert!(neighbors.may_pass(&answer(OTHER, PLC), ROUTE, BOARD, 0));
    assert!(neighbors.may_pass(&syn_from(PLC), ROUTE, BOARD, 600));
    assert_eq!(neighbors.reply(OWN, BOARD), None, "the MAC address is the earlier one");
    assert!(neighbors.request(OWN, BOARD).is_some());
    assert!(neighbors.may_pass(&answer(MACHINE, PLC), ROUTE, BOARD, 601));
    assert!(neighbors.may_pass(&syn_from(PLC), ROUTE, BOARD, 1200));
    assert_eq!(neighbors.reply(OWN, BOARD), Some(answer(MACHINE, PLC)));
}

#[test]
fn packets_of_other_networks_need_a_known_router() {
    let mut neighbors = Neighbors::default();
    let far = syn_from([172, 16, 0, 1]);
    assert!(!neighbors.may_pass(&far, ROUTE, BOARD, 1000), "there is no route");
    assert_eq!(neighbors.request(OWN, BOARD), None);
    let route = Route { router: Some(PLC), ..ROUTE };
    assert!(!neighbors.may_pass(&far, route, BOARD, 1000));
    let request = neighbors.request(OWN, BOARD);
    assert_eq!(request, Some(arp([0xff; 6], REQUEST, (BOARD, OWN.0), ([0; 6], PLC))));
    assert!(neighbors.may_pass(&answer(MACHINE, PLC), route, BOARD, 1001));
    assert!(neighbors.may_pass(&far, route, BOARD, 2000));
    assert_eq!(neighbors.reply(OWN, BOARD), Some(answer(MACHINE, PLC)));
}

#[test]
fn other_frames_pass() {
    let mut neighbors = Neighbors::default();
    let udp = |port: u16| {
        packet((BOARD, PLC, OWN.0, IpProtocol::Udp), 8, |udp| udp[2..4].copy_from_slice(&port.to_be_bytes()))
    };
    let broadcast = syn([0xff; 6], PLC, OWN.0, [50_000, 5006]);
    for (frame, passes) in [
        (syn_from([172, 16, 0, 1]), false),
        (syn_from([127, 0, 0, 1]), true),
        (syn_from(PLC), false),
        (broadcast, true),
        (udp(68), true),
        (udp(find::PORT), true),
        (udp(69), false),
        ([0; 14].to_vec(), true),
        (Vec::new(), true),
        (syn_from(PLC)[..30].to_vec(), false),
    ] {
        assert_eq!(neighbors.may_pass(&frame, ROUTE, BOARD, 0), passes, "{frame:?}");
    }
}

#[test]
fn nothing_is_learned_from_messages_for_others_and_of_no_machine() {
    let mut neighbors = Neighbors::default();
    let messages = [
        arp(BOARD, REPLY, (MACHINE, PLC), (BOARD, [10, 0, 2, 16].into())),
        arp(BOARD, REPLY, ([0xff; 6], PLC), (BOARD, OWN.0)),
        arp(BOARD, REPLY, (MACHINE, [10, 0, 2, 255].into()), (BOARD, OWN.0)),
        arp(BOARD, REPLY, (MACHINE, [10, 0, 3, 1].into()), (BOARD, OWN.0)),
    ];
    for message in messages {
        assert!(neighbors.may_pass(&message, ROUTE, BOARD, 0));
        assert!(neighbors.known.iter().all(Option::is_none), "{message:?}");
    }
    // the neighbor that was silent longest makes room
    for last in 1..=9 {
        assert!(neighbors.may_pass(&answer(MACHINE, [10, 0, 2, last].into()), ROUTE, BOARD, 0));
    }
    assert!(!neighbors.may_pass(&syn_from([10, 0, 2, 1]), ROUTE, BOARD, 0));
    assert!(neighbors.may_pass(&syn_from([10, 0, 2, 2]), ROUTE, BOARD, 0));
}

/// An Ethernet link with the neighbors in front of smoltcp, as in [`network`](crate::network).
struct Link {
    neighbors: Option<Neighbors>,
    now: u32,
    arrived: VecDeque<Vec<u8>>,
    sent: Vec<Vec<u8>>,
}

struct Frame(Vec<u8>);

struct Sent<'a>(&'a mut Vec<Vec<u8>>);

impl phy::Device for Link {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Sent<'a>;

    fn receive(&mut self, _: Instant) -> Option<(Frame, Sent<'_>)> {
        let Some(neighbors) = &mut self.neighbors else {
            return Some((Frame(self.arrived.pop_front()?), Sent(&mut self.sent)));
        };
        self.sent.extend(neighbors.request(OWN, BOARD).map(|request| request.to_vec()));
        let mut frame = match neighbors.reply(OWN, BOARD) {
            Some(reply) => return Some((Frame(reply.to_vec()), Sent(&mut self.sent))),
            None => self.arrived.pop_front()?,
        };
        if !neighbors.may_pass(&frame, ROUTE, BOARD, self.now) {
            frame.clear();
        }
        Some((Frame(frame), Sent(&mut self.sent)))
    }

    fn transmit(&mut self, _: Instant) -> Option<Sent<'_>> {
        Some(Sent(&mut self.sent))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = 1514;
        capabilities
    }
}

impl phy::RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(&self.0)
    }
}

impl phy::TxToken for Sent<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        let mut frame = vec![0; len];
        let result = fill(&mut frame);
        self.0.push(frame);
        result
    }
}

/// When the PLC begins its handshake, in milliseconds.
const FIRST: u32 = 3510;

/// Floods smoltcp with handshakes for 30 s, and returns the time from the handshake of a PLC during it to its answer, in
/// milliseconds.
fn answered_after(neighbors: Option<Neighbors>) -> Option<u32> {
    let mut link = Link { neighbors, now: 0, arrived: VecDeque::new(), sent: Vec::new() };
    let mut interface = Interface::new(iface::Config::new(EthernetAddress(BOARD).into()), &mut link, Instant::ZERO);
    interface.update_ip_addrs(|addresses| addresses.push(IpCidr::new(OWN.0.into(), OWN.1)).unwrap());
    let buffer = || tcp::SocketBuffer::new(vec![0; 64]);
    let mut sockets = SocketSet::new(Vec::new());
    let handles = [(); 3].map(|()| sockets.add(tcp::Socket::new(buffer(), buffer())));
    // the PLC retransmits as smoltcp and Linux do
    let begun = [0, 1000, 3000, 7000, 15_000].map(|after| after + FIRST);
    for step in 0..3000_u32 {
        link.now = step * 10;
        for handle in handles {
            let socket = sockets.get_mut::<tcp::Socket<'_>>(handle);
            // the longest handshake
            if !socket.is_open() || step % 300 == 0 {
                socket.abort();
                socket.listen(5006).unwrap();
            }
        }
        let last = u8::try_from(step * 7 % 200).unwrap();
        let invented = if step % 2 == 0 { [10, 0, 2, 20 + last] } else { [172, 16, 0, last] };
        if begun.contains(&link.now) {
            link.arrived.push_back(syn_from(PLC));
        }
        link.arrived.push_back(syn_from(invented));
        interface.poll(Instant::from_millis(link.now), &mut link, &mut sockets);
        for frame in core::mem::take(&mut link.sent) {
            if frame.get(38..42) == Some(&PLC.octets()) && frame[12..14] == ARP {
                link.arrived.push_back(answer(MACHINE, PLC).to_vec());
            }
            let is_synack = |tcp: TcpPacket<&[u8]>| tcp.syn() && tcp.ack();
            if frame[12..14] == IPV4
                && frame[30..34] == PLC.octets()
                && TcpPacket::new_checked(&frame[34..]).is_ok_and(is_synack)
            {
                return Some(link.now - FIRST);
            }
        }
    }
    None
}

#[test]
fn a_flood_of_invented_senders_does_not_delay_a_real_one() {
    // after its second SYN: the first SYN triggers the ARP request
    assert_eq!(answered_after(Some(Neighbors::default())), Some(1000));
    // otherwise invented peers have all sockets
    assert_eq!(answered_after(None), None);
}
