//! `bcap board` with the board's side of the protocol at the other end of a pair of pseudo-terminals.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};

use crate::common::{Run, bcap};
use bcap_board::console::{Action, Console};
use bcap_board::identity::Identity;
use bcap_board::signature::PublicKey;
use bcap_board::slots::Slots;
use bcap_board::update::{Partitions, Updater};
use bcap_testkit::flash::Flash;
use bcap_tests::pty;
use serialport::{SerialPort, TTYPort};

const IMAGE: &[u8] = b"robot=192.168.0.1:5007\n";
static RUNNING: Identity = Identity::new("test-board", "0.1.0");
static NEW: Identity = Identity::new("test-board", "0.2.0");

/// The initial stack pointer 0x20042000 and the reset vector 0x100101b5.
const VECTORS: &[u8] = b"\x00\x20\x04\x20\xb5\x01\x01\x10";

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
    /// Damages received bytes.
    damage: fn(usize, &mut u8),
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
                    let count = *result.as_ref().unwrap_or(&0);
                    let before = self.received.fetch_add(count, Ordering::Relaxed);
                    (before..).zip(&mut buffer[..count]).for_each(|(at, byte)| (self.damage)(at, byte));
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
    fn start() -> Self {
        Self::run(Console::new(Slots::new(Flash::new(4096), 0..4096).unwrap(), IMAGE), |_, _| {})
    }

    /// Starts a board with partitions for updates; `damage` gets the number of each received byte and the byte.
    fn with_updates(damage: fn(usize, &mut u8)) -> Self {
        Self::run(Self::console_with_updates(None), damage)
    }

    /// Makes the console of a board that receives updates, only signed ones if it has a key.
    fn console_with_updates(key: Option<PublicKey>) -> Console<'static, Flash<4, 2048>> {
        let mut slots = Slots::new(Flash::new(40_960), 0..4096).unwrap();
        let partitions = Partitions {
            active: 12_288..22_528,
            other: 22_528..34_816,
            state: 34_816..38_912,
            history: 4096..8192,
            signature: 8192..10_240,
        };
        let updater = Updater::start(slots.flash(), partitions, &RUNNING, &"power-on").unwrap().with_key(key);
        Console::new(slots, b"").with_updates(Some(updater))
    }

    fn run(mut console: Console<'static, Flash<4, 2048>>, damage: fn(usize, &mut u8)) -> Self {
        let (mut port, host) = pty::pair();
        port.set_timeout(std::time::Duration::from_millis(5)).unwrap();
        // the log of a board, and a partly sent request of an earlier program
        port.write_all(b"0.001 INFO  started\nok nothing was asked\n").unwrap();
        let (end, received) = <(Arc<AtomicBool>, Arc<AtomicUsize>)>::default();
        let mut line = Line { port, end: Arc::clone(&end), received: Arc::clone(&received), damage };
        let board = thread::spawn(move || console.run(&mut line).unwrap());
        Self { host, end, received, board: Some(board) }
    }

    fn configure(&self, arguments: &[&str]) -> Run {
        self.bcap("configure", arguments)
    }

    fn bcap(&self, command: &str, arguments: &[&str]) -> Run {
        bcap(&[&["board", command, &self.host.name().unwrap()], arguments].concat())
    }

    /// Ends the board, and returns the requested action.
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
    let board = Board::start();
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
    let board = Board::start();
    let run = board.configure(&["put=I/0-99", "--restart"]);
    assert!(run.code == 0 && run.out.ends_with(": ok\nrestart: ok\n"), "{run:?}");
    assert_eq!(board.end(), Some(Action::Restart));
}

#[test]
fn invalid_settings_are_refused_with_their_column_before_anything_is_sent() {
    let board = Board::start();
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
    let (mut device, host) = pty::pair();
    let is_full = |error: &io::Error| error.kind() == ErrorKind::TimedOut;
    thread::spawn(move || while device.write_all(b"$GPGGA,0\n").as_ref().err().is_none_or(is_full) {});
    let run = bcap(&["board", "configure", &host.name().unwrap(), "--timeout", "300"]);
    assert!(run.code == 4 && run.err.contains("no answer from a board at /dev/"), "{run:?}");
}

