//! The command line.
#![allow(rustdoc::broken_intra_doc_links, reason = "these comments are the help text, where brackets are brackets")]

use std::env;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use bcap_sim::Profile as ModelProfile;
use clap::{Args, Parser, Subcommand};

mod backup;
mod files;
mod profile;
mod proxy;
mod raw;
mod replay;
mod session;
mod slave;

pub(crate) use self::backup::{Diff, Dump, Restore};
pub(crate) use self::files::{Cp, Ls};
pub(crate) use self::profile::{Profile, ProfileCommand};
pub(crate) use self::proxy::{Proxy, RobotPorts};
pub(crate) use self::raw::Raw;
pub(crate) use self::replay::Replay;
pub(crate) use self::session::{Clear, Errors, Messages, MoveArgs, Run, Shell, Task, TaskCommand};
pub(crate) use self::slave::{Cosine, Doctor, Halt, Play, Record, Slave, SlaveCommand, StreamArgs};
use crate::duration;
use crate::error::Failure;
use crate::escape;
use crate::frame::Role;
use crate::profile::Profiles;
use crate::rules::AllowPut;
use crate::target;
use crate::trace::Level;
use bcap_std::{Address, NetworkAddress, Protocol};

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
Exit codes: 0 done, 1 the controller refused or diff found differences, 2 wrong usage or malformed input,
3 no connection, 4 timeout, 130 interrupted by a signal.
There are no colours if NO_COLOR is set or the output is not a terminal.";

/// The default time limit for an answer.
const DEFAULT_TIMEOUT: Duration = Duration::from_secs(3);

impl Cli {
    /// Parses the command line, or exits with the help or an error.
    pub(crate) fn parse_or_exit() -> Self {
        Self::try_parse().unwrap_or_else(|error| {
            if !error.use_stderr() {
                // help and version contain no text from outside
                error.exit();
            }
            // clap quotes arguments in its errors, so parse again with escaped arguments, which are safe to print
            let safe = env::args_os().map(|argument| escape::line(&escape::cut(&argument.display())));
            match Self::try_parse_from(safe) {
                Err(error) if error.use_stderr() => error.exit(),
                // the escaped arguments parse differently
                _ => Failure::Input(escape::line(&error.to_string())).exit(),
            }
        })
    }
}

/// The connection to the controller.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Connection")]
pub(crate) struct LinkArgs {
    /// The controller: [tcp:|udp:]HOST[:PORT] or serial:PATH; for rac HOST[:PORT] [env: BCAP_ROBOT=]
    /// [default: tcp:127.0.0.1]
    ///
    /// Without a protocol it is TCP; tcp://HOST is accepted too. Write IPv6 addresses in brackets: tcp:[fe80::1]:5007. A serial
    /// line may have settings, here with the defaults: 'serial:/dev/ttyUSB0?baud=115200&parity=none&stop=1'. `rac`,
    /// `doctor`, `gateway`, `proxy`, `replay` and `slave` need a network.
    #[arg(long, global = true, value_name = "ADDRESS")]
    robot: Option<String>,

    /// The time limit of the whole command, in ms or with a unit (2s) [default: 3 s for each answer or keep-alive]
    ///
    /// It covers connecting, all calls with their keep-alives, and the end of the session. `watch` and `slave record` apply
    /// it to each round; `doctor` to each link, and then to all other checks together; `slave play`, `slave cosine`,
    /// `gateway` and `replay` to each answer; `proxy` to connecting; `shell` and `run` to each line. A motion of `move` has
    /// --within instead. Without this option `halt` ends within 3 s, and a controller can keep any other call alive for
    /// 180 s. Over UDP the attempts (--attempts) share the time.
    #[arg(long, global = true, value_name = "MS", env = "BCAP_TIMEOUT", value_parser = duration::parse)]
    timeout: Option<Duration>,

    /// The provider to connect to; an RC9 or a COBOTTA PRO has CaoProv.DENSO.VRC9 [default: CaoProv.DENSO.VRC]
    #[arg(long, global = true, value_name = "NAME", env = "BCAP_PROVIDER")]
    provider: Option<String>,

