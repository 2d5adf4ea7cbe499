//! Serial ports of the board, which are Unix sockets of QEMU, and their connection with pseudo-terminals.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use bcap_qemu::Board;
use serialport::{SerialPort, TTYPort};

/// Connects to the socket of QEMU, which is there when the image has been built.
pub(crate) fn connect(board: &mut Board, socket: &Path) -> UnixStream {
    let since = Instant::now();
    loop {
        match UnixStream::connect(socket) {
            Ok(stream) => return stream,
            Err(error) => assert!(since.elapsed() < Duration::from_secs(600), "{error}: {}", board.log()),
        }
        assert!(board.is_running(), "{}", board.log());
        sleep(Duration::from_millis(50));
    }
}

/// Moves bytes between a line and the board until one of them ends.
pub(crate) fn join(mut line: TTYPort, board: UnixStream) {
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
