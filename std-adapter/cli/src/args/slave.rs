//! The arguments of `bcap slave`.

use std::path::PathBuf;

use bcap_core::slave::{Mode, PoseType};
use clap::{Args, Subcommand, ValueEnum};

/// Streams poses in Slave Mode, one every 8 ms, and shows how well that went
///
/// The robot moves with `play` and `cosine`: both ask first. Ctrl-C stops in an orderly way (a ramp, Slave Mode is left, the
/// arm given back) and ends with 130; a second Ctrl-C halts the robot over a connection of its own. After an error nothing
/// moves any more, and the controller's first error is told. The controller needs its b-CAP Slave licence, Auto mode, the
/// executable token and no error: `bcap doctor` looks.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave cosine --seconds 5
  bcap slave record path.csv --seconds 10
  bcap slave play path.csv --mode 2 --approach --report report.json --plot plot.svg")]
pub(crate) struct Slave {
    #[command(subcommand)]
    pub(crate) command: SlaveCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum SlaveCommand {
    Play(Play),
    Cosine(Cosine),
    Record(Record),
}

/// Plays a file of poses
///
/// A line of the file is a pose, its numbers separated by commas: J1 to J8 in degrees (fewer will do), X Y Z RX RY RZ FIG in
/// mm and degrees (P), or X Y Z OX OY OZ AX AY AZ FIG (T). The first line may name the columns; then their order does not
/// matter, columns of other names are left out, and a column `t` says when each pose is due, in seconds; as in what
/// `bcap slave record` writes. Poses between those of the file are interpolated where the cycle of 8 ms wants them. The
/// robot has to stand at the first pose; --approach brings it there.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave play path.csv
  bcap slave play path.csv --hz 50 --loop 10 --yes
  bcap slave play poses.csv --type P --mode 0 --robot udp:192.168.0.1 --provider CaoProv.DENSO.VRC9")]
pub(crate) struct Play {
    /// The poses
    pub(crate) file: PathBuf,

    /// How many lines of the file are due in a second, when it has no column `t`
    #[arg(long, default_value_t = 125.0, value_parser = positive)]
    pub(crate) hz: f64,

    /// How often the file is played, from its last pose straight on to its first
    #[arg(long = "loop", value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) loops: u32,

    /// Moves the robot to the first pose before, at this percentage of its speed
    #[arg(long, value_name = "PERCENT", num_args = 0..=1, default_missing_value = "10", value_parser = percent)]
    pub(crate) approach: Option<f64>,

    #[command(flatten)]
    pub(crate) stream: StreamArgs,
}

/// Moves along one period of a cosine, from where the robot stands, and back: the sample of the specification
///
/// Type J turns joint 1; types P and T move along Z.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave cosine
  bcap slave cosine --seconds 80 --amplitude 5 --mode 1 --yes")]
pub(crate) struct Cosine {
    /// How long the period takes
    #[arg(long, value_name = "N", default_value_t = 5.0, value_parser = positive)]
    pub(crate) seconds: f64,

    /// How far it goes, in degrees (J) or mm (P, T); negative for the other direction
    #[arg(long, value_name = "A", default_value_t = 10.0, allow_negative_numbers = true, value_parser = finite)]
    pub(crate) amplitude: f64,

    #[command(flatten)]
    pub(crate) stream: StreamArgs,
}

/// Writes down where the robot is, over a connection that moves nothing
///
/// Ends after --seconds, or with Ctrl-C, which is 0 as well. `bcap slave play` plays the file.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave record path.csv --seconds 10
  bcap slave record poses.csv --type P --hz 50")]
pub(crate) struct Record {
    /// Where to write; a file that is there is replaced
    pub(crate) file: PathBuf,

    /// What to write: joints, position, or homogeneous transform
    #[arg(long = "type", value_name = "TYPE", default_value = "J")]
    pub(crate) pose: PoseArg,

    /// How often in a second
    #[arg(long, default_value_t = 125.0, value_parser = positive)]
    pub(crate) hz: f64,

    /// For how long; until Ctrl-C unless given
    #[arg(long, value_name = "N", value_parser = positive)]
    pub(crate) seconds: Option<f64>,
}

/// What all streams have in common.
#[derive(Debug, Args)]
pub(crate) struct StreamArgs {
    /// When the controller takes a pose: 0 fills a buffer of 3, 1 overwrites the last, 2 answers when there is room
    #[arg(long, value_name = "MODE", default_value = "2")]
    pub(crate) mode: ModeArg,

