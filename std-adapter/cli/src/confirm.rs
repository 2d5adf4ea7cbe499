//! Asks the user before the command does something that cannot be undone.

use std::io::{self, BufRead, IsTerminal, Write};

use crate::error::Failure;
use crate::escape;

/// Prints `what` and `question`, and returns if the user agrees or has given `--yes`; `refused` is the error otherwise.
pub(crate) fn confirm(what: &str, question: &str, refused: &str, yes: bool) -> Result<(), Failure> {
    if yes {
        return Ok(());
    }
    let input = io::stdin();
    if !input.is_terminal() {
        return Err(Failure::Input(format!(
            "{what}: cannot ask for confirmation, as stdin is not a terminal; give --yes"
        )));
    }
    let mut err = anstream::stderr().lock();
    write!(err, "{}. {question} Continue? [y/N] ", escape::line(what))?;
    err.flush()?;
    let mut line = String::new();
    input.lock().read_line(&mut line)?;
    match line.trim().to_ascii_lowercase().as_str() {
        "y" | "yes" => Ok(()),
        _ => Err(Failure::Input(format!("not confirmed: {refused}"))),
    }
}
