//! Tests that `bcap board configure` changes the settings of the gateway board in QEMU, over its second serial port.
//!
//! ```text
//!  bcap ─► pseudo-terminals ─► this test ─► Unix socket ─► QEMU: serial port ─► console ─► flash
//! ```
#![cfg(unix)]

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::thread::{self, sleep};
use std::time::{Duration, Instant};
use std::{env, process};

use bcap_qemu::{Board, Sim, bcap, run};
use serialport::{SerialPort, TTYPort};

const PROVIDER: &str = "provider=CaoProv.DENSO.VRC";

#[test]
fn settings_are_used_after_a_restart_until_they_are_removed() {
    let Some(bcap) = bcap() else { return };
    let Ok((line, host)) = TTYPort::pair() else { return };
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let socket = env::temp_dir().join(format!("bcap-console-{}", process::id()));
    let options = ["--faults", "--console", socket.to_str().unwrap()];
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

/// Connects to the socket of QEMU.
fn connect(board: &mut Board, socket: &std::path::Path) -> UnixStream {
    let since = Instant::now();
    loop {
        match UnixStream::connect(socket) {
            Ok(stream) => return stream,
            Err(error) => assert!(since.elapsed() < Duration::from_secs(20), "{error}: {}", board.log()),
        }
        assert!(board.is_running(), "{}", board.log());
        sleep(Duration::from_millis(50));
    }
}

/// Moves bytes between a line and the board until one of them ends.
fn join(mut line: TTYPort, board: UnixStream) {
    let mut to_board = board.try_clone().unwrap();
    let mut from_board = board;
    let mut to_line = line.try_clone_native().unwrap();
    line.set_timeout(Duration::from_secs(1)).unwrap();
    thread::spawn(move || {
        let mut buffer = [0; 256];
        loop {
            match line.read(&mut buffer) {
                Ok(count) => to_board.write_all(&buffer[..count]).unwrap(),
                Err(error) if error.kind() == ErrorKind::TimedOut => {}
                Err(_) => return,
            }
        }
    });
    thread::spawn(move || {
        let mut buffer = [0; 256];
        while let Ok(count @ 1..) = from_board.read(&mut buffer) {
            if to_line.write_all(&buffer[..count]).is_err() {
                return;
            }
        }
    });
}
