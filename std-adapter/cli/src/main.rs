//! `bcap`: DENSO robot controllers from the command line.

mod args;
mod budget;
mod call;
mod capture;
mod connection;
mod decode;
mod demo;
mod dissect;
mod doctor;
mod error;
mod escape;
mod frame;
mod gateway;
mod halt;
mod hex;
mod interrupt;
mod item;
mod json;
mod line;
mod listen;
mod motion;
mod output;
mod plain;
mod rac;
mod raw;
mod reference;
mod rules;
mod script;
mod session;
mod shell;
mod signal;
mod sim;
mod slave;
mod tap;
mod target;
mod task;
mod text;
mod times;
mod trace;
mod trouble;
mod value;
mod variables;
mod watch;
mod wireshark;
mod words;

use std::process::ExitCode;

use clap::CommandFactory as _;

use crate::args::{Cli, Command};
use crate::error::Failure;
use crate::session::Session;

fn main() -> ExitCode {
    let cli = Cli::parse_or_exit();
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(cli.json),
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let mut session = Session::new(&cli.link);
    let done = verb(&cli.command, &mut session, cli.json);
    if session.has_arm() && matches!(cli.command, Command::Exec(_) | Command::Call(_)) {
        output::note(
            "the arm was taken, and is given back now, because one command is one session; `bcap shell` and `bcap run` keep \
             it, `bcap move` does a whole motion",
        );
    }
    done
}

/// Runs a command: one of the command line, of the shell or of a script.
pub(crate) fn verb(command: &Command, session: &mut Session, json: bool) -> Result<(), Failure> {
    let link = &session.link().clone();
    match command {
        Command::Get(args) => variables::get(args, session, json),
        Command::Put(args) => variables::put(args, session, json),
        Command::Watch(args) => watch::watch(args, session, json),
        Command::Names(_) => variables::names(session, json),
        Command::Call(args) => call::call(args, session, json),
        Command::Exec(args) => call::exec(args, session, json),
        Command::Move(args) => motion::motion(args, session, json),
        Command::Task(args) => task::task(args, session, json),
        Command::Errors(_) => trouble::errors(session, json),
        Command::Clear(_) => trouble::clear(session),
        Command::Messages(args) => trouble::messages(args, session, json),
        Command::Shell(_) => shell::shell(session, verb, json),
        Command::Run(args) => script::run(args, session, verb, json),
        Command::Raw(args) => raw::raw(args, link, json),
        Command::Rac(args) => rac::rac(args, link, json),
        Command::Sim(args) => sim::sim(args),
        Command::Slave(args) => slave::slave(args, link, json),
        Command::Halt(_) => halt::halt(session, json),
        Command::Doctor(args) => doctor::doctor(args, link, json),
        Command::Gateway(args) => gateway::gateway(args, link.untraced()?),
        Command::Demo(_) => demo::demo(),
        Command::Decode(args) => decode::decode(args, json),
        Command::Encode(args) => decode::encode(args),
        Command::Text(args) => text::text(args, json),
        Command::Wireshark(_) => wireshark::wireshark(),
        Command::Completions(args) => completions(args),
    }
}

fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "bcap", &mut script);
    Ok(output::print_raw(String::from_utf8_lossy(&script).trim_end())?)
}