    /// The machine name of Controller_Connect; for an RC9 the specification asks for the address of the controller
    /// [default: localhost]
    #[arg(long, global = true, value_name = "NAME", env = "BCAP_MACHINE")]
    machine: Option<String>,

    /// The option of Controller_Connect, such as @EventDisable=false [default: empty]
    #[arg(long, global = true, value_name = "TEXT", env = "BCAP_OPTION")]
    option: Option<String>,

    /// The attempts of a call over UDP, 1 to 7; other numbers become the nearest. They share the time limit of an answer,
    /// at least 100 ms each, so that the controller's keep-alives arrive before an attempt ends
    #[arg(long, global = true, value_name = "N", env = "BCAP_ATTEMPTS", default_value_t = 5)]
    pub(crate) attempts: u32,

    /// The port of RAC, for an address without a port for RAC [default: 5006]
    #[arg(long, global = true, value_name = "PORT", env = "BCAP_RAC_PORT")]
    rac_port: Option<u16>,

    /// A profile of ~/.config/bcap/config.toml, whose values apply where neither an option nor an environment variable is
    /// given
    #[arg(long, global = true, value_name = "NAME", env = "BCAP_PROFILE")]
    profile: Option<String>,

    /// The address of the profile.
    #[arg(skip)]
    profile_address: Option<String>,

    /// Records what the command sends and receives as packets in this file, for `bcap decode` and Wireshark
    ///
    /// The file is pcapng. A serial line has no packets. `sim` and `proxy` record their clients, `gateway` its PLCs and the
    /// robot.
    #[arg(long, global = true, value_name = "FILE.pcapng")]
    pub(crate) write: Option<PathBuf>,

    /// Prints each packet that is sent (->) and received (<-) on the standard error: headers, values, or bytes beside the
    /// values. `gateway`, `proxy`, `replay`, `slave play` and `slave cosine` do not have it
    #[arg(long, global = true, value_name = "LEVEL", num_args = 0..=1, require_equals = true,
          default_missing_value = "bytes")]
    pub(crate) trace: Option<Level>,
}

impl LinkArgs {
    /// Adds the values of the profile, where neither an option nor an environment variable is given.
    pub(crate) fn with_profile(&self) -> Result<Self, Failure> {
        let Some(name) = self.profile.as_deref().filter(|name| !name.is_empty()) else { return Ok(self.clone()) };
        let profiles = Profiles::read()?;
        let (profile, link) = (profiles.find(name)?, self.clone());
        Ok(Self {
            timeout: link.timeout.or(profile.timeout()),
            provider: link.provider.or_else(|| profile.provider().map(str::to_owned)),
            machine: link.machine.or_else(|| profile.machine.clone()),
            option: link.option.or_else(|| profile.option.clone()),
            rac_port: link.rac_port.or(profile.rac_port),
            profile_address: profile.address().map(str::to_owned),
            ..link
        })
    }

    /// Adds the values of the profile, as far as they do not hinder a halt: its time limit is ignored, and a profile that
    /// cannot be read is reported and ignored if --robot names the controller.
    pub(crate) fn with_profile_for_halt(&self) -> Result<Self, Failure> {
        match self.with_profile() {
            Ok(link) => Ok(Self { timeout: self.timeout, ..link }),
            Err(failure) if self.robot.is_some() => {
                failure.print(false, None);
                Ok(self.clone())
            }
            Err(failure) => Err(failure),
        }
    }

    /// Returns the provider to connect to.
    pub(crate) fn provider(&self) -> &str {
        self.provider.as_deref().filter(|name| !name.is_empty()).unwrap_or("CaoProv.DENSO.VRC")
    }

    /// Returns the machine name of Controller_Connect.
    pub(crate) fn machine(&self) -> &str {
        self.machine.as_deref().filter(|name| !name.is_empty()).unwrap_or("localhost")
    }

    /// Returns the option of Controller_Connect.
    pub(crate) fn option(&self) -> &str {
        self.option.as_deref().unwrap_or_default()
    }

