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
mod explain;
mod faults;
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
mod playback;
mod profile;
mod profiles;
mod proxy;
mod put;
mod rac;
mod record;
mod reference;
mod remote;
mod replay;
mod robot;
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
        Command::Sim(args) => sim::sim(args, link.write.as_deref()),
        Command::Slave(args) => slave::slave(args, link, cli.json),
        Command::Halt(_) => halt::halt(link, cli.json),
        Command::Doctor(args) => doctor::doctor(args, link, cli.json),
        Command::Gateway(args) => gateway::gateway(args, link),
        Command::Proxy(args) => proxy::proxy(args, link, cli.json),
        Command::Replay(args) => replay::replay(args, link, cli.json),
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
