//! The arguments of `bcap monitor`.

use std::time::Duration;

use clap::Args;

use bcap_capture::duration;

/// Shows variables, the robot, tasks, errors, messages and packets live in the terminal
///
/// A variable that changes is bold with a `*` for two seconds; numbers have a sparkline of their last values. The
/// packets are one call a line; a call whose reply is the same as before is omitted, until `a` shows all. It reads, and
/// never takes the arm. `w` writes a variable, and asks first. `h` halts the robot at once, over a separate connection;
/// a serial line carries one session, so there it waits for the call under way. `q` and Ctrl-C quit, after a halt that
/// is under way; if that fails, the exit code is 1. SIGTERM and SIGHUP end it with 130.
///
/// Without NAME it shows no variables. A lost connection is shown, and tried again every second. The terminal needs at least
/// 70x18; NO_COLOR removes the colours, and a locale without UTF-8 the characters that are not ASCII. TERM=dumb cannot move the
/// cursor, so use `bcap watch` there. --timeout limits each call.
#[derive(Debug, Args)]
#[command(after_help = "\
Keys:
  q, Ctrl-C            quits
  h, Ctrl-X            halts the robot at once; Ctrl-X also while a value is typed
  w, Enter             writes a variable: NAME=VALUE, then y; Esc cancels
  Up, Down, Home, End  selects a variable
  a                    shows all packets, or only those of calls whose reply has changed
  p                    pauses the packets

Examples:
  bcap monitor
  bcap monitor I1-I8 IO128-IO135 P1
  bcap monitor --robot tcp:192.168.0.1 robot/@SPEED task:Pro1/@CYCLE_TIME --interval 500ms
  NO_COLOR=1 bcap monitor I1")]
pub(crate) struct Monitor {
    /// The variables, as for `bcap get`
    #[arg(value_name = "NAME")]
    pub(crate) names: Vec<String>,

    /// The time from one reading to the next, in ms or with a unit (100ms, 2s)
    #[arg(long, value_name = "MS", default_value = "200", value_parser = duration::parse)]
    pub(crate) interval: Duration,
}
