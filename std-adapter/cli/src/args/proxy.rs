//! The arguments of `bcap proxy`.

use std::net::SocketAddr;

use clap::Args;

use bcap_capture::faults::{Delay, Share};

/// The addresses of a robot that is used over all protocols.
#[derive(Debug, Args)]
pub(crate) struct RobotPorts {
    /// The robot's address for b-CAP over UDP [default: that of --robot]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_udp: Option<String>,

    /// The robot's address for RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// Forwards b-CAP and RAC to a robot, prints the calls, and records every byte
///
/// Prints one line, `ready bcap=IP:PORT udp=IP:PORT rac=IP:PORT`, when it listens, then each call when its reply has arrived, as
/// `bcap decode` prints it. --write FILE.pcapng records every byte: packets between the client and the robot, as the client
/// sent and received them. Faults are injected by share: 0.1 is a tenth of the frames, chosen at random, in both directions. A
/// fault is printed, and in the file it is the comment of its packet. On SIGINT, SIGTERM and SIGHUP it ends with 0.
///
/// It serves 256 clients over UDP, 256 TCP connections of b-CAP and 256 of RAC. Datagrams of further clients are dropped, and
/// further connections are closed, with a note. A client over UDP that the robot has not answered for 10 minutes no longer counts.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap proxy --robot 192.168.0.1 --write session.pcapng
  bcap proxy --listen [::]:5007 --robot 192.168.0.1 --quiet --write session.pcapng
  bcap proxy --robot 192.168.0.1 --drop 0.01 --delay 50ms@0.1 --seed 7
  bcap proxy --robot 192.168.0.1 --corrupt 1:Variable_GetValue --drop 0.5:Robot_Execute/slvMove")]
pub(crate) struct Proxy {
    /// Where b-CAP listens, over TCP and UDP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) listen: SocketAddr,

    /// Where RAC listens [default: the port below that of --listen; a free one if that is 0]
    #[arg(long, value_name = "ADDR")]
    pub(crate) listen_rac: Option<SocketAddr>,

    #[command(flatten)]
    pub(crate) robot: RobotPorts,

    /// Prints no calls
    #[arg(long)]
    pub(crate) quiet: bool,

    /// Drops this share of the frames, SHARE[:FUNCTION[/COMMAND]]
    ///
    /// FUNCTION is a name or a number of `bcap call --list`, or GET or PUT of RAC. A fault of a function is one of its requests
    /// and of its replies. The option may be repeated.
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
