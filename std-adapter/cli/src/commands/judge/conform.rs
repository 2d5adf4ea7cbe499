//! `bcap conform`: judges a server by the cases of `bcap-conform`.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use bcap_conform::{Case, CaseResult, ClientJudge, Group, Level, Link, Options, Report, Target, Verdict};
use bcap_std::Protocol;
use clap::{Args, ValueEnum};

use crate::commands::judge::Recovery;
use crate::commands::robot_ports::{self, RobotPorts};
use crate::failure::Failure;
use crate::interrupt::State;
use crate::link::LinkArgs;
use crate::listen::{self, taken};
use crate::output::{print_block, print_json, print_line, print_result};
use crate::session::Session;

/// Judges a controller, a gateway or another server by the cases of the specifications and by answers of real controllers, or a
/// client
///
/// Each case has its own connection. A failure is printed with what was sent and received, what was expected and what came; a
/// skipped case with the reason. The address of --robot chooses the link of b-CAP, TCP or UDP. RAC is at the same host.
/// docs/conformance.md describes the groups.
///
/// The group `seen` has answers of real controllers that no specification has. A device of the same model that answers otherwise
/// differs, and does not fail.
///
/// A device that accepts no connection after a case, such as after a crash, is started with --restart and waited for, and the
/// case is named. Without the device the run ends.
///
/// The exit code is 0 if no case failed, otherwise 1; 3 if the device accepts no connections. Ctrl-C ends the run after the
/// present case; with --level motion it halts the robot first, and the case restores what it changed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap conform --robot tcp:192.168.0.1
  bcap conform --robot udp:192.168.0.1 --group udp --group handles
  bcap conform --robot tcp:192.168.0.1 --level write --scratch 50 --group variables
  bcap conform --robot tcp:192.168.0.1 --case frames/wrong-end --json
  bcap conform --robot tcp:192.168.0.1 --level motion --yes-the-robot-may-move --group slave --junit
  bcap conform --list --group udp
  bcap conform --listen 127.0.0.1:5007")]
pub(crate) struct Conform {
    /// The effects that the cases may have on the device
    #[arg(long, value_enum, default_value_t = LevelArg::Read)]
    pub(crate) level: LevelArg,

    /// Allows --level motion: the arm is taken, the motor switched on, and axis 6 turned by 5 degrees and back
    #[arg(long)]
    pub(crate) yes_the_robot_may_move: bool,

    /// Runs only this group, such as slave or seen; may be repeated
    #[arg(long, value_name = "GROUP", value_parser = group)]
    pub(crate) group: Vec<Group>,

    /// Runs only this case, such as frames/wrong-end; may be repeated
    #[arg(long, value_name = "NAME")]
    pub(crate) case: Vec<String>,

    /// Lists the cases with their level and source, and connects to nothing
    #[arg(long, conflicts_with = "junit")]
    pub(crate) list: bool,

    /// Prints the results as a file of JUnit
    #[arg(long, conflicts_with = "json")]
    pub(crate) junit: bool,

    /// The index of the variables I F D S V P J T that --level write writes and restores
    #[arg(long, value_name = "INDEX", default_value_t = 49)]
    pub(crate) scratch: u32,

    /// The task of the cases of tasks; --level motion starts and stops it
    #[arg(long, value_name = "NAME", default_value = "Pro1")]
    pub(crate) task: String,

    /// Plays a controller at this address instead, [tcp:|udp:]IP:PORT, and judges the clients that connect
    ///
    /// It prints `ready bcap=tcp:IP:PORT`, serves --sessions, and prints the results. It waits at most --timeout (60 s by default) for
    /// a client, and as long for each request. Some calls of Variable_GetValue are answered in unusual ways, so a client under
    /// test should make ten of them.
    #[arg(long, value_name = "ADDRESS", value_parser = listen::address, conflicts_with_all = ["level", "group", "case", "list"])]
    pub(crate) listen: Option<(Protocol, SocketAddr)>,