    /// Returns the same options for the controller at another address.
    pub(crate) fn at(&self, address: &str) -> Self {
        Self { robot: Some(address.to_owned()), ..self.clone() }
    }

    /// Returns the controller's address for b-CAP.
    pub(crate) fn target(&self) -> Result<Address, Failure> {
        target::bcap(self.robot.as_deref(), self.profile_address.as_deref())
    }

    /// Returns the controller's address for b-CAP, for a command that cannot use a serial line.
    pub(crate) fn network_target(&self) -> Result<NetworkAddress, Failure> {
        target::network(self.robot.as_deref(), self.profile_address.as_deref())
    }

    /// Returns the port of RAC that was given, if one was.
    pub(crate) const fn rac_port(&self) -> Option<u16> {
        self.rac_port
    }

    /// Returns the controller's address for RAC.
    pub(crate) fn rac_target(&self) -> Result<NetworkAddress, Failure> {
        target::rac(self.robot.as_deref(), self.profile_address.as_deref(), self.rac_port)
    }

    /// Returns the time limit for connecting, and for each answer or keep-alive.
    pub(crate) fn timeout(&self) -> Duration {
        self.timeout.unwrap_or(DEFAULT_TIMEOUT)
    }

    /// Returns the time limit of the whole command; `None` if the user gave none.
    pub(crate) const fn limit(&self) -> Option<Duration> {
        self.timeout
    }

    /// Limits the whole command even if the user gave no limit.
    pub(crate) fn limited(&self) -> Self {
        Self { timeout: Some(self.timeout()), ..self.clone() }
    }

    /// Returns the attempts of a call over UDP (S2:1493).
    pub(crate) fn attempts(&self) -> u8 {
        let most = u8::try_from(self.attempts.clamp(1, 7)).unwrap_or(7);
        let room = self.timeout().as_millis() / SHORTEST_ATTEMPT.as_millis();
        most.min(u8::try_from(room).unwrap_or(u8::MAX)).max(1)
    }

    /// Refuses `--trace` for a command whose connections it cannot see.
    pub(crate) fn untraced(&self) -> Result<&Self, Failure> {
        match self.trace {
            None => Ok(self),
            Some(_) => Err(Failure::Input(
                "this command has no --trace; record its packets with tcpdump and use `bcap decode FILE.pcap`".into(),
            )),
        }
    }

    /// Returns whether the controller is at a serial line.
    pub(crate) fn is_serial(&self) -> bool {
        matches!(self.target(), Ok(Address::Serial(_)))
    }

    /// Returns the option of Service_Start: a third of an attempt as keep-alive interval, from 80 ms to 400 ms. A keep-alive
    /// that came after the attempt would make a long call fail or be repeated.
    pub(crate) fn start_option(&self) -> String {
        let is_udp = matches!(self.network_target(), Ok(NetworkAddress { protocol: Protocol::Udp, .. }));
        let attempt = self.timeout().as_millis() / if is_udp { u128::from(self.attempts()) } else { 1 };
        // a server refuses intervals below 80 ms (S2:225)
        match (attempt / 3).clamp(80, 400) {
            interval if interval < attempt => format!("WDT={interval}"),
            _ => String::new(),
        }
    }
}

/// The shortest attempt of a call over UDP: longer than the shortest interval of keep-alives.
const SHORTEST_ATTEMPT: Duration = Duration::from_millis(100);

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Get(Get),
    Put(Put),
    Watch(Watch),
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
    Proxy(Proxy),
    Replay(Replay),
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
/// refused, such as 3,5 without --typed. Without --typed, TYPE,DATA is accepted only for an array, with the variable's own
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
/// A line begins with the seconds since the start; with --json it has the milliseconds as "ms". On SIGINT and SIGTERM the
/// command releases its objects, stops the service and exits with 0.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap watch robot/@CURRENT_POSITION --interval 20
  bcap watch I1 I2 IO128 --changed --json
  bcap watch I1-I4 P1 --interval 10ms --count 100 --csv table.csv")]
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

