//! Failures of the robot and of the link, one at a time.

use std::fmt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Monitor, Sim};
use fastrand::Rng;

use super::Shared;
use super::plc::Seen;

/// The time in which every PLC must be served again after a failure.
const RECOVERY: Duration = Duration::from_secs(60);

/// The failure to cause.
enum Failure {
    RobotKilled,
    RobotStopped,
    LinkCut,
}

/// Lets the robot and the link fail.
pub(super) struct Chaos {
    bcap: PathBuf,
    /// The robot; `None` while it is restarted.
    sim: Option<Sim>,
    monitor: Monitor,
    rng: Rng,
    /// One of each kind in random order, so that even a short test has all of them.
    next: Vec<Failure>,
    killed: u32,
    stopped: u32,
    cut: u32,
    longest: Duration,
}

impl Chaos {
    /// Connects to QEMU's monitor at this socket.
    pub(super) fn new(bcap: PathBuf, sim: Sim, socket: &Path, rng: Rng) -> Self {
        let monitor = Monitor::new(UnixStream::connect(socket).unwrap());
        Self {
            bcap,
            sim: Some(sim),
            monitor,
            rng,
            next: Vec::new(),
            killed: 0,
            stopped: 0,
            cut: 0,
            longest: Duration::ZERO,
        }
    }

    /// Causes a failure after some time, and waits until every PLC has been served after it.
    pub(super) fn fail(&mut self, board: &mut Board, seen: &[Seen], shared: &Shared) {
        self.pause(500..4000);
        if self.next.is_empty() {
            self.next = vec![Failure::RobotKilled, Failure::RobotStopped, Failure::LinkCut];
            self.rng.shuffle(&mut self.next);
        }
        match self.next.pop() {
            Some(Failure::RobotKilled) => self.kill_robot(shared),
            Some(Failure::RobotStopped) => self.stop_robot(),
            Some(Failure::LinkCut) | None => self.cut_link(shared),
        }
        let before: Vec<u32> = seen.iter().map(Seen::served).collect();
        let since = Instant::now();
        while !seen.iter().zip(&before).all(|(seen, before)| seen.served() > *before) {
            assert!(board.is_running(), "the board was reset: {}", board.log());
            assert!(since.elapsed() < RECOVERY, "a PLC is not served any more: {self}: {}", board.log());
            sleep(Duration::from_millis(20));
        }
        self.longest = self.longest.max(since.elapsed());
    }

    fn kill_robot(&mut self, shared: &Shared) {
        if let Some(sim) = self.sim.take() {
            let address = sim.bcap.clone();
            sim.end("-KILL");
            self.pause(0..3000);
            shared.robots.fetch_add(1, Ordering::Relaxed);
            self.sim = Some(Sim::start(&self.bcap, &address));
            self.killed += 1;
        }
    }

    fn stop_robot(&mut self) {
        let signal = |name| self.sim.iter().for_each(|sim| sim.signal(name));
        signal("-STOP");
        sleep(Duration::from_millis(self.rng.u64(100..6000)));
        signal("-CONT");
        self.stopped += 1;
    }

    fn cut_link(&mut self, shared: &Shared) {
        shared.links.fetch_add(1, Ordering::Relaxed);
        self.monitor.command("set_link n0 off");
        self.pause(50..6000);
        self.monitor.command("set_link n0 on");
        shared.links.fetch_add(1, Ordering::Relaxed);
        self.cut += 1;
    }

    fn pause(&mut self, millis: std::ops::Range<u64>) {
        sleep(Duration::from_millis(self.rng.u64(millis)));
    }
}

impl fmt::Display for Chaos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { killed, stopped, cut, longest, .. } = self;
        write!(f, "robot killed {killed} times and stopped {stopped} times, link cut {cut} times, ")?;
        write!(f, "all PLCs served again after at most {:.1} s", longest.as_secs_f64())
    }
}
