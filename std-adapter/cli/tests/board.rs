//! `bcap board configure` with the board's side of the protocol at the other end of a pair of pseudo-terminals.
#![cfg(unix)]

mod common;
#[path = "../../../embassy-adapter/board/tests/flash/mod.rs"]
mod flash;

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};

use bcap_board::console::{Action, Console};
use bcap_board::slots::Slots;
use bcap_tests::pty;
use common::{Run, bcap};
use flash::Flash;
use serialport::{SerialPort, TTYPort};

const IMAGE: &[u8] = b"robot=192.168.0.1:5007\n";

/// A board that serves its console until it restarts, or this value is dropped.
struct Board {
    /// The host's end, kept open so that the line exists between two commands.
    host: TTYPort,
    end: Arc<AtomicBool>,
    received: Arc<AtomicUsize>,
    board: Option<JoinHandle<Option<Action>>>,
}

/// The board's end of the line.
struct Line {
    port: TTYPort,
    end: Arc<AtomicBool>,
    received: Arc<AtomicUsize>,
}

impl embedded_io::ErrorType for Line {
    type Error = io::Error;
}

impl embedded_io::Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.end.load(Ordering::Acquire) {
            match self.port.read(buffer) {
                Err(error) if error.kind() == ErrorKind::TimedOut => {}
                result => {
                    self.received.fetch_add(*result.as_ref().unwrap_or(&0), Ordering::Relaxed);
                    return result;
                }
            }
        }
        Ok(0)
    }
}

impl embedded_io::Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Board {
    /// Starts a board; `None` if this machine has no pseudo-terminals.
    fn start() -> Option<Self> {
        let (mut port, host) = pty::pair()?;
        port.set_timeout(std::time::Duration::from_millis(5)).unwrap();
        // what a board logs, and a partly sent request of an earlier program
        port.write_all(b"0.001 INFO  started\nok nothing was asked\n").unwrap();
        let (end, received) = <(Arc<AtomicBool>, Arc<AtomicUsize>)>::default();
        let mut line = Line { port, end: Arc::clone(&end), received: Arc::clone(&received) };
        let mut console = Console::new(Slots::new(Flash::<4, 2048>::new(4096), 0..4096).unwrap(), IMAGE);
        let board = thread::spawn(move || console.run(&mut line).unwrap());
        Some(Self { host, end, received, board: Some(board) })
    }

    fn configure(&self, arguments: &[&str]) -> Run {
        bcap(&[&["board", "configure", &self.host.name().unwrap()], arguments].concat())
    }

    /// Ends the board, and returns what it was asked to do.
    fn end(mut self) -> Option<Action> {
        self.board.take().unwrap().join().unwrap()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Release);
    }
}

#[test]
fn settings_are_replaced_shown_and_removed() {
    let Some(board) = Board::start() else { return };
    let run = board.configure(&[]);
    let note = " note: these settings are those of the image; the flash has none\n";
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("robot=192.168.0.1:5007\n", note, 0));

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("board.conf");
    fs::write(&file, "# a cell\nrobot=10.0.0.5:5007  # its robot\n\nput=I/0-99\n").unwrap();
    let run = board.configure(&[&format!("@{}", file.display()), "hostname=cell-7"]);
    let answers = "add robot=10.0.0.5:5007: ok\nadd put=I/0-99: ok\nadd hostname=cell-7: ok\nsave e1559341: ok\n";
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (answers, "", 0));

    let run = board.configure(&[]);
    let note = " note: these settings are in the flash of the board\n";
    let shown = "robot=10.0.0.5:5007\nput=I/0-99\nhostname=cell-7\n";
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (shown, note, 0));
    let json = board.configure(&["--json"]).out;
    assert_eq!(json.lines().nth(1), Some("{\"setting\":\"put=I/0-99\"}"));

    let run = board.configure(&["--factory"]);
    assert_eq!((run.out.as_str(), run.code), ("factory: ok\n", 0), "{run:?}");
    assert_eq!(board.configure(&[]).out, "robot=192.168.0.1:5007\n");
}

#[test]
fn a_board_is_restarted_after_its_settings_are_saved() {
    let Some(board) = Board::start() else { return };
    let run = board.configure(&["put=I/0-99", "--restart"]);
    assert!(run.code == 0 && run.out.ends_with(": ok\nrestart: ok\n"), "{run:?}");
    assert_eq!(board.end(), Some(Action::Restart));
}

#[test]
fn invalid_settings_are_refused_with_their_column_before_anything_is_sent() {
    let Some(board) = Board::start() else { return };
    let long = format!("provider={}", "x".repeat(500));
    let many: Vec<String> = (0..9).map(|_| format!("provider={}", "x".repeat(300))).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    for (settings, message) in [
        (
            &["echo=7", "put=I/3-1"][..],
            "error: invalid setting \"put=I/3-1\": invalid index range 3-1: the first index is above the last, at column 7",
        ),
        (&["colour=red"], "error: invalid setting \"colour=red\": expected KEY=VALUE with a known key, at column 1"),
        (&["--restart", ""], "error: a setting has 1 to 508 bytes, but this has 0: \"\""),
        (&[&long], "error: a setting has 1 to 508 bytes, but this has 509: \"provider=xxx"),
        (&many, "error: the settings take 2790 bytes of 2016"),
        (&["@/no/such/file"], "error: /no/such/file: No such file"),
    ] {
        let run = board.configure(settings);
        assert!(run.code == 2 && run.out.is_empty() && run.err.starts_with(message), "{settings:?}: {run:?}");
    }
    assert_eq!(board.received.load(Ordering::Relaxed), 0, "bytes that the board received");
}

#[test]
fn a_device_that_sends_other_lines_without_end_is_no_board() {
    let Some((mut device, host)) = pty::pair() else { return };
    let is_full = |error: &io::Error| error.kind() == ErrorKind::TimedOut;
    thread::spawn(move || while device.write_all(b"$GPGGA,0\n").as_ref().err().is_none_or(is_full) {});
    let run = bcap(&["board", "configure", &host.name().unwrap(), "--timeout", "300"]);
    assert!(run.code == 4 && run.err.contains("no answer from a board at /dev/"), "{run:?}");
}

#[test]
fn a_port_without_a_board_is_reported() {
    let Some((_silent, host)) = pty::pair() else { return };
    let run = bcap(&["board", "configure", &host.name().unwrap(), "--timeout", "100"]);
    assert!(run.code == 4 && run.err.contains("no answer from a board at /dev/"), "{run:?}");
    let run = bcap(&["board", "configure", "/dev/no-such-line"]);
    assert!(run.code == 3 && run.err.contains("cannot open /dev/no-such-line: No such file"), "{run:?}");
}