/// Calls any of the 137 functions
///
/// FUNCTION is a name (VariableGetValue, Variable_GetValue, variable_get_value) or a number. ARG is TYPE,DATA. For a handle
/// it may be the name of an object, which is opened first and released at the end: controller, robot, robot:Arm0,
/// task:Pro1, file:NAME, extension:NAME, variable:I1, robot/variable:@SERVO_ON. For an integer, a float or a string it may
/// be plain data. A missing last `option` is an empty string, a missing last `param` is EMPTY. The command starts the
/// service and connects to the controller as needed.
///
/// What a call does for its session only, such as to take the arm, ends with the command; `bcap move` does a whole motion,
/// `bcap shell` and `bcap run` keep a session.
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
  bcap call --list")]
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

    /// Prints help; after FUNCTION, the help of that function
    #[arg(short, long)]
    pub(crate) help: bool,
}

/// Executes a command of the controller or a robot
///
/// OBJECT is controller, robot, robot:NAME, task:NAME, file:NAME or extension:NAME. ARG is TYPE,DATA; otherwise an integer
/// is sent as I4, another number as R8, any other text as a string. Without ARG the parameter is EMPTY. Several ARG are an
/// array: of I4, else of R8, else of VARIANT. What a command takes for this session only, such as the arm, is given back
/// when `bcap exec` ends; `bcap shell` and `bcap run` keep it.
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

/// Runs a virtual controller on real sockets
///
/// Prints one line, `ready bcap=IP:PORT udp=IP:PORT rac=IP:PORT`, when it listens. Port 0 selects a free port. On SIGINT and
/// SIGTERM it exits with 0.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap sim
  bcap sim --bcap 127.0.0.1:0 --udp 127.0.0.1:0 --rac 127.0.0.1:0
  bcap sim --scenario faults.toml
  bcap sim --replay session.pcapng
  bcap sim --record motion.csv
  bcap sim --model rc9 --print-model
  bcap sim --model cell7.toml
  bcap sim --model cobotta --robot-type CVR038A1-NV6
  bcap sim --bcap [::]:5007 --udp [::]:5007 --rac [::]:5006")]
pub(crate) struct Sim {
    /// The address for b-CAP over TCP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) bcap: SocketAddr,

    /// The address for b-CAP over UDP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) udp: SocketAddr,

    /// The address for RAC
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5006")]
    pub(crate) rac: SocketAddr,

    /// The controller to simulate: rc8, rc8a, rc9, cobotta, cobotta-pro, or a file like those that --print-model prints
    #[arg(long, value_name = "MODEL|FILE.toml", default_value = "rc8")]
    pub(crate) model: ModelSource,

    /// Prints the file of the model, to copy and change, and exits
    #[arg(long)]
    pub(crate) print_model: bool,

    /// The type of the robot, which drivers read as @TYPE_NAME [default: VS050A3; CVR038A1 for a COBOTTA]
    ///
    /// The type does not change the lengths, ranges and speeds of the arm. A scenario sets name, axes and version.
    #[arg(long, value_name = "TYPE")]
    pub(crate) robot_type: Option<String>,

    /// The operation mode at the start
    #[arg(long, value_name = "MODE", default_value = "auto")]
    pub(crate) mode: OperationMode,

    /// The holder of the executable token
    #[arg(long, value_name = "HOLDER", default_value = "any")]
    pub(crate) token: TokenHolder,

    /// Starts without a Slave Mode licence
    #[arg(long)]
    pub(crate) no_slave_licence: bool,

    /// A file with the initial state of the controller (errors, type, axes, version, limits) and with faults to inject:
    /// refused calls, errors, the emergency stop, a bad link
    #[arg(long, value_name = "FILE")]
    pub(crate) scenario: Option<PathBuf>,

