//! `bcap proxy`: forwards b-CAP and RAC to a robot, prints and records the bytes, and injects faults.
//!
//! The thread of the recording makes the lines, and another thread prints them: a terminal that does not read delays neither the
//! robot nor the file.

use std::io;
use std::net::SocketAddr;
use std::path::Path;

use bcap_capture::decode::{Format, Live};
use bcap_capture::faults::{Delay, FaultPlan, Share};
use bcap_capture::proxy::{Listeners, Robot};
use bcap_capture::record::Recording;
use bcap_terminal::signal;
use clap::Args;
use tokio::net::{TcpListener, UdpSocket};

use crate::commands::robot_ports::{self, RobotPorts};
use crate::commands::sim::args::Sim;
use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::listen::{Listening, runtime, taken, tcp, tcp_if};
use crate::output::{PrintQueue, Printer, print_line};

/// Forwards b-CAP and RAC to a robot, prints the calls, and records every byte
///
/// Prints one line, `ready bcap=IP:PORT udp=IP:PORT`, when it listens, with `rac=IP:PORT` after --listen-rac, then each call when
/// its reply has arrived, as `bcap decode` prints it. --write FILE.pcapng records every byte: packets between the client and the
/// robot, as the client sent and received them. Faults are injected by share: 0.1 is a tenth of the frames, chosen at random,
/// in both directions. A fault is printed, and in the file it is the comment of its packet. On SIGINT, SIGTERM and SIGHUP it
/// ends with 0.
///
/// It serves 256 clients over UDP, 256 TCP connections of b-CAP and 256 of RAC. Datagrams of further clients are dropped, and
/// further connections are closed, with a note. The slot of a client over UDP is free 5 seconds after its Service_Stop, or when
/// the robot has not answered it for 10 minutes, or at all in 30 seconds; a new client can take it when this client has sent nothing for 10 seconds.
/// A new TCP connection gets the slot of the one that has been idle longest, for at least 10 seconds. A connection that waits for
/// a reply keeps its slot for 10 minutes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap proxy --robot 192.168.0.1 --write session.pcapng
  bcap proxy --listen [::]:5007 --listen-rac [::]:5006 --robot 192.168.0.1 --quiet --write session.pcapng
  bcap proxy --robot 192.168.0.1 --drop 0.01 --delay 50ms@0.1 --seed 7
  bcap proxy --robot 192.168.0.1 --corrupt 1:Variable_GetValue --drop 0.5:Robot_Execute/slvMove")]
pub(crate) struct Proxy {
    /// Where b-CAP listens, over TCP and UDP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) listen: SocketAddr,

    /// Where RAC listens [default: RAC is not forwarded]
    #[arg(long, value_name = "ADDR")]
    pub(crate) listen_rac: Option<SocketAddr>,

    #[command(flatten)]
    pub(crate) robot: RobotPorts,

    /// Prints no calls
    #[arg(long)]
    pub(crate) quiet: bool,

    /// Drops this share of the frames, SHARE[:FUNCTION[/COMMAND]]
    ///
    /// FUNCTION is a name or a number of `bcap call --list`, or GET or PUT of RAC. A fault with a function applies to its
    /// requests and its replies. The option may be repeated.
    #[arg(long, value_name = "SHARE[:FUNCTION]", help_heading = "Faults")]
    pub(crate) drop: Vec<Share>,

    /// Delays all frames, or a share of them: TIME[@SHARE][:FUNCTION[/COMMAND]]
    ///
    /// Later bytes of the same direction of a TCP connection wait too; datagrams overtake each other.
    #[arg(long, value_name = "TIME[@SHARE][:FUNCTION]", help_heading = "Faults")]
    pub(crate) delay: Vec<Delay>,

    /// Changes one bit of this share of the frames, SHARE[:FUNCTION[/COMMAND]]
    #[arg(long, value_name = "SHARE[:FUNCTION]", help_heading = "Faults")]
    pub(crate) corrupt: Vec<Share>,

