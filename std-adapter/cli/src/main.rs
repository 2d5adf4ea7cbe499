//! `bcap`: DENSO robot controllers from the command line.

mod args;
mod backup;
mod board;
mod budget;
mod call;
mod confirm;
mod conform;
mod connection;
mod decode;
mod demo;
mod destination;
mod disk;
mod doctor;
mod error;
mod errors;
mod explain;
mod files;
mod fuzz;
mod gateway;
mod get;
mod halt;
mod input;
mod interrupt;
mod line;
mod listen;
mod mcap_log;
mod monitor;
mod motion;
mod named;
mod output;
mod place;
mod plain;
mod profile;
mod profiles;
mod proxy;
mod put;
mod rac;
mod raw;
mod reference;
mod remote;
mod replay;
mod robot;
mod rules;
mod samples;
mod screen;
mod script;
mod selection;
mod session;
mod shell;
mod silence;
mod sim;
mod slave;
mod stream;
mod table;
mod target;
mod task;
mod terminal;
mod text;
mod traffic;
mod trajectory;
mod value;
mod variables;
mod watch;
mod wireshark;
mod words;

use std::process::ExitCode;

use bcap_terminal::args::parse_or_exit;
use clap::CommandFactory as _;

use crate::args::{Cli, Command};
use crate::error::Failure;
use crate::interrupt::Interrupt;
use crate::session::Session;

fn main() -> ExitCode {
    let cli: Cli = parse_or_exit();
    let code = match recorded(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(cli.json),
    };
    // nothing is left on the controller, and the message is on the screen
    if Interrupt::of_process().is_some_and(|interrupt| interrupt.suspend_if_requested()) {
        output::note("Ctrl-Z had ended the command; start it again");
    }
    code
}

/// Runs the command, and records it if the user wants that.
fn recorded(cli: &Cli) -> Result<(), Failure> {
    // these record their clients or their robot
    let is_served = matches!(cli.command, Command::Proxy(_) | Command::Sim(_) | Command::Gateway(_) | Command::Fuzz(_));
    let Some(file) = cli.link.write.as_deref().filter(|_| !is_served) else { return run(cli) };
    if matches!(cli.command, Command::Raw(_) | Command::Conform(_)) || !cli.command.connects() {
        return Err(Failure::Input("this command has nothing to record; leave --write out".into()));
    }
    let recording = traffic::record(file)?;
    let result = run(cli);
    result.and(recording.finish().map_err(Failure::from))
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let link = match &cli.command {
        Command::Halt(_) => cli.link.with_profile_for_halt()?,
        command if command.connects() => cli.link.with_profile()?,
        _ => cli.link.clone(),
    };
    let mut session = Session::new(&link);
    let done = verb(&cli.command, &mut session, cli.json);
    if session.has_arm() && matches!(cli.command, Command::Exec(_) | Command::Call(_)) {
        output::note(
            "the arm was taken, and is given back now, because one command is one session; `bcap shell` and `bcap run` keep \
             it, `bcap move` does a whole motion",
        );
    }
    session.finish(done)
}

/// Runs a command: one of the command line, of the shell or of a script.
pub(crate) fn verb(command: &Command, session: &mut Session, json: bool) -> Result<(), Failure> {
    let link = &session.link().clone();
    match command {
        Command::Get(args) => get::get(args, session, json),
        Command::Put(args) => put::put(args, session, json),
        Command::Watch(args) => watch::watch(args, session, json),
        Command::Monitor(args) => monitor::monitor(args, session, json),
        Command::Names(_) => variables::names(session, json),
        Command::Ls(args) => files::ls(args, session, json),
        Command::Cp(args) => files::cp(args, session, json),
        Command::Dump(args) => backup::dump(args, session, json),
        Command::Diff(args) => backup::diff(args, session, json),
        Command::Restore(args) => backup::restore(args, session, json),
        Command::Profile(args) => profiles::profile(args, json),
        Command::Call(args) => call::call(args, session, json),
        Command::Exec(args) => call::exec(args, session, json),
        Command::Move(args) => motion::motion(args, session, json),
        Command::Task(args) => task::task(args, session, json),
        Command::Errors(_) => errors::errors(session, json),
        Command::Clear(_) => errors::clear(session),
        Command::Messages(args) => errors::messages(args, session, json),
        Command::Shell(_) => shell::shell(session, verb, json),
        Command::Run(args) => script::run(args, session, verb, check, json),
        Command::Raw(args) => raw::raw(args, session, json),
        Command::Rac(args) => rac::rac(args, link, json),
        Command::Sim(args) => sim::sim(args, link.write.as_deref()),
        Command::Slave(args) => slave::slave(args, session, json),
        Command::Halt(_) => halt::halt(session, json),
        Command::Doctor(args) => doctor::doctor(args, link, json),
        Command::Gateway(args) => gateway::gateway(args, link.untraced()?),
        Command::Board(args) => board::board(args, link, json),
        Command::Proxy(args) => proxy::proxy(args, link.untraced()?, json),
        Command::Replay(args) => replay::replay(args, link.untraced()?, json),
        Command::Conform(args) => conform::conform(args, link, json),
        Command::Fuzz(args) => fuzz::fuzz(args, link.untraced()?, json),
        Command::Demo(_) => demo::demo(),
        Command::Decode(args) => decode::decode(args, json),
        Command::Encode(args) => decode::encode(args),
        Command::Text(args) => text::text(args, json),
        Command::Explain(args) => explain::explain(args, json),
        Command::Wireshark(_) => wireshark::wireshark(),
        Command::Completions(args) => completions(args),
        Command::Man(args) => man(args),
    }
}

/// Checks the arguments of a command of a script before the script makes a call.
fn check(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Get(args::Get { names }) | Command::Watch(args::Watch { names, .. }) => {
            selection::Selection::parse_each(names).map(drop)
        }
        Command::Put(args) => put::check(args),
        Command::Call(args) => call::check(args),
        Command::Exec(args) => call::check_exec(args),
        Command::Move(args) => motion::check(args),
        Command::Rac(args) => rac::check(args),
        _ => Ok(()),
    }
}

fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "bcap", &mut script);
    Ok(output::print_raw(String::from_utf8_lossy(&script).trim_end())?)
}

/// Writes `bcap.1` and a page for each command, such as `bcap-get.1`.
fn man(args: &args::Man) -> Result<(), Failure> {
    let failed = |error| Failure::Input(format!("cannot write manual pages to {}: {error}", args.directory.display()));
    std::fs::create_dir_all(&args.directory).map_err(failed)?;
    // `bcap help` needs no pages
    let mut command = Cli::command().disable_help_subcommand(true);
    // propagates the global options
    command.build();
    clap_mangen::generate_to(command, &args.directory).map_err(failed)
}