    /// Answers as the server of a capture did, instead of as a virtual controller
    ///
    /// The connections of clients are those of the capture in their order. A request gets the reply of the next call with the same
    /// function and arguments, at once. A request that the capture does not have is refused with E_FAIL and printed on stderr.
    #[arg(long, value_name = "FILE.pcapng", conflicts_with_all = ["scenario", "files", "explain", "lenient", "record"])]
    pub(crate) replay: Option<PathBuf>,
    /// Writes the trajectory of the arm to a CSV file: the axes and the tool centre point every 8 ms while the arm moves
    ///
    /// Columns: time_s, J1 to J8 (degrees, mm), X, Y, Z (mm), RX, RY, RZ (degrees), tool, work. Time passes when clients
    /// call, so the file ends with the last call.
    #[arg(long, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,

    /// The folder of the controller's files; clients see its regular files and folders [default: an empty temporary folder]
    #[arg(long, value_name = "DIR")]
    pub(crate) files: Option<PathBuf>,

    /// Prints on stderr why an argument was refused: the call, the refused value, the accepted values
    ///
    /// GetErrorDescription of the code returns the same text.
    #[arg(long)]
    pub(crate) explain: bool,

    /// Accepts the provider of another model and unknown options, and prints each of them on stderr
    ///
    /// Without it, Controller_Connect answers E_CAO_PROV_INVALID, and other functions E_INVALIDARG.
    #[arg(long)]
    pub(crate) lenient: bool,
}

/// Where the model of a controller comes from.
#[derive(Clone, Debug)]
pub(crate) enum ModelSource {
    BuiltIn(ModelProfile),
    File(PathBuf),
}

impl FromStr for ModelSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(Self::BuiltIn(match text.to_ascii_lowercase().as_str() {
            "rc8" => ModelProfile::Rc8,
            "rc8a" => ModelProfile::Rc8a,
            "rc9" => ModelProfile::Rc9,
            "cobotta" => ModelProfile::Cobotta,
            "cobotta-pro" => ModelProfile::CobottaPro,
            name if name.ends_with(".toml") => return Ok(Self::File(text.into())),
            _ => return Err("it is rc8, rc8a, rc9, cobotta, cobotta-pro, or a file whose name ends with .toml".into()),
        }))
    }
}

/// An operation mode.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum OperationMode {
    Manual,
    TeachCheck,
    Auto,
}

impl From<OperationMode> for bcap_sim::Mode {
    fn from(mode: OperationMode) -> Self {
        match mode {
            OperationMode::Manual => Self::Manual,
            OperationMode::TeachCheck => Self::TeachCheck,
            OperationMode::Auto => Self::Auto,
        }
    }
}

/// The holder of the executable token.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum TokenHolder {
    /// Any client or the teach pendant
    Any,
    /// The teach pendant only
    Pendant,
}

impl From<TokenHolder> for bcap_sim::Token {
    fn from(holder: TokenHolder) -> Self {
        match holder {
            TokenHolder::Any => Self::Any,
            TokenHolder::Pendant => Self::TeachPendant,
        }
    }
}

/// Lets PLCs that speak RAC read, and if rules allow it write, the variables of a robot that speaks b-CAP
///
/// Prints one line, `ready rac=IP:PORT`, when it listens, then the audit log: one JSON object a line for every request and
/// for each change of the robot's session. While the robot is disconnected, every request is answered with E_NOT_CONNECTED
/// at once. SIGINT and SIGTERM end it with 0, after running requests have been answered.
#[derive(Debug, Args)]
#[command(after_help = "\
A file of rules. By default everything may be read and nothing written.
  convert = true                            # a value of another type is converted where nothing is lost
  rate = { per_second = 50, burst = 10 }    # for each client
  [[get]]
  kind = \"P\"
  [[put]]
  kind = \"I\"
  index = [0, 99]                           # or one number
  values = [-10, 10]                        # or a list of ranges, one for each element
Examples:
  bcap gateway --robot tcp:192.168.0.1
  bcap gateway --robot udp:192.168.0.1 --allow-put I/0-99,IO/128-143 --allow-put F/5=0..1
  bcap gateway --rac [::]:5006 --robot tcp:192.168.0.1 --rules rules.toml --audit /var/log/gateway.jsonl")]
