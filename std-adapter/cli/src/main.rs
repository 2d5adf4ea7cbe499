//! `bcap`: DENSO robot controllers from the command line.
#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "the comments of arguments are the help text, where brackets are brackets"
)]

mod cli;
mod commands;
mod completion;
mod failure;
mod input;
mod interrupt;
mod link;
mod listen;
mod output;
mod session;
mod shell;

use std::process::ExitCode;

use bcap_terminal::args::parse_or_exit;

use crate::cli::{Cli, Command};
use crate::commands::backup::{diff, dump, restore};
use crate::commands::calls::{call, exec};
use crate::commands::judge::{conform, fuzz};
#[cfg(feature = "screens")]
use crate::commands::monitor;
use crate::commands::packets::{decode, proxy, raw, replay};
use crate::commands::robot::{errors, halt, jog, log, motion, recover, task};
use crate::commands::variables::{get, io, names, put, rac, watch};
use crate::commands::{board, doctor, explain, files, gateway, profile, report, sim, slave};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::session::{Session, traffic};
use crate::shell::script;
use bcap_capture::value::selection::Selection;

fn main() -> ExitCode {
    completion::answer();
    let cli: Cli = parse_or_exit(cli::with_groups);
    let code = match recorded(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_output() && cli.command.only_prints() => ExitCode::SUCCESS,
        Err(failure) => failure.report(cli.json),
    };
    // the session on the controller has ended, and the message is on the screen
    if Interrupt::of_process().is_some_and(|interrupt| interrupt.suspend_if_requested()) {
        output::note("Ctrl-Z had ended the command; start it again");
    }
    code
}

/// Runs the command, and records it if the user wants that.
fn recorded(cli: &Cli) -> Result<(), Failure> {
    // these record their clients or their robot
    let is_served = matches!(cli.command, Command::Proxy(_) | Command::Sim(_) | Command::Gateway(_) | Command::Fuzz(_));
    if let (Some(written), Some(read)) = (cli.link.write.as_deref(), cli.command.replayed())
        && written.canonicalize().ok().is_some_and(|written| read.canonicalize().ok() == Some(written))
    {
        return Err(Failure::Input("--write would replace the capture that is replayed; name another file".into()));
    }
    let Some(file) = cli.link.write.as_deref().filter(|_| !is_served) else { return run(cli) };
    if matches!(cli.command, Command::Raw(_) | Command::Conform(_)) || !cli.command.connects() {
        return Err(Failure::Input("this command has nothing to record; leave --write out".into()));
    }
    traffic::record(file)?;
    let result = run(cli);
    failure::with_finding(result, traffic::finish())
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let link = match &cli.command {
        Command::Halt(_) => cli.link.with_profile_for_halt()?,
        command if command.connects() => cli.link.with_profile()?,
        _ => cli.link.clone(),
    };
    let mut session = Session::new(&link);
    let done = verb(&cli.command, &mut session, cli.json);
    let keeps_motor = matches!(&cli.command, Command::Recover(args) if args.keep);
    let is_single = keeps_motor || matches!(cli.command, Command::Exec(_) | Command::Call(_) | Command::Put(_));
    let is_interrupted = Interrupt::of_process().is_some_and(|interrupt| interrupt.is_interrupted());
    if is_single && done.is_ok() && !is_interrupted && session.leave_motor() {
        output::note("the motor stays on after this command; `bcap exec robot Motor 0` switches it off");
    }
    if is_single && session.has_arm() {
        output::note(
            "the arm was taken, and is given back now, because one command is one session; `bcap shell` and `bcap run` keep \
             it, `bcap move` does a whole motion",
        );
    }
    let done = session.finish(done);
    session.end_after(done)
}

/// Runs a command: one of the command line, of the shell or of a script.
pub(crate) fn verb(command: &Command, session: &mut Session, json: bool) -> Result<(), Failure> {
    let link = &session.link().clone();
    match command {
        Command::Status(_) => doctor::status::status(session, json),
        Command::Get(args) => get::get(args, session, json),
        Command::Put(args) => put::put(args, session, json),
        Command::Watch(args) => watch::watch(args, session, json),
        Command::Io(args) => io::io(args, session, json),
        #[cfg(feature = "screens")]
        Command::Monitor(args) => monitor::monitor(args, session, json),
        #[cfg(feature = "web")]
        Command::Web(args) => commands::web::web(args, link),
        Command::Names(args) => names::names(args, session, json),
        Command::Ls(args) => files::ls(args, session, json),
        Command::Cp(args) => files::cp(args, session, json),
        Command::Rm(args) => files::rm(args, session, json),
        Command::Dump(args) => dump::dump(args, session, json),
        Command::Diff(args) => diff::diff(args, session, json),
        Command::Restore(args) => restore::restore(args, session, json),
        Command::Profile(args) => profile::profile(args, json),
        Command::Scan(args) => doctor::scan::scan(args, link, json),
        Command::Call(args) if args.is_help() => cli::print_help("call"),
        Command::Call(args) => call::call(args, session, json),
        Command::Exec(args) => exec::exec(args, session, json),
        Command::Move(args) => motion::motion(args, session, json),
        Command::Jog(args) => jog::jog(args, session, json),
        Command::Teach(args) => jog::teach(args, session, json),
        Command::Task(args) => task::task(args, session, json),
        Command::Errors(args) => errors::errors(args, session, json),
        Command::Log(args) => log::log(args, session, json),
        Command::Recover(args) => recover::recover(args, session, json),
        Command::Shell(_) => shell::shell(session, verb, json),
        Command::Run(args) => script::run(args, session, verb, check, json),
        Command::Raw(args) => raw::raw(args, session, json),
        Command::Rac(args) => rac::rac(args, link, json),
        Command::Sim(args) => sim::sim(args, link.write.as_deref()),
        Command::Slave(args) => slave::slave(args, session, json),
        Command::Halt(_) => halt::halt(session, json),
        Command::Doctor(args) => doctor::doctor(args, link, json),
        Command::Report(args) => report::report(args, session, json),
        Command::Gateway(args) => gateway::gateway(args, link.untraced()?),
        Command::Board(args) => board::board(args, link, json),
        Command::Proxy(args) => proxy::proxy(args, link.untraced()?, json),
        Command::Replay(args) => replay::replay(args, link.untraced()?, json),
        Command::Conform(args) => conform::conform(args, link, json),
        Command::Fuzz(args) => fuzz::fuzz(args, link.untraced()?, json),
        Command::Decode(args) => decode::decode(args, json),
        Command::Explain(args) => explain::explain(args, json),
        Command::Generate(args) => cli::generate(args),
        Command::Connection => cli::print_help("connection"),
    }
}

/// Checks the arguments of a command of a script before the script makes a call.
fn check(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Get(get::Get { names })
        | Command::Io(io::Io { names, .. })
        | Command::Watch(watch::Watch { names, .. }) => Ok(Selection::parse_each(names).map(drop)?),
        Command::Put(args) => put::check(args),
        Command::Call(args) => call::check(args),
        Command::Exec(args) => exec::check(args),
        Command::Move(args) => motion::check(args),
        Command::Jog(args) => jog::check_jog(args),
        Command::Teach(args) => jog::check_teach(args),
        Command::Recover(args) => recover::check(args),
        Command::Rac(args) => rac::check(args),
        _ => Ok(()),
    }
}
