//! `bcap run`: runs the lines of a script over one session.

use std::fs::File;
use std::io::{self, BufRead, BufReader};

use crate::cli::Run;
use crate::failure::Failure;
use crate::input::Lines;
use crate::interrupt::Interrupt;
use crate::output::print_result;
use crate::session::Session;
use crate::shell::line::{Check, Checked, Checker, Flow, Runner, Verb};

/// Maximum nesting depth of scripts that run scripts.
const DEPTH: u8 = 16;

/// Runs `bcap run`.
pub(crate) fn run(args: &Run, session: &mut Session, verb: Verb, check: Check, json: bool) -> Result<(), Failure> {
    if session.scripts >= DEPTH {
        return Err(too_deep(args));
    }
    session.scripts += 1;
    let done = run_lines(args, session, verb, check, json);
    session.scripts -= 1;
    done
}

fn too_deep(args: &Run) -> Failure {
    Failure::Input(format!("{}: more than {DEPTH} scripts run each other", args.file.display()))
}

/// Checks all lines of a file before the first line runs. The lines of the standard input run as they arrive.
fn run_lines(args: &Run, session: &mut Session, verb: Verb, check: Check, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let (name, lines) = open(args)?;
    let mut lines = Lines::read(lines)?;
    if args.check || name != "-" {
        let all = collect(&name, &lines, &interrupt)?;
        check_lines(&name, &all, &mut Checker::new(session.variables.clone(), check), session.scripts)?;
        if args.check {
            return checked(&name, all.len(), json);
        }
        lines = Lines::of(all);
    }
    run_each(&name, &lines, session, &Runner::new(interrupt, verb, json))
}

/// Reads all lines; a signal ends that with an error.
fn collect(name: &str, lines: &Lines, interrupt: &Interrupt) -> Result<Vec<String>, Failure> {
    let mut all = Vec::new();
    loop {
        match lines.next(interrupt) {
            Ok(Some(line)) => all.push(line),
            Ok(None) => return Ok(all),
            Err(Failure::Interrupted(_)) => {
                return Err(Failure::Interrupted(format!("{name}: interrupted before its first line")));
            }
            Err(error) => return Err(Failure::Input(format!("{name}:{}: {error}", all.len() + 1))),
        }
    }
}

/// Checks the lines of a script, and of the scripts that it runs.
fn check_lines(name: &str, lines: &[String], checker: &mut Checker, depth: u8) -> Result<(), Failure> {
    for (line, number) in lines.iter().zip(1_u32..) {
        let failed = |failure| Failure::Script { place: format!("{name}:{number}"), failure: Box::new(failure) };
        match checker.line(line).map_err(failed)? {
            Checked::Script(args) => check_script(&args, checker, depth).map_err(failed)?,
            Checked::Continue => {}
            Checked::Exit => break,
        }
    }
    Ok(())
}

/// Checks the lines of a script that a script runs. The standard input is read when the line runs.
fn check_script(args: &Run, checker: &mut Checker, depth: u8) -> Result<(), Failure> {
    if args.file.as_os_str() == "-" {
        return Ok(());
    }
    if depth >= DEPTH {
        return Err(too_deep(args));
    }
    let (name, lines) = open(args)?;
    let lines = lines.lines().collect::<Result<Vec<_>, _>>();
    let lines = lines.map_err(|error| Failure::Input(format!("{name}: {error}")))?;
    check_lines(&name, &lines, checker, depth + 1)
}

/// Prints the result of `--check`.
fn checked(name: &str, lines: usize, json: bool) -> Result<(), Failure> {
    Ok(print_result(json, &serde_json::json!({ "lines": lines }), &format!("{name}: {lines} lines are valid"))?)
}

/// Runs lines until the last line, `exit`, an error or a signal.
fn run_each(name: &str, lines: &Lines, session: &mut Session, runner: &Runner) -> Result<(), Failure> {
    for number in 1_u32.. {
        let place = format!("{name}:{number}");
        let line = match lines.next(&runner.interrupt) {
            Ok(Some(line)) => line,
            Ok(None) => break,
            Err(Failure::Interrupted(_)) => {
                session.give_arm()?;
                return Err(Failure::Interrupted(format!("{place}: interrupted before this line")));
            }
            Err(error) => return Err(Failure::Input(format!("{place}: {error}"))),
        };
        match runner.run(&line, session) {
            Ok(Flow::Continue) => {}
            Ok(Flow::Exit) => break,
            Err(failure) => return Err(Failure::Script { place, failure: Box::new(failure) }),
        }
    }
    Ok(())
}

fn open(args: &Run) -> Result<(String, Box<dyn BufRead + Send>), Failure> {
    let name = args.file.display().to_string();
    if name == "-" {
        return Ok((name, Box::new(BufReader::new(io::stdin()))));
    }
    let file = File::open(&args.file).map_err(|error| Failure::Input(format!("{name}: {error}")))?;
    Ok((name, Box::new(BufReader::new(file))))
}
