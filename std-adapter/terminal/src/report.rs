//! An error and its hint on the standard error.

use std::fmt::Display;
use std::io::Write as _;

use anstyle::{AnsiColor, Style};

use crate::escape;

const RED: Style = AnsiColor::Red.on_default().bold();
const CYAN: Style = AnsiColor::Cyan.on_default();

/// Prints `error: MESSAGE`, and below it each line of `more` as ` LABEL: TEXT`. In colour, if the standard error has colours.
pub fn error(message: &impl Display, more: &[(&str, &str)]) {
    let mut err = anstream::stderr().lock();
    // an error of the standard error cannot be reported
    let _ = writeln!(err, "{RED}error:{RED:#} {}", escape::failure(message));
    for (label, text) in more {
        let _ = writeln!(err, " {CYAN}{label}:{CYAN:#} {}", escape::failure(text));
    }
}
