//! `bcap conform`: judges a server by the cases of `bcap-conform`.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use bcap_conform::{Case, CaseResult, ClientJudge, Level, Link, Options, Report, Target, Verdict};
use bcap_std::{NetworkAddress, Protocol, blocking};

use crate::args::{Conform, LevelArg, LinkArgs};
use crate::connection::not_connected;
use crate::error::Failure;
use crate::interrupt::{Interrupt, State};
use crate::listen::taken;
use crate::output::{print_block, print_json, print_line};
use crate::robot::host;
use crate::session::Session;
use crate::target;

/// Runs `bcap conform`.
pub(crate) fn conform(args: &Conform, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if let Some((over, address)) = args.listen {
        return judge_clients(args, over, address, link.limit().unwrap_or(CLIENT_LIMIT), json);
    }
    let chosen = chosen(args)?;
    if args.list {
        return Ok(chosen.iter().try_for_each(|case| list(case, json))?);
    }
    if args.level == LevelArg::Motion && !args.yes_the_robot_may_move {
        return Err(Failure::Input("--level motion moves the robot: add --yes-the-robot-may-move".into()));
    }
    let options = options(args, link)?;
    let interrupt = Interrupt::install(|_| {})?;
    let moves = args.level == LevelArg::Motion && chosen.iter().any(|case| case.level() == Level::Motion);
    if moves {
        // the motor must not stay on, so the cases always end with their clean-up
        Session::new(link).prepare_halt(&interrupt)?;
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
    interrupt.dismiss();
    printed?;
    finish(args, json, &report, chosen.len())
}

/// How long `--listen` waits for a client, and for its next request.
const CLIENT_LIMIT: Duration = Duration::from_secs(60);

/// Plays a controller, and judges its clients.
fn judge_clients(args: &Conform, over: Link, address: SocketAddr, limit: Duration, json: bool) -> Result<(), Failure> {
    let judge = ClientJudge::bind(over, address).map_err(|error| taken("--listen", address, &error))?;
    let protocol = match over {
        Link::Udp => "udp",
        Link::Tcp | Link::Serial => "tcp",
    };
    let ready = format!("{protocol}:{}", judge.address()?);
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
    let rac = args.robot_rac.clone().unwrap_or_else(|| host(&bcap));
    let rac = target::rac(Some(&rac), None, link.rac_port())?;
    let resolve = |address: &NetworkAddress| {
        let found = blocking::resolve(address, Some(link.timeout()))
            .map_err(|error| not_connected(&error, &bcap_std::Address::Network(address.clone())))?;
        found.first().copied().ok_or_else(|| Failure::Input(format!("{address} has no address")))
    };
    let over = match bcap.protocol {
        Protocol::Tcp => Link::Tcp,
        Protocol::Udp => Link::Udp,
    };
    let target = Target { bcap: Some((over, resolve(&bcap)?)), rac: Some(resolve(&rac)?) };
    Ok(Options {
        level: match args.level {
            LevelArg::Read => Level::Read,
            LevelArg::Write => Level::Write,
            LevelArg::Motion => Level::Motion,
        },
        groups: args.group.clone(),
        cases: args.case.clone(),
        timeout: link.timeout(),
        provider: link.provider().into(),
        machine: link.machine().into(),
        option: link.option().into(),
        task: args.task.clone(),
        scratch: args.scratch,
        ..Options::new(target)
    })
}

/// Prints a case of the list.
fn list(case: &Case, json: bool) -> io::Result<()> {
    let level = format!("{:?}", case.level()).to_lowercase();
    if json {
        let line = serde_json::json!({
            "name": case.name(), "level": level, "source": case.source(), "rule": case.rule()
        });
        return print_json(&line.to_string());
    }
    print_line(&format!("{} ({level}): {} [{}]", case.name(), case.rule(), case.source()))
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
        print_line(&report.summary())?;
    }
    if report.results.len() < planned {
        return Err(Failure::Interrupted(format!("ended after {} of {planned} cases", report.results.len())));
    }
    match report.count(Verdict::Fail) {
        0 => Ok(()),
        failed => Err(Failure::CasesFailed { failed, total: report.results.len() }),
    }
}