pub(crate) struct Gateway {
    /// Where RAC listens
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5006")]
    pub(crate) rac: SocketAddr,

    /// What clients may do, in TOML
    #[arg(long, value_name = "FILE")]
    pub(crate) rules: Option<PathBuf>,

    /// Allows variables to be written, in addition to the rules: KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...], several
    /// separated by commas
    ///
    /// Each range is about one element of the value, the last range also about the elements after it.
    #[arg(long, value_name = "RULES", value_parser = AllowPut::parse)]
    pub(crate) allow_put: Vec<AllowPut>,

    /// Connections of one IP address at the same time, of 64 in all
    #[arg(long, value_name = "COUNT", default_value_t = 16)]
    pub(crate) clients_per_address: usize,

    /// The seconds of silence after which a connection may be closed when another needs its slot. The connection that has
    /// been idle longest is closed first
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub(crate) evict_after: u32,

    /// Where the audit log goes; a file is appended to, - is the standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub(crate) audit: PathBuf,

    /// The lines a second that one IP address may cause in the audit log, and ten times as many at once. Further lines are
    /// counted only; 0 writes all. Successful writes are always logged
    #[arg(long, value_name = "LINES", default_value_t = 10)]
    pub(crate) audit_rate: u32,

    /// The size in MiB at which a log file is renamed to FILE.1 and a new file begins; 0 for any size
    #[arg(long, value_name = "MIB", default_value_t = 16)]
    pub(crate) audit_size: u32,

    /// The number of old log files to keep; FILE.1 is the newest
    #[arg(long, value_name = "COUNT", default_value_t = 4)]
    pub(crate) audit_keep: u32,
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

/// Decodes frames, values, or a capture of Wireshark or tcpdump
///
/// Of a capture (FILE.pcap, FILE.pcapng, FILE.cap) it prints the calls with their replies and times: b-CAP over TCP and UDP
/// port 5007, RAC on port 5006, and both on any other port whose first packet shows the protocol. Handles are shown by the
/// names that opened them; missing, repeated and malformed bytes are reported.
///
/// Prints HEX field by field with offsets; HEX may hold several frames in sequence. With `-` each line of the standard input
/// is one item and gives one line of output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
/// HEX may have blanks, colons, commas and 0x prefixes between bytes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap decode 011e000000040000006500000001000a0000000300010000000300000004
  bcap decode --as response --json 01 1c 00 00 00 04 00 00 00 00 00 00 00 01 00 08 00 00 00 0b 00 01 00 00 00 00 00 04
  bcap decode --variant --json 030001000000ffffffff
  bcap decode --json - <frames.hex >frames.jsonl
  bcap decode capture.pcapng
  bcap decode capture.pcapng --error any --object robot
  bcap decode capture.pcapng --stats --function Robot_Execute
  bcap decode capture.pcapng --csv --from 2 --until 3.5")]
pub(crate) struct Decode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// Accepts common errors of peers: trailing bytes, counts and lengths that disagree, unknown types
    #[arg(long)]
    pub(crate) lenient: bool,

    #[command(flatten)]
    pub(crate) capture: CaptureArgs,

    /// The bytes, or the file of a capture; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "HEX|FILE")]
    pub(crate) hex: Vec<String>,
}

/// What to show of a capture.
#[derive(Debug, Args)]
#[command(next_help_heading = "Captures")]
pub(crate) struct CaptureArgs {
    /// Only calls of this function: a name or a number of `bcap call --list`, or GET or PUT of RAC
    #[arg(long, value_name = "FUNCTION")]
    pub(crate) function: Option<String>,

    /// Only calls that use or open this object, such as I1, robot or task:Pro1
    #[arg(long, value_name = "NAME")]
    pub(crate) object: Option<String>,

    /// Only calls with this result code, a name or a number; any: calls that failed or have no reply
    #[arg(long, value_name = "CODE", allow_negative_numbers = true)]
    pub(crate) error: Option<String>,

