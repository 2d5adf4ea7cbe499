//! The command line.

use std::env;
use std::ffi::{OsStr, OsString};
use std::mem::ManuallyDrop;
use std::process;

use clap::{Command, Parser};

use crate::{escape, report};

/// Parses the command line, or exits with the help or an error. `adjust` makes changes that the derive macro cannot express. An
/// empty environment variable counts as unset.
#[must_use]
pub fn parse_or_exit<P: Parser>(adjust: fn(Command) -> Command) -> P {
    parse::<P, _>(adjust, env::args_os()).unwrap_or_else(|error| {
        if !error.use_stderr() {
            // help and version contain no text from outside
            error.exit();
        }
        // clap quotes arguments in its errors, so parse again with escaped arguments, which are safe to print
        let safe = env::args_os().map(|argument| escape::line(&escape::cut(&argument.display())));
        match parse::<P, _>(adjust, safe) {
            Err(error) if error.use_stderr() => error.exit(),
            // the escaped arguments parse differently
            _ => {
                report::error(&escape::line(&error.to_string()), &[]);
                process::exit(2)
            }
        }
    })
}

fn parse<P: Parser, A: Into<OsString> + Clone>(
    adjust: fn(Command) -> Command,
    arguments: impl Iterator<Item = A>,
) -> clap::error::Result<P> {
    let is_empty = |name: &OsStr| env::var_os(name).is_some_and(|value| value.is_empty());
    let command = P::command().mut_args(|argument| match argument.get_env() {
        Some(name) if is_empty(name) => argument.env(None::<&str>),
        _ => argument,
    });
    // not dropped, because freeing the memory of all commands takes a fifth of the start-up time
    let mut command = ManuallyDrop::new(adjust(command));
    P::from_arg_matches(&command.try_get_matches_from_mut(arguments)?)
}
