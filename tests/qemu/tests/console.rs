//! Tests that `bcap board configure` changes the settings of the gateway board in QEMU, over its second serial port.
//!
//! ```text
//!  bcap ─► pseudo-terminals ─► this test ─► Unix socket ─► QEMU: serial port ─► console ─► flash
//! ```

use std::{env, process};

use crate::line::{connect, join};
use bcap_qemu::{Board, Sim, bcap, free_port, run};
use serialport::{SerialPort, TTYPort};

const PROVIDER: &str = "provider=CaoProv.DENSO.VRC";

#[test]
fn settings_are_used_after_a_restart_until_they_are_removed() {
    let bcap = bcap();
    let (line, host) = TTYPort::pair().unwrap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let socket = env::temp_dir().join(format!("bcap-console-{}", process::id()));
    // the image with all features must fit the board, too
    let [health, modbus] = [free_port(), free_port()].map(|port| port.to_string());
    let options = ["--faults", "--health", &health, "--modbus", &modbus, "--console", socket.to_str().unwrap()];
    let mut board = Board::start(&sim.bcap, &options, &[PROVIDER]).up();
    join(line, connect(&mut board, &socket));
    let device = host.name().unwrap();
    let configure = |arguments: &[&str]| {
        let done = run(&bcap, &[&["board", "configure", &device, "--timeout", "20000"], arguments].concat());
        assert!(done.ok, "{done:?}");
        done.out
    };
    let put = |board: &Board| run(&bcap, &["rac", "put", "I5", "7", "--robot", &board.rac]);

    // the image has no rule for PUT
    assert!(put(&board).err.contains("E_ACCESSDENIED"));
    let of_image = configure(&[]);
    assert!(of_image.contains(PROVIDER) && !of_image.contains("put="), "{of_image}");
    let robot = of_image.lines().find(|line| line.starts_with("robot=")).unwrap();
    let new = [robot, PROVIDER, "put=I/0-99=-10..10", "hostname=cell-7"];
    let answers = configure(&[&new[..], &["--restart"]].concat());
    assert!(answers.ends_with(": ok\nrestart: ok\n"), "{answers}");
    board = board.up();
    assert_eq!(put(&board).out, "I5 = 7\n", "{}", board.log());
    assert_eq!(configure(&[]), new.join("\n") + "\n");

    assert_eq!(configure(&["--factory", "--restart"]), "factory: ok\nrestart: ok\n");
    board = board.up();
    assert!(put(&board).err.contains("E_ACCESSDENIED"));
    assert_eq!(configure(&[]), of_image);
}
