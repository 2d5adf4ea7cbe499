//! `bcap proxy`: forwards b-CAP and RAC to a robot, prints and records what passes, and injects faults.
//!
//! ```text
//!  tcp   a task for each direction of each connection ─┐
//!  udp   a socket to the robot for each client ────────┼─► record: the file, and the lines
//!  RAC   as TCP                                        ┘
//! ```
//!
//! Bytes are forwarded before they are recorded, so that recording does not delay them. The thread of the recording makes the
//! lines, and another thread prints them: a terminal that does not read delays neither the robot nor the file.

mod shared;
mod tcp;
mod udp;

use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_terminal::signal;
use tokio::net::{TcpListener, UdpSocket};
use tokio::time::sleep;

use self::shared::Shared;
use crate::args::{LinkArgs, Proxy, Sim};
use crate::capture::Live;
use crate::error::Failure;
use crate::faults::Plan;
use crate::listen::{runtime, taken};
use crate::output::{print_json, print_line};
use crate::record::Recording;
use crate::robot::Robot;

/// The most lines that wait for the terminal.
const LINES: usize = 4096;

/// The time between two looks whether the file can still be written.
const CHECK: Duration = Duration::from_millis(200);

/// The time limit for connecting to a controller in this process.
const DEFAULT_CONNECT: Duration = Duration::from_secs(3);

/// The bound sockets.
struct Listeners {
    bcap: TcpListener,
    udp: UdpSocket,
    /// `None` if the robot has no RAC.
    rac: Option<TcpListener>,
}

/// Runs `bcap proxy` until a signal ends it.
pub(crate) fn proxy(args: &Proxy, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let robot = Robot::resolve(&args.robot, link)?;
    let plan = Plan { drop: args.drop.clone(), delay: args.delay.clone(), corrupt: args.corrupt.clone() };
    let seed = args.seed.unwrap_or_else(|| fastrand::u64(..));
    let runtime = runtime()?;
    runtime.block_on(async {
        // the signals first: a reader of the line may send one at once
        let ended = signal::wait()?;
        let listeners = Listeners::of_proxy(args).await?;
        let lines = (!args.quiet).then(|| Lines::start(json)).transpose()?;
        let recording = record(link.write.as_deref(), lines.as_ref().map(|lines| lines.queue.clone()), json)?;
        print_line(&listeners.ready()?)?;
        let shared = Shared::new(&recording, link.timeout()).with_faults(plan, seed);
        listeners.run(&robot, &shared, &recording, ended).await;
        recording.finish()?;
        if let Some(lines) = lines {
            lines.finish();
        }
        Ok(())
    })
}

/// Returns when the recording has failed.
async fn failed(recording: &Recording) {
    while !recording.has_failed() {
        sleep(CHECK).await;
    }
}

/// Starts the recording, with lines of the calls if there is a queue for them.
fn record(file: Option<&Path>, lines: Option<SyncSender<String>>, json: bool) -> Result<Recording, Failure> {
    let mut live = Live::new(json);
    Recording::start(file, move |recorded| {
        let Some(queue) = &lines else { return };
        for line in live.lines(&recorded) {
            // lines are dropped if the terminal does not read; the file is complete
            let _ = queue.try_send(line);
        }
    })
}

/// A thread that prints lines.
struct Lines {
    queue: SyncSender<String>,
    thread: JoinHandle<()>,
}

impl Lines {
    fn start(json: bool) -> io::Result<Self> {
        let (queue, lines) = sync_channel::<String>(LINES);
        let print = if json { print_json } else { print_line };
        // a closed output does not end the proxy
        let work = move || lines.iter().for_each(|line| drop(print(&line)));
        Ok(Self { queue, thread: thread::Builder::new().name("lines".into()).spawn(work)? })
    }

    /// Prints the rest.
    fn finish(self) {
        drop(self.queue);
        // nothing is left to do if it panicked
        let _ = self.thread.join();
    }
}

