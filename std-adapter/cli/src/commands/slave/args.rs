//! The arguments of `bcap slave`.

use std::path::PathBuf;

use bcap_core::slave::{Mode, PoseType};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use super::format::FormatArgs;

/// Streams poses in Slave Mode, one every 8 ms, and reports the timing
///
/// `play` and `cosine` move the robot; a real one only after a confirmation. Ctrl-C and Ctrl-Z slow the robot down, leave Slave
/// Mode, switch the motor off, release the arm and exit with 130. A second Ctrl-C halts the robot over a separate connection. After an error the robot
/// stops, and the first error of the controller is printed. The controller needs a b-CAP Slave licence, Auto mode, the
/// executable token and no pending error; `bcap doctor` checks these.
///
/// Over a serial line the robot must be able to receive a pose and send its reply within 8 ms; a slower line is refused. Such
/// a line carries one session, so a second Ctrl-C cannot halt the robot, and --approach and --from are refused.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave cosine --seconds 5
  bcap slave record path.csv --seconds 10
  bcap slave play path.csv --mode 2 --approach --report report.json --plot plot.svg
  bcap slave cosine --robot 'serial:/dev/ttyUSB0?baud=921600'")]
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
/// A line of the file is a pose, with its numbers separated by commas: J1 to J8 in degrees (trailing joints are optional),
/// X Y Z RX RY RZ FIG in mm and degrees (P), or X Y Z OX OY OZ AX AY AZ FIG (T). The first line may name the columns, as in
/// a file of `bcap slave record`. Then they may have any order, columns with other names are ignored, and a column `t` is
/// the time of each pose in seconds. Poses are interpolated to the cycle of 8 ms. Columns MINI, HAND and USER are the outputs
/// of --send-format, numbers such as 48 or 0x30, from the time of their line on; a column whose part is not in --send-format
/// is refused. The robot must be at the first pose; --approach moves it there.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave play path.csv
  bcap slave play path.csv --hz 50 --loop 10 --yes
  bcap slave play welding.csv --send-format mini --recv-format PJ,time,mini --received replies.csv
  bcap slave play poses.csv --type P --mode 0 --robot udp:192.168.0.1 --provider CaoProv.DENSO.VRC9")]
pub(crate) struct Play {
    /// The poses
    pub(crate) file: PathBuf,

    /// The lines of the file per second, if it has no column `t`
    #[arg(long, default_value_t = 125.0, value_parser = positive)]
    pub(crate) hz: f64,

    /// How often the file is played; the first pose follows the last one without a pause
    #[arg(long = "loop", value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) loops: u32,

    /// First moves the robot to the first pose, at this percentage of its speed; not over a serial line
    #[arg(long, value_name = "PERCENT", num_args = 0..=1, default_missing_value = "10", value_parser = percent)]
    pub(crate) approach: Option<f64>,

    #[command(flatten)]
    pub(crate) stream: StreamArgs,
}

/// Moves along one period of a cosine, which ends where the robot stands now: the sample of the specification
///
/// Type J turns joint 1; types P and T move along Z. The sample program of the specification begins at the variable J1, in
/// mode 0: --from J1 --mode 0.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave cosine
  bcap slave cosine --from J1 --mode 0
  bcap slave cosine --seconds 80 --amplitude 5 --mode 1 --yes")]
pub(crate) struct Cosine {
    /// The period, in seconds
    #[arg(long, value_name = "N", default_value_t = 5.0, value_parser = positive)]
    pub(crate) seconds: f64,

    /// The distance to the turning point, in degrees (J) or mm (P, T); negative for the other direction
    #[arg(long, value_name = "A", default_value_t = 10.0, allow_negative_numbers = true, value_parser = finite)]
    pub(crate) amplitude: f64,

    /// First moves the robot to this variable, such as J1, as `bcap move` does; not over a serial line
    #[arg(long, value_name = "VARIABLE")]
    pub(crate) from: Option<String>,

    /// The speed of the motion to --from, in percent
    #[arg(long, value_name = "PERCENT", default_value_t = 10.0, requires = "from", value_parser = percent)]
    pub(crate) speed: f64,

    #[command(flatten)]
    pub(crate) stream: StreamArgs,
}