    /// The number of sessions of clients that --listen serves, one after the other
    #[arg(long, value_name = "N", default_value_t = 1, requires = "listen")]
    pub(crate) sessions: usize,

    #[command(flatten)]
    pub(crate) recovery: Recovery,

    /// The address of RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// The effects that cases may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LevelArg {
    /// Changes nothing: opens, reads and releases objects, and sends invalid frames
    Read,
    /// Writes the scratch variables too, and restores them
    Write,
    /// Moves the robot a little too, and starts the task
    Motion,
}

fn group(text: &str) -> Result<Group, String> {
    let names = || Group::ALL.map(Group::name).join(", ");
    let found = Group::ALL.into_iter().find(|group| group.name() == text);
    found.ok_or_else(|| format!("no group is named {text:?}; the groups are {}", names()))
}

/// Returns the link of b-CAP over a protocol.
const fn over(protocol: Protocol) -> Link {
    match protocol {
        Protocol::Tcp => Link::Tcp,
        Protocol::Udp => Link::Udp,
    }
}

/// Runs `bcap conform`.
pub(crate) fn conform(args: &Conform, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if let Some((protocol, address)) = args.listen {
        return judge_clients(args, protocol, address, link.limit().unwrap_or(CLIENT_LIMIT), json);
    }
    let chosen = chosen(args)?;
    if args.list {
        return Ok(chosen.iter().try_for_each(|case| list(case, json))?);
    }
    if args.level == LevelArg::Motion && !args.yes_the_robot_may_move {
        return Err(Failure::Input("--level motion moves the robot: add --yes-the-robot-may-move".into()));
    }
    // a device that answers no session is judged all the same
    let link = &Session::settled(link).unwrap_or_else(|_| link.clone());
    let options = options(args, link)?;
    // its end closes the session that halts, unless a shell has opened that one
    let mut signals = Session::new(link);
    let interrupt = signals.handle_signals()?;
    let moves = args.level == LevelArg::Motion && chosen.iter().any(|case| case.level() == Level::Motion);
    if moves {
        // the motor must not stay on, so the cases always end with their clean-up
        signals.prepare_halt(&interrupt)?;
        interrupt.enter(State::Restoring);
    }
    let mut printed = Ok(());
    let report = bcap_conform::run(
        &options,
        |result| {
            if printed.is_ok() && !args.junit {
                printed = print(result, json);
            }
        },
        || interrupt.is_interrupted(),
    );
    interrupt.enter(State::Stepping);
    printed?;
    finish(args, json, &report, chosen.len())
}

/// Maximum time that `--listen` waits for a client, and for its next request.
const CLIENT_LIMIT: Duration = Duration::from_secs(60);

/// Plays a controller, and judges its clients.
fn judge_clients(
    args: &Conform,
    protocol: Protocol,
    address: SocketAddr,
    limit: Duration,
    json: bool,
) -> Result<(), Failure> {
    let judge = ClientJudge::bind(over(protocol), address).map_err(|error| taken("--listen", address, &error))?;
    let ready = format!("{}:{}", if protocol == Protocol::Udp { "udp" } else { "tcp" }, judge.address()?);
    if json {
        print_json(&serde_json::json!({ "ready": ready }).to_string())?;
    } else if !args.junit {
        print_line(&format!("ready bcap={ready}"))?;
    }
    let report = judge.run(args.sessions, limit)?;
    if report.count(Verdict::Pass) + report.count(Verdict::Fail) == 0 {
        let message = format!("no client has sent a request within {} s", limit.as_secs());
        return Err(Failure::Timeout { message, hint: "--timeout sets how long --listen waits".into() });
    }
    if !args.junit {
        report.results.iter().try_for_each(|result| print(result, json))?;
    }
    finish(args, json, &report, report.results.len())
}

