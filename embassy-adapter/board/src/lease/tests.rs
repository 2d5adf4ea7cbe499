//! Leases of a hostile server, given to smoltcp through the check.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::vec;
use std::vec::Vec;

use bcap_test_support::dhcp::{Answer, GOOD};
use bcap_test_support::frames::syn;
use proptest::prelude::*;
use smoltcp::iface::{self, Interface, SocketSet};
use smoltcp::phy::{DeviceCapabilities, Medium};
use smoltcp::socket::{dhcpv4, tcp};
use smoltcp::time::Instant;
use smoltcp::wire::{DhcpMessageType, DhcpPacket, DhcpRepr, EthernetAddress, IpCidr, UdpPacket};

use super::*;
use crate::Settings;
use crate::host::is_host_in;

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 0x15];
const SERVER: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 2);
const BOARD: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 15);
/// A machine of another network.
const STRANGER: Ipv4Addr = Ipv4Addr::new(172, 16, 0, 9);

/// An Ethernet link with the check in front of the board.
struct Link {
    checks: bool,
    arrived: Vec<Vec<u8>>,
    sent: Vec<Vec<u8>>,
}

impl smoltcp::phy::Device for Link {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Sent<'a>;

    fn receive(&mut self, _: Instant) -> Option<(Frame, Sent<'_>)> {
        let mut frame = self.arrived.pop()?;
        if self.checks && check(&mut frame, MAC, is_host_in).is_err() {
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

struct Frame(Vec<u8>);

impl smoltcp::phy::RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(&self.0)
    }
}

struct Sent<'a>(&'a mut Vec<Vec<u8>>);

impl smoltcp::phy::TxToken for Sent<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        let mut frame = vec![0; len];
        let result = fill(&mut frame);
        self.0.push(frame);
        result
    }
}

/// The result of 100 s with a server, and a connection from another network.
#[derive(Debug, Default, PartialEq)]
struct Outcome {
    /// The requests that the server got.
    requests: usize,
    lease: Option<(Ipv4Addr, Option<Ipv4Addr>)>,
}

/// Runs the network stack of a board with a server that gives `answer`, as embassy-net runs it.
fn run(answer: Answer, checks: bool) -> Outcome {
    let mut link = Link { checks, arrived: Vec::new(), sent: Vec::new() };
    let mut interface = Interface::new(iface::Config::new(EthernetAddress(MAC).into()), &mut link, Instant::ZERO);
    let mut sockets = SocketSet::new(Vec::new());
    let dhcp = sockets.add(dhcpv4::Socket::new());
    let buffer = || tcp::SocketBuffer::new(vec![0; 512]);
    let listener = sockets.add(tcp::Socket::new(buffer(), buffer()));
    sockets.get_mut::<tcp::Socket<'_>>(listener).listen(5006).unwrap();
    let mut outcome = Outcome::default();
    for millis in (0..100_000).step_by(50) {
        let now = Instant::from_millis(millis);
        interface.poll(now, &mut link, &mut sockets);
        match sockets.get_mut::<dhcpv4::Socket<'_>>(dhcp).poll() {
            Some(dhcpv4::Event::Configured(config)) => {
                outcome.lease = Some((config.address.address(), config.router));
                interface.update_ip_addrs(|own| *own = [IpCidr::Ipv4(config.address)].into_iter().collect());
                match config.router {
                    Some(router) => drop(interface.routes_mut().add_default_ipv4_route(router).unwrap()),
                    None => drop(interface.routes_mut().remove_default_ipv4_route()),
                }
                link.arrived.push(syn(MAC, STRANGER, BOARD, [50_000, 5006]));
            }
            Some(dhcpv4::Event::Deconfigured) => outcome.lease = None,
            None => {}
        }
        interface.poll_at(now, &sockets);
        for frame in link.sent.drain(..) {
            let message = frame.get(ETHERNET + IPV4_HEADER + UDP_HEADER..).unwrap_or_default();
            let Ok(packet) = DhcpPacket::new_checked(message) else { continue };
            let Ok(request) = DhcpRepr::parse(&packet) else { continue };
            outcome.requests += 1;
            let kind = match request.message_type {
                DhcpMessageType::Discover => DhcpMessageType::Offer,
                _ => answer.kind,
            };
            link.arrived.push(Answer { kind, transaction: request.transaction_id, ..answer }.frame(MAC));
        }
    }
    outcome
}

#[test]
fn the_network_stack_gets_no_lease_that_it_cannot_bear() {
    let lease = |router| Some((BOARD, router));
    let router = |router: [u8; 4]| Answer { router: Some(router.into()), ..GOOD };
    let address = |address: [u8; 4]| Answer { address: address.into(), ..GOOD };
    let mask = |mask: [u8; 4]| Answer { mask: mask.into(), ..GOOD };
    let server = |server: [u8; 4]| Answer { server: server.into(), ..GOOD };
    let time = |times| Answer { times, ..GOOD };
    for (answer, expected) in [
        (GOOD, lease(Some(SERVER))),
        (router([0, 0, 0, 0]), lease(None)),
        (router([255, 255, 255, 255]), lease(None)),
        (router([224, 0, 0, 1]), lease(None)),
        (router([127, 0, 0, 1]), lease(None)),
        (router([10, 0, 2, 255]), lease(None)),
        (router([10, 0, 2, 15]), lease(None)),
        (router([192, 168, 7, 1]), lease(Some(Ipv4Addr::new(192, 168, 7, 1)))),
        (Answer { router: None, ..GOOD }, lease(None)),
        (address([0, 0, 0, 0]), None),
        (address([10, 0, 2, 0]), None),
        (address([10, 0, 2, 255]), None),
        (address([239, 1, 2, 3]), None),
        (address([127, 0, 0, 1]), None),
        (mask([0, 0, 0, 0]), None),
        (mask([255, 0, 255, 0]), None),
        (mask([255, 255, 255, 255]), lease(Some(SERVER))),
        (server([0, 0, 0, 0]), None),
        (server([127, 0, 0, 1]), None),
        (time([Some(0), None, None]), None),
        (time([Some(9), None, None]), None),
        (time([Some(10), None, None]), lease(Some(SERVER))),
        (time([Some(3600), Some(0), Some(1)]), lease(Some(SERVER))),
        (time([Some(3600), None, Some(0)]), lease(Some(SERVER))),
        (time([Some(u32::MAX), Some(u32::MAX), Some(u32::MAX)]), lease(Some(SERVER))),
        (time([None, None, None]), lease(Some(SERVER))),
    ] {
        let outcome = run(answer, true);
        assert_eq!(outcome.lease, expected, "{answer:?}");
        // ten of a lease of 10 s that is renewed, a request every 10 s without an answer
        assert!((2..=30).contains(&outcome.requests), "{answer:?}: {outcome:?}");
    }
}

