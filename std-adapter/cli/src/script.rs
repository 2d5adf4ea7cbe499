//! `bcap run`: runs the lines of a script over one session.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use crate::args::Run;
use crate::error::Failure;
use crate::line::{Flow, Runner, Verb};
use crate::session::Session;

/// How deep scripts that run scripts may be nested.
const DEPTH: u8 = 16;

/// How often a script that waits for its next line looks for a signal.
const LOOK: Duration = Duration::from_millis(20);

/// Runs `bcap run`.
pub(crate) fn run(args: &Run, session: &mut Session, verb: Verb, json: bool) -> Result<(), Failure> {
    if session.scripts >= DEPTH {
        return Err(Failure::Input(format!("{}: more than {DEPTH} scripts run each other", args.file.display())));
    }
    session.scripts += 1;
    let done = run_lines(args, session, verb, json);
    session.scripts -= 1;
    done
}

fn run_lines(args: &Run, session: &mut Session, verb: Verb, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let mut runner = Runner::new(interrupt.clone(), verb, json);
    let (name, lines) = open(args)?;
    let lines = read_on_thread(lines)?;
    let mut number = 0_u32;
    loop {
        let line = lines.recv_timeout(LOOK);
        if line != Err(RecvTimeoutError::Timeout) {
            number = number.saturating_add(1);
        }
        if interrupt.is_interrupted() {
            session.give_arm()?;
            return Err(Failure::Interrupted(format!("{name}:{number}: interrupted before this line")));
        }
        let place = format!("{name}:{number}");
        let line = match line {
            Ok(line) => line.map_err(|error| Failure::Input(format!("{place}: {error}")))?,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        match runner.run(&line, session) {
            Ok(Flow::Continue) => {}
            Ok(Flow::Exit) => return Ok(()),
            Err(failure) => return Err(Failure::Script { place, failure: Box::new(failure) }),
        }
    }
}

/// Reads lines on a thread of its own, because a signal must be noticed while a line is waited for.
fn read_on_thread(lines: Box<dyn BufRead + Send>) -> io::Result<Receiver<Result<String, String>>> {
    let (sender, receiver) = sync_channel(0);
    thread::Builder::new().name("script".into()).spawn(move || {
        for line in lines.lines() {
            if sender.send(line.map_err(|error| error.to_string())).is_err() {
                return;
            }
        }
    })?;
    Ok(receiver)
}

fn open(args: &Run) -> Result<(String, Box<dyn BufRead + Send>), Failure> {
    let name = args.file.display().to_string();
    if name == "-" {
        return Ok((name, Box::new(BufReader::new(io::stdin()))));
    }
    let file = File::open(&args.file).map_err(|error| Failure::Input(format!("{name}: {error}")))?;
    Ok((name, Box::new(BufReader::new(file))))
}
