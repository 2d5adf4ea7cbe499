//! Tests how the gateway board in QEMU answers `bcap board find`, even with hostile hosts on its network.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use bcap_board::find::{Found, PORT, REQUEST, request};
use bcap_qemu::{Board, Sim, TIMEOUT, bcap, free_port, run};
use bcap_test_support::frames::datagram;

use crate::wire::{BOARD, HOST, Wire, World};

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 0x15];
const BROADCAST: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 255);
const NUMBER: [u8; 8] = *b"a number";
/// The source port of the requests.
const HOST_PORT: u16 = 40_000;
/// How long the first answer may take: the board may have to be built first.
const BUILT: Duration = Duration::from_secs(600);
/// A host of the board's network that does not exist.
const NOBODY: Ipv4Addr = Ipv4Addr::new(10, 0, 2, 99);
/// Offsets in a frame: the destination, the ports, and the payload.
const DESTINATION: usize = 30;
const PORTS: usize = 34;
const PAYLOAD: usize = 42;

#[test]
fn the_command_finds_the_board() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let port = free_port().to_string();
    let settings = ["provider=CaoProv.DENSO.VRC", "hostname=cell-7", "mac=02:00:00:00:00:15"];
    let _board = Board::start(&sim.bcap, &["--find", &port], &settings).up();
    let found = run(&bcap, &["board", "find", &format!("127.0.0.1:{port}"), "--timeout", "20000"]);
    let line = "10.0.2.15:5006  02:00:00:00:00:15  gateway 0.1.0  cell-7\n";
    assert_eq!((found.out.as_str(), found.ok), (line, true), "{found:?}");
}

/// Sends a request in a frame.
fn ask(world: &World, from: Ipv4Addr, to: Ipv4Addr, payload: &[u8]) {
    let mac = if to == BROADCAST { [0xff; 6] } else { MAC };
    // until QEMU is up no process receives the frames
    let _ = world.wire.link.send(&datagram(mac, from, to, [HOST_PORT, PORT], payload));
}

/// Repeats the request until the board answers, and returns the destination and the payload.
fn first_answer(world: &mut World, board: &mut Board, limit: Duration) -> (Ipv4Addr, Vec<u8>) {
    let since = Instant::now();
    loop {
        assert!(since.elapsed() < limit, "no answer: {}", board.log());
        ask(world, HOST, BROADCAST, &request(NUMBER));
        let found = answers(world, board, Duration::from_millis(200));
        if let Some(found) = found.into_iter().next() {
            return found;
        }
    }
}

/// Runs for a time, and returns the datagrams from the board's port: their destinations and payloads.
fn answers(world: &mut World, board: &mut Board, time: Duration) -> Vec<(Ipv4Addr, Vec<u8>)> {
    let (end, mut found) = (Instant::now() + time, Vec::new());
    while Instant::now() < end {
        assert!(board.is_running(), "the board has ended or was reset: {}", board.log());
        world.wire.receive();
        for frame in &world.wire.arrived {
            if frame.len() > PAYLOAD && frame[23] == 17 && frame[PORTS..][..2] == PORT.to_be_bytes() {
                let to = <[u8; 4]>::try_from(&frame[DESTINATION..PORTS]).unwrap();
                found.push((to.into(), frame[PAYLOAD..].to_vec()));
            }
        }
        world.poll();
    }
    found
}

