//! `bcap run`: runs the lines of a script over one session.

use std::fs::File;
use std::io::{self, BufRead, BufReader};

use crate::args::Run;
use crate::error::Failure;
use crate::line::{Flow, Runner, Verb};
use crate::session::Session;

/// Runs `bcap run`.
pub(crate) fn run(args: &Run, session: &mut Session, verb: Verb, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let mut runner = Runner::new(interrupt.clone(), verb, json);
    let (name, lines) = open(args)?;
    for (number, line) in lines.lines().enumerate() {
        let place = format!("{name}:{}", number + 1);
        let line = line.map_err(|error| Failure::Input(format!("{place}: {error}")))?;
        if interrupt.is_interrupted() {
            session.give_arm()?;
            return Err(Failure::Interrupted(format!("{place}: interrupted before this line")));
        }
        match runner.run(&line, session) {
            Ok(Flow::Continue) => {}
            Ok(Flow::Exit) => return Ok(()),
            Err(failure) => return Err(Failure::Script { place, failure: Box::new(failure) }),
        }
    }
    Ok(())
}

fn open(args: &Run) -> Result<(String, Box<dyn BufRead>), Failure> {
    let name = args.file.display().to_string();
    if name == "-" {
        return Ok((name, Box::new(BufReader::new(io::stdin()))));
    }
    let file = File::open(&args.file).map_err(|error| Failure::Input(format!("{name}: {error}")))?;
    Ok((name, Box::new(BufReader::new(file))))
}
