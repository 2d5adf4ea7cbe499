//! The command line.
#![allow(rustdoc::broken_intra_doc_links, reason = "these comments are the help text, where brackets are brackets")]

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

mod backup;
mod board;
mod codec;
mod conform;
mod files;
mod fuzz;
mod gateway;
mod link;
mod monitor;
mod profile;
mod proxy;
mod raw;
mod replay;
mod session;
mod sim;
mod slave;
mod slave_format;
mod variables;

pub(crate) use self::backup::{Diff, Dump, Restore};
pub(crate) use self::board::{Board, BoardCommand, Configure, Status, Update};
pub(crate) use self::codec::{CaptureArgs, Decode, Encode, Text, TextCommand};
pub(crate) use self::conform::{Conform, LevelArg};
pub(crate) use self::files::{Cp, Ls};
pub(crate) use self::fuzz::Fuzz;
pub(crate) use self::gateway::Gateway;
pub(crate) use self::link::LinkArgs;
pub(crate) use self::monitor::Monitor;
pub(crate) use self::profile::{Profile, ProfileCommand};
pub(crate) use self::proxy::{Proxy, RobotPorts};
pub(crate) use self::raw::Raw;
pub(crate) use self::replay::Replay;
pub(crate) use self::session::{Clear, Errors, Messages, MoveArgs, Run, Shell, Task, TaskCommand};
pub(crate) use self::sim::{ArmSource, ModelSource, Sim};
pub(crate) use self::slave::{Cosine, Doctor, Halt, Play, Record, Slave, SlaveCommand, StreamArgs};
pub(crate) use self::slave_format::{FormatArgs, wide_bits};
pub(crate) use self::variables::{Get, Names, Put, Watch};

/// Talks to DENSO robot controllers over b-CAP and RAC, and decodes their traffic.
#[derive(Debug, Parser)]
#[command(name = "bcap", version, after_help = EXIT_CODES)]
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
Exit codes: 0 done, 1 the controller refused, diff found differences, a case of conform failed or fuzz found faults, 2 wrong
usage, malformed input or a diff that is refused or incomplete, 3 no connection, 4 timeout, 130 interrupted by a signal.
There are no colours if NO_COLOR is set or the output is not a terminal.";

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Get(Get),
    Put(Put),
    Watch(Watch),
    Monitor(Monitor),
    Names(Names),
    Ls(Ls),
    Cp(Cp),
    Dump(Dump),
    Diff(Diff),
    Restore(Restore),
    Profile(Profile),
    Call(Call),
    Exec(Exec),
    Move(MoveArgs),
    Task(Task),
    Errors(Errors),
    Clear(Clear),
    Messages(Messages),
    Shell(Shell),
    Run(Run),
    Raw(Raw),
    Rac(Rac),
    Sim(Sim),
    Slave(Slave),
    Halt(Halt),
    Doctor(Doctor),
    Gateway(Gateway),
    Board(Board),
    Proxy(Proxy),
    Replay(Replay),
    Conform(Conform),
    Fuzz(Fuzz),
    Demo(Demo),
    Decode(Decode),
    Encode(Encode),
    Text(Text),
    Explain(Explain),
    Wireshark(Wireshark),
    Completions(Completions),
    Man(Man),
}

impl Command {
    /// Returns whether the command connects to a controller. The others work with a wrong profile.
    pub(crate) const fn connects(&self) -> bool {
        !matches!(
            self,
            Self::Profile(_)
                | Self::Board(_)
                | Self::Sim(_)
                | Self::Demo(_)
                | Self::Decode(_)
                | Self::Encode(_)
                | Self::Text(_)
                | Self::Explain(_)
                | Self::Wireshark(_)
                | Self::Completions(_)
                | Self::Man(_)
        )
    }
}

/// Calls any of the 137 functions
///
/// FUNCTION is a name (VariableGetValue, Variable_GetValue, variable_get_value) or a number. ARG is TYPE,DATA. For a handle
/// it may be the name of an object, which is opened first and released at the end: controller, robot, robot:Arm0,
/// task:Pro1, file:NAME, extension:NAME, variable:I1, robot/variable:@SERVO_ON. For an integer, a float or a string it may
/// be plain data. A missing last `option` is an empty string, a missing last `param` is EMPTY. The command starts the
/// service and connects to the controller as needed.
///
/// Effects that belong to the session, such as the arm authority, end with the command; `bcap move` does a whole
/// motion, `bcap shell` and `bcap run` keep a session.
///
/// `bcap call FUNCTION --help` prints what FUNCTION does, its arguments with units, what it returns, and which controllers
/// have it.
#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
#[command(after_help = "\
Examples:
  bcap call ControllerGetName controller
  bcap call VariablePutValue variable:I1 3,42
  bcap call Robot_GetVariableNames robot
  bcap call 17 controller SysState
  bcap call TaskStart task:Pro1 1
  bcap call ServiceStart 8,WDT=400
  bcap call Robot_Move --help
  bcap call --list
  bcap call --list --effects")]
