//! The machines of the board's network that take part in ARP. The network stack gets only packets whose answer can go to a
//! known neighbor.
//!
//! ```text
//!  ARP for the board ─────────────────────────────► its sender is known
//!  IPv4, its sender or the sender's router known ─► network stack, with an ARP reply of the neighbor twice a second
//!  IPv4, neighbor unknown ────────────────────────► dropped; the board sends an ARP request
//!  IPv4 from another network, without a router ───► dropped
//! ```
//!
//! smoltcp 0.13.1 sends one ARP request a second, whatever the number of missing neighbors, and a socket that cannot send for
//! lack of a neighbor or of a route is silent for a second, even if it has a new peer by then. With each lease it drops all
//! neighbors. Under a flood from invented addresses, the connection of a PLC would be delayed until one of many ARP requests
//! happens to be for it and its socket sends again. So the flood is dropped here, and the stack gets ARP replies before it
//! requests them.
//!
//! A sender that takes part in ARP loses one packet at most: it retransmits, and by then it has answered the ARP request.

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

/// The board's place in its network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Route {
    pub(crate) own: Own,
    pub(crate) router: Option<Ipv4Addr>,
}

impl Route {
    /// Returns the neighbor that packets to an address are sent to.
    fn to(&self, address: Ipv4Addr) -> Option<Ipv4Addr> {
        let Self { own, router } = *self;
        if is_near(own, address) { Some(address).filter(|address| is_other(own, *address)) } else { router }
    }
}

/// A machine that has sent an ARP request or reply to the board.
#[derive(Clone, Copy, Debug)]
struct Neighbor {
    address: Ipv4Addr,
    mac: Mac,
    /// When the network stack last got a reply about it, or it was sent a request, in milliseconds. It wraps.
    told_at: u32,
}

/// The known neighbors, the most recent sender first.
#[derive(Debug, Default)]
pub(crate) struct Neighbors {
    known: [Option<Neighbor>; KNOWN],
    /// The neighbor to send an ARP request for.
    ask: Option<Ipv4Addr>,
    asked_at: u32,
    /// The neighbor of the next ARP reply to the network stack.
    tell: Option<Neighbor>,
}

impl Neighbors {
    /// Returns whether the network stack may have a received frame. `now` is in milliseconds and wraps.
    pub(crate) fn may_pass(&mut self, frame: &[u8], route: Route, mac: Mac, now: u32) -> bool {
        let Some((header, packet)) = frame.split_first_chunk::<ETHERNET>() else { return true };
        let [to @ .., _, _, _, _, _, _, _, _] = header;
        if header.ends_with(&ARP) {
            self.learn(packet, route.own, now);
            return true;
        }
        // the stack drops packets of senders that no machine can be
        let sender = address(packet, 12).filter(|sender| is_host(*sender));
        let (Some(sender), true, true) = (sender, header.ends_with(&IPV4), *to == mac) else { return true };
        if is_open(packet) {
            return true;
        }
        let Some(neighbor) = route.to(sender) else { return false };
        let from = header.get(6..12).unwrap_or_default();
        let is_known = self.refresh(neighbor, from, now);
        if !is_known && now.wrapping_sub(self.asked_at) >= ASK_PAUSE {
            (self.ask, self.asked_at) = (Some(neighbor), now);
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

    /// Stores the sender of an ARP message for the board.
    fn learn(&mut self, message: &[u8], own: Own, now: u32) {
        let Some(mac) = message.get(8..).and_then(|rest| rest.first_chunk::<6>()) else { return };
        let (sender, target) = (address(message, 14), address(message, 24));
        let is_group = mac.first().is_some_and(|first| first & 1 != 0);
        let sender = sender.filter(|sender| {
            message.starts_with(&HEAD)
                && target == Some(own.0)
                && is_near(own, *sender)
                && is_host(*sender)
                && is_other(own, *sender)
        });
        if let (Some(address), false) = (sender, is_group) {
            let place = self.place(address).unwrap_or(KNOWN - 1);
            self.move_to_front(place, Neighbor { address, mac: *mac, told_at: now });
        }
    }

    /// Records that a known neighbor has sent a packet; returns false for an unknown one.
    fn refresh(&mut self, address: Ipv4Addr, from: &[u8], now: u32) -> bool {
        let place = self.place(address);
        let Some((place, mut neighbor)) = place.and_then(|place| Some((place, (*self.known.get(place)?)?))) else {
            return false;
        };
        if now.wrapping_sub(neighbor.told_at) >= TELL_PAUSE {
            neighbor.told_at = now;
            // another machine may have taken over the address
            match neighbor.mac == from {
                true => self.tell = Some(neighbor),
                false => self.ask = Some(address),
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

/// Returns whether an address is in the network of the board.
fn is_near((own, prefix): Own, address: Ipv4Addr) -> bool {
    let hosts = u32::MAX.checked_shr(prefix.into()).unwrap_or(0);
    (own.to_bits() ^ address.to_bits()) & !hosts == 0
}

/// Returns whether a packet is a datagram of UDP to a port that any sender may use.
fn is_open(packet: &[u8]) -> bool {
    let header = packet.first().map_or(0, |first| usize::from(first & 0xf) * 4);
    let port = packet.get(header + 2..).and_then(|rest| rest.first_chunk()).map(|port| u16::from_be_bytes(*port));
    packet.get(9) == Some(&UDP) && port.is_some_and(|port| OPEN.contains(&port))
}

/// Creates an ARP frame with its sender and its target.
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
mod tests;
