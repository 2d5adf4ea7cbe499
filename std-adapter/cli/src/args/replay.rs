//! The arguments of `bcap replay`.

use std::path::PathBuf;

use clap::Args;

use super::RobotPorts;
use bcap_capture::CallName;

/// Makes the calls of a capture again, and compares the replies
///
/// Every connection of the capture is opened again, and its calls are made at their times. A call is never made before the calls
/// that were answered before it have been answered again. Handles are replaced by those that the robot gives now; a call is not
/// sent if its object is not open in the replay. The retries of calls over UDP are not repeated. A reply that differs is printed
/// with the recorded one, and the exit code is then 1. A call that had no reply is made, but not compared.
/// At most 1024 connections are replayed. When the output is closed, such as by `head`, no more calls are made.
///
/// Functions and commands that may move the robot or write must be allowed by name (`bcap call --list --effects`). Without
/// that nothing is sent.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap replay session.pcapng --robot 192.168.0.1
  bcap replay session.pcapng --fast --allow Variable_PutValue --allow Robot_Execute/TakeArm
  bcap replay session.pcapng --volatile @CURRENT_TIME --volatile Robot_Execute/slvMove --allow Robot_Execute")]
pub(crate) struct Replay {
    /// The capture: a file of `--write`, of Wireshark or of tcpdump
    pub(crate) file: PathBuf,

    /// Makes each call as soon as the replies before it have arrived, instead of at its time
    #[arg(long)]
    pub(crate) fast: bool,

    /// Allows a function that may move or write: FUNCTION[/COMMAND], or PUT of RAC
    #[arg(long, value_name = "FUNCTION[/COMMAND]")]
    pub(crate) allow: Vec<CallName>,

    /// Does not compare the value of these replies, only whether they succeed: FUNCTION[/COMMAND], or an object such as @MODE
    #[arg(long, value_name = "NAME")]
    pub(crate) volatile: Vec<String>,

    #[command(flatten)]
    pub(crate) robot: RobotPorts,
}