/// A recorded front of a virtual controller in this process, which listens on separate addresses.
pub(crate) struct Front {
    listeners: Listeners,
    recording: Recording,
}

impl Front {
    /// Binds the addresses of the controller, and starts the recording.
    pub(crate) async fn bind(args: &Sim, rac: Option<SocketAddr>, file: &Path) -> Result<Self, Failure> {
        Ok(Self { listeners: Listeners::of_sim(args, rac).await?, recording: Recording::start(Some(file), |_| {})? })
    }

    /// Returns the line that names the addresses.
    pub(crate) fn ready(&self) -> io::Result<String> {
        self.listeners.ready()
    }

    /// Forwards to the controller until `ended`, then closes the file.
    pub(crate) async fn serve(self, robot: &Robot, ended: impl Future<Output = ()>) -> Result<(), Failure> {
        let mut shared = Shared::new(&self.recording, DEFAULT_CONNECT);
        shared.shows_listener = true;
        self.listeners.run(robot, &shared, &self.recording, ended).await;
        self.recording.finish()
    }
}

impl Listeners {
    /// Binds the sockets that the arguments name. With port 0 b-CAP has the same port over TCP and UDP if it is free.
    async fn of_proxy(args: &Proxy) -> Result<Self, Failure> {
        let wanted = args.listen;
        let bcap = TcpListener::bind(wanted).await.map_err(|error| taken("--listen", wanted, &error))?;
        let bound = bcap.local_addr()?;
        let udp = match UdpSocket::bind(bound).await {
            Err(_) if wanted.port() == 0 => UdpSocket::bind(wanted).await,
            udp => udp,
        };
        let udp = udp.map_err(|error| taken("--listen", bound, &error))?;
        let below = SocketAddr::new(wanted.ip(), wanted.port().saturating_sub(1));
        let wanted = args.listen_rac.unwrap_or(below);
        let rac = TcpListener::bind(wanted).await.map_err(|error| taken("--listen-rac", wanted, &error))?;
        Ok(Self { bcap, udp, rac: Some(rac) })
    }

    /// Binds the sockets of a virtual controller that is recorded.
    async fn of_sim(args: &Sim, rac: Option<SocketAddr>) -> Result<Self, Failure> {
        let tcp =
            async |option, address| TcpListener::bind(address).await.map_err(|error| taken(option, address, &error));
        let bcap = tcp("--bcap", args.bcap).await?;
        let rac = match rac {
            Some(address) => Some(tcp("--rac", address).await?),
            None => None,
        };
        let udp = UdpSocket::bind(args.udp).await.map_err(|error| taken("--udp", args.udp, &error))?;
        Ok(Self { bcap, udp, rac })
    }

    fn ready(&self) -> io::Result<String> {
        let mut ready = format!("ready bcap={} udp={}", self.bcap.local_addr()?, self.udp.local_addr()?);
        if let Some(rac) = &self.rac {
            ready += &format!(" rac={}", rac.local_addr()?);
        }
        Ok(ready)
    }

    /// Forwards until `ended` or until the file cannot be written, then closes all connections.
    async fn run(self, robot: &Robot, shared: &Shared, recording: &Recording, ended: impl Future<Output = ()>) {
        tokio::select! {
            () = ended => {}
            () = self.serve(robot, shared) => {}
            () = failed(recording) => {}
        }
    }

    /// Forwards until it is dropped, which closes all connections.
    async fn serve(self, robot: &Robot, shared: &Shared) {
        let (tcp, rac): (Arc<[SocketAddr]>, Arc<[SocketAddr]>) =
            (robot.tcp.as_slice().into(), robot.rac.as_slice().into());
        tokio::join!(
            tcp::listen(self.bcap, tcp, false, shared.clone()),
            udp::serve(self.udp, robot.udp, shared.clone()),
            async {
                if let Some(listener) = self.rac {
                    tcp::listen(listener, rac, true, shared.clone()).await;
                }
            },
        );
    }
}
