//! The completion of a command line in a shell, by the engine of clap: the script of `bcap generate completions` calls `bcap` for
//! each Tab. Names of variables and tasks come from the controller of the line, if it answers in time.

use std::env;
use std::ffi::OsString;
use std::time::Duration;

use clap::{Arg, Command, CommandFactory as _, FromArgMatches as _};
use clap_complete::CompleteEnv;
use clap_complete::engine::{ArgValueCandidates, CompletionCandidate};

use crate::cli::Cli;
use crate::commands::variables::names::all_names;
use crate::link::LinkArgs;
use crate::link::profiles::Profiles;
use crate::session::Session;

/// The time that a Tab may take.
const LIMIT: Duration = Duration::from_millis(500);

/// Answers a shell that completes a line, and exits then.
pub(crate) fn answer() {
    CompleteEnv::with_factory(command).complete();
}

/// Returns the command line with the completions of its arguments.
fn command() -> Command {
    const VARIABLES: &[(&str, &str)] = &[
        ("get", "names"),
        ("put", "name"),
        ("watch", "names"),
        #[cfg(feature = "screens")]
        ("monitor", "names"),
    ];
    let of = |id: &'static str, candidates: fn() -> Vec<CompletionCandidate>| {
        // `mut_arg` would change the order of the arguments
        let add = move |argument: Arg| match argument.get_id() == id {
            true => argument.add(ArgValueCandidates::new(candidates)),
            false => argument,
        };
        move |command: Command| command.mut_args(add)
    };
    let command = of("profile", profiles)(Cli::command());
    VARIABLES
        .iter()
        .fold(command, |command, (name, id)| command.mut_subcommand(name, of(id, variables)))
        .mut_subcommand("profile", |command| command.mut_subcommand("show", of("name", profiles)))
        .mut_subcommand("task", |command| {
            let command = command.mut_subcommand("start", of("names", tasks));
            command.mut_subcommand("stop", of("name", tasks)).mut_subcommand("status", of("name", tasks))
        })
}

fn profiles() -> Vec<CompletionCandidate> {
    let profiles = Profiles::read().map(|profiles| profiles.by_name).unwrap_or_default();
    profiles.into_keys().map(CompletionCandidate::new).collect()
}

fn variables() -> Vec<CompletionCandidate> {
    names().iter().map(CompletionCandidate::new).collect()
}

fn tasks() -> Vec<CompletionCandidate> {
    names().iter().filter_map(|name| name.strip_prefix("task:")).map(CompletionCandidate::new).collect()
}

/// Returns the names that the controller of the line lists; no names if it does not answer in time.
fn names() -> Vec<String> {
    let link = || {
        // the words of the line follow --
        let words: Vec<OsString> = env::args_os().skip_while(|word| word != "--").skip(1).collect();
        let link =
            LinkArgs::from_arg_matches(&Cli::command().ignore_errors(true).try_get_matches_from(words).ok()?).ok()?;
        let link = link.with_profile().ok()?;
        // with the address instead of the profile: a Tab must not change a profile
        let target = link.target().ok()?.to_string();
        Some(link.at(&target).within(LIMIT))
    };
    link().and_then(|link| all_names(&mut Session::new(&link))).unwrap_or_default()
}
