//! The arguments of `bcap get`, `bcap put`, `bcap watch` and `bcap names`.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use bcap_capture::duration;

/// Reads variables
///
/// NAME is a variable of the controller, such as I1, P10 or @MODE, or of an object: robot/@SERVO_ON,
/// robot:Arm0/@CURRENT_POSITION, task:Pro1/@STATUS. I1-I50 is a range, and 'I*' are all variables of a kind (quote it).
/// With --json a line is {"name":"I1","vt":3,"v":5}; `bcap encode --help` describes `vt` and `v`. Without --json the numbers
/// of an R8 array, such as a pose, have at most 15 digits. $LAST_SEND_PACKET$ and $LAST_RECEIVE_PACKET$ are the bytes of the
/// last packets before them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap get I1
  bcap get --robot tcp:192.168.0.1 --json P1 P2 robot/@CURRENT_POSITION
  bcap get I1-I50 IO128-IO135 'S*'
  bcap get I1 '$LAST_SEND_PACKET$' '$LAST_RECEIVE_PACKET$'
  BCAP_ROBOT=udp:192.168.0.1 bcap get task:Pro1/@STATUS")]
pub(crate) struct Get {
    /// The variables
    #[arg(value_name = "NAME", required = true)]
    pub(crate) names: Vec<String>,
}

/// Writes variables
///
/// Several variables are written as NAME=VALUE, in order. All values are checked before the first is written. After a
/// refusal nothing more is written; each written variable has been printed.
///
/// VALUE is plain data, which take the variable's present type. A number has a decimal point; a BOOL is true, false, on, off,
/// or a number; an array has commas between its elements, as many as the variable has. With --typed VALUE is TYPE,DATA,
/// where TYPE is a VARTYPE number, and the variable is not read first: 3,5 is the I4 5. A VALUE that could be both is
/// refused, such as 3,5 without --typed. So are a number that is not finite, and a BOOL such as 5. Without --typed, TYPE,DATA is accepted only for an array, with the variable's own
/// type and length.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap put I1 5
  bcap put S1 'hello, world'
  bcap put P1 400,0,300,180,0,180,5
  bcap put --typed F1 4,2.5
  bcap put IO128 true
  bcap put I1=5 I2=7 V1=-1,2,3
  bcap get --json I1-I50 >values.jsonl
  bcap put --from values.jsonl")]
pub(crate) struct Put {
    /// The variable, as for `bcap get`, or NAME=VALUE
    #[arg(required_unless_present = "from")]
    pub(crate) name: Option<String>,

    /// The value, or the next NAME=VALUE
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: Option<String>,

    /// More variables
    #[arg(value_name = "NAME=VALUE")]
    pub(crate) more: Vec<String>,

    /// Reads each VALUE as TYPE,DATA, also of another type than the variable's
    #[arg(long)]
    pub(crate) typed: bool,

    /// Writes the values of a file of lines as `bcap get --json` prints them, with their types; - is the standard input
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "typed"])]
    pub(crate) from: Option<PathBuf>,
}

/// Reads variables periodically
///
/// A line begins with the seconds since the start; with --json it has the milliseconds as "ms". On SIGINT, SIGTERM and SIGHUP the
/// command releases its objects, stops the service and exits with 0.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap watch robot/@CURRENT_POSITION --interval 20
  bcap watch I1 I2 IO128 --changed --json
  bcap watch I1-I4 P1 --interval 10ms --count 100 --csv table.csv
  bcap watch I1 robot/@CURRENT_ANGLE --interval 20ms --count 100 --mcap values.mcap")]
pub(crate) struct Watch {
    /// The variables, as for `bcap get`
    #[arg(value_name = "NAME", required = true)]
    pub(crate) names: Vec<String>,

    /// The time from one round to the next, in ms or with a unit (10ms, 2s)
    #[arg(long, value_name = "MS", default_value = "100", value_parser = duration::parse)]
    pub(crate) interval: Duration,

    /// Prints a variable only when its value has changed; with --csv a row only when any value has changed
    #[arg(long, visible_alias = "changes")]
    pub(crate) changed: bool,

    /// Writes a table to a file instead: a row for each round, the seconds since the start in its first column `t`; - is the
    /// standard output
    ///
    /// An array has a column for each element, P1.1 to P1.7. An existing file is replaced.
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    pub(crate) csv: Option<PathBuf>,

    /// Writes the values to an MCAP file instead, for Foxglove and PlotJuggler: a topic for each variable, such as /I1
    ///
    /// A message is JSON with the field `value`; its time is the time of the reading. With --changed a value is written
    /// only when it has changed. An existing file is replaced.
    #[arg(long, value_name = "FILE.mcap", conflicts_with = "json")]
    pub(crate) mcap: Option<PathBuf>,

    /// Ends after this number of rounds
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
}

/// Lists the variables, robots, tasks, files, extensions and commands of the controller
///
/// The other commands accept the names as they are printed. A list that the controller does not implement (E_NOTIMPL) is
/// omitted. Any other list that cannot be read is an error, and the exit code is 1. Over UDP a list must fit one datagram of
/// at most 504 bytes; TCP carries longer lists.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap names
  bcap names --json --robot tcp:192.168.0.1")]
pub(crate) struct Names {}