    /// Chooses the same frames again for the same traffic
    #[arg(long, value_name = "N", help_heading = "Faults")]
    pub(crate) seed: Option<u64>,
}

/// Runs `bcap proxy` until a signal ends it.
pub(crate) fn proxy(args: &Proxy, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let robot = robot_ports::resolve(&args.robot, link)?;
    let faults = FaultPlan { drop: args.drop.clone(), delay: args.delay.clone(), corrupt: args.corrupt.clone() };
    let seed = args.seed.unwrap_or_else(|| fastrand::u64(..));
    let runtime = runtime()?;
    runtime.block_on(async {
        // install the signal handlers first: a reader of the `ready` line may send a signal immediately
        let ended = signal::wait()?;
        let listeners = bind(args).await?;
        let printer = (!args.quiet).then(|| Printer::start(json)).transpose()?;
        let recording = record(link.write.as_deref(), printer.as_ref().map(Printer::queue), json)?;
        print_line(&listening(&listeners)?.to_string())?;
        let proxy = bcap_capture::proxy::Proxy::new(listeners, robot);
        proxy.connect_timeout(link.timeout()).faults(faults, seed).run(&recording, ended).await;
        recording.finish()?;
        if let Some(printer) = printer {
            printer.finish();
        }
        Ok(())
    })
}

/// Starts the recording, with lines of the calls if there is a queue for them.
fn record(file: Option<&Path>, lines: Option<PrintQueue>, json: bool) -> Result<Recording, Failure> {
    let mut live = Live::new(if json { Format::Json } else { Format::Text });
    let recording = Recording::start(file, move |recorded| {
        let Some(queue) = &lines else { return };
        for line in live.lines(&recorded) {
            // the file is complete, whatever the terminal takes
            queue.put(line);
        }
    });
    Ok(recording?)
}

/// A recorded front of a virtual controller in this process, which listens on other addresses.
pub(crate) struct Front {
    listeners: Listeners,
    recording: Recording,
}

impl Front {
    /// Binds the addresses of the controller, and starts the recording.
    pub(crate) async fn bind(args: &Sim, rac: Option<SocketAddr>, file: &Path) -> Result<Self, Failure> {
        let listeners = Listeners {
            bcap: tcp("--bcap", args.bcap).await?,
            udp: UdpSocket::bind(args.udp).await.map_err(|error| taken("--udp", args.udp, &error))?,
            rac: tcp_if("--rac", rac).await?,
        };
        Ok(Self { listeners, recording: Recording::start(Some(file), |_| {})? })
    }

    /// Returns the addresses.
    pub(crate) fn listening(&self) -> io::Result<Listening> {
        listening(&self.listeners)
    }

    /// Forwards to the controller until `ended`, then closes the file.
    pub(crate) async fn serve(self, robot: Robot, ended: impl Future<Output = ()>) -> Result<(), Failure> {
        bcap_capture::proxy::Proxy::new(self.listeners, robot).show_listener().run(&self.recording, ended).await;
        Ok(self.recording.finish()?)
    }
}

/// Binds the sockets that the arguments name. With port 0 b-CAP has the same port over TCP and UDP if it is free.
async fn bind(args: &Proxy) -> Result<Listeners, Failure> {
    let wanted = args.listen;
    let bcap = tcp("--listen", wanted).await?;
    let bound = bcap.local_addr()?;
    let udp = match UdpSocket::bind(bound).await {
        Err(_) if wanted.port() == 0 => UdpSocket::bind(wanted).await,
        udp => udp,
    };
    let udp = udp.map_err(|error| taken("--listen", bound, &error))?;
    Ok(Listeners { bcap, udp, rac: tcp_if("--listen-rac", args.listen_rac).await? })
}

fn listening(listeners: &Listeners) -> io::Result<Listening> {
    let rac = listeners.rac.as_ref().map(TcpListener::local_addr).transpose()?;
    Ok(Listening { bcap: listeners.bcap.local_addr()?, udp: listeners.udp.local_addr()?, rac })
}
