//! The book: every command in a page of `docs/SUMMARY.md` runs as it is printed, and its output is compared with the page.
//!
//! A page has one virtual controller and one folder. Its blocks of the language `console` run in order:
//!
//! * A line `$ COMMAND` runs by `sh` and must end with 0, or with N if the line ends with `# exit code N`.
//! * The lines after it are its output, standard error included. `...` stands for any text, alone on a line for any lines.
//!   Without such lines the output is not compared.
//! * A command that ends with `&` is a server of `bcap`. It listens on free ports; the test translates addresses in both
//!   directions, and does so for the address 192.168.0.1 of the virtual controller as well.
//!
//! A comment `<!-- book: ... -->` above a block directs the test: `sim OPTIONS` starts another virtual controller, `run COMMAND` runs a
//! command that the reader does not see, `file NAME` writes the next block to a file, `needs PROGRAM` runs the next block only where
//! PROGRAM is installed, and `skip REASON` does not run it. The clock of the virtual controller of `sim stepped`, and of
//! `sim stepped --scenario FILE`, waits for its clients, so that a busy machine meets the deadlines of Slave Mode.

mod page;
mod pattern;
mod world;

use std::path::{Path, PathBuf};
use std::{fs, thread};

use bcap_tests::tools;
use page::{Action, Page};
use world::World;

/// The outcomes of the commands of a page.
#[derive(Default)]
struct Outcome {
    run: usize,
    /// Each block that was not run, with its commands and the reason.
    skipped: Vec<String>,
    failures: Vec<String>,
}

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs")
}

/// Returns the pages of the book, and of the two READMEs that show the command.
fn pages() -> Vec<Page> {
    let summary = fs::read_to_string(docs().join("SUMMARY.md")).unwrap();
    let names = summary.lines().filter_map(|line| line.split_once("](")?.1.strip_suffix(')'));
    names.chain(["../README.md", "../std-adapter/cli/README.md"]).map(|name| Page::read(&docs(), name)).collect()
}

fn run(page: &Page) -> Outcome {
    let mut outcome = Outcome::default();
    let mut world = World::new(&docs());
    for action in &page.actions {
        match action {
            Action::Sim(options) => world.start_sim(options),
            Action::File { name, content } => world.write(name, content),
            Action::Hidden(command) => outcome.failures.extend(world.run(command).err()),
            Action::Commands { needs: Some(program), commands, .. } if tools::find(program).is_none() => {
                outcome.skipped.push(format!("{}: {} commands: {program} is not installed", page.name, commands.len()));
            }
            Action::Commands { commands, .. } => {
                outcome.run += commands.len();
                outcome.failures.extend(commands.iter().filter_map(|command| world.run(command).err()));
            }
            Action::Skipped { commands, reason } => {
                outcome.skipped.push(format!("{}: {commands} commands: {reason}", page.name));
            }
        }
    }
    outcome
}

#[test]
fn every_command_runs_as_printed() {
    let pages = pages();
    let outcomes: Vec<Outcome> = thread::scope(|scope| {
        let running: Vec<_> = pages.iter().map(|page| scope.spawn(|| run(page))).collect();
        running.into_iter().map(|page| page.join().unwrap()).collect()
    });
    for line in outcomes.iter().flat_map(|outcome| &outcome.skipped) {
        println!("not run: {line}");
    }
    let commands: usize = outcomes.iter().map(|outcome| outcome.run).sum();
    let programs: usize = pages.iter().map(|page| page.programs).sum();
    println!("book: {} pages, {commands} commands run, {programs} programs compiled by doc tests", pages.len());
    let failures: Vec<_> = outcomes.into_iter().flat_map(|outcome| outcome.failures).collect();
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
    assert!(commands >= 90, "{commands} commands: are the blocks still found?");
}

#[test]
fn patterns_match_any_text_and_any_lines() {
    let is_match = |expected: &str, actual: &str| {
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
        pattern::matches(&lines(expected), &lines(actual))
    };
    assert!(is_match("a ... c", "a b c") && is_match("...", "") && is_match("a\n...\nd", "a\nb\nc\nd"));
    assert!(is_match("took ... ms, ... left", "took 0.6 ms, 3 left"));
    assert!(!is_match("a", "a\nb") && !is_match("a\n...", "b") && !is_match("a ... c", "a b"));
    assert!(!is_match("ab...ba", "aba"));
}