#[test]
fn a_port_without_a_board_is_reported() {
    let (_silent, host) = pty::pair();
    let run = bcap(&["board", "configure", &host.name().unwrap(), "--timeout", "100"]);
    assert!(run.code == 4 && run.err.contains("no answer from a board at /dev/"), "{run:?}");
    let run = bcap(&["board", "configure", "/dev/no-such-line"]);
    assert!(run.code == 3 && run.err.contains("cannot open /dev/no-such-line: No such file"), "{run:?}");
}

/// Writes an image of this length into a folder, and returns its path.
fn image(folder: &tempfile::TempDir, identity: &Identity, len: usize) -> String {
    let mut bytes: Vec<u8> = (0..len).map(|at| u8::try_from(at % 251).unwrap()).collect();
    bytes[..8].copy_from_slice(VECTORS);
    bytes[300..364].copy_from_slice(identity.as_bytes());
    let path = folder.path().join("image.bin");
    fs::write(&path, bytes).unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn an_image_is_received_although_the_line_damages_blocks() {
    // a changed digit, a line feed that is lost, and one that is added
    let damage = |at: usize, byte: &mut u8| match at {
        4000 | 9000 | 13_000 => *byte = b'x',
        6000..6300 if *byte == b'\n' => *byte = b'0',
        11_000 => *byte = b'\n',
        _ => {}
    };
    let board = Board::with_updates(damage);
    assert_eq!(board.bcap("status", &[]).out, "test-board 0.1.0 confirmed\n");
    let folder = tempfile::tempdir().unwrap();
    let image = image(&folder, &NEW, 10_000);
    let run = board.bcap("update", &[&image, "--no-restart", "--timeout", "1000"]);
    let received = run.out.strip_prefix("test-board 0.2.0: 10000 bytes received and checked, ");
    let repeated = received.and_then(|rest| rest.strip_suffix(" blocks were sent again\n"));
    assert!(repeated.unwrap().parse::<u32>().unwrap() >= 5 && run.code == 0, "{run:?}");
    assert_eq!(board.bcap("status", &[]).out, "test-board 0.1.0 runs; a restart swaps in 0.2.0\n");
    let run = board.bcap("update", &[&image]);
    assert!(run.code == 1 && run.err.contains("an update waits for a restart or is on trial"), "{run:?}");
}

#[test]
fn a_board_is_restarted_after_its_update() {
    let board = Board::with_updates(|_, _| {});
    let folder = tempfile::tempdir().unwrap();
    let run = board.bcap("update", &[&image(&folder, &NEW, 1000), "--json"]);
    let expected = r#"{"board":"test-board","bytes":1000,"repeated":0,"restarted":true,"version":"0.2.0"}"#;
    assert_eq!((run.out.trim_end(), run.code), (expected, 0), "{run:?}");
    assert_eq!(board.end(), Some(Action::Restart));
}

#[test]
fn an_update_that_would_lose_settings_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let new = image(&folder, &NEW, 1000);
    let run = Board::start().bcap("update", &[&new]);
    assert!(run.code == 1 && run.err.contains("the settings of the board are those of its image"), "{run:?}");
    let hint = "store them in the flash first: `bcap board configure PORT` prints them, and with @FILE it stores them; or use --force";
    assert!(run.err.contains(hint), "{run:?}");
    let board = Board::with_updates(|_, _| {});
    assert_eq!(board.configure(&["robot=192.168.0.1:5007"]).code, 0);
    let run = board.bcap("update", &[&new, "--no-restart"]);
    assert_eq!(run.code, 0, "settings in the flash remain: {run:?}");
}

#[test]
fn an_image_that_does_not_fit_the_board_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let board = Board::with_updates(|_, _| {});
    let other = Identity::new("other-board", "0.2.0");
    for (identity, len, message) in [
        (&other, 1000, "the image is for another board: this is a test-board"),
        (&NEW, 10_241, "an image has 1 to 10240 bytes on this board"),
    ] {
        let run = board.bcap("update", &[&image(&folder, identity, len)]);
        assert!(run.code == 1 && run.err.contains(message), "{run:?}");
    }
    let sent = board.received.load(Ordering::Relaxed);
    let other_file = folder.path().join("file");
    for (start, contents, message) in [
        (VECTORS, &b"BCAPNAME"[..], "the image does not tell its board"),
        (b"UF2\nWQ]\x9e", NEW.as_bytes(), "a UF2 file is for the boot ROM: send the ELF file"),
        // the second stage of the boot ROM, as in an image without a boot loader
        (b"\x00\xb5\x32\x4b\x21\x20\x58\x60", NEW.as_bytes(), "the image does not start with a vector table"),
    ] {
        fs::write(&other_file, [start, contents].concat()).unwrap();
        let run = board.bcap("update", &[other_file.to_str().unwrap()]);
        assert!(run.code == 2 && run.err.contains(message), "{run:?}");
    }
    assert_eq!(board.received.load(Ordering::Relaxed), sent, "bytes that the board received");

    let board = Board::start();
    let run = board.bcap("update", &[&image(&folder, &NEW, 1000), "--force"]);
    assert!(run.code == 1 && run.err.contains("this image has no partition for updates"), "{run:?}");
}

