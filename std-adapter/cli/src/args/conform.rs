//! The arguments of `bcap conform`.

use std::net::SocketAddr;

use bcap_conform::{Group, Link};
use clap::{Args, ValueEnum};

/// Judges a controller, a gateway or another server by the cases of the specification, or a client
///
/// Each case has its own connection. A failure is printed with what was sent and received, what was expected and what came; a
/// skipped case with the reason. The address of --robot chooses the link of b-CAP, TCP or UDP. RAC is at the same host.
/// docs/conformance.md describes the groups.
///
/// The exit code is 0 if no case failed, otherwise 1. Ctrl-C ends the run after the present case; with --level motion it
/// halts the robot first, and the case restores what it changed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap conform --robot tcp:192.168.0.1
  bcap conform --robot udp:192.168.0.1 --group udp --group handles
  bcap conform --robot tcp:192.168.0.1 --level write --scratch 50 --group variables
  bcap conform --robot tcp:192.168.0.1 --case frames/wrong-end --json
  bcap conform --robot tcp:192.168.0.1 --level motion --yes-the-robot-may-move --group slave --junit
  bcap conform --list --group udp
  bcap conform --listen 127.0.0.1:5007")]
pub(crate) struct Conform {
    /// The effects that the cases may have on the device
    #[arg(long, value_enum, default_value_t = LevelArg::Read)]
    pub(crate) level: LevelArg,

    /// Allows --level motion: the arm is taken, the motor switched on, and axis 6 turned by 5 degrees and back
    #[arg(long)]
    pub(crate) yes_the_robot_may_move: bool,

    /// Runs only this group; may be repeated
    #[arg(long, value_name = "GROUP", value_parser = group)]
    pub(crate) group: Vec<Group>,

    /// Runs only this case, such as frames/wrong-end; may be repeated
    #[arg(long, value_name = "NAME")]
    pub(crate) case: Vec<String>,

    /// Lists the cases with their level and source, and connects to nothing
    #[arg(long, conflicts_with = "junit")]
    pub(crate) list: bool,

    /// Prints the results as a file of JUnit
    #[arg(long, conflicts_with = "json")]
    pub(crate) junit: bool,

    /// The index of the variables I F D S V P J T that --level write writes and restores
    #[arg(long, value_name = "INDEX", default_value_t = 90)]
    pub(crate) scratch: u32,

    /// The task of the cases of tasks; --level motion starts and stops it
    #[arg(long, value_name = "NAME", default_value = "Pro1")]
    pub(crate) task: String,

    /// Plays a controller at this address instead, [tcp:|udp:]IP:PORT, and judges the clients that connect
    ///
    /// It prints `ready bcap=tcp:IP:PORT`, serves --sessions, and prints the results. It waits at most --timeout (60 s by default) for
    /// a client, and as long for each request. Some calls of Variable_GetValue are answered in unusual ways, so a client under
    /// test should make ten of them.
    #[arg(long, value_name = "ADDRESS", value_parser = listen, conflicts_with_all = ["level", "group", "case", "list"])]
    pub(crate) listen: Option<(Link, SocketAddr)>,

    /// The number of sessions of clients that --listen serves, one after the other
    #[arg(long, value_name = "N", default_value_t = 1, requires = "listen")]
    pub(crate) sessions: usize,

    /// The address of RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// The effects that cases may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LevelArg {
    /// Changes nothing: opens, reads and releases objects, and sends invalid frames
    Read,
    /// Writes the scratch variables too, and restores them
    Write,
    /// Moves the robot a little too, and starts the task
    Motion,
}

fn group(text: &str) -> Result<Group, String> {
    let names = || Group::ALL.map(Group::name).join(", ");
    let found = Group::ALL.into_iter().find(|group| group.name() == text);
    found.ok_or_else(|| format!("no group is named {text:?}; the groups are {}", names()))
}

fn listen(text: &str) -> Result<(Link, SocketAddr), String> {
    let (link, address) = match text.split_once(':') {
        Some(("tcp", rest)) => (Link::Tcp, rest),
        Some(("udp", rest)) => (Link::Udp, rest),
        _ => (Link::Tcp, text),
    };
    let address = address.parse().map_err(|error| format!("{error}: write [tcp:|udp:]IP:PORT"))?;
    Ok((link, address))
}
