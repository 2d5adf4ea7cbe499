//! Asks the user before the command moves a robot, or changes what cannot be restored.
//!
//! A virtual controller is changed without a question. It is one only if it says so twice, with the firmware of the simulator
//! and the serial number that no real controller has. Any other answer means a real controller.

use std::io::{self, BufRead, IsTerminal, Write};

use bcap_live::variables::is_virtual;
use bcap_terminal::escape;

use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::session::Session;

/// A question to the user.
pub(crate) struct Question<'a> {
    /// The change that the command is about to make.
    pub(crate) what: &'a str,
    /// A warning to the user.
    pub(crate) warning: &'a str,
    /// The outcome after a refusal.
    pub(crate) refused: &'a str,
}

impl Question<'_> {
    /// Returns if the user has given `--yes`, if the controller is virtual, or if the user agrees.
    ///
    /// # Errors
    ///
    /// [`Failure::Input`] if the user does not agree or cannot be asked, [`Failure::Interrupted`] after a signal, and the
    /// failure of a lost connection.
    pub(crate) fn confirm(&self, session: &mut Session, yes: bool) -> Result<(), Failure> {
        if yes {
            return Ok(());
        }
        if session.before_question(is_virtual)? {
            return Ok(());
        }
        let answered = self.ask();
        session.restart_budget();
        answered
    }

    /// Returns if the user has given `--yes`, or agrees. This includes virtual controllers: the user confirms facts that the
    /// controller does not report.
    ///
    /// # Errors
    ///
    /// Same as [`confirm`](Self::confirm).
    pub(crate) fn confirm_by_person(&self, session: &mut Session, yes: bool) -> Result<(), Failure> {
        let answered = if yes { Ok(()) } else { self.ask() };
        session.restart_budget();
        answered
    }

    /// Asks on the terminal, and returns if the user agrees.
    pub(crate) fn ask(&self) -> Result<(), Failure> {
        let Self { what, warning, refused } = self;
        let input = io::stdin();
        if !input.is_terminal() {
            return Err(Failure::Input(format!(
                "{what}: cannot ask for confirmation, as stdin is not a terminal; give --yes"
            )));
        }
        let mut err = anstream::stderr().lock();
        write!(err, "{}. {warning} Continue? [y/N] ", escape::line(what))?;
        err.flush()?;
        drop(err);
        wait_for_line(refused)?;
        let mut line = String::new();
        input.lock().read_line(&mut line)?;
        match line.trim().to_ascii_lowercase().as_str() {
            "y" | "yes" => Ok(()),
            _ => Err(Failure::Input(format!("not confirmed: {refused}"))),
        }
    }
}

/// Waits for a line of the terminal; a signal ends that with an error.
fn wait_for_line(refused: &str) -> Result<(), Failure> {
    loop {
        if Interrupt::of_process().is_some_and(|interrupt| interrupt.is_interrupted()) {
            // after the question
            anstream::eprintln!();
            return Err(Failure::Interrupted(format!("interrupted: {refused}")));
        }
        if has_line()? {
            return Ok(());
        }
    }
}

/// Returns whether the terminal has a line, at the latest after a moment.
#[cfg(unix)]
fn has_line() -> io::Result<bool> {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    /// Interval at which a question checks for a signal: 50 ms.
    const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
    let stdin = io::stdin();
    let mut input = [PollFd::new(&stdin, PollFlags::IN)];
    match poll(&mut input, Some(&LOOK)) {
        Ok(ready) => Ok(ready > 0),
        Err(rustix::io::Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Reading the line waits for it.
#[cfg(not(unix))]
fn has_line() -> io::Result<bool> {
    Ok(true)
}
