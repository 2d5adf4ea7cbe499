//! The arguments of the commands that do a whole job, of the shell and of scripts.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use bcap_capture::duration;

/// Moves the robot to a position, and waits until it rests there
///
/// Takes the arm, switches the motor on, moves, switches the motor off again and gives the arm back. Where this session has
/// the arm already (`exec robot TakeArm 0 1` in the shell or a script), it keeps the arm, and the motor stays on. Ctrl-C
/// and Ctrl-Z halt the robot and give the arm back; over a serial line they cannot, because such a line carries one session.
///
/// A real robot moves only after a question, or with --yes; without a terminal the question cannot be asked, so --yes is
/// needed. A virtual controller is recognised by its @MAKER_NAME and @SERIAL_NO, and is not asked about.
///
/// POSITION is a variable (P1, J2, T3), or a value as the controller's language writes it: 'J(0, 45, 90, 0, 45, 0)',
/// 'P(400, 0, 300, 180, 0, 180, 5)'. The exit code is 0 only if the robot rests at the destination, or,
/// with --no-wait, if the motion has begun.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap move P1 --line --speed 10
  bcap move 'J(0, 45, 90, 0, 45, 0)' --speed 20 --within 30s")]
pub(crate) struct MoveArgs {
    /// The destination
    #[arg(value_name = "POSITION")]
    pub(crate) to: String,

    /// Moves the tool along a line; without it all joints move at the same time
    #[arg(long)]
    pub(crate) line: bool,

    /// The speed, in percent of the speed that the arm is set to
    #[arg(long, value_name = "PERCENT", default_value_t = 10.0)]
    pub(crate) speed: f64,

    /// Selects the tool first; 0 is the flange
    #[arg(long, value_name = "N")]
    pub(crate) tool: Option<u8>,

    /// Selects the work coordinates first; 0 is the base of the robot
    #[arg(long, value_name = "N")]
    pub(crate) work: Option<u8>,

    /// Halts the robot if it has not arrived after this time
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "3min")]
    pub(crate) within: Duration,

    /// Waits for the end of the motion, which is the default
    #[arg(long, overrides_with = "no_wait")]
    pub(crate) wait: bool,

    /// Returns when the motion has begun. It needs the arm of the session, so only the shell and scripts have it
    #[arg(long)]
    pub(crate) no_wait: bool,

    /// Moves a real robot without asking for confirmation
    #[arg(long)]
    pub(crate) yes: bool,
}

/// Starts or stops a task, or prints its status
///
/// A program that `task start` has started runs on when the command ends.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap task start Pro1 --once
  bcap task status Pro1
  bcap task stop Pro1")]
pub(crate) struct Task {
    #[command(subcommand)]
    pub(crate) command: TaskCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Starts a task
    Start {
        /// The task
        name: String,
        #[command(flatten)]
        cycles: Cycles,
    },
    /// Stops a task
    Stop {
        /// The task
        name: String,
        #[command(flatten)]
        when: When,
    },
    /// Prints what a task does: running, ready, suspended, stopped at a step, or none
    Status {
        /// The task
        name: String,
    },
}

/// How long a task runs.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub(crate) struct Cycles {
    /// Runs the program once
    #[arg(long)]
    pub(crate) once: bool,

    /// Runs the program again and again
    #[arg(long)]
    pub(crate) forever: bool,

    /// Runs one step of the program
    #[arg(long)]
    pub(crate) step: bool,
}

/// When a task stops.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub(crate) struct When {
    /// Stops at once
    #[arg(long)]
    pub(crate) now: bool,

    /// Stops after the present step
    #[arg(long)]
    pub(crate) after_step: bool,

    /// Stops after the present cycle
    #[arg(long)]
    pub(crate) after_cycle: bool,

    /// Stops at once; the next start begins anew
    #[arg(long)]
    pub(crate) reset: bool,
}

/// Lists the errors of the controller, the first cause last, with their meanings and remedies
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap errors
  bcap errors --json")]
pub(crate) struct Errors {}

/// Clears the errors of the controller
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap clear")]
pub(crate) struct Clear {}

/// Fetches the messages of the controller and prints them: number, source, time and text
///
/// A controller keeps messages for each session from its start on, so a single command gets those that arrive while it
/// waits (--for); in the shell `messages` prints those since the last call.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap messages
  bcap messages --for 100ms --json")]
pub(crate) struct Messages {
    /// Waits this long for further messages; Ctrl-C ends that
    #[arg(long = "for", value_name = "TIME", value_parser = duration::parse)]
    pub(crate) time: Option<Duration>,
}

/// Runs commands over one session, with a prompt
///
/// Every command of `bcap` works without the word `bcap`, and all of them use one session: the arm stays taken, handles stay
/// open. The prompt shows model, mode, errors, and whether this session has the arm and the motor is on. Tab completes
/// commands, functions and the names that the controller lists. Also: `help [COMMAND|FUNCTION]`, `connect`, `exit`, and
/// what scripts have (`bcap run --help`).
///
/// Ctrl-C halts the robot if this session has the arm, over a second connection, and gives the arm back. The end of the
/// shell does the same.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap shell
  bcap shell --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9")]
pub(crate) struct Shell {}

/// Runs a script: the lines of `bcap shell`, from a file or the standard input (-)
///
/// All lines of a file are checked before the first one runs: their commands, arguments and script variables. The lines of the
/// standard input run as they arrive.
///
/// It stops at the first error, prints FILE:LINE, and returns the exit code of that line. Ctrl-C and Ctrl-Z halt the robot if
/// the script has the arm, and give the arm back; the end of the script gives it back as well.
#[derive(Debug, Args)]
#[command(after_help = "\
A script has one command a line. # begins a comment, words with blanks stand between ' or \", $x and ${x} are variables.
  set x = 3               sets a variable of the script
  put I1 $x
  sleep 100ms             waits
  wait I1 = 5 2s          waits until the controller's variable has the value; the time is optional
  expect I1 = 5           fails unless it has the value; also != < <= > >=
  exec robot TakeArm 0 1  the arm stays taken until GiveArm or the end
  move P1 --line --speed 10
Examples:
  bcap run cycle.bcap
  echo 'get I1' | bcap run -")]
pub(crate) struct Run {
    /// The script; - is the standard input
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,

    /// Only checks the lines, without a connection
    #[arg(long)]
    pub(crate) check: bool,
}
