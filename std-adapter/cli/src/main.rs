//! `bcap`: DENSO robot controllers from the command line.

mod args;
mod decode;
mod dissect;
mod error;
mod frame;
mod hex;
mod item;
mod json;
mod text;
mod value;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser as _};

use crate::args::{Cli, Command};
use crate::error::Failure;

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    match &cli.command {
        Command::Decode(args) => decode::decode(args, cli.json),
        Command::Encode(args) => decode::encode(args, cli.json),
        Command::Text(args) => text::text(args, cli.json),
        Command::Completions(args) => completions(args),
    }
}

fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "bcap", &mut script);
    item::print_line(String::from_utf8_lossy(&script).trim_end())
}
