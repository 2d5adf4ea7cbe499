//! The machines of the board's network that take part in ARP. Packets of other senders from this network do not reach the network stack.
//!
//! ```text
//!  ARP for the board ───────────────► its sender is known
//!  IPv4 from a known sender ────────► network stack, with an ARP reply of the sender twice a second
//!  IPv4 from an unknown sender ─────► dropped; the board asks for the sender by ARP
//!  IPv4 from another network ───────► network stack
//! ```
//!
//! smoltcp 0.13.1 sends one ARP request a second, whatever the number of missing neighbors, and a socket whose neighbor is missing is silent
//! for a second. With each lease it forgets all neighbors. Under a flood from invented addresses a real neighbor would then have to wait for
//! the one request in many that asks for it. So the flood is dropped here, and the stack is told about neighbors before it asks.
//!
//! A sender that takes part in ARP loses one packet at most: it retransmits, and by then it has answered.

use core::net::Ipv4Addr;

use crate::find;
use crate::host::{Own, is_host, is_other};

/// The size of an ARP frame.
pub(crate) const FRAME: usize = 42;
/// The neighbors that are known; smoltcp keeps as many.
const KNOWN: usize = 8;
/// The pause between two replies about the same neighbor, and between two requests, in milliseconds.
const TELL_PAUSE: u32 = 500;
const ASK_PAUSE: u32 = 10;

const ETHERNET: usize = 14;
const IPV4: [u8; 2] = [0x08, 0x00];
const ARP: [u8; 2] = [0x08, 0x06];
/// The start of an ARP message: Ethernet, IPv4, and the sizes of their addresses.
const HEAD: [u8; 6] = [0, 1, 8, 0, 6, 4];
const REQUEST: u8 = 1;
const REPLY: u8 = 2;
const UDP: u8 = 17;
/// The UDP ports that any sender may use: DHCP and `bcap board find`.
const OPEN: [u16; 2] = [68, find::PORT];

type Mac = [u8; 6];

/// A machine that has sent an ARP request or reply to the board.
#[derive(Clone, Copy, Debug)]
struct Neighbor {
    address: Ipv4Addr,
    mac: Mac,
    /// When the network stack was told about it, or it was asked, in milliseconds. It wraps.
    told_at: u32,
}

/// The known neighbors, the last sender first.
#[derive(Debug, Default)]
pub(crate) struct Neighbors {
    known: [Option<Neighbor>; KNOWN],
    /// The neighbor to ask for.
    ask: Option<Ipv4Addr>,
    asked_at: u32,
    /// The neighbor to tell the network stack about.
    tell: Option<Neighbor>,
}

impl Neighbors {
    /// Tells whether the network stack may have a received frame. `own` is the address of the board, `now` is in milliseconds and wraps.
    pub(crate) fn may_pass(&mut self, frame: &[u8], own: Own, mac: Mac, now: u32) -> bool {
        let Some((header, packet)) = frame.split_first_chunk::<ETHERNET>() else { return true };
        let [to @ .., _, _, _, _, _, _, _, _] = header;
        if header.ends_with(&ARP) {
            self.learn(packet, own, now);
            return true;
        }
        let sender = address(packet, 12).filter(|sender| is_neighbor(own, *sender));
        let (Some(sender), true, true) = (sender, header.ends_with(&IPV4), *to == mac) else { return true };
        if is_open(packet) {
            return true;
        }
        let from = header.get(6..12).unwrap_or_default();
        let is_known = self.refresh(sender, from, now);
        if !is_known && now.wrapping_sub(self.asked_at) >= ASK_PAUSE {
            (self.ask, self.asked_at) = (Some(sender), now);
        }
        is_known
    }

    /// Returns the ARP request to send, if there is one.
    pub(crate) fn request(&mut self, own: Own, mac: Mac) -> Option<[u8; FRAME]> {
        let asked = self.ask.take()?;
        Some(arp([0xff; 6], REQUEST, (mac, own.0), ([0; 6], asked)))
    }

    /// Returns the ARP reply that the network stack must get, if there is one.
    pub(crate) fn reply(&mut self, own: Own, mac: Mac) -> Option<[u8; FRAME]> {
        let neighbor = self.tell.take()?;
        Some(arp(mac, REPLY, (neighbor.mac, neighbor.address), (mac, own.0)))
    }

    /// Remembers the sender of an ARP message for the board.
    fn learn(&mut self, message: &[u8], own: Own, now: u32) {
        let Some(mac) = message.get(8..).and_then(|rest| rest.first_chunk::<6>()) else { return };
        let (sender, target) = (address(message, 14), address(message, 24));
        let is_group = mac.first().is_some_and(|first| first & 1 != 0);
        let sender =
            sender.filter(|sender| message.starts_with(&HEAD) && target == Some(own.0) && is_neighbor(own, *sender));
        if let (Some(address), false) = (sender, is_group) {
            let place = self.place(address).unwrap_or(KNOWN - 1);
            self.move_to_front(place, Neighbor { address, mac: *mac, told_at: now });
        }
    }

    /// Records that a known neighbor has sent a packet; returns false for an unknown one.
    fn refresh(&mut self, sender: Ipv4Addr, from: &[u8], now: u32) -> bool {
        let place = self.place(sender);
        let Some((place, mut neighbor)) = place.and_then(|place| Some((place, (*self.known.get(place)?)?))) else {
            return false;
        };
        if now.wrapping_sub(neighbor.told_at) >= TELL_PAUSE {
            neighbor.told_at = now;
            // another machine may have taken over the address
            match neighbor.mac == from {
                true => self.tell = Some(neighbor),
                false => self.ask = Some(sender),
            }
        }
        self.move_to_front(place, neighbor);
        true
    }

