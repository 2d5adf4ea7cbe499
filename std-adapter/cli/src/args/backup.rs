//! The arguments of `bcap dump`, `bcap diff` and `bcap restore`.

use std::path::PathBuf;

use clap::Args;

/// Saves all variables and files of the controller in a folder
///
/// The folder has a file of lines of JSON for each kind of variable, one for the system variables, and the controller's
/// files as they are; docs/backup.md describes it. `bcap diff` compares two of them, `bcap restore` writes one back. Nothing
/// is written to the controller. A dump that was interrupted or killed goes on where it was when the same command runs
/// again. The values are read one after another, so a program that runs meanwhile may change some of them.
///
/// The exit code is 1 if the controller refused a part; backup.json names it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap dump backup
  bcap dump --robot tcp:192.168.0.1 cell1-monday")]
pub(crate) struct Dump {
    /// The folder, which must not exist, be empty, or have an interrupted dump of the same controller
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,
}

/// Compares two backups, or a backup with a controller
///
/// A and B are folders of `bcap dump`, addresses such as tcp:192.168.0.1, or robot: for the controller of --robot. A
/// line is `I5: 3 -> 7`, first the value of A; with --json {"name":"I5","a":{"vt":3,"v":3},"b":{"vt":3,"v":7}}, where
/// null is a variable or a file that does not exist. System variables show the controller's state, so they are compared
/// only with --system. An item that one side lacks because its controller refused it is not compared: a line says so.
///
/// The exit code is 0 if everything was compared and is equal, 1 if there is a difference, and 2 or more after an error or a
/// refusal, or if a part was not compared and the rest is equal.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap diff backup
  bcap diff backup cell1-monday
  bcap diff --system backup tcp:192.168.0.1")]
pub(crate) struct Diff {
    /// The first backup or controller
    pub(crate) a: String,

    /// The second one
    #[arg(default_value = "robot:")]
    pub(crate) b: String,

    /// Compares the system variables too, except the clocks
    #[arg(long)]
    pub(crate) system: bool,
}

/// Writes a backup back to the controller
///
/// Compares the backup with the controller, shows what is going to be written, and asks. Only what differs is written, and
/// each value and file is read back. The command stops at the first refusal, and if a value or a file has changed since the
/// plan was shown. It writes nothing while the controller is busy or has an error, if a part that the backup has cannot be
/// read there, or if a variable of the backup does not exist or has another type there. Nothing is deleted. System variables
/// are never written, and IO only with --io, because they switch outputs.
///
/// Each write is recorded in DIR/restore.jsonl before it is sent, and a file that is replaced is saved in DIR/replaced. If the
/// command is killed, `bcap restore --status DIR` says what was written, and the same restore again writes the rest.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap restore --dry-run backup
  bcap restore --yes backup
  bcap restore --status backup")]
pub(crate) struct Restore {
    /// The folder of `bcap dump`
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,

    /// Writes without asking for confirmation
    #[arg(long)]
    pub(crate) yes: bool,

    /// Shows the whole plan and writes nothing
    #[arg(long, conflicts_with = "yes")]
    pub(crate) dry_run: bool,

    /// Writes IO variables too, which switches the outputs of the controller
    #[arg(long)]
    pub(crate) io: bool,

    /// Writes even if the controller's type or serial number differs from the backup, or if the number is unknown
    #[arg(long)]
    pub(crate) other_controller: bool,

    /// Says what the last restore from this folder has written, without a controller
    #[arg(long, conflicts_with_all = ["yes", "dry_run", "io", "other_controller"])]
    pub(crate) status: bool,
}
