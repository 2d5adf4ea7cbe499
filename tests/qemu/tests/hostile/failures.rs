//! Failures of everything next to the board: the robot is killed, the link is cut, its serial port gets random bytes, its clock
//! wraps.

use std::fmt;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};
use std::{env, process};

use bcap_board::console::HELLO;
use bcap_qemu::{Board, Monitor};
use fastrand::Rng;

use crate::line;
use crate::wire::{Phase, World};

/// The pause between two failures, and how long one lasts, in milliseconds.
const PAUSE: std::ops::Range<u64> = 2000..10_000;
const LENGTH: std::ops::Range<u64> = 200..3000;
/// A PLC that is not served for this time after a failure is reported, once.
const LATE: Duration = Duration::from_secs(8);
/// Number of random bytes that are sent to the serial port together.
const GARBAGE: usize = 64;
/// Beginnings of requests that change nothing in a board that is not restarted.
const REQUESTS: [&[u8]; 6] = [b"hello", b"show", b"new\n", b"add put=I/0-99", b"save", b"\xff\n"];

/// The sockets of QEMU that a board listens on.
pub(super) struct Sockets([PathBuf; 3]);

impl Sockets {
    pub(super) fn new() -> Self {
        Self(["monitor", "console", "qtest"].map(|name| {
            let name = format!("bcap-hostile-{}-{name}", process::id());
            env::temp_dir().join(name)
        }))
    }

    /// Returns the options of `run`.
    pub(super) fn options(&self) -> Vec<&str> {
        let Self([monitor, console, qtest]) = self;
        let options = [("--monitor", monitor), ("--console", console), ("--qtest", qtest)];
        options.into_iter().flat_map(|(option, path)| [option, path.to_str().unwrap()]).collect()
    }

    /// Connects to a board that is up, and sets its clock so that its 32 bits wrap after this time.
    pub(super) fn connect(&self, board: &mut Board, wrap: Duration, rng: Rng) -> Failures {
        let [monitor, console, qtest] = &self.0;
        set_clock(line::connect(board, qtest), wrap);
        let console = line::connect(board, console);
        console.set_nonblocking(true).unwrap();
        let next = Instant::now() + Duration::from_millis(PAUSE.start);
        Failures {
            monitor: Monitor::new(line::connect(board, monitor)),
            console,
            rng,
            state: State::None { until: next },
            killed: 0,
            cut: 0,
            garbage: 0,
            longest: Duration::ZERO,
        }
    }
}

/// Sets the counter of microseconds, which the clock of the board reads.
fn set_clock(stream: UnixStream, wrap: Duration) {
    let fpga_io = if env::var("BOARD").is_ok_and(|board| board == "mps2-an505") { 0x5030_2000 } else { 0x4002_8000 };
    let counter = u32::MAX - u32::try_from(wrap.as_micros()).unwrap();
    let mut qtest = BufReader::new(stream);
    writeln!(qtest.get_mut(), "writel {:#x} {counter:#x}", fpga_io + 0x18).unwrap();
    let mut answer = String::new();
    qtest.read_line(&mut answer).unwrap();
    assert_eq!(answer, "OK\n");
}

enum State {
    None {
        until: Instant,
    },
    RobotKilled {
        until: Instant,
    },
    LinkCut {
        until: Instant,
    },
    /// The failure has ended; the answers of the PLCs before.
    Recovery {
        since: Instant,
        answers: Vec<u32>,
    },
}

/// Lets the robot and the link fail, one at a time, and sends random bytes.
pub(super) struct Failures {
    monitor: Monitor,
    console: UnixStream,
    rng: Rng,
    state: State,
    killed: u32,
    pub(super) cut: u32,
    garbage: u64,
    /// Maximum time until all PLCs were served after a failure.
    pub(super) longest: Duration,
}

impl Failures {
    /// Begins a failure, ends it, or checks whether all PLCs are served after it.
    pub(super) fn go_on(&mut self, world: &mut World) {
        let now = Instant::now();
        match &self.state {
            State::None { until } if *until <= now => {
                let until = now + Duration::from_millis(self.rng.u64(LENGTH));
                if self.rng.bool() {
                    world.robot_is_down = true;
                    self.killed += 1;
                    self.state = State::RobotKilled { until };
                } else {
                    self.monitor.command("set_link n0 off");
                    self.cut += 1;
                    self.state = State::LinkCut { until };
                }
            }
            State::RobotKilled { until } | State::LinkCut { until } if *until <= now => self.end(world),
            State::Recovery { since, answers } => {
                let served = world.plcs.iter().zip(answers).all(|(plc, before)| plc.answers > *before);
                if since.elapsed() >= LATE && self.longest < LATE {
                    let states = world.unserved(answers);
                    let _ = writeln!(io::stderr(), "hostile network: not served {LATE:?} after a failure: {states}");
                }
                self.longest = self.longest.max(since.elapsed());
                if served {
                    self.state = State::None { until: now + Duration::from_millis(self.rng.u64(PAUSE)) };
                }
            }
            _ => {}
        }
        world.enter(if let State::None { .. } = self.state { Some(Phase::Attack) } else { None });
    }

    /// Ends the failure, if there is one, until the attack continues.
    pub(super) fn stop(&mut self, world: &mut World) {
        self.end(world);
        self.state = State::None { until: Instant::now() + Duration::from_millis(PAUSE.end) };
        world.enter(None);
    }

    /// Ends the failure, if there is one.
    fn end(&mut self, world: &mut World) {
        match self.state {
            State::RobotKilled { .. } => world.robot_is_down = false,
            State::LinkCut { .. } => self.monitor.command("set_link n0 on"),
            State::None { .. } | State::Recovery { .. } => return,
        }
        let answers = world.plcs.iter().map(|plc| plc.answers).collect();
        self.state = State::Recovery { since: Instant::now(), answers };
    }

    /// Sends random bytes to the serial port, among them beginnings of requests, and drops the answers.
    pub(super) fn send_garbage(&mut self) {
        let mut bytes: Vec<u8> = self.rng.choice(REQUESTS).unwrap().to_vec();
        bytes.resize_with(GARBAGE, || self.rng.u8(..));
        match self.console.write(&bytes) {
            Ok(count) => self.garbage += count as u64,
            // the port takes them as fast as the board reads them
            Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock, "the serial port: {error}"),
        }
        let _ = self.console.read(&mut [0; 4096]);
    }

    /// Waits until the serial port answers a request after the random bytes.
    pub(super) fn console_answers(&mut self) -> Result<(), String> {
        let since = Instant::now();
        let mut said = Vec::new();
        while !said.windows(HELLO.len()).any(|window| window == HELLO.as_bytes()) {
            if since.elapsed() >= Duration::from_secs(60) {
                return Err("the console does not answer".to_owned());
            }
            // a random byte may have begun a line
            let _ = self.console.write(b"\nhello\n");
            sleep(Duration::from_millis(50));
            let mut bytes = [0; 4096];
            if let Ok(count) = self.console.read(&mut bytes) {
                said.extend_from_slice(&bytes[..count]);
            }
        }
        Ok(())
    }
}

impl fmt::Display for Failures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { killed, cut, garbage, longest, .. } = self;
        write!(
            f,
            "robot killed {killed} times, link cut {cut} times, all PLCs served again after at most {longest:.1?}; "
        )?;
        write!(f, "{garbage} random bytes to the serial port")
    }
}