/// Shows that the check is needed. Once smoltcp is fixed, the check of the router can be removed.
#[test]
fn smoltcp_panics_and_floods_without_the_check() {
    for router in [[0, 0, 0, 0], [255, 255, 255, 255], [224, 0, 0, 1]] {
        let answer = Answer { router: Some(router.into()), ..GOOD };
        assert!(catch_unwind(AssertUnwindSafe(|| run(answer, false))).is_err(), "{router:?}");
    }
    for times in [[Some(0), None, None], [Some(3600), None, Some(0)]] {
        let outcome = run(Answer { times, ..GOOD }, false);
        assert!(outcome.requests > 100, "{times:?}: {outcome:?}");
    }
}

#[test]
fn a_server_on_a_far_network_and_an_address_of_the_robot_are_checked() {
    let settings = Settings::read(b"robot=10.0.2.15:5007", |line, _| panic!("{line:?}"));
    let refused = check(&mut GOOD.frame(MAC), MAC, |own| settings.accepts(own)).unwrap_err();
    assert_eq!(refused, RefusedLease { server: SERVER, address: BOARD, reason: Reason::Address });
    let other = Answer { address: Ipv4Addr::new(10, 0, 2, 16), ..GOOD };
    assert_eq!(check(&mut other.frame(MAC), MAC, |own| settings.accepts(own)), Ok(Some(Lease { is_offer: false })));
    // the lease of another client
    assert_eq!(check(&mut GOOD.frame(MAC), [2; 6], |own| settings.accepts(own)), Ok(None));
    assert_eq!(check(&mut syn(MAC, STRANGER, BOARD, [50_000, 5006]), MAC, |_| false), Ok(None));
}

proptest! {
    #[test]
    fn the_stack_sees_valid_leases_only(
        options in prop::collection::vec(
            (
                prop::sample::select(vec![PAD, MASK, ROUTER, LEASE_TIME, MESSAGE_TYPE, RENEWAL_TIME, REBINDING_TIME, END, 6, 54]),
                prop::sample::select(vec![0_u32, 1, 5, 10, 3600, 0x0a00_0202, 0x0a00_02ff, 0xe000_0001, 0xffff_ff00, u32::MAX]),
                0_u8..9,
            ),
            0..12,
        ),
        cut in 0_usize..400,
    ) {
        let mut frame = Answer { router: None, times: [None; 3], ..GOOD }.frame(MAC);
        let end = frame.len() - 1;
        frame.truncate(end);
        for (kind, value, len) in options {
            frame.extend([kind, len]);
            frame.extend(value.to_be_bytes().iter().cycle().take(len.into()));
        }
        let payload = ETHERNET + IPV4_HEADER + UDP_HEADER;
        frame.truncate(cut.max(payload + OPTIONS));
        if let Ok(Some(lease)) = check(&mut frame, MAC, is_host_in) {
            let packet = DhcpPacket::new_checked(&frame[payload..]).unwrap();
            let Ok(dhcp) = DhcpRepr::parse(&packet) else { return Ok(()) };
            prop_assert_eq!(lease.is_offer, dhcp.message_type == DhcpMessageType::Offer);
            prop_assert!(dhcp.router.is_none_or(is_host));
            prop_assert!(dhcp.lease_duration.is_none_or(|seconds| seconds >= SHORTEST_LEASE));
            prop_assert!(dhcp.renew_duration.is_none_or(|seconds| seconds >= SHORTEST_RENEWAL));
            prop_assert!(dhcp.rebind_duration.is_none_or(|seconds| seconds >= SHORTEST_RENEWAL));
            prop_assert!(dhcp.subnet_mask.is_none_or(|mask| !mask.is_unspecified()));
        }
    }
}

#[test]
fn the_checksum_fits_a_hidden_option() {
    for router in [[0, 0, 0, 0], [255, 255, 255, 255], [224, 0, 0, 1]] {
        let mut frame = Answer { router: Some(router.into()), times: [Some(60), Some(1), Some(2)], ..GOOD }.frame(MAC);
        assert_eq!(check(&mut frame, MAC, is_host_in), Ok(Some(Lease { is_offer: false })));
        let udp = UdpPacket::new_checked(&frame[ETHERNET + IPV4_HEADER..]).unwrap();
        assert!(udp.checksum() != 0 && udp.verify_checksum(&SERVER.into(), &Ipv4Addr::BROADCAST.into()));
        let packet = DhcpPacket::new_checked(udp.payload()).unwrap();
        let dhcp = DhcpRepr::parse(&packet).unwrap();
        assert_eq!((dhcp.router, dhcp.renew_duration, dhcp.rebind_duration), (None, None, None));
    }
}
