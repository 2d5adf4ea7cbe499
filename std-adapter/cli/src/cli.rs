//! The command line: all commands, and the arguments of those that work on the command line itself. A shell and a script
//! run any command, so their code is above this file.

mod pages;

use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};

use clap::{Args, CommandFactory as _, Parser, Subcommand};
use clap_complete::env::Shells;

use crate::commands::backup::{diff::Diff, dump::Dump, restore::Restore};
use crate::commands::board::Board;
use crate::commands::calls::{call::Call, exec::Exec};
use crate::commands::doctor::{Doctor, scan::Scan, status::Status};
use crate::commands::explain::Explain;
use crate::commands::files::{Cp, Ls, Rm};
use crate::commands::gateway::Gateway;
use crate::commands::judge::{conform::Conform, fuzz::Fuzz};
#[cfg(feature = "screens")]
use crate::commands::monitor::Monitor;
use crate::commands::packets::{decode::Decode, proxy::Proxy, raw::Raw, replay::Replay};
use crate::commands::profile::ProfileArgs;
use crate::commands::report::ReportArgs;
use crate::commands::robot::jog::{Jog, Teach};
use crate::commands::robot::{
    errors::Errors, halt::HaltArgs, log::Log, motion::MoveArgs, recover::Recover, task::Task,
};
use crate::commands::sim::args::Sim;
use crate::commands::slave::args::Slave;
use crate::commands::variables::{get::Get, io::Io, names::Names, put::Put, rac::Rac, watch::Watch};
#[cfg(feature = "web")]
use crate::commands::web::Web;
use crate::failure::{Failure, cannot};
use crate::link::LinkArgs;
use crate::output::print_raw;

/// Talks to DENSO robot controllers over b-CAP and RAC, and decodes their traffic.
#[derive(Debug, Parser)]
#[command(name = "bcap", version, help_template = include_str!("page.txt"), after_help = EXIT_CODES)]
pub(crate) struct Cli {
    /// Prints results as JSON, one object per line; failures too, as {"error":...}
    #[arg(long, global = true)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArgs,

    #[command(subcommand)]
    pub(crate) command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 the controller refused, diff found differences, a case of
conform failed or fuzz found faults, 2 wrong usage, malformed input, a file that
failed, or a diff that is refused or incomplete, 3 no connection, 4 timeout,
130 interrupted by a signal. There are no colours if NO_COLOR is set or the
output is not a terminal.";

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Status(Status),
    Get(Get),
    Put(Put),
    Watch(Watch),
    Io(Io),
    #[cfg(feature = "screens")]
    Monitor(Monitor),
    #[cfg(feature = "web")]
    Web(Web),
    Names(Names),
    Ls(Ls),
    Cp(Cp),
    Rm(Rm),
    Dump(Dump),
    Diff(Diff),
    Restore(Restore),
    Profile(ProfileArgs),
    Scan(Scan),
    Call(Call),
    Exec(Exec),
    Move(MoveArgs),
    Jog(Jog),
    Teach(Teach),
    Task(Task),
    Errors(Errors),
    Log(Log),
    Recover(Recover),
    Shell(Shell),
    #[command(visible_alias = "include")]
    Run(Run),
    Raw(Raw),
    Rac(Rac),
    Sim(Sim),
    Slave(Slave),
    Halt(HaltArgs),
    Doctor(Doctor),
    Report(ReportArgs),
    Gateway(Gateway),
    Board(Board),
    Proxy(Proxy),
    Replay(Replay),
    Conform(Conform),
    Fuzz(Fuzz),
    Decode(Decode),
    Explain(Explain),
    Generate(Generate),
    /// The options of the connection to a controller, of every command that has one
    #[command(hide = true)]
    Connection,
}

impl Command {
    /// Returns whether the command connects to a controller. The others work with a wrong profile.
    pub(crate) const fn connects(&self) -> bool {
        !matches!(
            self,
            Self::Profile(_)
                | Self::Board(_)
                | Self::Sim(_)
                | Self::Decode(_)
                | Self::Explain(_)
                | Self::Generate(_)
                | Self::Connection
        )
    }

    /// Returns whether all that the command does is to print, so that a reader such as `head` may end it.
    pub(crate) const fn only_prints(&self) -> bool {
        matches!(
            self,
            Self::Status(_)
                | Self::Get(_)
                | Self::Watch(_)
                | Self::Io(_)
                | Self::Names(_)
                | Self::Ls(_)
                | Self::Diff(_)
                | Self::Scan(_)
                | Self::Errors(_)
                | Self::Log(_)
                | Self::Doctor(_)
                | Self::Report(_)
                | Self::Decode(_)
                | Self::Explain(_)
                | Self::Generate(_)
                | Self::Connection
        )
    }

    /// Returns the capture that the command replays.
    pub(crate) fn replayed(&self) -> Option<&Path> {
        match self {
            Self::Replay(args) => Some(&args.file),
            Self::Sim(args) => args.replay.as_deref(),
            _ => None,
        }
    }
}