    /// Only what began at this time or later, in seconds since the start of the capture, as the output without --json has them
    #[arg(long, value_name = "SECONDS")]
    pub(crate) from: Option<f64>,

    /// Only what began before this time
    #[arg(long, value_name = "SECONDS")]
    pub(crate) until: Option<f64>,

    /// Prints the calls as CSV with a heading: time, link, serial, function, command, arguments, attempts, hresult, ms, value
    #[arg(long, conflicts_with_all = ["json", "stats"])]
    pub(crate) csv: bool,

    /// Prints for each function the number of calls and errors, and p50, p99 and maximum of the response time; for Slave Mode
    /// also the times between two slvMove requests, and how many are longer than 12 ms
    #[arg(long)]
    pub(crate) stats: bool,
}

impl CaptureArgs {
    /// Returns whether any option was given.
    pub(crate) const fn is_used(&self) -> bool {
        self.function.is_some()
            || self.object.is_some()
            || self.error.is_some()
            || self.from.is_some()
            || self.until.is_some()
            || self.csv
            || self.stats
    }
}

/// Encodes frames or values from the JSON that `bcap decode --json` prints
///
/// A frame is {"serial":4,"reserved":0,"code":101,"args":[{"vt":3,"v":3}]}. The defaults are 1 for `serial`, 0 for
/// `reserved` and no `args`; `name` may replace `code`. Unknown fields are errors. With --variant a value is
/// {"vt":3,"v":100}. The output is lower-case hexadecimal digits.
///
/// `v` is a number for numbers, CY (ten-thousandths), DATE (days since 1899-12-30) and ERROR; -1 or 0 for BOOL; a string
/// for BSTR; null for EMPTY and NULL; a list for arrays. Elements of VARIANT arrays are again {"vt":..,"v":..}. Floats that
/// are not finite are "NaN", "inf" and "-inf"; a NaN with other bits is "NaN(0x7ff8000000000001)". An unpaired surrogate is
/// \ud800.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap encode '{"serial":4,"code":101,"args":[{"vt":3,"v":3}]}'
  bcap encode '{"name":"ServiceStart","args":[{"vt":8,"v":"WDT=400"}]}'
  bcap encode --variant '{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":2,"v":100}]}'
  bcap encode - <frames.jsonl >frames.hex"#)]
pub(crate) struct Encode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// The JSON; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "JSON")]
    pub(crate) line: Vec<String>,
}

/// The format of the bytes.
#[derive(Debug, Args)]
pub(crate) struct Form {
    /// The bytes are a single VARIANT instead of a frame
    #[arg(long)]
    pub(crate) variant: bool,

    /// Frames have the CRC of a serial (COM) line
    #[arg(long, conflicts_with = "variant")]
    pub(crate) com: bool,

    /// The kind of the frames, which their bytes do not show
    #[arg(long = "as", value_name = "ROLE", default_value = "request", conflicts_with = "variant")]
    pub(crate) role: Role,
}

/// Converts values to the text form of RAC, and back
///
/// The text is TYPE,DATA: the VARTYPE as a number, then the data. Parsing the output gives the same bits, except that control
/// characters are printed as \u{1b}; with --json the text is {"text":"8,\u001b"}, which is exact. A value without a text
/// form, such as an empty array, is an error. With `-` each line of the standard input is one item and gives one line of
/// output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap text parse '8204,(8,Sample),(2,100)'
  bcap text parse --json '8196,1,2.5,-3e9'
  bcap text print 0300010000007b000000
  bcap text parse - <values.txt | bcap text print -")]
pub(crate) struct Text {
    #[command(subcommand)]
    pub(crate) command: TextCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TextCommand {
    /// Prints the bytes of a value, as hexadecimal digits, or as JSON with --json
    Parse {
        /// The text; without it, or with `-`, the lines of the standard input
        text: Option<String>,
    },
    /// Prints the text of a value
    Print {
        /// The bytes; without it, or with `-`, the lines of the standard input
        #[arg(value_name = "HEX")]
        hex: Vec<String>,
    },
}

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
