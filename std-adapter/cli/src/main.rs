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
mod duration;
mod error;
mod escape;
mod explain;
mod faults;
mod frame;
mod gateway;
mod halt;
mod hex;
mod item;
mod json;
mod listen;
mod output;
mod plain;
mod playback;
mod proxy;
mod rac;
mod record;
mod reference;
mod replay;
mod robot;
mod rules;
mod session;
mod signal;
mod sim;
mod slave;
mod tap;
mod target;
mod text;
mod times;
mod title;
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
    match recorded(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(cli.json),
    }
}

/// Runs the command, and records it if the user wants that.
fn recorded(cli: &Cli) -> Result<(), Failure> {
    // these record their clients or their robot
    let is_served = matches!(cli.command, Command::Proxy(_) | Command::Sim(_) | Command::Gateway(_));
    let Some(file) = cli.link.write.as_deref().filter(|_| !is_served) else { return run(cli) };
    let recording = record::Recording::of_command(file)?;
    let result = run(cli);
    result.and(recording.finish())
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
        Command::Sim(args) => sim::sim(args, cli.link.write.as_deref()),
        Command::Slave(args) => slave::slave(args, &cli.link, cli.json),
        Command::Halt(_) => halt::halt(&cli.link, cli.json),
        Command::Doctor(args) => doctor::doctor(args, &cli.link, cli.json),
        Command::Gateway(args) => gateway::gateway(args, &cli.link),
        Command::Proxy(args) => proxy::proxy(args, &cli.link, cli.json),
        Command::Replay(args) => replay::replay(args, &cli.link, cli.json),
        Command::Demo(_) => demo::demo(),
        Command::Decode(args) => decode::decode(args, cli.json),
        Command::Encode(args) => decode::encode(args),
        Command::Text(args) => text::text(args, cli.json),
        Command::Explain(args) => explain::explain(args, cli.json),
        Command::Wireshark(_) => wireshark::wireshark(),
        Command::Completions(args) => completions(args),
        Command::Man(args) => man(args),
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
