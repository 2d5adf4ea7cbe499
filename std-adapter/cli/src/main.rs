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
mod item;
mod json;
mod listen;
mod output;
mod plain;
mod rac;
mod reference;
mod rules;
mod session;
mod signal;
mod sim;
mod slave;
mod tap;
mod target;
mod text;
mod times;
mod trajectory;
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
    match &cli.command {
        Command::Get(args) => variables::get(args, &cli.link, cli.json),
        Command::Put(args) => variables::put(args, &cli.link, cli.json),
        Command::Watch(args) => watch::watch(args, &cli.link, cli.json),
        Command::Names(_) => variables::names(&cli.link, cli.json),
        Command::Call(args) => call::call(args, &cli.link, cli.json),
        Command::Exec(args) => call::exec(args, &cli.link, cli.json),
        Command::Rac(args) => rac::rac(args, &cli.link, cli.json),
        Command::Sim(args) => sim::sim(args),
        Command::Slave(args) => slave::slave(args, &cli.link, cli.json),
        Command::Halt(_) => halt::halt(&cli.link, cli.json),
        Command::Doctor(args) => doctor::doctor(args, &cli.link, cli.json),
        Command::Gateway(args) => gateway::gateway(args, &cli.link),
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
