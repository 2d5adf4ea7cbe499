//! Faults of the gateway board in QEMU: it restarts, serves again, and says why it was reset.

use std::io::{self, Write};
use std::thread;
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Plc, Sim, TIMEOUT, bcap, free_port};
use bcap_test_support::tools;

use crate::wire::{Wire, World};

const PROVIDER: &str = "provider=CaoProv.DENSO.VRC";

#[test]
fn a_board_tells_after_its_restart_why_it_was_reset() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let mut board = Board::start(&sim.bcap, &["--faults"], &[PROVIDER]).up();
    let mut starts = 1;
    for (letter, cause) in [
        (b's', "stack overflow: CFSR 0x"),
        (b'b', "address 0xf0000000"),
        (b'p', "panic at .."),
        (b'h', "watchdog: "),
        (b'E', "the Ethernet controller does not respond"),
    ] {
        let mut lines = Vec::new();
        // a machine that stalls for seconds lets the watchdog reset the board before the fault does
        for _ in 0..3 {
            board.key(letter);
            let Some(found) = board.log_is_text.then(|| board.log_lines(&["last reset:"], starts + 1)) else {
                return tools::missing("defmt-print is not installed");
            };
            (starts, lines) = (found.len(), found);
            // it serves again
            board = board.up();
            if lines[starts - 1].contains(cause) || !lines[starts - 1].contains("watchdog: no task runs") {
                break;
            }
        }
        assert!(lines[0].contains("power-on") && lines[starts - 1].contains(cause), "{lines:?}");
        let _ = writeln!(io::stderr(), "restarted after {:?}: {}", char::from(letter), lines[starts - 1]);
    }
}

#[test]
fn a_board_without_a_dhcp_server_asks_again_while_it_uses_its_own_address() {
    // an Ethernet link to a port where nothing listens
    let port = free_port();
    let netdev = format!("socket,id=n0,udp=127.0.0.1:{port},localaddr=127.0.0.1:{}", free_port());
    let board = Board::start("10.0.2.2:5007", &["--faults", "--netdev", &netdev], &[PROVIDER]);
    if board.log_is_text {
        let _ = board.log_lines(&["no DHCP server answers"], 3);
        assert_eq!(board.log_lines(&["last reset:"], 1).len(), 1, "{}", board.log());
    }
}

#[test]
fn a_plc_stays_connected_to_a_board_without_a_dhcp_server_and_a_robot() {
    let (wire, netdev) = Wire::open(1);
    let mut board = Board::start("10.0.2.99:5007", &["--faults", "--netdev", &netdev], &[PROVIDER]);
    let mut world = World::new(wire, 1, 1);
    // the board may have to be built first; without a robot each answer is an error
    world.run_until(&mut board, Duration::from_secs(600), |world| world.plcs[0].errors > 0);
    world.forget();
    // this image would request an address every 3 s
    let end = Instant::now() + Duration::from_secs(15);
    world.run_until(&mut board, TIMEOUT, |_| Instant::now() >= end);
    let plc = &world.plcs[0];
    assert!(plc.errors > 0 && plc.lost == 0, "{}", world.report());
}

#[test]
fn a_silent_ethernet_controller_is_initialised_again() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let mut board = Board::start(&sim.bcap, &["--faults"], &[PROVIDER]).up();
    let mut plc = Plc::connect_when_free(&board.rac);
    board.key(b'e');
    // the connection outlives that, because no reset happened; the one to the robot may not
    let mut is_served = || {
        let answer = plc.ask("GET:RC8:1:I:\r");
        thread::sleep(Duration::from_millis(200));
        answer.starts_with("0,")
    };
    for _ in 0..2 {
        assert!((0..50).any(|_| is_served()));
    }
    if board.log_is_text {
        let _ = board.log_line(&["up ", "restarts: 1"]);
        assert_eq!(board.log_lines(&["last reset:"], 1).len(), 1);
    }
}