#[test]
fn only_hosts_of_its_network_get_answers_and_a_flood_gets_few() {
    let (wire, netdev) = Wire::open(1);
    let settings = ["dhcp=no", "hostname=cell-7", "mac=02:00:00:00:00:15"];
    let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev], &settings);
    let mut world = World::new(wire, 0, 1);
    let (to, answer) = first_answer(&mut world, &mut board, BUILT);
    let expected =
        Found { name: "cell-7", board: "gateway", version: "0.1.0", address: (BOARD, 24), port: 5006, mac: MAC };
    assert_eq!((to, Found::read(&answer, NUMBER)), (HOST, Some(expected)));
    assert!(answer.len() < REQUEST, "{} bytes", answer.len());

    // other networks, groups, the board itself, no host; requests that an answer would amplify
    let others = [
        [172, 16, 0, 7],
        [10, 0, 3, 2],
        [224, 0, 0, 1],
        [255; 4],
        [10, 0, 2, 255],
        [10, 0, 2, 0],
        [0; 4],
        [127, 0, 0, 1],
    ];
    for from in others.map(Ipv4Addr::from).into_iter().chain([BOARD]) {
        for to in [BOARD, BROADCAST] {
            ask(&world, from, to, &request(NUMBER));
        }
    }
    for payload in [&request(NUMBER)[..REQUEST - 1], &[], &[0; 1400], &answer] {
        ask(&world, HOST, BOARD, payload);
    }
    assert_eq!(answers(&mut world, &mut board, Duration::from_secs(2)), []);

    let since = Instant::now();
    let (mut sent, mut count) = (0, 0);
    while since.elapsed() < Duration::from_secs(3) {
        for _ in 0..10 {
            ask(&world, HOST, BOARD, &request(NUMBER));
            sent += 1;
        }
        count += answers(&mut world, &mut board, Duration::from_millis(5)).len();
    }
    while let more @ 1.. = answers(&mut world, &mut board, Duration::from_millis(200)).len() {
        count += more;
        assert!(since.elapsed() < TIMEOUT, "{count} answers to {sent} requests");
    }
    let most = since.elapsed().as_millis() / 50 + 1;
    assert!(sent > 100 && count > 0 && (count as u128) <= most, "{count} answers to {sent} requests, at most {most}");
    ask(&world, HOST, BOARD, &request(NUMBER));
    assert_eq!(answers(&mut world, &mut board, Duration::from_secs(1)).len(), 1, "it answers again");
}

#[test]
fn a_request_from_an_address_that_does_not_exist_holds_up_no_answer() {
    let (wire, netdev) = Wire::open(1);
    let settings = ["dhcp=no", "mac=02:00:00:00:00:15"];
    let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev], &settings);
    let mut world = World::new(wire, 0, 1);
    first_answer(&mut world, &mut board, BUILT);
    for _ in 0..3 {
        ask(&world, NOBODY, BOARD, &request(NUMBER));
        // answers to earlier requests arrive in the meantime
        answers(&mut world, &mut board, Duration::from_millis(1500));
        first_answer(&mut world, &mut board, TIMEOUT);
    }
}

#[test]
fn hosts_of_the_settings_that_are_off_hold_up_no_answer() {
    for setting in ["ntp=10.0.2.99", "syslog=10.0.2.99"] {
        let (wire, netdev) = Wire::open(1);
        let settings = ["dhcp=no", "mac=02:00:00:00:00:15", setting];
        // with the page, an image has syslog and SNTP; the page is not requested here
        let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev, "--health", "1"], &settings);
        let mut world = World::new(wire, 0, 1);
        first_answer(&mut world, &mut board, BUILT);
    }
}

#[test]
fn the_board_tells_its_switch_what_it_is() {
    let (wire, netdev) = Wire::open(1);
    let settings = ["dhcp=no", "hostname=cell-7", "mac=02:00:00:00:00:15"];
    let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev], &settings);
    let mut world = World::new(wire, 1, 1);
    // the board may have to be built first
    let since = Instant::now();
    let frame = loop {
        assert!(board.is_running() && since.elapsed() < 10 * TIMEOUT, "no frame of LLDP: {}", board.log());
        world.wire.receive();
        if let Some(frame) = world.wire.arrived.iter().find(|frame| frame[12..14] == [0x88, 0xcc]) {
            break frame.clone();
        }
        world.poll();
    };
    let expected: [&[u8]; 8] = [
        &[0x01, 0x80, 0xc2, 0, 0, 0x0e],
        &MAC,
        &[0x88, 0xcc, 2, 7, 4, 2, 0, 0, 0, 0, 0x15, 4, 7, 3, 2, 0, 0, 0, 0, 0x15, 6, 2, 0, 120, 10, 6],
        b"cell-7",
        &[12, 13],
        b"gateway 0.1.0",
        &[16, 12, 5, 1, 10, 0, 2, 15, 1, 0, 0, 0, 0, 0],
        &[0, 0],
    ];
    assert_eq!(frame, expected.concat());
}