/// Returns the cases that the arguments choose.
fn chosen(args: &Conform) -> Result<Vec<&'static Case>, Failure> {
    let cases = bcap_conform::cases();
    if let Some(unknown) = args.case.iter().find(|name| !cases.iter().any(|case| case.name() == **name)) {
        return Err(Failure::Input(format!("no case is named {unknown:?}; `bcap conform --list` prints the names")));
    }
    let is_chosen = |case: &&Case| {
        (args.group.is_empty() || args.group.contains(&case.group()))
            && (args.case.is_empty() || args.case.contains(&case.name()))
    };
    let chosen: Vec<_> = cases.iter().filter(is_chosen).collect();
    if chosen.is_empty() {
        return Err(Failure::Input("no case of --case is in a group of --group".into()));
    }
    Ok(chosen)
}

fn options(args: &Conform, link: &LinkArgs) -> Result<Options, Failure> {
    let bcap = link.untraced()?.network_target()?;
    let robot = robot_ports::resolve(&RobotPorts { robot_udp: None, robot_rac: args.robot_rac.clone() }, link)?;
    // the same host and port over both protocols
    let target = Target { bcap: Some((over(bcap.protocol), robot.udp)), rac: robot.rac.first().copied() };
    Ok(Options {
        level: match args.level {
            LevelArg::Read => Level::Read,
            LevelArg::Write => Level::Write,
            LevelArg::Motion => Level::Motion,
        },
        groups: args.group.clone(),
        cases: args.case.clone(),
        timeout: link.timeout(),
        wait: args.recovery.wait,
        restart: args.recovery.restart.clone(),
        restarts: args.recovery.restarts,
        provider: link.provider().into(),
        machine: link.machine(),
        option: link.option().into(),
        task: args.task.clone(),
        scratch: args.scratch,
        ..Options::new(target)
    })
}

/// Prints a case of the list.
fn list(case: &Case, json: bool) -> io::Result<()> {
    let level = format!("{:?}", case.level()).to_lowercase();
    let (name, source, rule) = (case.name(), case.source(), case.rule());
    let object = serde_json::json!({ "name": name, "level": level, "source": source, "rule": rule });
    print_result(json, &object, &format!("{name} ({level}): {rule} [{source}]"))
}

fn print(result: &CaseResult, json: bool) -> io::Result<()> {
    if json {
        // serializing strings and numbers cannot fail
        return print_json(&serde_json::to_string(result).unwrap_or_default());
    }
    print_block(&result.text())
}

/// Prints the end of the report, and returns the failure of the command if a case failed.
fn finish(args: &Conform, json: bool, report: &Report, planned: usize) -> Result<(), Failure> {
    if args.junit {
        print_block(report.junit().trim_end())?;
    } else if !json {
        report.crashes.iter().try_for_each(|case| print_line(&format!("the device stopped after {case}")))?;
        print_line(&report.summary())?;
    }
    if report.unreachable {
        let (after, planned) = (report.results.len(), report.results.len().max(planned));
        let last =
            report.crashes.last().map(|case| format!("; {case} was the last one that reached it")).unwrap_or_default();
        let message = format!("the device accepts no connection after {after} of {planned} cases{last}");
        return Err(Failure::Connection {
            message,
            hint: "start the device again; --restart runs a command for that, and --wait allows more time".into(),
        });
    }
    if let Some(first) = report.crashes.first() {
        let count = report.crashes.len();
        let message = format!("the device accepted no connection for a time after {count} cases, such as {first}");
        return Err(Failure::Unfit { message, code: None, hint: Some("run these cases alone with --case".into()) });
    }
    if report.results.len() < planned {
        return Err(Failure::Interrupted(format!("ended after {} of {planned} cases", report.results.len())));
    }
    match report.count(Verdict::Fail) {
        0 => Ok(()),
        failed => Err(Failure::Reported(format!("{failed} of {} cases failed", report.results.len()))),
    }
}
