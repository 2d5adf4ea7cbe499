//! The arguments.

use std::path::PathBuf;

use clap::Parser;
use clap_complete::Shell;

/// Publishes variables of many DENSO robot controllers to an MQTT broker, as plain JSON or Sparkplug B
///
/// CONFIG is a file in TOML with the broker, the controllers and the variables; docs/fleet.md describes it. The broker and the
/// controllers may disconnect and return. While the broker is disconnected, readings go to a buffer on disk and are sent later as historical.
/// Variables can be written through the broker if a rule of CONFIG allows it; every such command is printed.
///
/// Two processes with the same group and node and a table `[standby]` are active and standby.
///
/// Prints a line `ready`, then one JSON object a line: changes of connections, and commands. SIGINT and SIGTERM end it with 0.
/// SIGHUP reads CONFIG again; with a terminal as the standard output it ends the program too.
#[derive(Debug, Parser)]
#[command(
    name = "bcap-fleet",
    version,
    after_help = "\
A small CONFIG:
  group = \"plant\"
  node = \"edge1\"
  [broker]
  host = \"127.0.0.1\"
  [[controller]]
  name = \"cell1\"
  address = \"tcp:192.168.0.1\"
  [[controller.publish]]
  names = [\"I1-9\", \"IO128\", \"pose\", \"error\"]
  interval_ms = 200
Examples:
  bcap-fleet fleet.toml --check
  bcap-fleet fleet.toml --check --offline
  bcap-fleet fleet.toml
  bcap-fleet fleet.toml --screen
  mosquitto_sub -v -t 'bcap/plant/#'
  bcap-fleet --completions bash >~/.local/share/bash-completion/completions/bcap-fleet
  bcap-fleet --man >bcap-fleet.1
Exit codes: 0 ended by a signal, or the check found no fault; 2 wrong usage, an invalid configuration, or a file that cannot be
used; 3 a part of the check failed, or the address for metrics cannot be listened on."
)]
pub(crate) struct Args {
    /// The configuration
    #[arg(value_name = "CONFIG", required_unless_present_any = ["completions", "man"])]
    pub(crate) config: Option<PathBuf>,

    /// Connects to the broker and all controllers, reads each variable once, prints a table and ends; the exit code is 3 if
    /// anything failed
    #[arg(long)]
    pub(crate) check: bool,

    /// Makes --check connect to nothing: it reads the configuration with its secrets and certificates
    #[arg(long, requires = "check")]
    pub(crate) offline: bool,

    /// Prints the table of --check as JSON, one object per line; a failure too, as {"error":...}
    #[arg(long)]
    pub(crate) json: bool,

    /// Shows the controllers, the buffer, the broker and the last events live in the terminal, and prints no lines
    #[arg(long, conflicts_with = "check")]
    pub(crate) screen: bool,

    /// Prints a completion script for a shell
    #[arg(long, value_name = "SHELL", exclusive = true)]
    pub(crate) completions: Option<Shell>,

    /// Prints the manual page
    #[arg(long, exclusive = true)]
    pub(crate) man: bool,
}