/// Records the pose of the robot in a file, without moving it
///
/// Ends after --seconds or on Ctrl-C, and exits with 0. `bcap slave play` plays the file.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap slave record path.csv --seconds 10
  bcap slave record poses.csv --type P --hz 50")]
pub(crate) struct Record {
    /// The file to write; an existing file is replaced
    pub(crate) file: PathBuf,

    /// The pose type: joints, position, or homogeneous transform
    #[arg(long = "type", value_name = "TYPE", default_value = "J", value_parser = pose())]
    pub(crate) pose: PoseType,

    /// The poses per second
    #[arg(long, default_value_t = 125.0, value_parser = positive)]
    pub(crate) hz: f64,

    /// The duration in seconds [default: until Ctrl-C]
    #[arg(long, value_name = "N", value_parser = positive)]
    pub(crate) seconds: Option<f64>,
}

/// The options of all streams.
#[derive(Debug, Args)]
pub(crate) struct StreamArgs {
    /// How the controller accepts poses: 0 fills a buffer of 3, 1 overwrites the last pose, 2 answers when there is room
    #[arg(long, value_name = "MODE", default_value = "2", value_parser = mode())]
    pub(crate) mode: Mode,

    /// The pose type: joints, position, or homogeneous transform [default: from the file's first line, or J]
    #[arg(long = "type", value_name = "TYPE", value_parser = pose())]
    pub(crate) pose: Option<PoseType>,

    #[command(flatten)]
    pub(crate) format: FormatArgs,

    /// Moves a real robot without asking for confirmation; a virtual one is never asked about
    #[arg(long)]
    pub(crate) yes: bool,

    /// Leaves the motor on at the end; without it a motor that the stream has switched on is switched off
    #[arg(long)]
    pub(crate) keep_motor: bool,

    /// Refuses poses that need a higher speed of an axis, in degrees or mm per second
    #[arg(long, value_name = "SPEED", value_parser = positive)]
    pub(crate) max_speed: Option<f64>,

    /// Refuses poses that need a higher acceleration of an axis, in degrees or mm per second squared; also limits the stop
    #[arg(long, value_name = "ACCELERATION", value_parser = positive)]
    pub(crate) max_acceleration: Option<f64>,

    /// Writes the statistics as JSON: cycles, late, underflows, refused, rtt_us and jitter_us with p50, p99, p999 and max
    #[arg(long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,

    /// Plots the commanded and actual poses, their difference, and the cycle times
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,

    /// Runs with this real-time priority (SCHED_FIFO, 1 to 99); needs a privilege
    #[arg(long, value_name = "PRIORITY", num_args = 0..=1, default_missing_value = "80", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub(crate) fifo: Option<u8>,

    /// Locks the program's memory, so that it is never paged out; needs a privilege
    #[arg(long)]
    pub(crate) lock_memory: bool,

    /// Runs on this processor core, counted from 0
    #[arg(long, value_name = "N")]
    pub(crate) core: Option<usize>,
}

/// Parses a mode.
fn mode() -> impl TypedValueParser<Value = Mode> {
    PossibleValuesParser::new(["0", "1", "2"]).map(|mode| match mode.as_str() {
        "0" => Mode::Mode0,
        "1" => Mode::Mode1,
        _ => Mode::Mode2,
    })
}

/// Parses a type of poses.
fn pose() -> impl TypedValueParser<Value = PoseType> {
    let types = [("J", "j"), ("P", "p"), ("T", "t")].map(|(name, alias)| PossibleValue::new(name).alias(alias));
    PossibleValuesParser::new(types).map(|pose| match pose.to_ascii_uppercase().as_str() {
        "P" => PoseType::P,
        "T" => PoseType::T,
        _ => PoseType::J,
    })
}

fn finite(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "write a finite number, such as 2.5".into())
}

fn positive(text: &str) -> Result<f64, String> {
    Some(finite(text)?).filter(|number| *number > 0.0).ok_or_else(|| "write a number above 0".into())
}

fn percent(text: &str) -> Result<f64, String> {
    positive(text).ok().filter(|number| *number <= 100.0).ok_or_else(|| "write a percentage, above 0 up to 100".into())
}