    /// What the poses are: joints, position, or homogeneous transform; otherwise what the file's first line says, or J
    #[arg(long = "type", value_name = "TYPE")]
    pub(crate) pose: Option<PoseArg>,

    /// Does not ask before the robot moves
    #[arg(long)]
    pub(crate) yes: bool,

    /// Refuses a pose that asks more of an axis than this, in degrees or mm per second
    #[arg(long, value_name = "SPEED", value_parser = positive)]
    pub(crate) max_speed: Option<f64>,

    /// Refuses a pose that asks more of an axis than this, in degrees or mm per second squared; also slows down so
    #[arg(long, value_name = "ACCELERATION", value_parser = positive)]
    pub(crate) max_acceleration: Option<f64>,

    /// Writes the figures as JSON: cycles, late, underflows, refused, rtt_us and jitter_us with p50, p99, p999 and max
    #[arg(long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,

    /// Draws where the robot was to be and where it was, the difference, and the times of the cycles
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,

    /// Runs before all ordinary threads of this machine (SCHED_FIFO, 1 to 99); needs rights
    #[arg(long, value_name = "PRIORITY", num_args = 0..=1, default_missing_value = "80", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub(crate) fifo: Option<u8>,

    /// Keeps the program's memory from being paged out; needs rights
    #[arg(long)]
    pub(crate) lock_memory: bool,

    /// Stays on this core of the processor
    #[arg(long, value_name = "N")]
    pub(crate) core: Option<usize>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ModeArg {
    #[value(name = "0")]
    Mode0,
    #[value(name = "1")]
    Mode1,
    #[value(name = "2")]
    Mode2,
}

impl From<ModeArg> for Mode {
    fn from(mode: ModeArg) -> Self {
        match mode {
            ModeArg::Mode0 => Self::Mode0,
            ModeArg::Mode1 => Self::Mode1,
            ModeArg::Mode2 => Self::Mode2,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum PoseArg {
    #[value(name = "J", alias = "j")]
    J,
    #[value(name = "P", alias = "p")]
    P,
    #[value(name = "T", alias = "t")]
    T,
}

impl From<PoseArg> for PoseType {
    fn from(pose: PoseArg) -> Self {
        match pose {
            PoseArg::J => Self::J,
            PoseArg::P => Self::P,
            PoseArg::T => Self::T,
        }
    }
}

fn finite(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "write a number, such as 2.5".into())
}

fn positive(text: &str) -> Result<f64, String> {
    finite(text)?;
    finite(text).ok().filter(|number| *number > 0.0).ok_or_else(|| "write a number above 0".into())
}

fn percent(text: &str) -> Result<f64, String> {
    positive(text).ok().filter(|number| *number <= 100.0).ok_or_else(|| "write a percentage, above 0 up to 100".into())
}

/// Stops the robot, whoever moves it
///
/// Takes a connection of its own, whatever else runs, and needs neither the arm nor the token. All of it takes at most
/// --timeout, or 3 s; if the controller has not halted by then, the exit code is 4. What moved the robot fails: a
/// motion with E_ABORT, a stream of Slave Mode because Slave Mode is off.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap halt
  bcap halt --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9")]
pub(crate) struct Halt {}

/// Looks at all that a program needs before it can move the robot, and says what to do about what is missing
///
/// Reachability over TCP and UDP, provider, version, mode, executable token, errors, emergency stop, arm, motor, the licence
/// and the formats of Slave Mode: each is ok, FAILED, ? (the controller's answer tells neither) or - (not looked at, because of
/// something else). With --json a line is {"check":"mode","result":"failed","detail":"..","hint":".."}, its result one of
/// passed, failed, untested and skipped. The exit code is that of the first that is FAILED or ?. Nothing moves and nothing is
/// written; the arm is taken for a moment if it is free.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap doctor --robot tcp:192.168.0.1
  bcap doctor --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9 --json")]
pub(crate) struct Doctor {
    /// Where b-CAP over TCP is, if not at the port of --robot
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) tcp_port: Option<u16>,

    /// Where b-CAP over UDP is, if not at the port of --robot
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) udp_port: Option<u16>,
}