pub(crate) struct Call {
    /// The function
    #[arg(required_unless_present_any = ["help", "list"])]
    pub(crate) function: Option<String>,

    /// Its arguments
    #[arg(value_name = "ARG", allow_negative_numbers = true)]
    pub(crate) arguments: Vec<String>,

    /// Lists all functions
    #[arg(long, conflicts_with = "function")]
    pub(crate) list: bool,

    /// Lists functions and commands with their effect (session, reads, writes, moves), and whether Slave Mode allows them
    ///
    /// A call that Slave Mode refuses ends a stream, even when another client sends it. "unknown" counts as refused,
    /// and a command that is not listed may move.
    #[arg(long, requires = "list")]
    pub(crate) effects: bool,

    /// Prints help; after FUNCTION, the help of that function
    #[arg(short, long)]
    pub(crate) help: bool,
}

/// Executes a command of the controller or a robot
///
/// OBJECT is controller, robot, robot:NAME, task:NAME, file:NAME or extension:NAME. ARG is TYPE,DATA; otherwise an
/// integer is sent as I4, another number as R8, any other text as a string. Without ARG the parameter is EMPTY. Several
/// ARG are an array: of I4, else of R8, else of VARIANT. Resources that belong to the session, such as the arm, are
/// released when `bcap exec` ends; `bcap shell` and `bcap run` keep it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap exec controller SysState
  bcap exec controller GetErrorDescription -2147481344
  bcap exec robot TakeArm 0 1
  bcap exec robot CurPos --json")]
pub(crate) struct Exec {
    /// The object
    pub(crate) object: String,

    /// The command; case does not matter
    pub(crate) command: String,

    /// Its parameter, or the elements of its parameter
    #[arg(value_name = "ARG", allow_negative_numbers = true)]
    pub(crate) arguments: Vec<String>,
}

/// Reads and writes variables over RAC, the text protocol
///
/// NAME is one of I F D V P J T S IO with a number: I1, P10, IO128. --robot is HOST[:PORT] here, with the default port 5006.
/// If the environment variable BCAP_ROBOT names a protocol, such as tcp:HOST:PORT, only its host is used.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap rac --robot 192.168.0.1 get I1 P10
  bcap rac --robot 192.168.0.1:5006 put S1 'hello, world'")]
pub(crate) struct Rac {
    #[command(subcommand)]
    pub(crate) command: RacCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum RacCommand {
    /// Reads variables
    Get(Get),
    /// Writes a variable
    Put(RacPut),
}

#[derive(Debug, Args)]
pub(crate) struct RacPut {
    /// The variable
    pub(crate) name: String,

    /// The value
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: String,

    /// Reads VALUE as TYPE,DATA, also of another type than the variable's
    #[arg(long)]
    pub(crate) typed: bool,
}

/// Shows a session with a virtual controller: each frame with its bytes and their meaning
///
/// Starts the controller in this process, on free ports of this machine, and connects to it over TCP, UDP and RAC.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap demo
  bcap demo | less")]
pub(crate) struct Demo {}

/// Explains result codes: meaning, usual cause, what to do
///
/// CODE is a name, or a number as the manuals write it (0x83500121 or 83500121) or as a program prints it (-2092957407). Needs
/// no connection.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap explain 0x83500121
  bcap explain E_ACCESSDENIED 84204043
  bcap explain --json -2091908831
  bcap explain --index >errors.md")]
pub(crate) struct Explain {
    /// The codes
    #[arg(value_name = "CODE", required_unless_present = "index", allow_negative_numbers = true)]
    pub(crate) codes: Vec<String>,
    /// Print all known codes as Markdown
    #[arg(long, conflicts_with = "codes")]
    pub(crate) index: bool,
}

/// Prints a dissector for Wireshark, one Lua file
///
/// It decodes b-CAP over TCP and UDP, and RAC. docs/wireshark.md describes its fields and filters.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap wireshark >~/.local/lib/wireshark/plugins/bcap.lua
  bcap wireshark >bcap.lua && tshark -X lua_script:bcap.lua -r capture.pcapng")]
pub(crate) struct Wireshark {}

/// Prints a completion script for a shell
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap completions bash >~/.local/share/bash-completion/completions/bcap
  bcap completions zsh >~/.zfunc/_bcap
  bcap completions fish >~/.config/fish/completions/bcap.fish")]
pub(crate) struct Completions {
    /// The shell
    pub(crate) shell: clap_complete::Shell,
}

/// Writes the manual pages, one for each command
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap man man1 && man ./man1/bcap.1
  bcap man /usr/local/share/man/man1")]
pub(crate) struct Man {
    /// The directory; it is made if it does not exist
    #[arg(value_name = "DIR")]
    pub(crate) directory: PathBuf,
}
