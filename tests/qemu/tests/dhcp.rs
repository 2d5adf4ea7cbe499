//! Tests the frames with which the gateway board in QEMU asks for an address.

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use bcap_qemu::Board;

/// Offsets in a frame: the protocol and the destination port of a datagram without IP options, and the options of DHCP.
const IP_PROTOCOL: usize = 23;
const UDP_DESTINATION: usize = 36;
const DHCP_OPTIONS: usize = 282;
const UDP: u8 = 17;
const DHCP_SERVER: [u8; 2] = 67_u16.to_be_bytes();
const HOST_NAME: u8 = 12;

#[test]
fn the_board_asks_for_an_address_with_its_name_and_a_mac_of_its_own() {
    // an Ethernet link to this test
    let link = UdpSocket::bind("127.0.0.1:0").unwrap();
    let board_end = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    link.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let netdev = format!("socket,id=n0,udp={},localaddr={board_end}", link.local_addr().unwrap());
    let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev], &["hostname=cell-7"]);

    // the board may have to be built first
    let since = Instant::now();
    let discover = loop {
        assert!(board.is_running() && since.elapsed() < Duration::from_secs(600), "no DHCP: {}", board.log());
        let mut frame = [0; 2048];
        let Ok(len) = link.recv(&mut frame) else { continue };
        let frame = &frame[..len];
        if len > DHCP_OPTIONS && frame[IP_PROTOCOL] == UDP && frame[UDP_DESTINATION..][..2] == DHCP_SERVER {
            break frame.to_vec();
        }
    };
    assert_eq!(option(&discover[DHCP_OPTIONS..], HOST_NAME), Some(&b"cell-7"[..]));
    // derived from the address of QEMU's controller, 52:54:00:12:34:56
    let mac = bcap_board::mac::from_unique_id(&[0x52, 0x54, 0, 0x12, 0x34, 0x56]);
    assert_eq!(discover[6..12], mac, "the sender's address");
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
