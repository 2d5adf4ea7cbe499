//! The arguments of `bcap fuzz`.

use std::path::PathBuf;
use std::time::Duration;

use bcap_gateway::AllowBuf;
use clap::Args;

use bcap_capture::duration;

/// Fuzzes a device that you may break: sends valid, nearly valid and hostile sessions, and saves what goes wrong
///
/// Each session has a separate connection, and depends only on --seed and its number. After it a new client must be
/// served. A finding is a crash, a hang, a connection that the device closes after a valid frame, a wrong reply
/// (malformed, serial, type of the value), a handle that is valid without being open, or a leak of handles. It is
/// repeated, reduced to the steps that it needs, and saved in --out as steps (for --again) and as a capture (for `bcap
/// decode` and Wireshark). With findings the exit code is 1.
///
/// By default the fuzzer sends only functions that open, read and release, and commands that read, as `bcap replay` does without
/// --allow. That holds for hostile bytes too: a damaged frame whose function could be another one is not sent. Still a device with a
/// fault may do anything with any packet. Keep its emergency stop at hand. The address of --robot chooses the link of b-CAP, TCP or UDP.
/// RAC is fuzzed if its port is open.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap fuzz --robot 192.168.0.1 --seed 1 --duration 2s --yes-this-device-is-mine
  bcap fuzz --robot 192.168.0.1 --seed 7 --runs 20 --rate 500 --with-writes I/90-99 --yes-this-device-is-mine
  bcap fuzz --robot udp:192.168.0.1 --runs 20 --reconnect 500ms --yes-this-device-is-mine
  bcap fuzz --robot 192.168.0.1 --again finding.steps --yes-this-device-is-mine")]
pub(crate) struct Fuzz {
    /// Confirms that the device may crash, and that no person or machine depends on it
    #[arg(long)]
    pub(crate) yes_this_device_is_mine: bool,

    /// Chooses the sessions; the same number gives the same ones
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,

    /// Ends after this time
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "1min")]
    pub(crate) duration: Duration,

    /// Ends after this number of sessions
    #[arg(long, value_name = "N")]
    pub(crate) runs: Option<u64>,

    /// Ends after this number of different findings
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) findings: u64,

    /// Retries refused connections for this time, for devices with few slots. A restart within this time is not detected
    #[arg(long, value_name = "TIME", value_parser = duration::parse)]
    pub(crate) reconnect: Option<Duration>,

    /// Sends at most this number of packets in a second; 0 is no limit
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub(crate) rate: u32,

    /// Runs the steps of a file once instead
    #[arg(long, value_name = "FILE")]
    pub(crate) again: Option<PathBuf>,

    /// The folder for findings; it is made for the first one
    #[arg(long, value_name = "DIR", default_value = "fuzz-findings")]
    pub(crate) out: PathBuf,

    /// Writes these variables too, KIND[/FIRST[-LAST]] such as I/90-99; the option may be repeated
    #[arg(long, value_name = "RANGE", value_parser = range)]
    pub(crate) with_writes: Vec<AllowBuf>,

    /// Sends every function of the specification, and commands that move or set, such as Draw, Motor, SetTool and KillAll
    ///
    /// The robot moves, tasks start and stop, and settings and files change. docs/fuzzing-devices.md lists the commands.
    #[arg(long)]
    pub(crate) with_motion: bool,

    /// How long a device that does not answer after a finding may take to restart
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "30s")]
    pub(crate) restart: Duration,

    /// The robot's address for RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// Parses a range of variables; a fuzzer sends any value, so a rule with values would promise too much.
fn range(text: &str) -> Result<AllowBuf, String> {
    if text.contains('=') {
        return Err("a fuzzer sends any value; write KIND[/FIRST[-LAST]], such as I/90-99".into());
    }
    AllowBuf::parse(text).map_err(|error| error.to_string())
}
