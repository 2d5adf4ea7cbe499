//! Tests how the gateway board in QEMU gets an address.

use std::net::{Ipv4Addr, UdpSocket};
use std::thread::sleep;
use std::time::{Duration, Instant};
use std::{env, process};

use bcap_qemu::{Board, Monitor};
use bcap_test_support::dhcp::{Answer, GOOD};
use bcap_test_support::frames::arp_request;
use smoltcp::wire::{ArpOperation, ArpPacket, DhcpMessageType, DhcpPacket, DhcpRepr};

use crate::line;

/// Offsets in a frame: the type, the protocol and the destination port of a datagram without IP options, and the message and
/// the options of DHCP.
const ETHERNET: usize = 14;
const IP_PROTOCOL: usize = 23;
const UDP_DESTINATION: usize = 36;
const DHCP: usize = 42;
const DHCP_OPTIONS: usize = 282;
const UDP: u8 = 17;
const DHCP_SERVER: [u8; 2] = 67_u16.to_be_bytes();
const HOST_NAME: u8 = 12;
const HOST: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 2);

/// The board, and an Ethernet link between it and this test.
struct Linked {
    board: Board,
    link: UdpSocket,
}

impl Linked {
    fn start(options: &[&str], settings: &[&str]) -> Self {
        let link = UdpSocket::bind("127.0.0.1:0").unwrap();
        let board_end = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        link.connect(board_end).unwrap();
        link.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        let netdev = format!("socket,id=n0,udp={},localaddr={board_end}", link.local_addr().unwrap());
        Self { board: Board::start("10.0.2.2:5007", &[options, &["--netdev", &netdev]].concat(), settings), link }
    }

    /// Calls `ask` about every 100 ms until a frame of the board is accepted.
    fn until<T>(
        &mut self,
        limit: Duration,
        ask: impl Fn(&UdpSocket),
        mut accept: impl FnMut(&UdpSocket, &[u8]) -> Option<T>,
    ) -> T {
        let (since, mut next) = (Instant::now(), Instant::now());
        loop {
            assert!(self.board.is_running() && since.elapsed() < limit, "{}", self.board.log());
            if Instant::now() >= next {
                ask(&self.link);
                next = Instant::now() + Duration::from_millis(100);
            }
            let mut frame = [0; 2048];
            // a datagram to a QEMU that is not up is reported as an error
            let Ok(len) = self.link.recv(&mut frame) else { continue };
            if let Some(accepted) = accept(&self.link, &frame[..len]) {
                return accepted;
            }
        }
    }

    /// Waits until the board answers an ARP request for this address.
    fn has(&mut self, address: Ipv4Addr) {
        let ask = |link: &UdpSocket| drop(link.send(&arp_request([0xff; 6], address, HOST)));
        self.until(Duration::from_secs(60), ask, |_, frame| {
            let packet = ArpPacket::new_checked(frame.get(ETHERNET..).filter(|_| frame[12..14] == [8, 6])?).ok()?;
            let is_it = packet.operation() == ArpOperation::Reply && packet.source_protocol_addr() == address.octets();
            is_it.then_some(())
        });
    }
}

/// The board may have to be built first.
const BUILT: Duration = Duration::from_secs(600);

#[test]
fn the_board_asks_for_an_address_with_its_name_and_a_mac_of_its_own() {
    let mut linked = Linked::start(&[], &["hostname=cell-7"]);
    let discover = linked.until(BUILT, |_| {}, |_, frame| asked(frame).map(|_| frame.to_vec()));
    assert_eq!(option(&discover[DHCP_OPTIONS..], HOST_NAME), Some(&b"cell-7"[..]));
    // derived from the address of QEMU's controller, 52:54:00:12:34:56
    let mac = bcap_board::mac::from_unique_id(&[0x52, 0x54, 0, 0x12, 0x34, 0x56]);
    assert_eq!(discover[6..12], mac, "the sender's address");
}

#[test]
fn a_lost_answer_is_asked_for_again_and_without_a_server_the_configured_address_returns() {
    let socket = env::temp_dir().join(format!("bcap-dhcp-{}", process::id()));
    let mut linked = Linked::start(&["--monitor", socket.to_str().unwrap()], &[]);
    let mut monitor = Monitor::new(line::connect(&mut linked.board, &socket));
    let leased = Ipv4Addr::new(10, 0, 2, 77);
    let mut times = Vec::new();
    linked.until(
        BUILT,
        |_| {},
        |link, frame| {
            let (message, transaction) = asked(frame)?;
            times.push(Instant::now());
            let kind = match message {
                // the answer to the first message is lost
                _ if times.len() == 1 => return None,
                DhcpMessageType::Discover => DhcpMessageType::Offer,
                _ => DhcpMessageType::Ack,
            };
            let mac = frame[6..12].try_into().unwrap();
            link.send(&Answer { kind, transaction, address: leased, ..GOOD }.frame(mac)).unwrap();
            (kind == DhcpMessageType::Ack).then_some(())
        },
    );
    let pause = times[1] - times[0];
    assert!(pause < Duration::from_secs(8), "the second message came after {pause:?}");
    linked.has(leased);

    monitor.command("set_link n0 off");
    sleep(Duration::from_secs(1));
    monitor.command("set_link n0 on");
    linked.has(Ipv4Addr::new(10, 0, 2, 15));
}

/// Returns the kind and the transaction of a message of DHCP to a server.
fn asked(frame: &[u8]) -> Option<(DhcpMessageType, u32)> {
    let is_dhcp =
        frame.len() > DHCP_OPTIONS && frame[IP_PROTOCOL] == UDP && frame[UDP_DESTINATION..][..2] == DHCP_SERVER;
    let packet = DhcpPacket::new_checked(frame.get(DHCP..).filter(|_| is_dhcp)?).ok()?;
    Some((DhcpRepr::parse(&packet).ok()?.message_type, packet.transaction_id()))
}

/// Returns the data of a DHCP option.
fn option(mut options: &[u8], wanted: u8) -> Option<&[u8]> {
    while let [kind, len, rest @ ..] = options {
        let (data, after) = rest.split_at_checked((*len).into())?;
        if *kind == wanted {
            return Some(data);
        }
        options = after;
    }
    None
}