/// Runs commands over one session, with a prompt
///
/// Every command of `bcap` works without the word `bcap`, and all of them use one session: the arm stays taken, handles stay
/// open. The prompt shows model, mode, errors, and whether this session has the arm and the motor is on. Tab completes
/// commands, functions and the names that the controller lists. New messages of the controller come before the prompt. Also:
/// `help [COMMAND|FUNCTION]`, `connect`, `exit`, and what scripts have (`bcap run --help`).
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
  wait I1 = 5 --within 2s waits until the controller's variable has the value; `wait IO130` waits until it is true
  repeat 3 run part.bcap  runs a command, here the lines of another script with the same variables, several times
  while I1 < 5 run F      runs a command while the controller's variable has the value
  if IO130 = true put I1 7
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

/// Generates the completion script of a shell, pages of the commands, or a dissector for Wireshark
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap generate completions bash >~/.local/share/bash-completion/completions/bcap
  bcap generate man man1 && man ./man1/bcap.1
  bcap generate wireshark >~/.local/lib/wireshark/plugins/bcap.lua")]
pub(crate) struct Generate {
    #[command(subcommand)]
    pub(crate) output: GenerateCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum GenerateCommand {
    /// Prints a completion script for a shell, which calls bcap for each Tab
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Writes the manual pages, one for each command
    Man {
        /// The directory; it is made if it does not exist
        #[arg(value_name = "DIR")]
        directory: PathBuf,
    },
    /// Writes a page of Markdown for each command, as the book has them, and prints a list of them
    Pages {
        /// The directory; it is made if it does not exist
        #[arg(value_name = "DIR")]
        directory: PathBuf,
    },
    /// Prints a dissector for Wireshark, one Lua file
    ///
    /// It decodes b-CAP over TCP and UDP, and RAC. docs/wireshark.md describes its fields and filters.
    Wireshark,
}

/// Hides the options of the connection in the help of the commands that do not connect; for others `bcap help connection` has
/// them.
pub(crate) fn with_groups(command: clap::Command) -> clap::Command {
    // other readers than a terminal, such as `less`, wrap lines themselves
    let command = if io::stdout().is_terminal() { command } else { command.term_width(0) };
    const LOCAL: [&str; 6] = ["profile", "board", "sim", "decode", "explain", "generate"];
    let is_of_connection = |option: &clap::Arg| option.get_help_heading() == Some("Connection");
    let options: Vec<_> = command.get_arguments().filter(|option| is_of_connection(option)).cloned().collect();
    let command = command.mut_subcommand("connection", |page| page.args(options.clone()));
    let command = command.mut_args(|option| match option.get_id() == "robot" {
        true => option.long_help(None),
        false if is_of_connection(&option) => option.hide_long_help(true),
        false => option,
    });
    // `sim` records its clients
    let is_hidden = |name, option: &clap::Arg| name != "sim" || option.get_id() != "write";
    let of = |name| options.iter().map(move |option| option.clone().hide(is_hidden(name, option)));
    LOCAL.iter().fold(command, |command, name| command.mut_subcommand(name, |local| local.args(of(*name))))
}

/// Prints the help of a command, as `bcap NAME --help` does.
pub(crate) fn print_help(command: &str) -> Result<(), Failure> {
    let mut cli = with_groups(Cli::command());
    // propagates the global options
    cli.build();
    Ok(cli.find_subcommand_mut(command).map_or(Ok(()), clap::Command::print_long_help)?)
}

/// Runs `bcap generate`.
pub(crate) fn generate(args: &Generate) -> Result<(), Failure> {
    match &args.output {
        GenerateCommand::Completions { shell } => {
            let mut script = Vec::new();
            if let Some(shell) = Shells::builtins().completer(&shell.to_string()) {
                shell.write_registration("COMPLETE", "bcap", "bcap", "bcap", &mut script)?;
            }
            Ok(print_raw(String::from_utf8_lossy(&script).trim_end())?)
        }
        GenerateCommand::Man { directory } => man(directory),
        GenerateCommand::Pages { directory } => {
            // as in the help, other options of the connection have one page
            let mut cli = with_groups(Cli::command().disable_help_subcommand(true));
            cli.build();
            let list = pages::write(&mut cli, directory).map_err(cannot("write pages to", directory))?;
            Ok(print_raw(list.trim_end())?)
        }
        // it has no text from outside
        GenerateCommand::Wireshark => Ok(print_raw(bcap_capture::wireshark::script().trim_end())?),
    }
}

/// Writes `bcap.1` and a page for each command, such as `bcap-get.1`.
fn man(directory: &Path) -> Result<(), Failure> {
    let failed = cannot("write manual pages to", directory);
    std::fs::create_dir_all(directory).map_err(&failed)?;
    // `bcap help` needs no pages
    let mut command = Cli::command().disable_help_subcommand(true);
    // propagates the global options
    command.build();
    clap_mangen::generate_to(command, directory).map_err(failed)
}
