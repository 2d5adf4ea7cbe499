//! The gateway board in QEMU, a virtual controller and PLCs, as processes and connections of this machine.
//!
//! Building an image takes a compiler for the board, and running it takes QEMU. The tests of this package are therefore only
//! built with the feature `qemu`. The variable `BCAP` has the path of the built command `bcap`, and `BOARD` names another
//! board; `embassy-adapter/firmware/test` sets them.
#![cfg(unix)]

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;

/// Timeout of every wait; a test fails after it.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// The RAC line that reports an error.
pub fn error(code: HResult) -> String {
    format!("{}\r", code.0)
}

/// Returns the path of the command `bcap`.
pub fn bcap() -> PathBuf {
    std::env::var_os("BCAP").expect("the variable BCAP has the path of the command `bcap`").into()
}

/// The result of a run of `bcap`.
#[derive(Debug, PartialEq, Eq)]
pub struct Run {
    /// The standard output.
    pub out: String,
    /// The standard error.
    pub err: String,
    /// Whether the exit code was 0.
    pub ok: bool,
}

/// Runs `bcap` to its end.
pub fn run(bcap: &PathBuf, args: &[&str]) -> Run {
    let output = Command::new(bcap).args(args).env_remove("BCAP_ROBOT").stdin(Stdio::null()).output().unwrap();
    Run {
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
        ok: output.status.success(),
    }
}

/// Sends a signal such as `-KILL` to a process, or to a group (`-NUMBER`).
pub fn signal(signal: &str, process: &str) {
    assert!(Command::new("kill").args([signal, "--", process]).status().unwrap().success());
}

/// A virtual controller: `bcap sim`.
pub struct Sim {
    child: Child,
    /// Its address for b-CAP over TCP.
    pub bcap: String,
    /// Its address for b-CAP over UDP.
    pub udp: String,
}

impl Sim {
    /// Starts one at this address of b-CAP; port 0 takes a free one.
    pub fn start(bcap: &PathBuf, address: &str) -> Self {
        let args = ["sim", "--bcap", address, "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
        let mut child = Command::new(bcap).args(args).stdout(Stdio::piped()).spawn().unwrap();
        let mut ready = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
        let address = |key: &str| {
            let mut words = ready.split_whitespace();
            words.find_map(|word| word.strip_prefix(key)?.strip_prefix('=')).unwrap().to_owned()
        };
        Self { bcap: address("bcap"), udp: address("udp"), child }
    }

    /// Sends it a signal.
    pub fn signal(&self, name: &str) {
        signal(name, &self.child.id().to_string());
    }

    /// Ends it with a signal, and waits for its end.
    pub fn end(mut self, name: &str) {
        self.signal(name);
        self.child.wait().unwrap();
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A board in QEMU that runs the gateway until this value is dropped.
pub struct Board {
    child: Child,
    /// The board's serial port; the emulator would end if it were closed.
    input: ChildStdin,
    log: PathBuf,
    /// The address of its RAC server.
    pub rac: String,
    /// Whether the log is text: there is `defmt-print`.
    pub log_is_text: bool,
}

impl Board {
    /// Builds the image of the gateway if it is not built, and starts it with a robot and settings.
    pub fn start(robot: &str, options: &[&str], settings: &[&str]) -> Self {
        Self::start_image("gateway", robot, options, settings)
    }

    /// Builds an image if it is not built, and starts it with a robot and settings.
    pub fn start_image(image: &str, robot: &str, options: &[&str], settings: &[&str]) -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let log = std::env::temp_dir().join(format!("bcap-qemu-{}-{number}.log", std::process::id()));
        let rac = free_port();
        let mut command = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../embassy-adapter/firmware/run"));
        command.args(["--robot", robot, "--rac", &rac.to_string(), "--time", "600"]);
        if let Ok(board) = std::env::var("BOARD") {
            command.args(["--board", &board]);
        }
        for setting in settings {
            command.args(["--set", setting]);
        }
        let out = File::create(&log).unwrap();
        let err = out.try_clone().unwrap();
        // a process group, so that one signal ends QEMU and defmt-print too
        command.args(options).arg(image).process_group(0);
        let mut child = command.stdin(Stdio::piped()).stdout(out).stderr(err).spawn().unwrap();
        let input = child.stdin.take().unwrap();
        let log_is_text = Command::new("defmt-print").arg("--version").output().is_ok();
        Self { child, input, log, rac: format!("127.0.0.1:{rac}"), log_is_text }
    }

    /// Waits until the board answers, and then until its robot is there.
    pub fn up(mut self) -> Self {
        let since = Instant::now();
        while !self.try_get().is_some_and(|answer| answer.starts_with("0,")) {
            assert!(since.elapsed() < 5 * TIMEOUT, "the board does not answer: {}", self.log());
            assert!(self.is_running(), "the board has ended: {}", self.log());
            sleep(Duration::from_millis(50));
        }
        self
    }

    /// Sends one request: QEMU accepts connections before the board is up.
    fn try_get(&self) -> Option<String> {
        let mut plc = Plc::try_connect(&self.rac, Duration::from_secs(2)).ok()?;
        plc.try_ask("GET:RC8:1:I:\r").ok()
    }

    /// Sends a byte to the board's serial port.
    pub fn key(&mut self, letter: u8) {
        self.input.write_all(&[letter]).unwrap();
    }

    /// Returns whether it runs; a reset would have ended it.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Returns the log so far.
    pub fn log(&self) -> String {
        String::from_utf8_lossy(&fs::read(&self.log).unwrap()).into_owned()
    }

    /// Waits for a line of the log with all of these words, and returns it; the log must be text.
    pub fn log_line(&self, words: &[&str]) -> String {
        self.log_lines(words, 1).remove(0)
    }

    /// Waits for this number of lines of the log with all of these words, and returns them; the log must be text.
    pub fn log_lines(&self, words: &[&str], count: usize) -> Vec<String> {
        let since = Instant::now();
        loop {
            let log = self.log();
            let found = log.lines().filter(|line| words.iter().all(|word| line.contains(word)));
            let found: Vec<String> = found.map(str::to_owned).collect();
            if found.len() >= count {
                return found;
            }
            assert!(since.elapsed() < TIMEOUT, "{} of {count} lines with {words:?} in the log: {log}", found.len());
            sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        // a board that was reset has ended already
        if self.is_running() {
            signal("-TERM", &format!("-{}", self.child.id()));
        }
        let _ = self.child.wait();
        if std::thread::panicking() {
            let _ = writeln!(io::stderr(), "the board's log: {}", self.log());
        }
        let _ = fs::remove_file(&self.log);
    }
}

/// QEMU's monitor.
#[derive(Debug)]
pub struct Monitor(UnixStream);

impl Monitor {
    /// Waits for the prompt of a monitor.
    pub fn new(stream: UnixStream) -> Self {
        let mut monitor = Self(stream);
        monitor.until_prompt();
        monitor
    }

    /// Performs a command.
    pub fn command(&mut self, line: &str) {
        self.0.write_all(format!("{line}\n").as_bytes()).unwrap();
        let said = self.until_prompt();
        assert!(!said.contains("Error") && !said.contains("not found"), "{line}: {said}");
    }

    fn until_prompt(&mut self) -> String {
        let mut said = Vec::new();
        let mut byte = [0];
        while !said.ends_with(b"(qemu) ") {
            self.0.read_exact(&mut byte).unwrap();
            said.push(byte[0]);
        }
        String::from_utf8_lossy(&said).into_owned()
    }
}

/// Returns a port that is free at the moment, and each only once. QEMU listens again on it after a power cut, so it is below
/// those that the kernel gives to outgoing connections.
pub fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let start = u16::try_from(std::process::id() % 1000).unwrap() * 20;
    loop {
        let port = 10_000 + (start + NEXT.fetch_add(1, Ordering::Relaxed)) % 20_000;
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            return port;
        }
    }
}

/// A PLC: a connection on which lines are sent and answers read.
pub struct Plc {
    stream: BufReader<TcpStream>,
}

impl Plc {
    /// Connects.
    pub fn connect(address: &str) -> Self {
        Self::try_connect(address, TIMEOUT).unwrap()
    }

