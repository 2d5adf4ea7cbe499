//! `bcap`: DENSO robot controllers from the command line.

mod args;
mod backup;
mod budget;
mod call;
mod capture;
mod confirm;
mod connection;
mod decode;
mod demo;
mod disk;
mod dissect;
mod doctor;
mod duration;
mod error;
mod escape;
mod files;
mod frame;
mod gateway;
mod get;
mod halt;
mod hex;
mod interrupt;
mod item;
mod json;
mod listen;
mod named;
mod output;
mod place;
mod plain;
mod profile;
mod profiles;
mod put;
mod rac;
mod reference;
mod remote;
mod rules;
mod selection;
mod session;
mod signal;
mod sim;
mod slave;
mod table;
mod tap;
mod target;
mod text;
mod times;
mod value;
mod variables;
mod watch;
mod wireshark;

use std::process::ExitCode;

use clap::CommandFactory as _;

use crate::args::{Cli, Command};
use crate::error::Failure;

fn main() -> ExitCode {
    let cli = Cli::parse_or_exit();
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(cli.json),
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let link = &match &cli.command {
        Command::Halt(_) => cli.link.with_profile_for_halt()?,
        command if command.connects() => cli.link.with_profile()?,
        _ => cli.link.clone(),
    };
    match &cli.command {
        Command::Get(args) => get::get(args, link, cli.json),
        Command::Put(args) => put::put(args, link, cli.json),
        Command::Watch(args) => watch::watch(args, link, cli.json),
        Command::Names(_) => variables::names(link, cli.json),
        Command::Ls(args) => files::ls(args, link, cli.json),
        Command::Cp(args) => files::cp(args, link, cli.json),
        Command::Dump(args) => backup::dump(args, link, cli.json),
        Command::Diff(args) => backup::diff(args, link, cli.json),
        Command::Restore(args) => backup::restore(args, link, cli.json),
        Command::Profile(args) => profiles::profile(args, cli.json),
        Command::Call(args) => call::call(args, link, cli.json),
        Command::Exec(args) => call::exec(args, link, cli.json),
        Command::Rac(args) => rac::rac(args, link, cli.json),
        Command::Sim(args) => sim::sim(args),
        Command::Slave(args) => slave::slave(args, link, cli.json),
        Command::Halt(_) => halt::halt(link, cli.json),
        Command::Doctor(args) => doctor::doctor(args, link, cli.json),
        Command::Gateway(args) => gateway::gateway(args, link),
        Command::Demo(_) => demo::demo(),
        Command::Decode(args) => decode::decode(args, cli.json),
        Command::Encode(args) => decode::encode(args),
        Command::Text(args) => text::text(args, cli.json),
        Command::Wireshark(_) => wireshark::wireshark(),
        Command::Completions(args) => completions(args),
    }
}

fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "bcap", &mut script);
    Ok(output::print_raw(String::from_utf8_lossy(&script).trim_end())?)
}