    fn place(&self, address: Ipv4Addr) -> Option<usize> {
        self.known.iter().position(|known| known.is_some_and(|known| known.address == address))
    }

    fn move_to_front(&mut self, place: usize, neighbor: Neighbor) {
        if let Some(known) = self.known.get_mut(..=place) {
            known.rotate_right(1);
            known.iter_mut().take(1).for_each(|first| *first = Some(neighbor));
        }
    }
}

/// Returns whether an address is another machine's in the network of the board.
fn is_neighbor(own: Own, address: Ipv4Addr) -> bool {
    let hosts = u32::MAX.checked_shr(own.1.into()).unwrap_or(0);
    (own.0.to_bits() ^ address.to_bits()) & !hosts == 0 && is_host(address) && is_other(own, address)
}

/// Returns whether a packet is a datagram of UDP to a port that any sender may use.
fn is_open(packet: &[u8]) -> bool {
    let header = packet.first().map_or(0, |first| usize::from(first & 0xf) * 4);
    let port = packet.get(header + 2..).and_then(|rest| rest.first_chunk()).map(|port| u16::from_be_bytes(*port));
    packet.get(9) == Some(&UDP) && port.is_some_and(|port| OPEN.contains(&port))
}

/// Makes an ARP frame with its sender and its target.
fn arp(to: Mac, operation: u8, (from, sender): (Mac, Ipv4Addr), (mac, target): (Mac, Ipv4Addr)) -> [u8; FRAME] {
    let (sender, target) = (sender.octets(), target.octets());
    let parts: [&[u8]; 9] = [&to, &from, &ARP, &HEAD, &[0, operation], &from, &sender, &mac, &target];
    let mut frame = [0; FRAME];
    frame.iter_mut().zip(parts.into_iter().flatten()).for_each(|(to, from)| *to = *from);
    frame
}

fn address(bytes: &[u8], at: usize) -> Option<Ipv4Addr> {
    bytes.get(at..)?.first_chunk::<4>().map(|octets| Ipv4Addr::from(*octets))
}

#[cfg(test)]
mod tests {
    use bcap_test_support::frames::{packet, syn};
    use smoltcp::wire::IpProtocol;
    use std::vec::Vec;

    use super::*;

    const BOARD: Mac = [2, 0, 0, 0, 0, 0x15];
    const OWN: Own = (Ipv4Addr::new(10, 0, 2, 15), 24);
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
        assert!(!neighbors.may_pass(&syn_from(PLC), OWN, BOARD, 1000));
        let request = neighbors.request(OWN, BOARD);
        assert_eq!(request, Some(arp([0xff; 6], REQUEST, (BOARD, OWN.0), ([0; 6], PLC))));
        assert_eq!(neighbors.request(OWN, BOARD), None, "once");
        assert!(neighbors.may_pass(&answer(MACHINE, PLC), OWN, BOARD, 1001), "the stack learns it, too");
        assert!(neighbors.may_pass(&syn_from(PLC), OWN, BOARD, 2000));
        assert_eq!(neighbors.request(OWN, BOARD), None);
    }

    #[test]
    fn invented_senders_are_dropped_at_a_hundred_requests_a_second() {
        let mut neighbors = Neighbors::default();
        let asked = (0..1000_u32).filter(|now| {
            let from = [10, 0, 2, 20 + u8::try_from(now % 200).unwrap()];
            assert!(!neighbors.may_pass(&syn_from(from), OWN, BOARD, now + 1000));
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
        assert!(neighbors.may_pass(&request, OWN, BOARD, u32::MAX - 100));
        let told = (0..2000_u32).filter(|now| {
            assert!(neighbors.may_pass(&syn_from(PLC), OWN, BOARD, *now));
            let reply = neighbors.reply(OWN, BOARD);
            assert!(reply.is_none_or(|reply| reply == answer(MACHINE, PLC)));
            reply.is_some()
        });
        assert_eq!(told.count(), 4);
    }

    #[test]
    fn a_machine_that_took_over_an_address_is_asked_for_and_not_told() {
        let mut neighbors = Neighbors::default();
        assert!(neighbors.may_pass(&answer(OTHER, PLC), OWN, BOARD, 0));
        assert!(neighbors.may_pass(&syn_from(PLC), OWN, BOARD, 600));
        assert_eq!(neighbors.reply(OWN, BOARD), None, "the MAC address is the earlier one");
        assert!(neighbors.request(OWN, BOARD).is_some());
        assert!(neighbors.may_pass(&answer(MACHINE, PLC), OWN, BOARD, 601));
        assert!(neighbors.may_pass(&syn_from(PLC), OWN, BOARD, 1200));
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
            (syn_from([172, 16, 0, 1]), true),
            (syn_from([10, 0, 3, 2]), true),
            (syn_from(PLC), false),
            (broadcast, true),
            (udp(68), true),
            (udp(find::PORT), true),
            (udp(69), false),
            ([0; 14].to_vec(), true),
            (Vec::new(), true),
            (syn_from(PLC)[..30].to_vec(), false),
        ] {
            assert_eq!(neighbors.may_pass(&frame, OWN, BOARD, 0), passes, "{frame:?}");
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
            assert!(neighbors.may_pass(&message, OWN, BOARD, 0));
            assert!(neighbors.known.iter().all(Option::is_none), "{message:?}");
        }
        // the one that was silent longest makes room
        for last in 1..=9 {
            assert!(neighbors.may_pass(&answer(MACHINE, [10, 0, 2, last].into()), OWN, BOARD, 0));
        }
        assert!(!neighbors.may_pass(&syn_from([10, 0, 2, 1]), OWN, BOARD, 0));
        assert!(neighbors.may_pass(&syn_from([10, 0, 2, 2]), OWN, BOARD, 0));
    }
}
