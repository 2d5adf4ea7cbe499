//! The server, in a separate process, and its resources as seen from outside.

use std::fmt;
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use bcap_std::server::Limits;
use bcap_tests::process::{Memory, Process};
use bcap_tests::served::Served;

/// The argument by which this program becomes the server.
pub(crate) const SERVE: &str = "--serve";

/// Serves until the standard input ends; answers each input line with the server's resources.
pub(crate) fn serve() {
    let server = Served::start(Limits::default().connections_per_address(Limits::default().connections));
    println!("{} {} {}", server.tcp, server.udp, server.rac);
    for _ in std::io::stdin().lines() {
        let tasks = server.tasks();
        let application = server.application();
        println!("{} {} {tasks}", application.open.len(), application.peers.len());
    }
}

/// Where the server listens.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Addresses {
    pub(crate) tcp: SocketAddr,
    pub(crate) udp: SocketAddr,
    pub(crate) rac: SocketAddr,
}

/// The process of the server; it ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Server {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    addresses: Addresses,
}

/// The resources of the server at one time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct State {
    pub(crate) handles: usize,
    pub(crate) peers: usize,
    pub(crate) tasks: usize,
    pub(crate) descriptors: Option<usize>,
    pub(crate) memory: Option<Memory>,
}

impl State {
    pub(crate) const HEAD: &str = "handles  peers  tasks  files  memory";
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { handles, peers, tasks, descriptors, memory } = self;
        write!(f, "{handles:7}  {peers:5}  {tasks:5}")?;
        if let (Some(descriptors), Some(memory)) = (descriptors, memory) {
            write!(f, "  {descriptors:5}  {:.1} MiB", memory.now as f64 / f64::from(1 << 20))?;
        }
        Ok(())
    }
}

impl Server {
    pub(crate) fn start() -> Self {
        let program = std::env::current_exe().expect("this program has a file");
        let mut command = Command::new(program);
        let mut child =
            command.arg(SERVE).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the server starts");
        let input = child.stdin.take().expect("it has an input");
        let mut output = BufReader::new(child.stdout.take().expect("it has an output"));
        let words: Vec<SocketAddr> = line(&mut output);
        let [tcp, udp, rac] = words[..] else { panic!("three addresses: {words:?}") };
        Self { child, input, output, addresses: Addresses { tcp, udp, rac } }
    }

    pub(crate) const fn addresses(&self) -> Addresses {
        self.addresses
    }

    pub(crate) fn process(&self) -> Process {
        Process::new(self.child.id())
    }

    /// Returns the server's current resources.
    pub(crate) fn state(&mut self) -> State {
        writeln!(self.input).expect("the server lives");
        let words: Vec<usize> = line(&mut self.output);
        let [handles, peers, tasks] = words[..] else { panic!("three numbers: {words:?}") };
        let process = self.process();
        State { handles, peers, tasks, descriptors: process.descriptors(), memory: process.memory() }
    }

    /// Returns the server's resources when no client is connected and they no longer change.
    pub(crate) fn quiet(&mut self) -> State {
        let mut state = self.state();
        loop {
            std::thread::sleep(Duration::from_millis(50));
            let before = std::mem::replace(&mut state, self.state());
            if state.peers == 0 && (before.tasks, before.descriptors) == (state.tasks, state.descriptors) {
                return state;
            }
        }
    }

    /// Waits until the server's resources are as before or a timeout; returns them.
    pub(crate) fn settled(&mut self, before: &State) -> State {
        let until = Instant::now() + Duration::from_secs(10);
        loop {
            let state = self.state();
            let is_flat = (state.handles, state.peers, state.tasks, state.descriptors)
                == (before.handles, before.peers, before.tasks, before.descriptors);
            if is_flat || Instant::now() >= until {
                return state;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the words of a line.
fn line<T: std::str::FromStr<Err: fmt::Debug>>(output: &mut impl BufRead) -> Vec<T> {
    let mut line = String::new();
    output.read_line(&mut line).expect("the server answers");
    line.split_whitespace().map(|word| word.parse().expect("a word of the right kind")).collect()
}