    /// Connects until the board accepts the connection: the slot of an earlier connection may not be free yet.
    pub fn connect_when_free(address: &str) -> Self {
        let since = Instant::now();
        loop {
            let mut plc = Self::connect(address);
            // a board without a free slot answers that
            if plc.try_ask("GET:RC8:1:I:\r").is_ok_and(|answer| answer != error(HResult::E_MAX_CONNECT)) {
                return plc;
            }
            assert!(since.elapsed() < TIMEOUT, "{address} has no free slot");
            sleep(Duration::from_millis(20));
        }
    }

    /// Connects, with a limit for the wait for each answer.
    ///
    /// # Errors
    ///
    /// The connection was refused.
    pub fn try_connect(address: &str, timeout: Duration) -> io::Result<Self> {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(timeout))?;
        stream.set_nodelay(true)?;
        Ok(Self { stream: BufReader::new(stream) })
    }

    /// Sends bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        self.try_send(bytes).unwrap();
    }

    /// Sends bytes.
    ///
    /// # Errors
    ///
    /// The connection ended.
    pub fn try_send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.get_mut().write_all(bytes)
    }

    /// Reads an answer.
    ///
    /// # Errors
    ///
    /// The answer is cut off, or does not arrive.
    pub fn answer(&mut self) -> io::Result<String> {
        let mut answer = Vec::new();
        self.stream.read_until(b'\r', &mut answer)?;
        match answer.last() {
            Some(b'\r') => String::from_utf8(answer).map_err(io::Error::other),
            _ => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }

    /// Sends a line and returns its answer; both end with a CR.
    ///
    /// # Errors
    ///
    /// The connection ended, or the answer does not arrive.
    pub fn try_ask(&mut self, line: &str) -> io::Result<String> {
        self.stream.get_mut().write_all(line.as_bytes())?;
        self.answer()
    }

    /// Sends a line and returns its answer; both end with a CR.
    pub fn ask(&mut self, line: &str) -> String {
        self.try_ask(line).unwrap_or_else(|error| panic!("{line:?}: {error}"))
    }

    /// Sends bytes and returns as many.
    pub fn echo(&mut self, bytes: &[u8], back: &mut [u8]) {
        self.send(bytes);
        self.stream.read_exact(back).unwrap();
    }
}