/// The board's end of a connection; a board has another program for it, with the same protocol.
struct Connection(TcpStream);

impl embedded_io::ErrorType for Connection {
    type Error = io::Error;
}

impl embedded_io::Read for Connection {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl embedded_io::Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Creates a key, and returns the path of its file and the public key.
fn key(folder: &tempfile::TempDir, name: &str) -> (String, PublicKey) {
    let path = folder.path().join(name).to_str().unwrap().to_owned();
    let run = bcap(&["board", "key", &path]);
    assert_eq!(run.code, 0, "{run:?}");
    let digits = run.out.trim().as_bytes().as_chunks::<2>().0.to_vec();
    let bytes = digits.iter().map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap());
    (path, PublicKey(bytes.collect::<Vec<_>>().try_into().unwrap()))
}

#[test]
fn a_key_is_made_once_and_read_by_its_owner_only() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (path, public) = key(&folder, "plant.key");
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert_eq!(bcap(&["board", "key", "--show", &path]).out, format!("{public}\n"));
    let run = bcap(&["board", "key", &path]);
    assert!(run.code == 2 && run.err.contains("exists"), "{run:?}");
    assert_ne!(key(&folder, "other.key").1, public);
    fs::write(&path, "not a key").unwrap();
    let run = bcap(&["board", "key", "--show", &path]);
    assert!(run.code == 2 && run.err.contains("not a secret key, which is 64 hexadecimal digits"), "{run:?}");
}

#[test]
fn a_board_with_a_key_takes_signed_images_over_tcp() {
    let folder = tempfile::tempdir().unwrap();
    let ((plant, public), (other, _)) = (key(&folder, "plant.key"), key(&folder, "other.key"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", listener.local_addr().unwrap());
    let board = thread::spawn(move || {
        let mut console = Board::console_with_updates(Some(public));
        loop {
            if let Ok(Some(action)) = console.run(&mut Connection(listener.accept().unwrap().0)) {
                return action;
            }
        }
    });
    let new = image(&folder, &NEW, 10_000);
    let update = |options: &[&str]| bcap(&[&["board", "update", &port, &new, "--timeout", "20000"], options].concat());
    let run = update(&[]);
    assert!(run.code == 1 && run.err.contains("this board takes signed images only"), "{run:?}");
    let run = update(&["--key", &other]);
    assert!(run.code == 1 && run.err.contains("the signature is not by the key of this board"), "{run:?}");
    let run = update(&["--key", "/no/such/file"]);
    assert!(run.code == 2 && run.err.contains("/no/such/file: No such file"), "{run:?}");
    // an older one needs --older
    let old = image(&folder, &Identity::new("test-board", "0.0.9"), 1000);
    let run = update(&["--key", &plant, "--no-restart"]);
    assert!(run.code == 1 && run.err.contains("the image is older than 0.1.0, which runs"), "{run:?}");
    assert_eq!(old, new, "the same file");
    image(&folder, &NEW, 10_000);
    // signed on another computer
    let run = bcap(&["board", "sign", &new, "--key", &plant]);
    assert_eq!(run.out, format!("{new}.sig: test-board 0.2.0 signed\n"), "{run:?}");
    let signature = format!("{new}.sig");
    let run = update(&["--signature", &signature]);
    assert_eq!((run.out.as_str(), run.code), ("test-board 0.2.0: 10000 bytes received and checked\n", 0), "{run:?}");
    assert_eq!(board.join().unwrap(), Action::Restart);
    // the signature of another image is found before anything is sent
    image(&folder, &NEW, 10_001);
    let run = update(&["--signature", &signature]);
    assert!(run.code == 2 && run.err.contains("the signature is for another image"), "{run:?}");
}
